# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The learning filter: what a trial leaves of an error, in theory and in the loop, and where the filter ends."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import Delay, TransferFunction
from hyst_control.chain.memoryless import Gain
from hyst_control.control.feedback.pi import PI
from hyst_control.control.learning.iterative_learning import IterativeLearning
from hyst_control.control.learning.learning_filter import (
    CONTRACTION,
    LearningFilter,
    lines_of,
    measured_filter,
    model_filter,
    robustness,
)
from hyst_control.control.learning.learning_loop import run_learning_loop
from hyst_control.control.linearization import hysteresis_slopes, linearized, sampled_response
from hyst_control.control.moving_modes import with_modes
from hyst_control.control.tuning import controller_response, tune
from hyst_control.model_file import Model, Simulator, load_model, simulate
from hyst_control.records.excitation import excitation

MHL = load_model(Path(__file__).resolve().parents[2] / "config" / "models" / "fsm_mhl.yaml")
TIME, PERIOD = 1e-3, 40
MODE = TransferFunction([4e6], [1.0, 300.0, 1e6])


def contraction(filter_: LearningFilter, plant: np.ndarray, controller: np.ndarray) -> np.ndarray:
    """Greatest share (F,) of an error that one trial leaves: of d - Q (G^-1 + C) (I + P C)^-1 P d, the same feedback on every axis."""
    unit = np.eye(filter_.axes)
    feedback = controller[:, None, None] * unit
    shaped = np.linalg.solve(unit + plant @ feedback, plant)
    left = unit - filter_.robustness[:, None, None] * ((filter_.inverse + feedback) @ shaped)
    return np.abs(np.linalg.eigvals(left)).max(axis=1)


def linear(*stages) -> Model:
    return Model(name="m", axes=("x",), units={"command": "V", "measurement": "um"}, sample_time=TIME, chain=Chain(stages))


@pytest.mark.parametrize(("gain", "mode"), [(1.0, 1.0), (1.1, 1.0), (1.0, 0.8), (0.9, 1.2)])
@pytest.mark.parametrize("controller", [PI(0.0, 0.0, TIME, -1e9, 1e9), PI(0.02, 8.0, TIME, -1e9, 1e9, roll_off=60.0)])
def test_a_trial_leaves_what_theory_says(gain, mode, controller):
    """E_1 / E_0 of every line in the loop against |1 - Q (1 / G + C) P S|: the filter knows G alone, the plant is another."""
    model = linear(Delay(5e-4), MODE)
    filter_ = model_filter(model, PERIOD, model_error=0.0, mode_spread=0.2)
    moved = (*with_modes(model.chain.stages, 1, mode), Gain(gain))
    plant = Simulator(linear(*moved))
    reference = np.random.default_rng(1).standard_normal((PERIOD, 1))
    learner = IterativeLearning(filter_, settling=12, averaged=2, trials=3).start()
    signals = run_learning_loop(np.tile(reference, (28, 1)), None, controller.start(1), plant, learner)
    error = (signals["reference"] - signals["measurement"])[:, 0].reshape(28, PERIOD)
    before, after = (np.abs(np.fft.rfft(error[period])) for period in (13, 27))
    z = lines_of(PERIOD)
    z[0] = np.exp(1e-9j)  # at rest the integral's response has no bound
    response = sampled_response((*with_modes(model.chain.stages, 1, mode), TransferFunction([gain], [1.0])), 1, TIME, z)
    theory = contraction(filter_, response, controller_response(controller, z))
    found = before > 1e-6
    np.testing.assert_allclose((after[found] / before[found]), theory[found], atol=2e-4)
    assert np.all(theory[filter_.robustness > 0] < 1.0)


@cache
def tuned(plant: str):
    """A model, its sample time, its tuned feedback and a filter for it; the mirror's notch hides its mode from the model."""
    model, ts = (linear(Delay(5e-4), MODE), TIME) if plant == "mode" else (MHL, 2e-4)
    spread = 0.2 if plant == "mode" else 0.0
    return model, ts, tune(model, sample_time=ts, roll_off=0.16 / ts), model_filter(model, 50, sample_time=ts, mode_spread=spread)


@pytest.mark.parametrize("gain", [0.9, 1.0, 1.1])
@pytest.mark.parametrize(("plant", "mode"), [("mirror", 1.0), *(("mode", mode) for mode in (0.8, 0.9, 1.0, 1.1, 1.2))])
def test_it_converges_for_every_plant_that_it_allows_for(plant, gain, mode):
    """With the tuned feedback: every line that learns gets better, at the spread's corners and within."""
    model, ts, tuning, filter_ = tuned(plant)
    z, axes = lines_of(50), len(model.axes)
    z[0] = np.exp(1e-9j)
    feedback = controller_response(tuning.law, z)
    mean, _ = hysteresis_slopes(model)
    response = sampled_response(with_modes(linearized(model, gain * mean), axes, mode), axes, ts, z)
    left = contraction(filter_, response if model is MHL else gain * response, feedback)
    learning = filter_.robustness > 0
    assert learning.sum() >= 3 and np.all(left[learning] < 1.0)
    assert np.all(left[filter_.robustness == 1.0] <= CONTRACTION)


def test_a_measured_response_gives_the_models_filter():
    """From a noisy record of the model, the response is the sampled one to a few per cent where it learns."""
    model = linear(Delay(5e-4), MODE)
    command = excitation.multisine(TIME, 4.0, 0.25, 480.0, 1.0, 1, 0.0, 1, seed=3)
    rng = np.random.default_rng(2)
    measurement = simulate(model, command) + 0.01 * rng.standard_normal(command.shape)
    found = measured_filter(command, measurement, PERIOD, TIME)
    expected = model_filter(model, PERIOD)
    learning = found.robustness > 0.5
    assert learning.sum() > 5
    np.testing.assert_allclose(found.inverse[learning], expected.inverse[learning], rtol=0.05)


@pytest.mark.parametrize("peak", [1.0, 2.0])
def test_the_filter_ends_before_the_first_line_that_might_diverge(peak):
    error = np.array([0.1, 0.1, 0.2, 0.3, 0.2, 0.44, 0.46, 0.95, 0.1, 0.1])
    found = robustness(error, peak)
    end = {1.0: 7, 2.0: 6}[peak]
    assert np.all(found[end:] == 0.0) and np.all(found[: 2 * end // 3] == 1.0) and np.all(np.diff(found) <= 0.0)


def test_what_cannot_be_learned_is_refused():
    with pytest.raises(InputError, match="diverge"):
        robustness(np.array([0.1, 1.0, 0.1]), 1.0)
    with pytest.raises(InputError, match="period"):
        model_filter(MHL, 3)
    with pytest.raises(InputError, match="lines"):
        LearningFilter(10, np.ones((5, 1, 1), dtype=complex), np.ones(6))
    with pytest.raises(InputError, match="between 0 and 1"):
        LearningFilter(10, np.ones((6, 1, 1), dtype=complex), np.full(6, 2.0))
