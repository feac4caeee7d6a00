# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Paths of two axes over a field: spiral and raster."""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.records.excitation.signal_size import check_size, number, sample_count, sample_times
from hyst_control.records.excitation.waveforms import triangle


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
