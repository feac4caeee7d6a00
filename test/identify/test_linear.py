# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The family "linear": known systems, simulated by scipy's own discretisation, are found again from any excitation."""

import json
import tracemalloc
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.signal import chirp, cont2discrete, dlsim, dlti, lfilter

from hyst_control.base.errors import InputError
from hyst_control.identify import identify
from hyst_control.identify.assess import fit_report
from hyst_control.identify.modal import coupled_linear, search_parts
from hyst_control.model_file import simulate
from hyst_control.records.record import Record, sampled_record
from hyst_control.records.stream import row_store

SAMPLE_TIME = 1e-4
FREQUENCY, DAMPING, GAIN = 600.0, 0.05, 0.1


def plant(command: np.ndarray, whole_delay: int, offset: float = 0.0) -> np.ndarray:
    """A resonance behind a DAC, at rest at its first command, by scipy; command and result (N, 1)."""
    w = 2 * np.pi * FREQUENCY
    a, b, c, d, _ = cont2discrete((*_companion(w),), SAMPLE_TIME, "zoh")
    late = np.concatenate([np.repeat(command[:1], whole_delay, axis=0), command])[: len(command)]
    _, response, _ = dlsim(dlti(a, b, c, d, dt=SAMPLE_TIME), late - late[0])
    return response + GAIN * command[0] + offset


def _companion(w: float):
    return (
        np.array([[0.0, 1.0], [-w * w, -2 * DAMPING * w]]),
        np.array([[0.0], [GAIN * w * w]]),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
    )


def sweep(samples: int = 6000) -> np.ndarray:
    t = np.arange(samples) * SAMPLE_TIME
    return (10 + 5 * np.sin(2 * np.pi * (5 * t + 1500 * t**2 / (2 * t[-1]))))[:, None]


def step(samples: int = 4000) -> np.ndarray:
    return np.where(np.arange(samples) > 500, 20.0, 10.0)[:, None]


def made(command: np.ndarray, noise: float = 1e-3, delay: int = 2, name: str = "record") -> Record:
    rng = np.random.default_rng(len(command) + delay)
    measurement = plant(command, delay, offset=3.0) + noise * rng.normal(size=command.shape)
    return sampled_record(name, command, measurement, SAMPLE_TIME, ("x",), "um", "zoh", start="settled")


def entries(report: dict) -> dict[str, dict]:
    return {row["name"]: row for row in report["parameters"]}


@pytest.mark.parametrize("command", [sweep(), step()], ids=["sweep", "step"])
def test_frequency_damping_delay_and_gain_are_found_within_their_errors(command):
    found = identify([made(command)], "linear")
    rows = entries(found.report)
    for name, true in (("frequency[0]", FREQUENCY), ("damping[0]", DAMPING)):
        assert abs(rows[name]["value"] - true) < 5 * rows[name]["standard_error"] + 1e-4 * true
    held = simulate(found.model, step())
    truth = plant(step(), 2, offset=3.0)
    assert np.sqrt(np.mean((held - truth) ** 2)) < 2e-3 * np.ptp(truth)


def test_a_model_of_one_kind_of_record_predicts_another():
    found = identify([made(sweep(), name="sweep"), made(step(), name="step"), made(sweep(5000), name="other")], "linear")
    command = 10 + np.cumsum(np.random.default_rng(5).normal(size=(3000, 1)) * 0.1, axis=0)
    truth = plant(command, 2, offset=3.0)
    assert np.max(np.abs(simulate(found.model, command) - truth)) < 5e-3 * np.ptp(truth)
    assert found.report["states"] == 2
    assert found.model.noise["sigma"][0] == pytest.approx(1e-3, rel=0.2)


def test_two_axes_that_couple_become_one_state_space():
    rng = np.random.default_rng(3)
    a = np.zeros((4, 4))
    for at, (w, z) in enumerate(((2 * np.pi * 400, 0.03), (2 * np.pi * 900, 0.02))):
        a[2 * at : 2 * at + 2, 2 * at : 2 * at + 2] = [[0, w], [-w, -2 * z * w]]
    b = np.array([[0, 0], [900.0, 300.0], [0, 0], [-500.0, 1200.0]])
    c = np.array([[1.0, 0, 0.4, 0], [-0.3, 0, 1.0, 0]])
    ad, bd, cd, dd, _ = cont2discrete((a, b, c, np.zeros((2, 2))), SAMPLE_TIME, "zoh")
    records = []
    for index in range(3):
        command = rng.normal(size=(4000, 2))
        command[0] = 0.0
        _, response, _ = dlsim(dlti(ad, bd, cd, dd, dt=SAMPLE_TIME), command)
        records.append(
            sampled_record(
                f"r{index}",
                command,
                response + 1e-4 * rng.normal(size=response.shape),
                SAMPLE_TIME,
                ("x", "y"),
                "mrad",
                start="settled",
            )
        )
    found = identify(records[:2], "linear")
    assert [stage.name for stage in found.model.chain.stages][-1] == "state_space"
    error = simulate(found.model, records[2].command) - records[2].measurement
    assert np.all(error.std(axis=0) < 1.5e-4)
    frequencies = sorted(row["value"] for name, row in entries(found.report).items() if name.startswith("frequency"))
    assert np.allclose(frequencies, [400, 900], rtol=1e-3)


def test_axes_that_do_not_couple_become_transfer_functions():
    one, other = made(sweep()), made(sweep(), delay=5)
    both = sampled_record(
        "both",
        np.hstack([one.command, other.command[::-1]]),
        np.hstack([one.measurement, plant(other.command[::-1], 5)]),
        SAMPLE_TIME,
        ("x", "y"),
        "um",
        start="settled",
    )
    found = identify([both], "linear", coupled=False)
    assert "transfer_function" in [stage.name for stage in found.model.chain.stages]
    error = simulate(found.model, both.command) - both.measurement
    assert np.all(error.std(axis=0) < 5e-3 * both.span)


def test_every_pole_is_stable_even_from_noise_alone():
    rng = np.random.default_rng(0)
    data = sampled_record(
        "noise", rng.normal(size=(2000, 1)), rng.normal(size=(2000, 1)), SAMPLE_TIME, ("x",), "um", start="settled"
    )
    found = identify([data], "linear", order=6, delay=0.0)
    den = next(stage for stage in found.model.chain.stages if stage.name == "transfer_function").den
    assert np.all(np.roots(den).real < 0)


def test_the_report_of_a_single_step_is_json():
    """Blocks of rows are held out of a single step, too; no number of its report is one that no JSON document may hold."""
    found = identify([made(step())], "linear", order=2, delay=2e-4)
    report = json.loads(json.dumps(found.report, allow_nan=False))
    assert report["orders"] and all(0.0 < row["held_out"] < 0.01 for row in report["orders"])


@pytest.mark.parametrize(
    "records, words",
    [
        ([], "no record"),
        ([sampled_record("still", np.zeros((100, 1)), np.zeros((100, 1)), 1e-3, ("x",), "um", start="settled")], "never moves"),
        ([sampled_record("short", np.ones((8, 1)), np.ones((8, 1)), 1e-3, ("x",), "um", start="settled")], "at least 32"),
        ([made(step(100)), sampled_record("slow", step(100), step(100), 1e-3, ("x",), "um", start="settled")], "sample time"),
        (
            [sampled_record("broken", step(100) * np.nan, step(100), 1e-3, ("x",), "um", start="settled")],
            "command: must be finite, is not in sample 0",
        ),
    ],
)
def test_unusable_records_are_refused_in_one_line(records, words):
    with pytest.raises(InputError, match=words) as caught:
        identify(records, "linear")
    assert "\n" not in str(caught.value)


def test_an_order_that_the_rows_cannot_tell_is_refused():
    with pytest.raises(InputError, match="order: 400 states are more than 500 rows can tell: give 62 or fewer"):
        identify([made(sweep(500))], "linear", order=400)


def test_one_line_tells_a_gain_and_no_more():
    """Whole periods of one sine excite one frequency: the fit has that frequency's gain, and does not fail for want of a second one."""
    command = np.sin(2 * np.pi * np.arange(2000) / 100.0)[:, None]
    model = identify([sampled_record("sine", command, 0.7 * command, 1e-4, ("x",), "um", start="settled")], "linear").model
    found = simulate(model, np.tile(command, (2, 1)))[2000:]
    np.testing.assert_allclose(np.ptp(found), 2 * 0.7, rtol=0.02)


def late_lag(seed: int, count: int = 269) -> tuple[np.ndarray, np.ndarray]:
    """A first-order lag of 20 ms and 0.12 um/V, in closed form between reads at 50 Hz that come some ms late: command and result (N,)."""
    rng = np.random.default_rng(seed)
    lines, phases = np.arange(2, 21) / 4.0, rng.uniform(0.0, 2 * np.pi, 19)
    time = np.arange(count) / 50.0
    command = 40.0 + 8.0 * np.sqrt(2 / 19) * np.sum(np.sin(2 * np.pi * lines * time[:, None] + phases), axis=1)
    reads = time + rng.exponential(0.5e-3, count) + np.where(rng.random(count) < 0.02, 8e-3, 0.0)
    steps, applied = np.diff(reads, prepend=reads[0] - 0.02), np.concatenate([command[:1], command])
    measurement, y = np.empty(count), 0.12 * command[0]
    for k in range(count):
        y += (0.12 * applied[k] - y) * -np.expm1(-steps[k] / 0.020)
        measurement[k] = y
    return command, measurement


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("gap", [None, (42, 60), (100, 130)], ids=["whole", "early gap", "gap"])
def test_a_lag_read_at_unsteady_times_stays_a_lag(seed, gap):
    command, measurement = late_lag(seed)
    parts = [slice(None)] if gap is None else [slice(0, gap[0]), slice(gap[1], None)]
    records = [
        sampled_record("late", command[part, None], measurement[part, None], 0.02, ("x",), "um", "zoh", start="settled")
        for part in parts
    ]
    found = identify(records, "linear")
    t = np.arange(200) / 50.0
    answer = simulate(found.model, 40.0 + 8.0 * np.sin(2 * np.pi * t)[:, None])[100:, 0]
    gain = abs(np.exp(-2j * np.pi * t[100:]) @ (answer - answer.mean())) / 400.0
    assert gain == pytest.approx(0.12 / abs(1 + 2j * np.pi * 0.020), rel=0.03)
    assert 1 <= found.report["states"] <= 3


@pytest.mark.parametrize(
    ("lengths", "kept", "held"),
    [([300], [200], [100]), ([300, 300], [300], [300]), ([90, 600], [90, 400], [200]), ([300] * 5, [300] * 4, [300])],
)
def test_the_smaller_part_of_the_rows_is_held_out(lengths, kept, held):
    command = np.random.default_rng(1).normal(size=(max(lengths), 1))
    records = [
        sampled_record("r", command[:count], command[:count], 1e-3, ("x",), "um", "zoh", start="settled") for count in lengths
    ]
    assert [[len(data.command) for data in part] for part in coupled_linear.held_out_split(records)] == [kept, held]


def test_the_part_that_moves_is_held_out_where_the_end_of_a_record_is_at_rest():
    command = np.random.default_rng(1).normal(size=(900, 1))
    command[500:] = 0.0
    data = sampled_record("r", command, command, 1e-3, ("x",), "um", "zoh", start="settled")
    kept, held = coupled_linear.held_out_split([data])
    assert [len(part.command) for part in kept] == [300, 300]
    np.testing.assert_array_equal(held[0].command, command[300:600])


def test_a_long_record_is_taken_in_parts(monkeypatch):
    """A slow sweep, of which no part excites the whole band, and a rest at its end: as good as whole, and never held twice."""
    rows, part = 2**16, 2**12
    time = np.arange(rows) * SAMPLE_TIME
    command = (10 + 5 * np.sin(2 * np.pi * (5 * time + 1500 * time**2 / (2 * time[-1]))))[:, None]
    command[-2 * part :] = command[-2 * part]
    data = made(command)
    monkeypatch.setattr(coupled_linear, "WHOLE_ROWS", 2 * part)
    monkeypatch.setattr(coupled_linear, "PART_ROWS", part)
    monkeypatch.setattr(coupled_linear, "PART_LINES", part)
    tracemalloc.start()
    parts = coupled_linear.spectra_of_records([data])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(parts) == rows // part - 2
    assert peak < command.nbytes
    found = entries(identify([data], "linear", order=2).report)
    for name, true in (("frequency[0]", FREQUENCY), ("damping[0]", DAMPING)):
        assert abs(found[name]["value"] - true) < 5 * found[name]["standard_error"] + 1e-4 * true


def swept(modes: Sequence[tuple[float, float]], damping: float, rows: int) -> Record:
    """A stage with modes of these frequencies (Hz) and gains under a slow sweep at 20 kHz."""
    rate = 20e3
    time = np.arange(rows) / rate
    command = 50.0 + 5.0 * chirp(time, 1.0, time[-1], 1500.0, phi=-90)
    measurement = 0.05 * np.random.default_rng(0).normal(size=rows) + command[0]
    for frequency, share in modes:
        w = 2 * np.pi * frequency
        num, den, _ = cont2discrete(([share * w**2], [1.0, 2.0 * damping * w, w**2]), 1.0 / rate, "zoh")
        measurement += lfilter(num[0], den, command - command[0])
    return sampled_record("sweep", command[:, None], measurement[:, None], 1.0 / rate, ("x",), "um", "zoh", start="settled")


def test_modes_that_a_long_sweep_passes_in_a_few_rows_are_found():
    """Parts that are spread evenly over the record hold neither of them."""
    found = identify([swept(((310.0, 0.8), (1230.0, 0.2)), 0.005, 120_000)], "linear")
    assert found.report["states"] == 4
    known = entries(found.report)
    assert [known[f"frequency[{i}]"]["value"] for i in range(2)] == pytest.approx([310.0, 1230.0], rel=1e-3)


def test_more_narrow_modes_than_parts_are_searched_are_found(monkeypatch):
    """The structure of the first parts has no third mode: a part where it leaves much is searched too."""
    monkeypatch.setattr(search_parts, "SEARCH_ROWS", 8_000)
    modes = ((310.0, 0.8), (820.0, 0.1), (1230.0, 0.8))
    known = entries(identify([swept(modes, 0.001, 120_000)], "linear", order=6).report)
    assert [known[f"frequency[{i}]"]["value"] for i in range(3)] == pytest.approx([each for each, _ in modes], rel=1e-3)


def test_the_mean_of_residuals_is_that_of_all_their_rows(monkeypatch):
    """Also where they come in several blocks."""
    monkeypatch.setattr(row_store, "BLOCK", 100)
    rng = np.random.default_rng(3)
    residuals = [rng.normal(0.1, 1.0, (count, 2)) for count in (250, 70)]
    mean, square = fit_report.mean_of(residuals)
    together = np.concatenate(residuals)
    np.testing.assert_allclose(mean, together.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(square, np.mean(together**2, axis=0), rtol=1e-12)
