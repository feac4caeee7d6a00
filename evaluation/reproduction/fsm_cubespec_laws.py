# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Regression of a linear model's error on candidate nonlinear forces of the measured mirror, per force law and level.

The linear model's error is regressed, in windows of neighboring lines, on the command and on candidate forces computed from the
linear model's own output, which the command alone causes. Every force has a frequency response of its own, so no assumption is
made about where it acts. The regression is fitted on the realizations of `FIT` and judged on the others: a law that is wrong, or
has more unknowns than it explains, does worse than none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from evaluation.reproduction.softening_modes import stop_operators
from hyst_control.base.arrays import Array
from hyst_control.identify.modal.modal_model import ModalModel

LINES = 24
"""Lines of 0.78 Hz in a window, over which each response is a straight line."""
RIDGE = 1e-3
"""Of the regression, relative to each column's power."""
STOP = 0.15
"""Threshold of the stop operators, relative to the rms of the command."""


@dataclass(frozen=True)
class Motion:
    """Elongation, its velocity and the command (N, A, R), each scaled to an rms of 1."""

    elongation: Array
    velocity: Array
    command: Array


def _root(q: Array) -> Array:
    return q * np.sqrt(np.abs(q))


def _pairs(q: Array) -> Array:
    return np.concatenate([q * q, q * np.roll(q, 1, axis=1)], axis=1)


LAWS: dict[str, Callable[[Motion], Sequence[Array]]] = {
    "command alone": lambda motion: (),
    "q|q|^0.25": lambda motion: (motion.elongation * np.abs(motion.elongation) ** 0.25,),
    "q|q|^0.5": lambda motion: (_root(motion.elongation),),
    "q|q|": lambda motion: (motion.elongation * np.abs(motion.elongation),),
    "q^3": lambda motion: (motion.elongation**3,),
    "q|q|^0.5 + q|q|": lambda motion: (_root(motion.elongation), motion.elongation * np.abs(motion.elongation)),
    "q|q|^0.5 + q^3": lambda motion: (_root(motion.elongation), motion.elongation**3),
    "q|q|^0.5 + q^2 and products": lambda motion: (_root(motion.elongation), _pairs(motion.elongation)),
    "q|q|^0.5 + |q| v, damping": lambda motion: (_root(motion.elongation), np.abs(motion.elongation) * motion.velocity),
    "q|q|^0.5 + sign v, friction": lambda motion: (_root(motion.elongation), np.tanh(3.0 * motion.velocity)),
    "q|q|^0.5 + v|v|^0.5": lambda motion: (_root(motion.elongation), _root(motion.velocity)),
    "q|q|^0.5 + u|u|^0.5, amplifier": lambda motion: (_root(motion.elongation), _root(motion.command)),
    "q|q|^0.5 + stop of the command": lambda motion: (_root(motion.elongation), stop_operators(motion.command, (STOP,))),
    "q times all actuators' amplitude^0.5": lambda motion: (
        motion.elongation * np.sum(motion.elongation**2, axis=1, keepdims=True) ** 0.25,
    ),
}
"""Forces of the elongation q, the velocity v and the command u, per actuator."""


def motion_of(model: ModalModel, command: Annotated[Array, "N A R"], sample_time: float) -> tuple[Motion, Array]:
    """Compute the motion and the output that a periodic command causes in a linear model."""
    samples = len(command)
    lines = np.arange(1, samples // 2)
    spectrum = np.zeros((samples // 2 + 1, *command.shape[1:]), dtype=complex)
    spectrum[lines] = model.response(2 * np.pi * lines / samples) @ np.fft.rfft(command, axis=0)[lines]
    output = np.fft.irfft(spectrum, samples, axis=0)
    # In volts of a slow command: what the low lines' gain makes of the output.
    low = model.response(2 * np.pi * np.linspace(80.0, 230.0, 50) * sample_time).mean(axis=0).real
    elongation = np.einsum("ij,njr->nir", np.linalg.inv(low), output)
    slope = np.fft.rfft(elongation, axis=0) * (1j * np.arange(samples // 2 + 1))[:, None, None]
    slope[-1] = 0.0
    velocity = np.fft.irfft(slope, samples, axis=0)
    return Motion(*(part / np.std(part) for part in (elongation, velocity, command))), output


def left_over(error: Annotated[Array, "N A R"], regressors: Annotated[Array, "N K R"], fit: Sequence[int]) -> Annotated[Array, "R"]:
    """Compute the mean square of an error that its regression leaves in each realization."""
    samples = len(error)
    y, x = (np.fft.rfft(part, axis=0)[1:-1] for part in (error, regressors))
    left = np.zeros(error.shape[2])
    slope = np.linspace(-1.0, 1.0, LINES)[:, None] ** np.arange(2)
    chosen = np.asarray(fit)
    for begin in range(0, len(y), LINES):
        window = slice(begin, min(begin + LINES, len(y)))
        powers = slope[: window.stop - begin]
        columns = np.einsum("kjr,kd->krdj", x[window], powers).reshape(len(powers), error.shape[2], -1)
        target = np.swapaxes(y[window], 1, 2)
        a, b = columns[:, chosen].reshape(-1, columns.shape[2]), target[:, chosen].reshape(-1, target.shape[2])
        gram = a.conj().T @ a
        diagonal = np.diag(gram).real
        gains = np.linalg.solve(gram + np.diag(RIDGE * diagonal + 1e-12 * diagonal.max()), a.conj().T @ b)
        left += np.sum(np.abs(target - columns @ gains) ** 2, axis=(0, 2))
    return 2.0 * left / samples**2
