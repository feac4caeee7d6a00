# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A model of coupled axes beside a record of a greater amplitude, at which every mode has moved by another share."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.signal import cont2discrete

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import StateSpace
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.effects import EFFECTS
from hyst_control.effects.softening_modes import SofteningModes
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record, Signal

pytestmark = pytest.mark.long_file

STEP, COUNT, WARM_UP, SIGMA = 1e-4, 4500, 0.2, 1e-3
FREQUENCIES, DAMPING = np.array([310.0, 820.0, 1900.0]), np.array([0.02, 0.015, 0.03])
LOST, GROWN = np.array([0.04, 0.004, 0.015]), np.array([0.3, 0.0, -0.2])
"""Shares by which the frequencies fall and the damping grows, mode by mode."""
RIVALS = {"softening_modes", "resonance", "cross_coupling", "gain", "delay", "added_mass", "sensor_lowpass"}


def structure(lost: np.ndarray, grown: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C of three modes of both axes, moved by shares; what each gives at rest is kept."""
    random = np.random.default_rng(8)
    a, b = [], []
    for f, z, less, more in zip(FREQUENCIES, DAMPING, lost, grown, strict=True):
        at_rest, moved = (2 * np.pi * f * np.array([[-z * m, -s], [s, -z * m]]) for s, m in ((1.0, 1.0), (1.0 - less, 1.0 + more)))
        a.append(moved)
        b.append(moved @ np.linalg.solve(at_rest, 2 * np.pi * f * random.normal(size=(2, 2))))
    return block_diag(*a), 0.02 * np.concatenate(b), random.normal(size=(2, 6))


def played(command: np.ndarray) -> np.ndarray:
    """The structure with moved modes; scipy's discretisation, the sample before the command acts."""
    a, b, c = structure(LOST, GROWN)
    ad, bd, *_ = cont2discrete((a, b, c, np.zeros((2, 2))), STEP)
    state, output = np.zeros(6), np.empty_like(command)
    for row, u in enumerate(command):
        output[row] = c @ state
        state = ad @ state + bd @ u
    return output


def drive(seed: int) -> np.ndarray:
    """Noise up to 2.5 kHz, in V."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).normal(size=(COUNT, 2)), axis=0)
    spectrum[np.fft.rfftfreq(COUNT, STEP) > 2500.0] = 0.0
    return 10.0 * np.fft.irfft(spectrum, COUNT, axis=0)


@pytest.fixture(scope="module")
def answer():
    a, b, c = structure(np.zeros(3), np.zeros(3))
    stage = StateSpace(a.tolist(), b.tolist(), c.tolist(), np.zeros((2, 2)).tolist())
    model = Model("small", ("x", "y"), {"command": "V", "measurement": "um"}, STEP, Chain((stage,)), noise={"sigma": SIGMA})
    command, time = drive(1), STEP * np.arange(COUNT)
    measured = played(command) + SIGMA * np.random.default_rng(2).normal(size=(COUNT, 2))
    record = Record(
        {"command": Signal(time, command, ("x", "y"), "V"), "measurement": Signal(time, measured, ("x", "y"), "um")}, "drive"
    )
    report, _, better = diagnosed(
        [record], model, warm_up=WARM_UP, cache=False, without=[name for name in EFFECTS if name not in RIVALS]
    )
    return model, report, better


def test_softening_is_named_first(answer):
    _, report, _ = answer
    assert report["verdict"] == "effect" and report["effects"][0]["name"] == "softening_modes"
    assert report["effects"][0]["axis"] == ["x", "y"] and report["effects"][0]["shrink"] > 0.95
    assert set(report["effects"][0]["parameters"]) == {"softening", "damping"}


def test_every_mode_has_its_own_share(answer):
    """The amplitude is the same at all times: shares of the stage are those of the structure by one factor."""
    stage = next(one for one in answer[2].chain.stages if isinstance(one, SofteningModes))
    found = stage.softening * np.array(stage.softening_factors)
    assert found / found[0] == pytest.approx(LOST / LOST[0], abs=0.03)
    grown = stage.damping * np.array(stage.damping_factors)
    assert grown / found[0] == pytest.approx(GROWN / LOST[0], abs=0.6)


def test_the_model_that_has_it_foresees_another_record_of_this_amplitude(answer):
    model, _, better = answer
    command = drive(9)
    counted = slice(round(WARM_UP / STEP), None)
    left, before = (np.mean((played(command) - simulate(one, command))[counted] ** 2) for one in (better, model))
    assert left < 0.01 * before
