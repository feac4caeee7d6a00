# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Linear plants from records in time: the plants are simulated by scipy, the fits are held against their true poles, gain and noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from hyst_control.chain import Chain, Sampling
from hyst_control.chain.memoryless import Gain
from hyst_control.identify import Fit, identify
from hyst_control.identify.assess.fit_report import MOVING
from hyst_control.identify.modal import linear
from hyst_control.identify.modal.linear import Linear
from hyst_control.identify.modal.linear_options import LinearOptions
from hyst_control.identify.modal.linear_search import search
from hyst_control.identify.modal.partial_fractions import Sections
from hyst_control.identify.modal.vector_fitting import spread_poles, vector_fit
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.identify.solve.simulation_error import Parametrization, SimulationError
from hyst_control.model_file import simulate
from hyst_control.records.record import Record, sampled_record
from hyst_control.records.tables.columns import Column
from hyst_control.records.tables.frequency_response import response_record

TOPICS = (("frequency", "Hz"), ("real", "um/V"), ("imaginary", "um/V"))


def mode(gain: float, frequency: float, damping: float) -> tuple[list[float], list[float]]:
    w = 2 * np.pi * frequency
    return [gain * w * w], [1.0, 2 * damping * w, w * w]


def answer(command: np.ndarray, period: float, *plants, late: int = 0, first: float = 0.0) -> np.ndarray:
    """Sum of transfer functions of a held command, from rest at `first`, by scipy."""
    held = np.concatenate([np.full(late, first), command])[: len(command)] - first
    return sum(
        signal.lfilter(b.ravel(), a, held) + first * num[-1] / den[-1]
        for num, den in plants
        for b, a, _ in [signal.cont2discrete((num, den), period)]
    )


def record(command, measurement, period, noise=1e-3, seed=0) -> tuple[Record, float]:
    sigma = noise * np.ptp(measurement)
    noisy = measurement + sigma * np.random.default_rng(seed).normal(size=len(command))
    return sampled_record("r", command[:, None], noisy[:, None], period, ("x",), "um", "zoh", "auto"), sigma


def rows(fit) -> dict[str, float]:
    return {row["name"]: row["value"] for row in fit.report["parameters"]}


def stairs(levels: int, hold: int, seed: int = 1) -> np.ndarray:
    return np.repeat(np.concatenate([[0.0], np.random.default_rng(seed).uniform(0, 10, levels - 1)]), hold)


@pytest.mark.parametrize("hum", [1e-3, 5e-3])
def test_hum_between_the_lines_of_a_square_wave_is_no_mode(hum):
    """Modes that the command does not drive explained it by an initial state each: 5 to 16 states and 1 % left where hum is 0.1 %."""
    row, pole = np.arange(5000), np.exp(-1.0 / 5.5)
    command = np.where(row // 50 % 2 == 0, 0.5, -0.5)
    lag, _ = signal.lfilter([0.0, 1.0 - pole], [1.0, -pole], command, zi=[-0.5 * pole])
    lines = hum * (np.sin(0.04 * np.pi * row + 0.7) + 0.5 * np.sin(0.08 * np.pi * row))
    measured = np.round((lag + lines) / 2e-3) * 2e-3
    fit = identify([sampled_record("hum", command[:, None], measured[:, None], 1e-3, ("x",), "um", start="auto")], "linear")
    found = rows(fit)
    assert fit.report["states"] == 1 and fit.report["records"][0]["rmse"] < np.std(measured - lag) * 1.05
    assert found["static_gain"] == pytest.approx(1.0, abs=1e-3) and found["frequency[0]"] == pytest.approx(
        500 / np.pi / 5.5, rel=2e-3
    )


def test_one_step_tells_two_modes():
    """A single clean step, of which 18 % of the range were once left."""
    command = 2.0 * (np.arange(1200) >= 100)
    data, sigma = record(command, answer(command, 1 / 300, mode(0.7, 2.0, 0.03), mode(0.3, 5.1, 0.04)), 1 / 300)
    fit = identify([data], "linear")
    found = rows(fit)
    assert fit.report["states"] == 4 and fit.report["records"][0]["rmse"] < 1.1 * sigma
    for name, true in {
        "frequency[0]": 2.0,
        "damping[0]": 0.03,
        "frequency[1]": 5.1,
        "damping[1]": 0.04,
        "static_gain": 1.0,
    }.items():
        assert found[name] == pytest.approx(true, rel=0.01), name


@pytest.mark.parametrize("tau", [10, 150])
def test_a_lag_under_a_staircase(tau):
    """Slower than the stairs, too: what goes on beyond a level is no drift of the record."""
    command = stairs(20, 40)
    data, sigma = record(command, answer(command, 1e-3, ([0.2], [tau * 1e-3, 1.0])), 1e-3)
    fit = identify([data], "linear")
    assert rows(fit)["static_gain"] == pytest.approx(0.2, rel=0.01)
    assert rows(fit)["frequency[0]"] == pytest.approx(1 / (2 * np.pi * tau * 1e-3), rel=0.02)
    assert fit.report["states"] == 1 and fit.report["records"][0]["rmse"] < 1.1 * sigma


def test_a_dead_time_before_a_lag():
    command = 6 * stairs(6, 130)
    data, sigma = record(command, 21.0 + answer(command, 1.0, ([0.8], [150.0, 1.0]), late=20), 1.0)
    fit = identify([data], "linear")
    found = rows(fit)
    assert found["delay[0]"] == pytest.approx(20.0, abs=0.5) and found["static_gain"] == pytest.approx(0.8, rel=0.01)
    assert found["frequency[0]"] == pytest.approx(1 / (2 * np.pi * 150.0), rel=0.02)
    assert fit.report["records"][0]["rmse"] < 1.1 * sigma


def test_a_command_that_jumps_from_rest_at_its_first_row():
    """A mode that rings from the first row on, because the machine was at rest at 0 V: the report says so, and the error has no ringing."""
    t = np.arange(3000) * 1e-3
    command = np.cos(2 * np.pi * np.outer(t, [1, 3, 7, 19, 41])).sum(axis=1)
    data, sigma = record(command, answer(command, 1e-3, mode(1.0, 4.0, 0.05)), 1e-3)
    fit = identify([data], "linear")
    assert "the first command jumps" in fit.report["beginnings"][0]["assumed"].replace("its", "the").replace("which the", "the")
    assert fit.report["records"][0]["rmse"] < 1.1 * sigma and rows(fit)["frequency[0]"] == pytest.approx(4.0, rel=0.001)


@pytest.mark.parametrize(("frequency", "jumps"), [(97.0, False), (300.0, True)])
def test_a_mode_far_above_the_command_is_found_where_it_rings(frequency, jumps):
    """Kinks of a slow triangle, or the first jump of a slow random command, excite a mode more than 20 times as fast."""
    t = np.arange(5000) / 5000.0
    slow = np.cos(2 * np.pi * np.outer(t, [1, 3, 7, 11])).sum(axis=1)
    command = slow if jumps else np.abs(1.0 - (3.0 * t) % 2.0)
    data, sigma = record(command, answer(command, 2e-4, mode(1.0, frequency, 0.015), first=0.0 if jumps else command[0]), 2e-4)
    fit = identify([data], "linear")
    assert fit.report["records"][0]["rmse"] < 1.05 * sigma
    assert rows(fit)["frequency[0]"] == pytest.approx(frequency, rel=0.002)
    assert rows(fit)["damping[0]"] == pytest.approx(0.015, rel=0.1)


def test_a_larger_model_of_one_kind_never_fits_worse():
    random = np.random.default_rng(4)
    command = np.cumsum(random.normal(size=1500))
    plants = [mode((-1.0) ** k, frequency, 0.02) for k, frequency in enumerate((3.0, 7.0, 15.0, 31.0))]
    data, _ = record(command, answer(command, 2e-3, *plants), 2e-3)
    window = Window(data.command[:, 0], data.measurement[:, 0], 2e-3, "zoh", 0, 0)
    _, table = search([window], LinearOptions(direct=False, delay=0.0))
    for kind in (0, 1):  # two more poles than zeros, or one
        errors = [row["fitted"] for row in table if row["parameters"] - 2 * row["order"] == kind - 1]
        assert len(errors) > 5 and np.all(np.diff(errors) <= 1e-6)


def test_fits_on_all_cores_are_those_of_one(monkeypatch):
    command = stairs(40, 50)
    data, _ = record(command, answer(command, 1e-3, mode(1.0, 60.0, 0.1), late=3), 1e-3)
    window = Window(data.command[:, 0], data.measurement[:, 0], 1e-3, "zoh", 0, 0)
    together, _ = search([window], LinearOptions())
    monkeypatch.setattr("hyst_control.base.parallel._serial", True)
    alone, _ = search([window], LinearOptions())
    assert together.variant == alone.variant
    np.testing.assert_array_equal(together.solution.parameters, alone.solution.parameters)


def test_a_record_that_is_too_short_says_how_well_the_static_gain_is_known():
    """A pole of thirty record lengths: its gain and its rate cannot be told apart, and the note's deviation covers the truth."""
    command = stairs(20, 50)
    data, _ = record(command, answer(command, 1.0, ([0.8], [30_000.0, 1.0])), 1.0, noise=1e-2)
    fit = identify([data], "linear", order=1)
    gain = fit.report["parameters"][-1]
    assert gain["name"] == "static_gain" and abs(gain["value"] - 0.8) < 3 * gain["standard_error"] > 0.1 * gain["value"]
    assert any("static gain known to ± " in note for note in fit.report["notes"])
    well, _ = record(command, answer(command, 1.0, ([0.8], [30.0, 1.0])), 1.0)
    assert not any("static gain" in note for note in identify([well], "linear", order=1).report["notes"])


def test_two_records_that_begin_amid_a_motion_are_one_plant():
    """Cut from one run, with sensor offsets of their own: the unknown states at the cuts are no part of the plant."""
    random = np.random.default_rng(6)
    command = np.repeat(random.uniform(0, 10, 120), 25)
    measured = answer(command, 1e-3, mode(0.5, 8.0, 0.03))
    parts = [
        record(command[cut], measured[cut] + 3.0 * k, 1e-3, seed=k)[0]
        for k, cut in enumerate((slice(313, 1500), slice(1511, 3000)))
    ]
    found = rows(identify(parts, "linear"))
    assert found["frequency[0]"] == pytest.approx(8.0, rel=1e-3) and found["damping[0]"] == pytest.approx(0.03, rel=0.02)
    assert found["static_gain"] == pytest.approx(0.5, rel=0.01)


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0.01, 1.0), st.floats(0.01, 3.0), st.floats(-1, 1), st.floats(-1, 1)), min_size=1, max_size=2),
    st.booleans(),
    st.booleans(),
    st.integers(0, 2**31),
)
def test_sections_and_their_polynomials_are_one_system(sections, odd, smooth, seed):
    """The state space that a search runs, the transfer function of the model file, and the partial fractions and back."""
    shape = Sections(2 * len(sections) + odd, False, False, smooth, 0.3, 1e-3, 1e-3, 1e6)
    vector = np.array([x for w, z, g, h in sections for x in (np.log(100 * w), np.log(z), g, h)] + [np.log(20.0), 0.5] * odd)
    command = np.random.default_rng(seed).normal(size=(300, 1))

    def run(stages):
        running = Chain(tuple(stages)).filter(Sampling(1e-3, 1))
        running.settle(command[0])
        return running.process(command)[:, 0]

    once = run(shape.running(vector))
    scale = 1e-6 * (np.ptp(once) + 0.3)
    np.testing.assert_allclose(run(shape.stages(vector)), once, atol=scale)
    again = shape.vector(shape.partial(vector, 1e-3), 1e-3, 0.0)
    np.testing.assert_allclose(run(shape.running(again)), once, atol=1e3 * scale if smooth else 30 * scale)


def test_vector_fitting_needs_no_guess():
    """Poles of three decades from evenly spread ones, of a record that begins amid a motion, without noise: they are exact."""
    command = np.cumsum(np.random.default_rng(2).normal(size=4000))
    plants = [([1.0], [1.0, 1.0]), mode(0.5, 4.0, 0.02), mode(-0.2, 60.0, 0.1)]
    measured = answer(command, 1e-3, *plants)
    found = vector_fit([Window(command[500:], measured[500:], 1e-3, "zoh", 0, 0)], spread_poles(5, 3500), 0.0, False)
    rates = np.sort(np.abs(found.poles)) * 1e3
    np.testing.assert_allclose(rates, [1.0, 2 * np.pi * 4.0, 2 * np.pi * 60.0], rtol=1e-3)
    assert found.error < 1e-8 * np.var(measured)


def test_axes_are_fitted_one_by_one_if_they_do_not_drive_each_other():
    command = np.column_stack([stairs(20, 40, 1), stairs(20, 40, 2)])
    measured = np.column_stack(
        [answer(command[:, 0], 1e-3, ([0.2], [0.02, 1.0])), answer(command[:, 1], 1e-3, mode(0.4, 9.0, 0.1))]
    )
    measured += 1e-4 * np.random.default_rng(0).normal(size=measured.shape)
    fit = Linear().fit(
        [sampled_record("r", command, measured, 1e-3, ("x", "y"), "um", start="settled")], LinearOptions(coupled=False)
    )
    found = rows(fit)
    assert found["static_gain[x]"] == pytest.approx(0.2, rel=0.01) and found["static_gain[y]"] == pytest.approx(0.4, rel=0.01)
    assert found["frequency[0][y]"] == pytest.approx(9.0, rel=1e-3)


def test_two_modes_in_a_sweep_are_found_though_one_alone_gains_little():
    """States without the second mode gained too little: growing ended at one state, which left 19 times the noise."""
    row, rate, count = np.arange(6400), 123.0, 6400
    command = 20.0 * (1.0 + signal.chirp(row / rate, 0.04, count / rate, 24.6, "logarithmic"))
    plants = mode(0.6, 1.40, 0.075), mode(0.4, 3.12, 0.012)
    data, sigma = record(command, answer(command, 1 / rate, *plants, first=command[0]), 1 / rate, noise=5e-3)
    fit = identify([data], "linear")
    assert fit.report["states"] == 4 and fit.report["records"][0]["rmse"] < 1.1 * sigma
    assert rows(fit)["static_gain"] == pytest.approx(1.0, rel=5e-3)


def test_the_answer_to_one_step_counts_though_no_held_out_row_has_it():
    """A step whose whole answer is in rows that are fitted: the held-out ones hold any structure for as good."""
    command = 3.0 * (np.arange(4800) >= 480)
    for frequency, damping in ((80.0, 0.3), (100.0, 0.5)):
        data, sigma = record(command, answer(command, 1e-3, mode(0.8, frequency, damping), late=5), 1e-3, noise=5e-3)
        fit = identify([data], "linear")
        assert fit.report["states"] == 2 and fit.report["records"][0]["rmse"] < 1.1 * sigma


@pytest.mark.parametrize("seed", [5, 8])
def test_a_stage_with_hysteresis_that_begins_at_rest(seed):
    """A slow pole, a drift and an initial state took back from each other what none of them does: simulated from rest they left thrice."""
    command = np.repeat(np.random.default_rng(seed).uniform(10, 90, 40), 125)
    command[:50] = 0.0
    bent = 0.06 * command
    for threshold, weight in zip((2, 5, 10, 20, 35), (0.01, 0.01, 0.015, 0.01, 0.008), strict=True):
        play = 0.0
        for row, value in enumerate(command):
            play = min(max(play, value - threshold), value + threshold)
            bent[row] += weight * play
    data, _ = record(command, answer(bent, 1e-3, mode(1.0, 80.0, 0.05)), 1e-3, 2e-4)
    fit = identify([data], "linear")
    simulated = simulate(fit.model, data.command, 1e-3)
    ringing = np.column_stack([answer(command, 1e-3, mode(1.0, 80.0, 0.05)), np.ones(len(command))])
    best = ringing @ np.linalg.lstsq(ringing, data.measurement, rcond=None)[0]
    assert np.std(data.measurement - simulated) < np.std(data.measurement - best)


@pytest.mark.parametrize("seems, free, kept", [(MOVING, 0.5, "amid"), (MOVING, 2.0, "rest"), ("at rest", 0.5, "rest")])
def test_free_initial_states_are_taken_where_the_record_seems_to_move_and_they_leave_less(seems, free, kept, monkeypatch):
    """A hysteresis resembles a motion from before the record, by which a fit may be led astray."""
    data, _ = record(stairs(10, 20), stairs(10, 20)[:, None], 1e-3)
    names = {True: "rest", False: "amid"}

    def fitted(records, options, *, still):
        size = 1.0 if still else free
        report = {"name": names[still], "beginnings": [{"assumed": seems}]}
        return Fit(None, report, (size * np.random.default_rng(0).normal(size=(200, 1)),))

    monkeypatch.setattr(linear, "_fitted", fitted)
    assert Linear().fit([replace(data, start="settled")], LinearOptions()).report["name"] == kept


def test_modes_that_few_poles_do_not_show():
    """Growing ended at three states that left 60 % of the power, as the fourth and fifth gained nothing; eight are four modes."""
    command = np.cumsum(np.random.default_rng(7).normal(size=1500))
    plants = [mode((-1.0) ** k, frequency, 0.02) for k, frequency in enumerate((3.0, 7.0, 15.0, 31.0))]
    data, sigma = record(command, answer(command, 2e-3, *plants), 2e-3)
    fit = identify([data], "linear", direct=False, delay=0.0)
    assert fit.report["records"][0]["rmse"] < 1.1 * sigma and fit.report["states"] == 8


def test_a_frequency_response_of_few_lines_is_not_overfitted():
    """The answer to 20 sines is 40 equations, however many rows: ten poles, two of them undamped, fitted the noise of the lines."""
    frequency = np.geomspace(0.03, 1.0, 20)
    random = np.random.default_rng(7)
    scatter = 1.0 + 0.05 * (random.normal(size=20) + 1j * random.normal(size=20))
    true = 3.0 / (1.0 + 2j * np.pi * frequency * 2.0) * np.exp(-2j * np.pi * frequency * 0.3)
    rows_of = [frequency, (true * scatter).real, (true * scatter).imag]
    columns = [Column(topic, (str(i),), unit, (1.0,)) for i, (topic, unit) in enumerate(TOPICS)]
    data = response_record("lag", columns, {str(i): values[:, None] for i, values in enumerate(rows_of)}).aligned()[0]
    found = rows(identify([data], "linear"))
    assert found["static_gain"] == pytest.approx(3.0, rel=0.02) and found["delay[0]"] == pytest.approx(0.3, abs=0.03)
    assert found["frequency[0]"] == pytest.approx(1 / (4 * np.pi), rel=0.05)


def test_a_gain_alone_has_no_pole():
    """The smallest order had one: of 1e-4 Hz, with a static gain of 2.2 in place of 3 that nothing tells."""
    command = np.random.default_rng(1).uniform(-1, 1, 2000)
    data, sigma = record(command, 3.0 * np.append(0.0, command[:-1]), 0.01, 5e-3)
    found = rows(identify([data], "linear"))
    assert found == {"static_gain": pytest.approx(3.0, rel=1e-3)}


def test_the_held_out_blocks_of_several_records_are_those_of_each():
    """Of records whose numbers of blocks are no multiples of three, every third block of all was taken for a held-out one."""
    windows = [
        Window(np.random.default_rng(n).normal(size=n), np.random.default_rng(n + 1).normal(size=n), 1e-3, "zoh", 0, group)
        for group, n in enumerate((700, 1030, 860))
    ]
    found = SimulationError(windows, Parametrization(lambda _: [Gain(1.0)]), "linear", everything=False).visit(np.zeros(0))
    assert found.energies.sum() == pytest.approx(found.grams.held_out[-1, -1], rel=1e-9)


def test_growing_ends_soon_where_a_record_has_no_noise():
    command = stairs(12, 60)
    data, _ = record(command, answer(command, 1e-3, mode(2.0, 30.0, 0.1)), 1e-3, noise=0.0)
    fit = identify([data], "linear")
    assert max(row["order"] for row in fit.report["orders"]) <= 6 and fit.report["states"] == 2
