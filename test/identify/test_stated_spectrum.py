"""Spectrum of the own error in a model file: the power of known lines and noise, and what a reader makes of it on another record."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from hyst_control.base.errors import InputError
from hyst_control.identify.model_error.stated_spectrum import StatedSpectrum, band_edges, spectrum_on_new_records

STEP, ROWS, NOISE = 1e-3, 4000, 0.01
TIME = STEP * np.arange(ROWS)
COMMAND = np.sin(2 * np.pi * 5.0 * TIME)


def noise(seed: int, rows: int = ROWS) -> np.ndarray:
    return NOISE * np.random.default_rng(seed).standard_normal(rows)


def stated(line: float = 0.2) -> StatedSpectrum:
    """Output of 3 um at 5 Hz; an error of a line at 15 Hz, twice measured."""
    errors = [line * np.sin(2 * np.pi * 15.0 * TIME + phase) + noise(seed) for seed, phase in enumerate((0.3, 1.4))]
    measured = [3.0 * COMMAND + error for error in errors]
    return StatedSpectrum.of([COMMAND, COMMAND], errors, errors, measured, STEP)


def at(spectrum: StatedSpectrum, frequency: float) -> int:
    return int(np.searchsorted(spectrum.frequencies, frequency, side="right")) - 1


def on_new(spectrum: StatedSpectrum, output: np.ndarray, relative: float) -> tuple[np.ndarray, np.ndarray]:
    found = spectrum_on_new_records([spectrum], [output[:, None]], STEP, 5.0, np.array([relative]), False)
    return found.frequencies, found.power[:, 0]


def test_a_line_has_the_power_of_its_amplitude():
    """Cosine coefficients of a line add up to N a² / 2; three bins around it are averaged."""
    found = stated()
    assert found.error[at(found, 15.0)] == pytest.approx(ROWS * 0.2**2 / 2 / 3, rel=0.35)
    assert found.output[at(found, 5.0)] == pytest.approx(ROWS * 3.0**2 / 2 / 3, rel=0.35)
    assert found.noise == pytest.approx(NOISE, rel=0.1)
    assert found.output_rms == pytest.approx(3.0 / np.sqrt(2.0), rel=0.01)


def test_far_from_every_line_there_is_the_noise_alone():
    found = stated()
    assert np.all(found.error[at(found, 60.0) :] < 3.0 * NOISE**2)


def test_a_file_keeps_it():
    document = yaml.safe_load(yaml.safe_dump(stated().document()))
    back, found = StatedSpectrum.from_document(document), stated()
    assert back.error == pytest.approx(found.error, rel=6e-3)
    assert back.output == pytest.approx(found.output, rel=6e-3)
    assert back.rest is back.error
    assert len(document["frequencies"]) < 100


@pytest.mark.parametrize(
    "change",
    [{"error": [1.0]}, {"rows": 0}, {"noise": -1.0}, {"output": "much"}, {"frequencies": None}, {"output_rms": float("nan")}],
)
def test_another_form_is_refused(change):
    document = {**stated().document(), **change}
    with pytest.raises(InputError, match=r"discrepancy\.spectrum: .* identify the model again"):
        StatedSpectrum.from_document(document)


def test_the_same_command_at_another_sample_time_has_the_same_error():
    found = stated()
    time = 0.5 * STEP * np.arange(2 * ROWS)
    new = spectrum_on_new_records([found], [3.0 * np.sin(2 * np.pi * 5.0 * time)[:, None]], 0.5 * STEP, 5.0, np.array([0.1]), False)
    line = int(np.argmin(np.abs(new.frequencies - 15.0)))
    # Twice the rows in the same time: a line of that amplitude has twice the power.
    assert new.power[line, 0] == pytest.approx(2.0 * found.error[at(found, 15.0)], rel=0.01)


def test_a_command_that_drives_more_raises_the_error_in_proportion():
    """Output three times as large at 5 Hz: nine times the power of the error there, and next to none elsewhere."""
    errors = [0.1 * COMMAND + noise(seed) for seed in (1, 2)]
    found = StatedSpectrum.of([COMMAND] * 2, errors, errors, [3.0 * COMMAND + error for error in errors], STEP)
    frequencies, power = on_new(found, 3.0 * 3.0 * COMMAND, 0.1 / 3.0)
    here, far = int(np.argmin(np.abs(frequencies - 5.0))), int(np.argmin(np.abs(frequencies - 100.0)))
    assert power[here] == pytest.approx(9.0 * found.error[at(found, 5.0)], rel=0.25)
    assert power[far] < 1e-4 * power[here]


def test_where_the_clean_commands_drove_nothing_the_usual_share_of_the_output_is_taken():
    frequencies, power = on_new(stated(), np.sin(2 * np.pi * 80.0 * TIME), 0.1)
    here = int(np.argmin(np.abs(frequencies - 80.0)))
    assert power[here] == pytest.approx(0.1**2 * ROWS / 2 / 3, rel=0.4)


@pytest.mark.parametrize("rows", [16, 100, 1024, 4000, 8192, 99999])
def test_bands_begin_with_every_coefficient_and_end_within_the_record(rows):
    edges = band_edges(rows)
    assert edges[0] == 0 and edges[1] == 1 and edges[-1] < rows
    assert np.all(np.diff(edges) > 0)
    assert np.max(edges[2:] / edges[1:-1]) <= 2.0
