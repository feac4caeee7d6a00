"""A model at rest: its static curve, its reachable stroke, and the inverse of both. Rates, delays and dynamics are left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyst_control.chain import Parallel, Stage
from hyst_control.chain.chain import resolved
from hyst_control.chain.linear import Delay, LinearStage
from hyst_control.chain.madelung import Madelung
from hyst_control.chain.stage import Array, Filter, Sampling
from hyst_control.errors import InputError
from hyst_control.model_file import Model

SLOW = 1e9
"""Sample time in s at which the rate terms of hysteresis stages vanish."""


def quasi_static(model: Model, commands: Array) -> Array:
    """Output (N, A) of the model when every command (N, A) in V is held until all has settled, from rest at 0 V."""
    return quasi_static_stages(resolved(model.chain.stages, len(model.axes)), np.array(commands, dtype=float), len(model.axes))


def quasi_static_stages(stages: Sequence[Stage], signal: Array, axes: int) -> Array:
    """The same for a list of stages and the signal (N, A) that enters them."""
    for stage in stages:
        if isinstance(stage, Delay):
            continue
        if isinstance(stage, Parallel):
            signal = np.sum([quasi_static_stages(branch, signal, axes) for branch in stage.branches], axis=0)
        elif isinstance(stage, LinearStage):
            gain, bias = static_gain(stage, axes)
            signal = signal @ gain.T + bias
        else:
            running: Filter = stage.filter(Sampling(SLOW, axes, "foh"))
            running.settle(signal[0])
            signal = running.process(np.ascontiguousarray(signal))
    return signal


def static_gain(stage: LinearStage, axes: int) -> tuple[Array, Array]:
    """Static gain (A, A) and bias (A,) of a linear stage."""
    if getattr(stage, "discrete", False):
        a, b, c, d = (np.array(getattr(stage, part), dtype=float) for part in "ABCD")
        return d + c @ np.linalg.solve(np.eye(len(a)) - a, b), np.zeros(axes)
    systems = stage.systems(axes)
    gain = np.zeros((axes, axes))
    width = axes // len(systems)
    for i, system in enumerate(systems):
        gain[i * width : (i + 1) * width, i * width : (i + 1) * width] = system.static_gain()
    return gain, np.concatenate([system.bias for system in systems])


def mean_line(model: Model, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Slope (A,), measurement unit per V, and intercept (A,) of the straight line through the slow loop between two commands (A,).

    The loop is taken over the part of [lower, upper] where the model is valid. Raises `InputError` when it has no slope.
    """
    valid = model.valid.get("command")
    if valid is not None:
        inside = np.array(valid, dtype=float).reshape(-1, 2)
        lower, upper = np.maximum(lower, inside[:, 0]), np.minimum(upper, inside[:, 1])
    ramp = np.linspace(lower, upper, 201)
    loop = np.concatenate([ramp, ramp[::-1], ramp, ramp[::-1]])
    output = quasi_static(model, loop)[-2 * len(ramp) :]
    lines = [np.polyfit(loop[-2 * len(ramp) :, axis], output[:, axis], 1) for axis in range(output.shape[1])]
    slope, offset = np.array(lines).T
    if np.any(slope == 0.0) or not np.all(np.isfinite(slope)):
        raise InputError("chain: the output does not depend on the command at rest: this model has no static gain to invert")
    return slope, offset


def hysteretic(stage: Stage) -> bool:
    """Whether a stage has memory and no linear description: the part of a chain that a compensator inverts by itself."""
    if isinstance(stage, Parallel):
        return any(hysteretic(item) for branch in stage.branches for item in branch)
    return isinstance(stage, Madelung) or hasattr(stage, "thresholds")
