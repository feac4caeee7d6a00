# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A model with its hysteresis replaced by a slope, and its sampled frequency response."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated

import numpy as np
from scipy.linalg import schur

from hyst_control.base.arrays import Array, Complex
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling, Stage
from hyst_control.chain.chain import ParallelFilter, SeriesFilter, at_rest, resolved
from hyst_control.chain.linear.linear_stages import (
    LinearFilter,
    LinearStage,
    TransferFunction,
)
from hyst_control.chain.stage import Filter
from hyst_control.model_file import Model


def hysteresis_slopes(model: Model) -> tuple[Array, Array]:
    """Mean and greatest local slope (A,) of the hysteresis at rest over the valid range, without the first percent after a reversal."""
    axes = len(model.axes)
    core = next(_hystereses(resolved(model.chain.stages, axes), axes), None)
    if core is None:
        return np.ones(axes), np.ones(axes)
    valid = model.valid.get("command", [0.0, 100.0])
    lower, upper = np.broadcast_to(np.array(valid, dtype=float), (axes, 2)).T
    turns = [0.0, 1.0, 0.0, 1.0, 0.1, 0.9, 0.2, 0.8, 0.3, 0.7]
    shares = np.concatenate([np.linspace(a, b, 201)[1:] for a, b in zip(turns, turns[1:])])
    command = lower + (upper - lower) * shares[:, None]
    output = at_rest([core], command).reshape(-1, 200, axes)
    command = command.reshape(-1, 200, axes)
    rise = (output[:, 10:] - output[:, :-10]) / (command[:, 10:] - command[:, :-10])
    mean = (output[0, -1] - output[1, -1]) / (command[0, -1] - command[1, -1])
    greatest = rise.reshape(-1, axes)
    return mean, greatest[np.abs(greatest).argmax(axis=0), np.arange(axes)]


def linearized(model: Model, slope: Annotated[Array, "A"] | None = None) -> tuple[Stage, ...]:
    """The chain with its hysteresis replaced by `slope` (A,), its mean one by default; modes that soften stand still.

    A parallel rate correction is kept. Hysteresis besides the first one, such as play, gets its own mean slope.
    """
    axes = len(model.axes)
    slope = hysteresis_slopes(model)[0] if slope is None else slope
    stages = resolved(model.chain.stages, axes)
    slopes: dict[int, Array] = {}
    for stage in _hystereses(stages, axes):
        own = stage.mean_slope(axes) if slopes else slope
        if own is not None:
            slopes[id(stage)] = own
    return tuple(_replaced(stages, slopes, axes))


def _hystereses(stages: Sequence[Stage], axes: int) -> Iterator[Stage]:
    """Stages that a slope of each axis stands in for, also those inside others."""
    for stage in stages:
        for chain in stage.inner_chains:
            yield from _hystereses(chain, axes)
        if not stage.inner_chains and stage.is_hysteresis and not stage.mixes_axes and stage.linearized(axes) is None:
            yield stage


def _replaced(stages: Sequence[Stage], slopes: Mapping[int, Array], axes: int) -> list[Stage]:
    """The stages with those that have a slope (A,), by identity, replaced by it."""
    kept: list[Stage] = []
    for stage in stages:
        slope = slopes.get(id(stage))
        if stage.inner_chains:
            kept.append(stage.with_inner_chains([_replaced(chain, slopes, axes) for chain in stage.inner_chains]))
        elif slope is not None:
            kept.append(TransferFunction([[float(value)] for value in slope], [1.0]))
        else:
            linear = stage.linearized(axes)
            if linear is None:
                raise InputError(f"chain ({stage.name}): has no linear description to tune a controller on")
            kept.extend(linear)
    return kept


def sampled_response(stages: Sequence[Stage], axes: int, sample_time: float, z: Complex) -> Complex:
    """Response (F, A, A) from the held command[k] to measurement[k]."""
    running = Chain(tuple(stages)).filter(Sampling(sample_time, axes, "zoh"))
    # The filter's output is the sample at the interval's end.
    return _response(running, axes, z) / z[:, None, None]


def _response(running: Filter, axes: int, z: Complex) -> Complex:
    if isinstance(running, SeriesFilter):
        total = np.broadcast_to(np.eye(axes, dtype=complex), (len(z), axes, axes))
        for part in running.filters:
            total = _response(part, axes, z) @ total
        return total
    if isinstance(running, ParallelFilter):
        return np.asarray(sum((_response(part, axes, z) for part in running.filters), np.zeros((len(z), axes, axes), complex)))
    if not isinstance(running, LinearFilter):
        raise InputError("chain: has a stage without a linear description")
    systems, n, _ = running.a.shape
    width = axes // systems
    total = np.zeros((len(z), axes, axes), dtype=complex)
    back = (1.0 / z)[:, None, None]
    for s in range(systems):
        late = z[:, None, None] ** -running.whole[s * width : (s + 1) * width].astype(float)
        entering = running.b[s, 0] + running.b[s, 1] * back + running.b[s, 2] * back**2
        # In the triangular form the states follow one from the other, at all frequencies (and inputs) at once.
        triangle, turn = schur(running.a[s], output="complex")
        columns = turn.conj().T @ np.moveaxis(entering, 1, 0).reshape(n, len(z) * entering.shape[2])
        each = np.repeat(back[:, 0, 0], entering.shape[2])
        state = np.empty_like(columns)
        for i in reversed(range(n)):
            state[i] = (columns[i] + each * (triangle[i, i + 1 :] @ state[i + 1 :])) / (1.0 - triangle[i, i] * each)
        output = ((running.c[s] @ turn) @ state).reshape(len(running.c[s]), len(z), entering.shape[2])
        block = np.moveaxis(output, 0, 1) + running.d[s, 0] + running.d[s, 1] * back
        total[:, s * width : (s + 1) * width, s * width : (s + 1) * width] = block * late
    return total


def modes(stages: Sequence[Stage], axes: int) -> Complex:
    """Complex poles (rad/s) of a linear chain, one of each pair, the slowest first."""
    within = [modes(chain, axes) for stage in stages for chain in stage.inner_chains]
    poles = np.concatenate(
        [np.empty(0), *within, *(_complex_poles(stage, axes) for stage in stages if isinstance(stage, LinearStage))]
    )
    return np.asarray(poles[np.argsort(np.abs(poles))], dtype=np.complex128)


def has_dynamics(stages: Sequence[Stage], axes: int) -> bool:
    """True where a stage of a linear chain has states, delays apart."""
    return any(
        any(has_dynamics(chain, axes) for chain in stage.inner_chains)
        or (isinstance(stage, LinearStage) and any(len(system.A) for system in stage.systems(axes)))
        for stage in stages
    )


def _complex_poles(stage: LinearStage, axes: int) -> Complex:
    poles = np.concatenate([np.linalg.eigvals(system.A) for system in stage.systems(axes)])
    return np.asarray(poles[poles.imag > 1e-6 * np.abs(poles)])
