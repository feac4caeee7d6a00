# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Motion of the other axis in the measurement."""

from __future__ import annotations

import numpy as np

from hyst_control.chain.linear.linear_stages import CrossCoupling
from hyst_control.chain.stage import Stage
from hyst_control.effects.coupled_modes import CoupledModes
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Share of the other axis' motion, and corner of the low-pass it comes through, in a record's surroundings `around`."""
    nyquist = 0.5 / around.sample_time
    corner = Parameter(
        "corner", "Hz", 0.5 * nyquist, (0.1 * nyquist, 0.5 * nyquist), 3.0 / around.duration, 5.0 * nyquist, 1.5, True
    )
    return (Parameter("coupling", "", 0.0, (0.01,), -0.5, 0.5, 0.03), corner)


def coupled_parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """From every other axis' input to every sensor a response in the mechanics' modes, in phase and in quadrature, and a static part."""
    if not around.modes:
        return parameters(around)
    parts = [f"{part}_{mode}" for part in MODAL for mode in range(len(around.modes))] + [STATIC]
    return tuple(
        Parameter(
            f"{part}_{sensor}_{source}", "", 0.0, (0.0,), -2.0, 2.0, 0.1, told=False, sensor=sensor, response=f"{part}_{source}"
        )
        for part in parts
        for sensor in range(around.axes)
        for source in range(around.axes)
        if sensor != source
    )


IN_PHASE = "in_phase"
QUADRATURE = "quadrature"
MODAL = (IN_PHASE, QUADRATURE)
STATIC = "static"


def at_rest(values: Values) -> dict[str, float]:
    """Coupling of a matrix of responses: its greatest share at rest, of commands of one size in any pattern over the axes."""
    static = [name for name in values if name.startswith(f"{STATIC}_")]
    if not static:
        return {}
    axes = 1 + max(int(name.rpartition("_")[2]) for name in static)
    matrix = np.zeros((axes, axes))
    for name, value in values.items():
        part, _, source = name.rpartition("_")
        part, _, sensor = part.rpartition("_")
        if part == STATIC or part.startswith(f"{IN_PHASE}_"):
            matrix[int(sensor), int(source)] += value
    return {"coupling": float(np.linalg.norm(matrix, 2))}


def stage(values: Values, around: Surroundings) -> Stage:
    """Onto every axis comes `coupling` of the next one (the last one's next is the first), or a matrix of responses in all modes."""
    axes = around.axes
    if f"{STATIC}_0_1" in values:
        size = around.stroke / max(around.command[1] - around.command[0], 1e-300)

        def matrix_of(part: str) -> np.ndarray:
            rows = [[values.get(f"{part}_{sensor}_{source}", 0.0) for source in range(axes)] for sensor in range(axes)]
            return size * np.array(rows)

        in_phase, quadrature = (np.array([matrix_of(f"{part}_{mode}") for mode in range(len(around.modes))]) for part in MODAL)
        frequency, damping = np.array(around.modes).T
        return CoupledModes(frequency, damping, in_phase, quadrature, matrix_of(STATIC))
    coupling = np.broadcast_to(np.array(values["coupling"], dtype=float), axes)
    matrix = np.eye(axes)
    for axis in range(axes if axes > 1 else 0):
        matrix[axis, (axis + 1) % axes] += coupling[axis]
    return CrossCoupling(matrix, values.get("corner"))


EFFECT = Effect(
    "cross_coupling",
    "motion",
    "A share of the other axis' motion comes in, through a first-order low-pass or in the modes that coupled axes share.",
    parameters,
    stage,
    exercised=lambda around: around.axes > 1,
    couples=True,
    separate_sizes=True,
    static=True,
    phrase="cross coupling of {coupling}",
    coupled_parameters=coupled_parameters,
    summary=at_rest,
)
