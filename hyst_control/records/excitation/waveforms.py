# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Signals that an equation gives: of one axis (rest, sines, ramps, triangles, steps, loops), and paths of two over a field."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.records.excitation.signal_size import check_size, number, sample_count, sample_times


def rest(sample_time: float, duration: float, offset: float = 0.0) -> Array:
    """Constant signal at `offset`."""
    return np.full(sample_count(duration, sample_time), number(offset, "offset"))


def sine(
    sample_time: float, frequency: float, amplitude: float, offset: float = 0.0, duration: float = 1.0, phase: float = 0.0
) -> Array:
    """Sine: offset + amplitude sin(2π frequency t + phase)."""
    return offset + amplitude * np.sin(2 * np.pi * frequency * sample_times(duration, sample_time) + phase)


def smooth_step(through: NDArray[np.floating[Any]]) -> Array:
    """Weight from 0 to 1 where its argument goes from 0 to 1, whose slope and curvature are 0 at both ends: its jerk is limited."""
    x = np.clip(np.asarray(through, dtype=np.float64), 0.0, 1.0)
    weight: Array = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return weight


def cosine_ramp(sample_time: float, start: float, stop: float, duration: float) -> Array:
    """Ramp along half a cosine, without a jump in value or rate."""
    count = sample_count(duration, sample_time)
    return start + (stop - start) * 0.5 * (1 - np.cos(np.pi * np.arange(count) / count))


def decaying_sine(
    sample_time: float,
    frequency: float,
    amplitude: float,
    offset: float = 0.0,
    duration: float = 1.0,
    final: float = 0.0,
    phase: float = 0.0,
) -> Array:
    """Sine whose amplitude changes linearly from `amplitude` to `final`; it grows where `final` is larger."""
    time = sample_times(duration, sample_time)
    return offset + (amplitude + (final - amplitude) * time / duration) * np.sin(2 * np.pi * frequency * time + phase)


def multi_frequency(
    sample_time: float,
    frequencies: Sequence[float],
    amplitudes: Sequence[float],
    offset: float = 0.0,
    duration: float = 1.0,
    phases: Sequence[float] | None = None,
) -> Array:
    """Sum of sines: offset + Σ a_i sin(2π f_i t + φ_i) (MHL paper §4.3, §4.4)."""
    f, a = np.asarray(frequencies, dtype=float), np.asarray(amplitudes, dtype=float)
    p = np.zeros_like(f) if phases is None else np.asarray(phases, dtype=float)
    if not f.shape == a.shape == p.shape or f.ndim != 1 or not f.size:
        raise InputError(f"frequencies: must be as many as amplitudes and phases, got {f.size}, {a.size} and {p.size}")
    time = sample_times(duration, sample_time)
    waves = sum(ai * np.sin(2 * np.pi * fi * time + pi) for fi, ai, pi in zip(f, a, p, strict=True))
    return np.asarray(offset + waves)


def triangle(sample_time: float, frequency: float, amplitude: float, offset: float = 0.0, duration: float = 1.0) -> Array:
    """Triangle between offset ± amplitude, which begins at its lowest point."""
    phase = (frequency * sample_times(duration, sample_time)) % 1.0
    return offset + amplitude * (1.0 - 4.0 * np.abs(phase - 0.5))


def staircase(sample_time: float, levels: Sequence[float] | Array, hold: float, ramp: float = 0.0) -> Array:
    """Levels that are held one after the other."""
    values = [number(level, "levels") for level in levels]
    check_size(len(values) * (number(hold, "hold") + number(ramp, "ramp")) / sample_time)
    if not values:
        raise InputError("levels: must be a list of at least one level, got an empty one")
    parts = []
    for before, level in zip([values[0], *values], values, strict=False):
        if ramp and level != before:
            parts.append(cosine_ramp(sample_time, before, level, ramp))
        parts.append(rest(sample_time, hold, level))
    return np.concatenate(parts)


def step(sample_time: float, height: float, offset: float = 0.0, before: float = 0.01, after: float = 0.2) -> Array:
    """Step from `offset` to offset + height."""
    return np.concatenate([rest(sample_time, before, offset), rest(sample_time, after, offset + height)])


def steps(sample_time: float, lowest: float, highest: float, hold: float, count: int, seed: int = 0) -> Array:
    """Random levels between `lowest` and `highest`, each held; begins and ends at `lowest`."""
    check_size(number(count, "count") * max(number(hold, "hold") / sample_time, 1.0))
    levels = np.random.default_rng(seed).uniform(lowest, highest, int(count))
    return staircase(sample_time, [lowest, *levels, lowest], hold)


def loops(sample_time: float, frequency: float, peak: float, cycles: float) -> Array:
    """One-sided loops from 0 to `peak` and back: peak (1 - cos 2π f t) / 2."""
    count = sample_count(cycles / frequency, sample_time)
    return np.asarray(0.5 * peak * (1 - np.cos(2 * np.pi * frequency * np.arange(count) * sample_time)))


def spiral(sample_time: float, axes: int, radius: float, frequency: float, duration: float, offset: float = 0.0) -> Array:
    """Spiral of axes 0 and 1: offset + r(t) (cos, sin), with r growing linearly from 0 to `radius`."""
    _two_axes(axes)
    check_size(number(duration, "duration") * axes / sample_time)
    time = sample_times(duration, sample_time)
    rows = np.full((len(time), axes), float(offset))
    grown = radius * time / duration
    rows[:, 0] += grown * np.cos(2 * np.pi * frequency * time)
    rows[:, 1] += grown * np.sin(2 * np.pi * frequency * time)
    return rows


def raster(sample_time: float, axes: int, width: float, height: float, lines: int, line_time: float, offset: float = 0.0) -> Array:
    """Raster scan: axis 0 sweeps ± width/2 as a triangle while axis 1 climbs linearly from -height/2 to height/2."""
    _two_axes(axes)
    duration = lines * line_time
    check_size(number(duration, "lines") * axes / sample_time)
    rows = np.full((sample_count(duration, sample_time), axes), float(offset))
    rows[:, 0] += triangle(sample_time, 0.5 / line_time, width / 2, 0.0, duration)
    rows[:, 1] += height * (np.arange(len(rows)) / max(len(rows) - 1, 1) - 0.5)
    return rows


def _two_axes(axes: int) -> None:
    if axes < 2:
        raise InputError(f"axes: {axes}, two axes are needed")
