# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A mode that a model of coupled axes lacks: every input drives it, every sensor sees it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.signal import cont2discrete

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import StateSpace
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.effects import EFFECTS
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record, Signal

pytestmark = pytest.mark.long_file

STEP, COUNT, SHORT, SIGMA = 1e-4, 3000, 2500, 1e-3
MODES = ((310.0, 0.02), (820.0, 0.015), (1900.0, 0.03))
LOST = 1
RIVALS = {"resonance", "cross_coupling", "gain", "delay", "added_mass", "creep", "sensor_lowpass", "amplifier_lowpass", "vibration"}
"""Effects that are looked for where a mode is missing: all that change a linear response, and a line."""


def modal() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C of three modes, none of which belongs to one of the two axes."""
    random = np.random.default_rng(8)
    a = [2 * np.pi * f * np.array([[-z, -1.0], [1.0, -z]]) for f, z in MODES]
    b = np.concatenate([2 * np.pi * f * random.normal(size=(2, 2)) for f, _ in MODES])
    return block_diag(*a), 0.02 * b, random.normal(size=(2, 6))


def played(command: np.ndarray) -> np.ndarray:
    """The structure with all modes; scipy's discretisation, the sample before the command acts."""
    a, b, c = modal()
    ad, bd, *_ = cont2discrete((a, b, c, np.zeros((2, 2))), STEP)
    state, output = np.zeros(6), np.empty_like(command)
    for row, u in enumerate(command):
        output[row] = c @ state
        state = ad @ state + bd @ u
    return output


def drive(seed: int) -> np.ndarray:
    """Noise up to 2.5 kHz from rest, in V."""
    random = np.random.default_rng(seed)
    spectrum = np.fft.rfft(random.normal(size=(COUNT, 2)), axis=0)
    spectrum[np.fft.rfftfreq(COUNT, STEP) > 2500.0] = 0.0
    command = 10.0 * np.fft.irfft(spectrum, COUNT, axis=0)
    command[:50] = 0.0
    return command


@pytest.fixture(scope="module")
def answer():
    a, b, c = modal()
    kept = [i for i in range(6) if i // 2 != LOST]
    stage = StateSpace(a[np.ix_(kept, kept)].tolist(), b[kept].tolist(), c[:, kept].tolist(), np.zeros((2, 2)).tolist())
    model = Model("poorer", ("x", "y"), {"command": "V", "measurement": "um"}, STEP, Chain((stage,)), noise={"sigma": SIGMA})
    command, time = drive(1), STEP * np.arange(COUNT)
    measured = played(command) + SIGMA * np.random.default_rng(2).normal(size=(COUNT, 2))
    record = Record(
        {"command": Signal(time, command, ("x", "y"), "V"), "measurement": Signal(time, measured, ("x", "y"), "um")}, "drive"
    )
    others = [name for name in EFFECTS if name not in RIVALS]
    report, diagnosis, better = diagnosed([record], model, cache=False, without=others)
    return model, report, better, diagnosis.problem


def test_it_is_named_at_its_frequency(answer):
    _, report, *_ = answer
    assert report["verdict"] == "effect" and [effect["name"] for effect in report["effects"]] == ["resonance"]
    [effect] = report["effects"]
    assert effect["axis"] == ["x", "y"] and set(effect["parameters"]) == {"frequency", "damping", "gain"}
    frequency, damping = MODES[LOST]
    assert effect["parameters"]["frequency"]["value"] == pytest.approx(frequency, rel=2e-3)
    assert effect["parameters"]["damping"]["value"] == pytest.approx(damping, rel=0.1)
    assert effect["shrink"] > 0.99


def test_the_model_that_has_it_foresees_another_record(answer):
    model, _, better, _ = answer
    command = drive(9)
    measured = played(command)
    left, before = (np.mean((measured - simulate(one, command)) ** 2) for one in (better, model))
    assert left < 0.01 * before


def test_no_effect_is_on_all_axes_and_once_more_on_one(answer):
    problem = answer[3]
    members = {(member.name, member.axis): member for member in catalogue(problem, {})}
    everywhere, x, y = (members["gain", axis] for axis in (None, 0, 1))
    assert everywhere.excludes(x) and y.excludes(everywhere) and x.excludes(x)
    assert not x.excludes(y) and not everywhere.excludes(members["delay", None])


@pytest.fixture(scope="module")
def uncoupled():
    """A model whose axes have each all modes and its own input alone, beside the structure."""
    a, b, c = modal()
    stage = StateSpace(
        block_diag(a, a).tolist(),
        block_diag(*(b[:, [i]] for i in range(2))).tolist(),
        block_diag(*(c[[i]] for i in range(2))).tolist(),
        np.zeros((2, 2)).tolist(),
    )
    model = Model("apart", ("x", "y"), {"command": "V", "measurement": "um"}, STEP, Chain((stage,)), noise={"sigma": SIGMA})
    command, time = drive(1)[:SHORT], STEP * np.arange(SHORT)
    measured = played(command) + SIGMA * np.random.default_rng(2).normal(size=(SHORT, 2))
    record = Record(
        {"command": Signal(time, command, ("x", "y"), "V"), "measurement": Signal(time, measured, ("x", "y"), "um")}, "drive"
    )
    others = [name for name in EFFECTS if name not in ("cross_coupling", "resonance", "gain", "delay", "added_mass")]
    report, _, better = diagnosed([record], model, cache=False, without=others)
    return model, report, better


def test_a_missing_coupling_is_a_matrix_of_responses_with_all_modes(uncoupled):
    model, report, better = uncoupled
    assert report["verdict"] == "effect" and [effect["name"] for effect in report["effects"]] == ["cross_coupling"]
    [effect] = report["effects"]
    assert effect["axis"] == ["x", "y"] and set(effect["parameters"]) == {"coupling"} and effect["shrink"] > 0.99
    command = drive(9)
    measured = played(command)
    left, before = (np.mean((measured - simulate(one, command)) ** 2) for one in (better, model))
    assert left < 0.01 * before


def test_its_size_is_that_of_the_static_responses_between_the_axes(uncoupled):
    model, report, _ = uncoupled
    a, b, c = modal()
    rest = -c @ np.linalg.solve(a, b)
    command = drive(1)[:SHORT]
    measured = played(command)
    coupling = np.linalg.norm(rest - np.diag(np.diag(rest)), 2) * np.ptp(command) / np.ptp(measured)
    assert report["effects"][0]["parameters"]["coupling"]["value"] == pytest.approx(coupling, rel=0.05)


def test_axes_that_share_their_modes_may_each_have_a_gain_of_their_own():
    a, b, c = modal()
    stage = StateSpace(a.tolist(), b.tolist(), c.tolist(), np.zeros((2, 2)).tolist())
    model = Model("whole", ("x", "y"), {"command": "V", "measurement": "um"}, STEP, Chain((stage,)), noise={"sigma": SIGMA})
    command, time = drive(1)[:SHORT], STEP * np.arange(SHORT)
    gains = np.array([1.06, 0.95])
    measured = played(command) * gains + SIGMA * np.random.default_rng(2).normal(size=(SHORT, 2))
    record = Record(
        {"command": Signal(time, command, ("x", "y"), "V"), "measurement": Signal(time, measured, ("x", "y"), "um")}, "drive"
    )
    others = [name for name in EFFECTS if name not in ("gain", "delay", "added_mass", "cross_coupling")]
    report, *_ = diagnosed([record], model, cache=False, without=others)
    assert report["verdict"] == "effect" and [effect["name"] for effect in report["effects"]] == ["gain"]
    values = report["effects"][0]["parameters"]
    assert [values[name]["value"] for name in ("gain", "gain_x", "gain_y")] == pytest.approx([0.06, 0.06, -0.05], abs=2e-3)
