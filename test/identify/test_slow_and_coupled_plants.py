# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The family "linear" on an integrator, on lags far slower than the sampling, and on noise between modes: plants simulated here."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from hyst_control.identify import identify
from hyst_control.identify.data.fit import Fit
from hyst_control.identify.modal.linear_search import SEARCH_ROWS
from hyst_control.identify.modal.partial_fractions import Sections
from hyst_control.identify.modal.thinned_rows import thinned, thinning
from hyst_control.identify.modal.vector_fitting import Partial
from hyst_control.identify.solve import simulation_error
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.model_file import simulate
from hyst_control.records.record import sampled_record


def held_answer(num: list[float], den: list[float], command: np.ndarray, step: float) -> np.ndarray:
    """Answer to a held command from rest at 0, exact at its ticks."""
    top, bottom, _ = cont2discrete((num, den), step)
    return lfilter(np.ravel(top), bottom, command)


def lag(tau: float, command: np.ndarray, step: float) -> np.ndarray:
    return held_answer([1.0], [tau, 1.0], command, step)


def mode(frequency: float, damping: float, command: np.ndarray, step: float) -> np.ndarray:
    w = 2 * np.pi * frequency
    return held_answer([w * w], [1.0, 2 * damping * w, w * w], command, step)


def fitted(command: np.ndarray, measurement: np.ndarray, step: float, start: str = "auto", **options: object) -> Fit:
    rows = (values.reshape(len(command), -1) for values in (command, measurement))
    axes = ("x", "y")[: command.size // len(command)]
    return identify([sampled_record("own", *rows, step, axes, "um", "zoh", start)], "linear", **options)


def test_an_integrator_that_does_not_begin_at_rest_gets_no_leak():
    """Twelve seconds of velocity 55 um/s/V behind a lag of 4 ms: a leak of 0.016 1/s, well known, was found."""
    step = 2e-3
    time = step * np.arange(6000)
    random = np.random.default_rng(5)
    tones = [np.sin(2 * np.pi * f * time + p) for f, p in zip((0.3, 0.8, 1.7, 4.0, 9.0), random.uniform(0, 6.28, 5), strict=True)]
    command = 0.8 * sum(tones) / np.abs(sum(tones)).max()

    def integrated(u: np.ndarray) -> np.ndarray:
        velocity = 55.0 * lag(0.004, u, step)
        return 55.0 * step * np.concatenate([[0.0], np.cumsum(u)[:-1]]) - 0.004 * velocity

    motion = integrated(command)
    fit = fitted(command, motion + 3e-3 * np.ptp(motion) * random.normal(size=len(time)), step)
    slowest = next(row for row in fit.report["parameters"] if row["name"] == "frequency[0]")
    leak, deviation = 2 * np.pi * slowest["value"], 2 * np.pi * slowest["standard_error"]
    assert leak < 1e-3 and deviation > 5e-5  # 2.5e-4 is what least squares with a free leak say of this record
    assert any("static gain known to" in note for note in fit.report["notes"])
    fresh = np.concatenate([np.zeros(100), 0.3 * np.sin(2 * np.pi * 0.7 * time)])
    wanted = integrated(fresh)
    error = simulate(fit.model, fresh[:, None], step, "zoh")[:, 0] - wanted
    assert np.std(error) < 3e-3 * np.ptp(wanted)


def test_initial_states_that_have_died_away_stay_so_in_the_chunks_that_follow(monkeypatch):
    """A record is simulated in chunks; a state counts beside the record's offset, in every one of them."""
    random = np.random.default_rng(9)
    command = 40.0 + lfilter([0.1], [1.0, -0.9], random.normal(size=3000))
    window = Window(command, lag(0.01, command, 1e-3) + 0.01 * random.normal(size=3000), 1e-3, "zoh", 0, 0)
    shape = Sections(1, False, False, False, 1.0, 0.0, 0.005 / 3.0, 1e4)
    vector = shape.vector(Partial(np.array([-0.09 + 0j]), np.array([0.088 + 0j]), 0.0, 0.0), 1e-3, 0.0)
    found = []
    for chunk in (10_000, 300):
        monkeypatch.setattr(simulation_error, "CHUNK", chunk)
        problem = simulation_error.SimulationError([window], simulation_error.Parametrization(shape.running), unknown_state=True)
        found.append(problem.visit(vector, derivatives=True))
    whole, parts = found
    assert parts.fitted == pytest.approx(whole.fitted, rel=1e-9) and parts.states == pytest.approx(whole.states, rel=1e-6)
    both, other = (each.grams.fitted + each.grams.held_out for each in found)
    assert other == pytest.approx(both, rel=1e-6)


def slow_stage(command: np.ndarray, step: float) -> np.ndarray:
    late = np.concatenate([np.zeros(round(8.0 / step)), command])[: len(command)]
    return 3.1 * lag(95.0, late, step) + 1.7 * lag(610.0, late, step)


def test_lags_of_minutes_are_found_in_a_long_record_of_many_samples():
    """Half an hour at 50 Hz: parts of 40,000 rows held less than the slow lag, and gave one pole."""
    step, random = 0.02, np.random.default_rng(6)
    command = np.repeat([0.0, 2.0, 4.0, 1.0, 5.0, 3.0, 0.0], round(420.0 / step))
    assert len(command) > 3 * SEARCH_ROWS
    motion = slow_stage(command, step)
    fit = fitted(command, motion + 2e-3 * np.ptp(motion) * random.normal(size=len(command)), step, "settled")
    found = {row["name"]: row["value"] for row in fit.report["parameters"]}
    times = sorted(1.0 / (2 * np.pi * value) for name, value in found.items() if name.startswith("frequency"))
    assert times == pytest.approx([95.0, 610.0], rel=0.01)
    assert found["static_gain"] == pytest.approx(4.8, rel=0.005) and found["delay[0]"] == pytest.approx(8.0, abs=0.2)
    assert fit.report["held_out_nrmse"][0] == pytest.approx(0.2, rel=0.1)  # of all rows, not of their means


def test_only_slow_motions_are_thinned_and_their_answer_stays():
    random = np.random.default_rng(7)
    command = np.repeat(random.uniform(-1.0, 1.0, 60), 2000)
    slow, quick = (lag(tau, command, 1e-3) + 1e-3 * random.normal(size=len(command)) for tau in (2.0, 2e-3))
    windows = [Window(command, values, 1e-3, "zoh", 0, 0) for values in (slow, quick)]
    counts = [thinning([window], SEARCH_ROWS) for window in windows]
    assert counts == [3, 1] and thinning([windows[0]], len(command)) == 1
    few = thinned(windows[0], counts[0])
    assert few.sample_time == pytest.approx(3e-3)
    assert np.std(few.measurement - lag(2.0, few.command, 3e-3)) < 1e-3


def test_axes_get_no_modes_of_noise():
    """Four modes in two axes, beside 1 % of noise: seven made of noise came along, one without damping."""
    step, random = 1e-4, np.random.default_rng(8)
    rows = 4000
    command = lfilter([0.25], [1.0, -0.75], random.normal(size=(rows, 2)), axis=0)
    late = np.vstack([np.zeros((2, 2)), command])[:rows]

    def moved(u: np.ndarray) -> np.ndarray:
        a, b, c, d = (mode(f, z, u[:, j], step) for f, z, j in ((310, 0.02, 0), (345, 0.025, 1), (760, 0.015, 0), (900, 0.01, 1)))
        return np.column_stack([22.0 * a + 2.0 * c + 1.6 * b, 20.0 * b - 1.5 * d - 1.2 * a])

    motion = moved(late)
    fit = fitted(command, motion + 1e-2 * np.ptp(motion, axis=0) * random.normal(size=motion.shape), step)
    assert fit.report["states"] == 8
    found = sorted(row["value"] for row in fit.report["parameters"] if row["name"].startswith("frequency"))
    assert found == pytest.approx([310.0, 345.0, 760.0, 900.0], rel=2e-3)


@pytest.mark.parametrize("late", [3_000, 15_000])
def test_a_long_staircase_is_searched_where_it_steps(late):
    """Steps of 2.5 s at 10 kHz: evenly spread parts of a second hold none, or few."""
    step, random = 1e-4, np.random.default_rng(3)
    command = np.repeat(random.uniform(-10.0, 10.0, 20), 25_000)[late:]
    motion = 0.3 * mode(300.0, 0.02, command, step)
    fit = fitted(command, motion + 1e-3 * np.ptp(motion) * random.normal(size=len(motion)), step)
    fresh = np.append(0.0, random.uniform(-10.0, 10.0, 20_000))  # from rest
    truth = 0.3 * mode(300.0, 0.02, fresh, step)
    left = simulate(fit.model, fresh[:, None], step, "zoh")[:, 0] - truth
    assert np.std(left) < 1e-3 * np.std(truth)
