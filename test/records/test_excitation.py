# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Excitation signals: their spectra, bounds, periods and joints, from closed forms."""

from inspect import signature

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.records.excitation.excitation import KINDS, build, multisine_lines
from hyst_control.records.excitation.parameters import declarations, described
from hyst_plant_sim.physics import PLANTS, load_plant

STEP = 1e-4
SUM = {"signal": "multi_frequency", "frequencies": [1.0, 2.0], "amplitudes": [1.0, 1.0]}
LEVELS = {"signal": "steps", "lowest": 0.0, "highest": 1.0, "hold": 0.1, "count": 3}


def test_a_multisine_has_power_on_its_lines_only():
    spec = {
        "signal": "multisine",
        "period": 0.5,
        "lower_frequency": 10.0,
        "upper_frequency": 400.0,
        "rms": 2.0,
        "offset": 30.0,
        "periods": 3,
        "detection": 4,
        "avoid_mains": True,
        "seed": 5,
    }
    rows = build(spec, STEP, 2)
    assert rows.shape == (15000, 2)
    np.testing.assert_array_equal(rows[:5000], rows[5000:10000])
    lines = multisine_lines(0.5, 10.0, 400.0, True, 4, True, 5)
    assert np.all(lines % 2 == 1) and len(np.setdiff1d(np.arange(5, 201, 2), lines)) > len(lines) // 5
    assert not any(abs(line / 0.5 - mains * k) < 2.0 for line in lines for mains in (50, 60) for k in range(1, 9))
    for axis in range(2):
        amplitude = 2 * np.abs(np.fft.rfft(rows[:5000, axis] - 30.0)) / 5000
        np.testing.assert_allclose(amplitude[lines], amplitude[lines][0], rtol=1e-9)
        amplitude[lines] = 0.0
        assert amplitude.max() < 1e-9
        assert np.std(rows[:5000, axis]) == pytest.approx(2.0)
    assert np.abs(np.corrcoef(rows[:5000].T)[0, 1]) < 0.5
    np.testing.assert_array_equal(rows, build(spec, STEP, 2))
    assert not np.array_equal(rows, build({**spec, "seed": 6}, STEP, 2))


def test_closed_forms():
    time = np.arange(1000) * STEP
    sine = build({"signal": "sine", "frequency": 30.0, "amplitude": 2.0, "offset": 5.0, "duration": 0.1}, STEP)[:, 0]
    np.testing.assert_allclose(sine, 5 + 2 * np.sin(2 * np.pi * 30 * time), atol=1e-12)
    triangle = build({"signal": "triangle", "frequency": 10.0, "amplitude": 3.0, "offset": 3.0, "duration": 0.1}, STEP)[:, 0]
    assert triangle[0] == 0.0 and triangle.max() == pytest.approx(6.0)
    np.testing.assert_allclose(np.abs(np.diff(triangle)), 4 * 3.0 * 10.0 * STEP, rtol=1e-9)
    many = build(
        {"signal": "multi_frequency", "frequencies": [15.0, 40.0], "amplitudes": [-19.2, -10.7], "offset": 50.0, "duration": 0.1},
        STEP,
    )[:, 0]
    np.testing.assert_allclose(many, 50 - 19.2 * np.sin(30 * np.pi * time) - 10.7 * np.sin(80 * np.pi * time), atol=1e-12)


@pytest.mark.parametrize("logarithmic", [True, False])
def test_a_sweep_runs_through_its_frequencies(logarithmic):
    sweep = build(
        {
            "signal": "sweep",
            "start_frequency": 10.0,
            "stop_frequency": 200.0,
            "amplitude": 1.0,
            "duration": 2.0,
            "logarithmic": logarithmic,
        },
        1e-5,
    )[:, 0]
    crossings = np.flatnonzero(np.diff(np.sign(sweep)))
    frequency = 0.5 / (np.diff(crossings) * 1e-5)
    middle = 1e-5 * 0.5 * (crossings[1:] + crossings[:-1])
    expected = 10.0 * 20.0 ** (middle / 2.0) if logarithmic else 10.0 + 95.0 * middle
    np.testing.assert_allclose(frequency, expected, rtol=0.02)


def test_two_axis_figures():
    spiral = build({"signal": "spiral", "radius": 1.0, "frequency": 20.0, "duration": 1.0}, STEP, 2)
    np.testing.assert_allclose(np.hypot(*spiral.T), np.arange(10000) / 10000, atol=1e-12)
    raster = build({"signal": "raster", "width": 2.0, "height": 1.0, "lines": 10, "line_time": 0.1}, STEP, 2)
    assert (
        np.ptp(raster[:, 0]) == pytest.approx(2.0)
        and np.all(np.diff(raster[:, 1]) > 0)
        and np.ptp(raster[:, 1]) == pytest.approx(1.0)
    )
    with pytest.raises(InputError, match="two axes are needed"):
        build({"signal": "spiral", "radius": 1.0, "frequency": 20.0, "duration": 1.0}, STEP, 1)


def test_a_joined_sequence_does_not_jump():
    parts = [
        {"signal": "rest", "duration": 0.01, "offset": 1.0},
        {"signal": "rest", "duration": 0.01, "offset": 9.0},
        {"signal": "sine", "frequency": 10.0, "amplitude": 1.0, "duration": 0.1},
    ]
    joined = build({"signal": "sequence", "parts": parts, "join": 0.05}, STEP)[:, 0]
    assert np.abs(np.diff(joined)).max() <= 9.0 * np.pi / 2 * STEP / 0.05 * 1.001
    assert np.abs(np.diff(build({"signal": "sequence", "parts": parts}, STEP)[:, 0])).max() == pytest.approx(9.0)


@pytest.mark.parametrize(
    "spec, lowest, highest",
    [
        ({"signal": "hampi_identification", "peak": 60.0}, 0.0, 60.0),
        ({"signal": "mhl_identification", "peak": 100.0}, 0.0, 100.0),
        ({"signal": "diagnostic", "lowest": 5.0, "highest": 85.0}, 5.0, 85.0),
    ],
)
@pytest.mark.parametrize("axes", [1, 2])
def test_records_keep_within_the_drive_and_begin_and_end_at_rest(spec, lowest, highest, axes):
    rows = build({**spec, "lower": lowest, "upper": highest}, STEP, axes)
    assert rows.shape[1] == axes and rows.min() == pytest.approx(lowest) and rows.max() > lowest + 0.8 * (highest - lowest)
    np.testing.assert_allclose(rows[:50], lowest)
    np.testing.assert_allclose(rows[-50:], lowest)


def test_the_diagnostic_record_repeats_its_multisines():
    """Two equal periods of each multisine: their difference is what a record has of noise and drift."""
    rows = build({"signal": "diagnostic", "lowest": 0.0, "highest": 80.0, "duration": 1.5}, STEP)[:, 0]
    period = 2000
    equal = np.array(
        [
            np.array_equal(rows[k : k + period], rows[k + period : k + 2 * period]) and np.ptp(rows[k : k + period]) > 1.0
            for k in range(len(rows) - 2 * period)
        ]
    )
    assert equal.sum() == 2


@pytest.mark.parametrize(
    "signal",
    [
        {"signal": "step", "height": 60.0, "offset": 20.0},
        {"signal": "steps", "lowest": 0.0, "highest": 80.0, "hold": 0.01, "count": 9},
        {"signal": "staircase", "levels": [0.0, 70.0, 10.0], "hold": 0.02},
        {"signal": "diagnostic", "lowest": 0.0, "highest": 80.0},
    ],
)
def test_jumps_are_spread_so_that_the_rate_is_kept(signal):
    """The rest of the signal is as without the bound; a jump goes straight, at the bound or a little under it."""
    free, bounded = build(signal, STEP, 2), build({**signal, "slew_limit": 6e4}, STEP, 2)
    rate = np.abs(np.diff(bounded, axis=0)) / STEP
    assert np.abs(np.diff(free, axis=0)).max() / STEP > 6e4 >= rate.max() * (1 - 1e-9)
    for axis in range(2):
        jumps = np.flatnonzero(np.abs(np.diff(free[:, axis])) > 6e4 * STEP * (1 + 1e-9))
        near = (jumps[:, None] + np.arange(1, 15)).ravel()  # 80 V take 14 samples
        others = np.setdiff1d(np.arange(len(free)), near)
        np.testing.assert_array_equal(bounded[others, axis], free[others, axis])


@settings(max_examples=40, deadline=None)
@given(levels=st.lists(st.floats(-50.0, 50.0), min_size=2, max_size=6), most=st.floats(0.5, 200.0))
def test_a_staircase_with_long_holds_keeps_any_rate(levels, most):
    rows = build({"signal": "staircase", "levels": levels, "hold": 0.03, "slew_limit": most / STEP}, STEP)[:, 0]
    assert np.abs(np.diff(rows)).max() <= most * (1 + 1e-6) and rows[-1] == levels[-1]


@pytest.mark.parametrize("name", PLANTS)
def test_the_diagnostic_record_is_bounded_for_the_plant_at_hand(name, tmp_path, capsys):
    """`hyst excite --plant`: within rating and slew limit, on the plant's axes; what is beyond the rating is refused."""
    plant = load_plant(name)
    low, high = plant.rating
    words = ["excite", "diagnostic", f"lowest={low}", "duration=0.5", f"highest={high}", "--plant", name]
    assert main([*words, "--output", str(tmp_path / "record.npy")]) == 0
    rows = np.load(tmp_path / "record.npy")
    assert f" {len(rows) / 20000:g} s (duration=0.5 s does not count ramps and steps), " in capsys.readouterr().out
    assert rows.shape[1] == len(plant.axes) and rows.min() == low and rows.max() == pytest.approx(high)
    assert np.abs(np.diff(rows, axis=0)).max() * 20000 <= plant.slew_limit * (1 + 1e-9)
    for more in ([f"highest={2 * high}"], ["highest=1", "--unit", "um"], ["highest=1", "--axes", "3"]):
        assert main([*words[:4], *more, "--plant", name, "--output", str(tmp_path / "other.npy")]) == 2
    assert not (tmp_path / "other.npy").exists()


def test_a_sine_grows():
    rows = build({"signal": "decaying_sine", "frequency": 25.0, "amplitude": 0.0, "final": 4.0, "duration": 0.4}, STEP)[:, 0]
    peaks = [np.abs(piece).max() for piece in np.split(rows, 20)]
    assert np.all(np.diff(peaks) > 0) and peaks[-1] == pytest.approx(4.0, rel=0.05)


@pytest.mark.parametrize(
    "spec, words",
    [
        ({"signal": "sign"}, "'sign' is not known, one of"),
        ({"signal": "sine", "frequency": 10.0}, "sine: amplitude: is missing"),
        ({"signal": "sine", "frequency": 10.0, "amplitude": 1.0, "freq": 2.0}, "sine: freq: no such parameter"),
        ({"signal": "sine", "frequency": 10.0, "amplitude": 60.0, "upper": 50.0}, "runs from -60 to 60, 10 beyond"),
        ({"signal": "sine", "frequency": 100.0, "amplitude": 1.0, "slew_limit": 100.0}, "rate reaches 6"),
        ({"signal": "sine", "frequency": "ten", "amplitude": 1.0}, "sine: frequency: must be a number, got 'ten'"),
        ({**SUM, "frequencies": [1.0, "ten"]}, "multi_frequency: frequencies: must be a number, got 'ten'"),
        ({**LEVELS, "highest": 10**400}, "steps: highest: must be a number, got 1000"),
        ({**SUM, "frequencies": 10.0}, "multi_frequency: frequencies: must be a list of numbers"),
        ({**LEVELS, "seed": -1}, "steps: seed: must be a whole number >= 0, got -1"),
        ({**LEVELS, "count": 2.5}, "steps: count: must be a whole number >= 0, got 2.5"),
        ({**LEVELS, "count": float("inf")}, "steps: count: must be a whole number >= 0, got inf"),
        ({"signal": "rest", "duration": 1e12}, "too long for memory"),
        ({"signal": "rest", "duration": 0.0}, "shorter than a sample"),
        (
            {"signal": "multisine", "period": 0.01234567, "lower_frequency": 1.0, "upper_frequency": 9.0, "rms": 1.0},
            "no whole number",
        ),
        ({"signal": "sequence", "parts": [{"signal": "rest"}]}, r"sequence: parts\[0\]: rest: duration: is missing"),
        ({"signal": "rest", "duration": 1.0, "axis": 3}, "axis: 3, 0 to 0"),
    ],
)
def test_unusable_descriptions_are_named(spec, words):
    with pytest.raises(InputError, match=words):
        build(spec, STEP)


@pytest.mark.parametrize(
    "spec, name",
    [
        ({"signal": "sine", "frequency": 900.0, "amplitude": 1.0}, "frequency"),
        ({"signal": "spiral", "frequency": -900.0, "radius": 1.0, "duration": 1.0}, "frequency"),
        ({"signal": "triangle", "frequency": 500.0, "amplitude": 1.0}, "frequency"),
        ({"signal": "loops", "frequency": 900.0, "peak": 1.0, "cycles": 9}, "frequency"),
        ({**SUM, "frequencies": [1.0, 900.0]}, "frequencies"),
        ({"signal": "multisine", "period": 0.1, "lower_frequency": 10.0, "upper_frequency": 900.0, "rms": 1.0}, "upper_frequency"),
        ({"signal": "sweep", "start_frequency": 1.0, "stop_frequency": 900.0, "amplitude": 1.0}, "stop_frequency"),
        ({"signal": "hampi_identification", "frequencies": [10.0, 500.0]}, "frequencies"),
    ],
)
def test_frequencies_that_the_rate_cannot_show_are_refused(spec, name):
    with pytest.raises(InputError, match=f"^{spec['signal']}: {name}: must be below half the sample rate, 500 Hz"):
        build(spec, 1e-3)


def test_a_spiral_of_negative_frequency_turns_the_other_way():
    spec = {"signal": "spiral", "radius": 1.0, "duration": 1.0}
    there, back = (build({**spec, "frequency": frequency}, 1e-3, 2) for frequency in (7.0, -7.0))
    np.testing.assert_array_equal(back, there * [1.0, -1.0])


def test_frequencies_by_default_are_those_that_the_rate_can_show():
    shown = {"signal": "hampi_identification", "frequencies": [10.0, 20.0, 50.0, 100.0, 200.0, 300.0]}
    np.testing.assert_array_equal(build({"signal": "hampi_identification"}, 1e-3), build(shown, 1e-3))


def test_every_kind_says_what_it_is():
    assert all(function.__doc__ for function in KINDS.values())


def test_every_parameter_is_declared_and_every_declaration_used():
    used = {(kind, name) for kind, function in KINDS.items() for name in signature(function).parameters}
    used = {(kind, name) for kind, name in used if name not in ("sample_time", "axes")}
    assert all(described(kind, name).meaning for kind, name in used)
    own = {(kind, name) for kind, each in declarations()["kinds"].items() for name in each}
    assert {name for _, name in used} == set(declarations()["signals"]) and own <= used
