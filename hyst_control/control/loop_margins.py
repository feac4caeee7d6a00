# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Margins of open loops from their responses, the worst over a relative error of the response."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hyst_control.base.arrays import Array, Complex


@dataclass(frozen=True)
class Margins:
    """Stability of one loop.

    gain_margin dB, phase_margin degrees, peak_sensitivity (max |1 / (1 + L)|; of mixed axes the greatest singular value), crossover and
    bandwidth Hz (-3 dB of L / (1 + L), half the sampling rate when it stays above).
    """

    gain_margin: float
    phase_margin: float
    peak_sensitivity: float
    crossover: float
    bandwidth: float

    def keep(self, gain_margin: float, phase_margin: float, peak_sensitivity: float) -> bool:
        """True when the margins are at least these, in dB and degrees, and the peak at most this."""
        enough = self.gain_margin >= gain_margin and self.phase_margin >= phase_margin
        return enough and self.peak_sensitivity <= peak_sensitivity


def margins(loop: Complex, z: Complex, sample_time: float, error: float = 0.0) -> Margins:
    """Margins of a stable loop, the worst over a relative error of its response.

    Parameters
    ----------
    loop
        Response of the open loop (F,).
    z
        Points (F,) exp(j w T) of the response, in order of frequency.
    sample_time
        Sample time T, s.
    error
        Relative error of the response.

    Returns
    -------
    Margins
        Gain margin in dB, phase margin in degrees, peak sensitivity, and crossover and bandwidth in Hz.
    """
    frequency = np.angle(z) / (2.0 * np.pi * sample_time)
    crossing = float(crossing_180(loop[None])[0]) * (1.0 + error)
    above = np.flatnonzero(np.abs(loop) >= 1.0)
    closed = np.abs(loop / (1.0 + loop))
    below = np.flatnonzero(closed < np.sqrt(0.5))
    return Margins(
        gain_margin=-20.0 * float(np.log10(crossing)) if crossing > 0.0 else np.inf,
        phase_margin=float(np.degrees(phase_margin_of(courses_of(loop[None]), error)[0])),
        peak_sensitivity=1.0 / min_distance(loop, error),
        crossover=float(frequency[above[-1]]) if len(above) else 0.0,
        bandwidth=float(frequency[below[0]]) if len(below) else 0.5 / sample_time,
    )


def worst(cases: list[Margins]) -> Margins:
    """The worst of each margin over several loops."""
    least = {name: min(getattr(case, name) for case in cases) for name in vars(cases[0])}
    return Margins(**{**least, "peak_sensitivity": max(case.peak_sensitivity for case in cases)})


def crossing_180(loops: Complex) -> Array:
    """The greatest |L| (M,) where each of loops (M, F) crosses the negative real axis; 0 where it never does."""
    real, imaginary = loops.real, loops.imag
    change = imaginary[:, :-1] - imaginary[:, 1:]
    share = imaginary[:, :-1] / np.where(change == 0.0, 1.0, change)
    at = real[:, :-1] + share * (real[:, 1:] - real[:, :-1])
    crossed = (imaginary[:, :-1] * imaginary[:, 1:] <= 0.0) & (at < 0.0)
    # At half the sampling rate L is real, whatever its sign.
    return np.asarray(np.maximum(np.where(crossed, -at, 0.0).max(axis=1), -real[:, -1].clip(max=0.0)))


def min_distance(loops: Complex, error: float) -> float:
    """The least |1 + L (1 + d)| over loops and all relative errors |d| up to `error`."""
    return float((np.abs(1.0 + loops) - error * np.abs(loops)).min())


class Courses(NamedTuple):
    """Loops (M, F) between neighboring points: ln |L| (M, F) at all of them, arg L (M, F - 1) and what it turns by up to the next."""

    size: Array
    phase: Array
    turn: Array


def courses_of(loops: Complex) -> Courses:
    """Sizes and phases of loops (M, F), as `phase_margin_of` takes them."""
    return Courses(np.log(np.abs(loops)), np.angle(loops[:, :-1]), np.angle(loops[:, 1:] / loops[:, :-1]))


def phase_margin_of(courses: Courses, error: float, scale: float = 1.0) -> Array:
    """Least distance (M,) in rad of the phase from -180 degrees where |L| of `scale` times the loops crosses 1; pi where it never does."""
    # A relative error turns the phase by its arc sine, and moves the crossing to where |L| is 1 / (1 + error) to 1 / (1 - error).
    least = np.full(len(courses.size), np.pi)
    for factor in (1.0 - error, 1.0, 1.0 + error) if error else (1.0,):
        size = courses.size + np.log(factor * scale)
        loop, at = np.nonzero(size[:, :-1] * size[:, 1:] <= 0.0)
        before = size[loop, at]
        change = before - size[loop, at + 1]
        phase = courses.phase[loop, at] + courses.turn[loop, at] * before / np.where(change == 0.0, 1.0, change)
        np.minimum.at(least, loop, np.abs(np.mod(phase, 2.0 * np.pi) - np.pi))
    return np.asarray(least - np.arcsin(error))
