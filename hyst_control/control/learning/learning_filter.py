# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Inverse response and robustness filter, from which a periodic error becomes a correction of the feedforward.

Over a period of N samples in steady state every signal is a sum of N // 2 + 1 lines. With the plant P, feedback C and sensitivity
S = 1 / (1 + P C), a feedforward that is wrong by d leaves the error e = P S d, and the feedback adds u_b = C e. So

    d = (1 / P + C) e = e / P + u_b

exactly, whatever the feedback is: it needs no model of the controller, as its output is measured. With a response G in place of P
the learning step L e = e / G + u_b leaves

    1 - L P S = (1 - P / G) S

of d after a trial (the condition of Norrloef and Gunnarsson, "Time and frequency domain convergence properties in iterative
learning control", Int. J. Control 75 (2002), for the lifted filter; inversion-based as in Kim and Zou, "A modeling-free
inversion-based iterative feedforward control", IEEE/ASME Trans. Mechatronics 18 (2013)). A real robustness filter 0 <= Q <= 1 on the
step makes that 1 - Q + Q (1 - P / G) S, which is below 1 wherever |(1 - P / G) S| is. Q ends where that can no longer be promised.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Complex, Mask
from hyst_control.base.errors import InputError
from hyst_control.control.linearization import linearized, sampled_response
from hyst_control.control.moving_modes import first_mode
from hyst_control.control.plant_cases import Plants, singular_values, spread_responses
from hyst_control.identify.modal.frequency_response import excited_lines, local_polynomial
from hyst_control.model_file import Model

AMPLIFICATION = 5.0
"""Voltage for a unit of error, relative to that at rest, beyond which nothing is learned: what little moves there is noise."""
GAIN_SPREAD = 0.1  # Relative spread of the plant's gain that is allowed for
MIN_RESONANT = 0.5  # Damping ratio from which a pair of poles is no resonance
CONTRACTION = 0.9
"""Greatest share of an error that a trial may leave, of any plant that is allowed for; the robustness filter ends where it is more."""


@dataclass(frozen=True)
class LearningFilter:
    """The filter of one period."""

    period: int
    inverse: Complex
    robustness: Array

    def __post_init__(self) -> None:
        lines, axes = self.period // 2 + 1, self.inverse.shape[-1]
        if self.inverse.shape != (lines, axes, axes) or self.robustness.shape != (lines,):
            raise InputError(
                f"learning filter: inverse {self.inverse.shape} and robustness {self.robustness.shape}: {lines} lines are needed "
                f"for a period of {self.period} samples"
            )
        if not np.all((self.robustness >= 0.0) & (self.robustness <= 1.0)):
            raise InputError("learning filter: robustness: must be between 0 and 1")

    @property
    def axes(self) -> int:
        """Number of axes."""
        return int(self.inverse.shape[-1])

    def correction(self, error: Annotated[Array, "N A"], feedback: Array) -> Array:
        """Correction (N, A) in V of the feedforward."""
        spectrum = np.einsum("fij,fj->fi", self.inverse, np.fft.rfft(error, axis=0)) + np.fft.rfft(feedback, axis=0)
        return np.fft.irfft(self.robustness[:, None] * spectrum, self.period, axis=0)


def lines_of(period: int) -> Complex:
    """The points z (N // 2 + 1,) on the unit circle of a period of N samples."""
    return np.asarray(np.exp(2j * np.pi * np.arange(period // 2 + 1) / period))


def model_filter(
    model: Model,
    period: int,
    *,
    sample_time: float | None = None,
    mode_spread: float = 0.0,
    model_error: float = 0.15,
) -> LearningFilter:
    """The filter from a model's sampled response at its mean slope."""
    # mode_spread, model_error: relative spread of the first resonance, and the response's own error, for which every trial must gain.
    # Where the plant is beyond them a trial may lose, and the lines that did are then measured anew by the learner; so a resonance
    # that moves is allowed for only where that is asked. It is one below half the sample rate and lightly damped
    sample_time = float(sample_time or model.sample_time)
    axes, z = len(model.axes), lines_of(_checked(period))
    stages = linearized(model)
    response = sampled_response(stages, axes, sample_time, z)
    mode = first_mode(stages, axes)
    if mode is None or abs(mode) * sample_time > np.pi or -mode.real > MIN_RESONANT * abs(mode):
        mode_spread = 0.0  # poles that belong to a delay or a filter do not move as a resonance does
    plants = Plants(z, spread_responses(model, sample_time, 0, GAIN_SPREAD, mode_spread, z), np.zeros(len(z), bool))
    if plants.mixed:  # sizes are greatest singular values then
        ratio = plants.responses @ plants.inverses[0]
        error = (singular_values(np.eye(axes) - ratio)[0] + model_error * singular_values(ratio)[0]).max(axis=0)
    else:
        ratio = (plants.loci.reshape(-1, axes, len(z)) / plants.loci[:axes]).reshape(-1, len(z))
        error = (np.abs(1.0 - ratio) + model_error * np.abs(ratio)).max(axis=0)
    inverse: Complex = np.asarray(np.linalg.inv(response), dtype=np.complex128)
    error[amplified(inverse)] = np.inf
    return LearningFilter(period, inverse, robustness(error))


def measured_filter(command: Annotated[Array, "M A"], measurement: Array, period: int, sample_time: float) -> LearningFilter:
    """The filter from a record in which the command moves in all frequencies of interest (a sweep, noise, a multisine).

    Each axis by itself: the response by local polynomials, its error the radius of its 95 % confidence. That holds the scatter which
    the hysteresis causes, so the filter ends by itself where the record says no more.
    """
    lines = np.arange(_checked(period) // 2 + 1) / (period * sample_time)
    axes = command.shape[1]
    inverse = np.zeros((len(lines), axes, axes), dtype=complex)
    error = np.zeros(len(lines))
    for axis in range(axes):
        given = command[:, axis : axis + 1]
        excited = excited_lines(np.abs(np.fft.rfft(given[:, 0])) ** 2)
        highest = float(excited[-1]) / (len(given) * sample_time) if len(excited) else None
        found = local_polynomial([given], [measurement[:, axis : axis + 1]], sample_time, highest=highest)
        gain, radius = found.response[:, 0, 0], found.radius()[:, 0, 0]
        at_lines = np.interp(lines, found.frequency, gain.real) + 1j * np.interp(lines, found.frequency, gain.imag)
        # Rest is not in the record: the period's slowest line stands for it, where the response is nearly real.
        at_lines[0] = np.copysign(abs(at_lines[1]), at_lines[1].real)
        inverse[:, axis, axis] = 1.0 / at_lines
        error = np.maximum(error, np.interp(lines, found.frequency, radius / np.abs(gain), right=np.inf))
    error[0] = error[1]
    error[amplified(inverse)] = np.inf
    return LearningFilter(period, inverse, robustness(GAIN_SPREAD + error * (1.0 + GAIN_SPREAD)))


def amplified(inverse: Complex) -> Mask:
    """Lines (F,) at which the inverse (F, A, A) asks for more than `AMPLIFICATION` times the voltage at rest."""
    size = np.linalg.norm(inverse, ord=2, axis=(1, 2))
    return np.asarray(size > AMPLIFICATION * size[0])


def robustness(error: Array, peak_sensitivity: float = 2.0) -> Array:
    """Q (F,) for a response whose relative error is up to `error` (F,), in a loop with |S| up to `peak_sensitivity`.

    1 up to two thirds of the first line where a trial might leave more than `CONTRACTION`, 0 from there on, a cosine in between.
    Raises `InputError` when that is the first line already.
    """
    lost = np.flatnonzero(np.asarray(error) * peak_sensitivity >= CONTRACTION)
    end = int(lost[0]) if len(lost) else len(error)
    if end < 2:
        raise InputError(
            f"learning filter: the response is known to {error[min(1, len(error) - 1)]:.0%} at the first line of the period, with a "
            f"peak sensitivity of {peak_sensitivity:g}: learning may diverge: identify again, or lower the spread that is allowed for"
        )
    line = np.arange(len(error))
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * np.clip(3.0 * line / end - 2.0, 0.0, 1.0)))


def _checked(period: int) -> int:
    if period < 4:
        raise InputError(f"period: {period} samples: must be at least 4")
    return period
