# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A model at rest: its static curve, its reachable stroke, and the inverse of both. Rates, delays and dynamics are left out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain import Stage
from hyst_control.chain.chain import at_rest, resolved
from hyst_control.model_file import Model


def quasi_static(model: Model, commands: Annotated[Array, "N A"]) -> Array:
    """Output (N, A) of a model at rest."""
    return quasi_static_stages(resolved(model.chain.stages, len(model.axes)), np.array(commands, dtype=float), len(model.axes))


def quasi_static_stages(stages: Sequence[Stage], signal: Annotated[Array, "N A"], axes: int) -> Array:
    """Output (N, A) of stages at rest."""
    return at_rest(stages, signal)


def mean_line(model: Model, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Slope (A,) and intercept (A,) of the line through the slow loop between two commands (A,); raises `InputError` where it is flat."""
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
    """Tell whether a stage has memory and no linear description: the part of a chain that a compensator inverts by itself."""
    return stage.has_compensator
