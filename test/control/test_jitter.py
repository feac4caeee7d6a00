# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Predicted jitter against loops that numpy runs tick by tick around the recorded motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hyst_control as hc
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import StateSpace, TransferFunction
from hyst_control.cli import main
from hyst_control.control.jitter import jitter
from hyst_control.control.tuning import tune
from hyst_control.model_file import Model

STEP, COUNT = 1e-3, 40_000


def plant(stage, axes=("x",)) -> Model:
    return Model("m", axes, {"command": "V", "measurement": "mrad"}, STEP, Chain((stage,)))


def wander(axes: int, seed: int = 0) -> np.ndarray:
    """Slow noise and a line at 60 Hz."""
    noise = np.random.default_rng(seed).standard_normal((COUNT, axes))
    slow = np.empty_like(noise)
    state = np.zeros(axes)
    for k in range(COUNT):
        state = 0.95 * state + noise[k]
        slow[k] = state
    return 1e-3 * (slow + 3.0 * np.sin(2 * np.pi * 60.0 * STEP * np.arange(COUNT))[:, None] * np.linspace(1.0, 0.3, axes))


def at_rest(rows, command=0.0):
    return hc.from_arrays(np.full_like(rows, command), rows, rate=1 / STEP, unit="mrad", axes=("x", "y")[: rows.shape[1]])


def by_ticks(rows, gains, a, b, delay):
    """Rms (A,) of y = x + d, x' = a x + b u held over a step, u = kp e + ki T sum(e), e = -y, a number of ticks late."""
    axes = rows.shape[1]
    x, total, sent = np.zeros(axes), np.zeros(axes), [np.zeros(axes)] * (delay + 1)
    left = np.empty_like(rows)
    for k in range(len(rows)):
        left[k] = x + rows[k]
        total = total - left[k]
        sent = [*sent[1:], -gains.kp * left[k] + gains.ki * STEP * total]
        x = a * x + b @ sent[0]
    return left[1000:].std(axis=0)


@pytest.mark.parametrize("delay", [0, 1])
def test_jitter_of_a_lag_is_that_of_a_loop_run_tick_by_tick(delay):
    lag, rows = 0.004, wander(1)
    model = plant(TransferFunction((2.0,), (lag, 1.0)))
    gains = tune(model, loop_delay=delay)
    found = jitter(gains, model, at_rest(rows), delay)
    decay = np.exp(-STEP / lag)
    expected = by_ticks(rows, gains, decay, np.array([[2.0 * (1.0 - decay)]]), delay)
    assert np.sqrt(np.sum(found.closed[:, 0] ** 2)) == pytest.approx(expected[0], rel=0.02)
    assert np.sqrt(np.sum(found.without[:, 0] ** 2)) == pytest.approx(rows.std(), rel=0.02)
    assert found.closed[0, 0] < 0.2 * found.without[0, 0]  # below 1 Hz


def test_axes_that_drive_each_other_pass_the_motion_on():
    mixing, decay, rows = np.array([[1.0, 0.4], [0.1, 0.8]]), np.exp(-STEP / 0.004), wander(2)
    a = -np.eye(2) / 0.004
    model = plant(StateSpace(a.tolist(), (mixing / 0.004).tolist(), np.eye(2).tolist(), np.zeros((2, 2)).tolist()), ("x", "y"))
    gains = tune(model, peak_sensitivity=3.0)
    found = jitter(gains, model, at_rest(rows))
    expected = by_ticks(rows, gains, decay, mixing * (1.0 - decay), 0)
    np.testing.assert_allclose(np.sqrt(np.sum(found.closed**2, axis=0)), expected, rtol=0.02)


def test_motion_above_half_the_rate_of_the_loop_stays():
    rows = 1e-3 * np.random.default_rng(1).standard_normal((COUNT, 1))
    model = plant(TransferFunction((2.0,), (0.004, 1.0)))
    found = jitter(tune(model, sample_time=0.01), model, at_rest(rows))
    # White up to 500 Hz, of which the loop sees 50 Hz.
    assert found.closed[-1] == pytest.approx(found.without[-1], rel=0.05) and "alias" in found.notes[-1]


def test_the_command_must_rest_and_the_axes_be_those_of_the_model(tmp_path, capsys):
    model = plant(TransferFunction((2.0,), (0.004, 1.0)))
    gains = tune(model)
    read_back = hc.from_arrays(1e-5 * wander(1, 1), wander(1), rate=1 / STEP, unit="mrad")
    assert jitter(gains, model, read_back).closed.all()  # a drive's voltage as it is read is noisy
    moving = hc.from_arrays(0.1 * wander(1), wander(1), rate=1 / STEP, unit="mrad")
    with pytest.raises(InputError, match="the command moves"):
        jitter(gains, model, moving)
    with pytest.raises(InputError, match="has 2 axes in mrad, m 1 in mrad"):
        jitter(gains, model, at_rest(wander(2)))


@pytest.mark.parametrize("names", ["x [mrad],y [mrad]", "command x [V],command y [V],position x [mrad],position y [mrad]"])
def test_the_command_line_prints_rms_by_band(names, tmp_path: Path, capsys):
    """The log of a detector need not have a command."""
    rows, path = wander(2)[:5000], tmp_path / "quiet.csv"
    commands = np.zeros((len(rows), names.count(",") - 1))
    table = np.column_stack([STEP * np.arange(len(rows)), commands, rows])
    np.savetxt(path, table, delimiter=",", header=f"time [s],{names}", comments="")
    assert main(["tune", "config/models/fsm_mhl.yaml", "--jitter", str(path)]) == 0
    text = capsys.readouterr().out
    assert "without feedback" in text and "10 to 100 Hz" in text
