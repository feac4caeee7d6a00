# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects beside a baseline record of the same command: their change goes through the plant's dynamics, not the model's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, cont2discrete, lfilter

from hyst_control.chain import Chain, Sampling
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.model_error.plant_response import lacking_response
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.problem.per_record_stages import CarriedError, LackingResponse
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.run.diagnosis import diagnose
from hyst_control.diagnose.search.beam_search import carried_noise
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.search.fit import Linearized, fit
from hyst_control.diagnose.verdict import Verdict
from hyst_control.effects.backlash import Backlash
from hyst_control.effects.placement import insert
from hyst_control.model_file import Model
from test.diagnose.test_baseline import RATE, fitted, machine, record


def drive(rows: int = 4000) -> np.ndarray:
    """Noise up to 300 Hz, which excites the machine's mode at 430 Hz and the model's at 400 Hz."""
    noise = lfilter(*butter(2, 300.0 / (RATE / 2)), np.random.default_rng(5).standard_normal(rows))
    return 40.0 / np.abs(noise).max() * noise * np.minimum(np.arange(rows) / 100, 1.0)


def limited(rate: float):
    """A driver that follows no faster than a rate, sample by sample."""

    def followed(command: np.ndarray) -> np.ndarray:
        found = command.copy()
        for k in range(1, len(found)):
            found[k] = found[k - 1] + np.clip(command[k] - found[k - 1], -rate / RATE, rate / RATE)
        return found

    return followed


def with_play(position: np.ndarray) -> np.ndarray:
    """A play of 0.06 um to either side."""
    found = position.copy()
    for k in range(1, len(found)):
        found[k] = min(max(found[k - 1], position[k] - 0.06), position[k] + 0.06)
    return found


@pytest.mark.long_file
@pytest.mark.parametrize(
    "name, changed, value, near",
    [
        ("slew_limit", {"drive": limited(15000.0)}, 15000.0, 0.03),
        ("slew_limit", {"drive": limited(25000.0)}, 25000.0, 0.03),
        ("backlash", {"sensor": with_play}, 0.06, 0.05),
    ],
)
def test_an_effect_on_a_machine_with_another_mode_is_named_alone(name, changed, value, near):
    """The model leaves 0.5 of 0.6 um rms on the healthy machine: what it says of the change is as wrong, without the filter."""
    command = drive()
    model = replace(fitted(), hold="foh")
    healthy, new = (record(command, machine(command, seed, **more), "r") for seed, more in ((1, {}), (2, changed)))
    [found] = diagnose([new], model, baseline=[healthy], cache=False).parts
    assert found.decision.verdict is Verdict.EFFECT
    assert [one.names for one in found.listed] == [(name,)]
    [member] = found.chosen.candidate.members
    assert next(iter(member.values(found.chosen.solution.x).values())) == pytest.approx(value, rel=near)


@pytest.mark.long_file
def test_the_healthy_machine_has_no_gap_beside_itself():
    model = replace(fitted(), hold="foh")
    healthy, new = (record(drive(), machine(drive(), seed), "r") for seed in (1, 2))
    [found] = diagnose([new], model, baseline=[healthy], cache=False).parts
    assert found.decision.verdict is Verdict.NO_GAP


def test_the_filter_is_the_response_that_the_model_lacks():
    """Errors that are a filter of the outputs, exactly, on two records of two axes."""
    random, taps = np.random.default_rng(1), np.array([[0.3, -0.2], [0.1, 0.4], [-0.05, 0.0]])
    outputs = [random.standard_normal((rows, 2)) for rows in (6000, 9000)]
    errors = [np.stack([lfilter(taps[:, axis], 1.0, rows[:, axis]) for axis in range(2)], axis=1) for rows in outputs]
    found = lacking_response(outputs, errors)
    np.testing.assert_allclose(found[:3], taps, atol=2e-3)
    np.testing.assert_allclose(found[3:], 0.0, atol=2e-3)
    assert not lacking_response([np.zeros((100, 1))], [np.ones((100, 1))]).any()


@pytest.mark.parametrize("cuts", [[], [1, 4], [700]])
def test_the_filter_runs_in_any_blocks(cuts):
    """From rest at the first value, against SciPy's filter of the rows from there on."""
    taps, rows = np.array([[0.3, -0.2], [0.1, 0.4], [-0.05, 0.0]]), np.random.default_rng(2).standard_normal((900, 2))
    running = LackingResponse(taps).filter(Sampling(1e-3, 2, "foh"))
    settled = running.settle(rows[0])
    found = np.concatenate([running.process(block) for block in np.split(rows, cuts)])
    expected = rows[0] * (1.0 + taps.sum(axis=0))
    np.testing.assert_allclose(settled, expected)
    for axis in range(2):
        late = lfilter(taps[:, axis], 1.0, rows[:, axis] - rows[0, axis])
        np.testing.assert_allclose(found[:, axis], rows[:, axis] + late + rows[0, axis] * taps[:, axis].sum(), atol=1e-12)


def test_what_acts_on_the_motion_acts_on_the_carried_error_too():
    stages = (TransferFunction((1.0,), (1.0,)), LackingResponse(np.zeros((1, 1))), CarriedError((np.zeros((5, 1)),)))
    names = [stage.name for stage in insert(stages, "motion", Backlash(0.1))]
    assert names == ["transfer_function", "lacking_response", "carried_error", "backlash"]


def test_noise_that_an_effect_takes_off_the_carried_error_is_no_gain():
    """Of white noise a low-pass leaves the power of its impulse response, and a delay all of it."""
    rows, step = 20000, 1e-3
    command, noise = np.sin(0.01 * np.arange(rows))[:, None], 0.5 * np.random.default_rng(7).standard_normal((rows, 1))
    carried = CarriedError((np.zeros((rows, 1)),), noise=(noise,))
    chain = Chain((TransferFunction((1.0,), (1.0,)), carried))
    model = Model("gain", ("x",), {"command": "V", "measurement": "um"}, step, chain)
    problem = Problem(model, (Piece(command, command),), step, "foh", np.ones(1), beside_error=True)
    linearized = Linearized(problem, scatter_of(model))

    def share(name: str, **values: float) -> float:
        member = next(one for one in catalogue(problem, {}) if one.name == name and one.place == "sensor")
        member = replace(member, parameters=(), fixed=tuple(values.items()))
        candidate = Candidate((member,))
        energy = carried_noise(linearized, candidate, fit(linearized, candidate.unknowns()))
        return energy / carried_noise(linearized, None, fit(linearized))

    assert carried_noise(linearized, None, fit(linearized)) == pytest.approx(0.5 * rows * 0.25, rel=0.03)
    pole = 2 * np.pi * 50.0
    b, a, _ = cont2discrete(([pole], [1.0, pole]), step, "foh")
    impulse = lfilter(b.ravel(), a, np.arange(300) == 0.0)
    assert share("sensor_lowpass", cutoff=50.0, order=1.0) == pytest.approx(impulse @ impulse, rel=0.03)
    assert share("delay", tau=2 * step) == pytest.approx(1.0, rel=0.01)
