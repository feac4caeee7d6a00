# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes of the feedback that the tuning tries: all but the gains that it scales."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.control.feedback.filters import Filters
from hyst_control.control.feedback.pi import PI

STRUCTURES = ("pi", "pid", "notch", "damping")
ROLL_OFFS = tuple(np.geomspace(0.4, 0.004, 11).tolist())
"""Corners of the roll-off that are tried, relative to the sample rate; beside other filters every fourth of them."""
DERIVATIVES = tuple(product(np.geomspace(1.0, 1000.0, 10).tolist(), (0.1, 0.25, 0.5), (0.1, 0.4)))
"""Integral time in samples, derivative time over it, and corner of the derivative's low-pass relative to the sample rate."""
NOTCHES = tuple(product((0.3, 0.7, 1.5), (0.03, 0.1, 0.3)))  # Damping ratio of the poles, and depth
DAMPINGS = tuple(product((0.15, 0.25, 0.35), (0.3, 0.5, 0.8, 1.2, 2.0)))
"""Gain times the plant's static gain, which the gain margin keeps below 1/2, and corner over the first resonance."""


@dataclass(frozen=True)
class Shape:
    """Roll-off (Hz), integral time, derivative time over it, and filters, of which `several` are compared."""

    roll_off: float = 0.0
    time: float | None = None  # s; None to try many
    derivative: float = 0.0
    derivative_corner: float = 0.0  # Hz
    notch: tuple[float, float, float] | None = None  # frequency (Hz), width, depth
    damping_gain: float = 0.0  # V per measurement unit
    damping_corner: float = 0.0  # Hz
    several: bool = True

    def law(self, kp: float, ki: float, kd: float, sample_time: float) -> PI:
        """The law with these gains, without limits."""
        corner = self.derivative_corner if kd else 0.0
        filters = Filters(kd, corner, damping_gain=self.damping_gain, damping_corner=self.damping_corner)
        if self.notch:
            frequency, width, depth = self.notch
            filters = replace(filters, notch_frequency=(frequency,), notch_width=(width,), notch_depth=(depth,))
        return PI(kp, ki, sample_time, -1e300, 1e300, roll_off=self.roll_off, filters=filters)


def shapes(structure: str, roll_off: float | None, static: float, mode: complex | None, sample_time: float) -> list[Shape]:
    """Shapes of a structure or, for "auto", of all; roll-off in Hz, None to try several; the plant's static gain, and first mode's pole."""
    if structure == "pi":
        corners = [0.0, *(share / sample_time for share in ROLL_OFFS)] if roll_off is None else [roll_off]
        return [Shape(corner, several=corner > 0.0) for corner in corners]
    corners = [0.0, *(share / sample_time for share in ROLL_OFFS[::4])] if roll_off is None else [roll_off]
    frequency = 0.0 if mode is None else abs(mode) / (2.0 * math.pi)
    usable = 0.0 < frequency * sample_time < 0.5
    if structure in ("notch", "damping") and not usable:
        found_at = f"the first is at {frequency:g} Hz" if frequency else "the model has none"
        raise InputError(f"structure: {structure} needs a resonance below half the sample rate, {found_at}: take pid or pi")
    found: list[Shape] = []
    for corner in corners:
        if structure in ("pid", "damping", "auto"):
            found += [Shape(corner)]  # without a derivative, and without damping
        if structure in ("pid", "auto"):
            found += [Shape(corner, time * sample_time, share, place / sample_time) for time, share, place in DERIVATIVES]
        if structure in ("notch", "auto") and usable:
            found += [Shape(corner, notch=(frequency, width, depth)) for width, depth in NOTCHES]
        if structure in ("damping", "auto") and usable:
            found += [Shape(corner, damping_gain=gain / static, damping_corner=place * frequency) for gain, place in DAMPINGS]
    return found
