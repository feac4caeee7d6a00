# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Filters of the feedback: notches of the error, derivative action and damping of a resonance, each a section of second order.

Behind the notches the error is e. The feedback is `pi`'s kp e + ki ∫e, and beside it

    derivative      kd s / (1 + s / w_d) e
    damping        -g / (1 + s / w_g) e      (positive feedback of the low-passed measurement)

A notch is (s² + 2 depth width w s + w²) / (s² + 2 width w s + w²), by Tustin's rule prewarped to its frequency. The damping is integral
resonance control in the form of Fleming, Aphale and Moheimani (IEEE Transactions on Nanotechnology 9, 2010, section III): the
controller k / s and a feedthrough 1 / g, whose corner is k / g. Its lag and the 90 degrees of the plant at its resonance make a
negative feedback of the positive one there.

A further filter is a method that returns a section, and a parameter of `Filters`, which the node declares.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hyst_control.base.arrays import Array, Complex
from hyst_control.base.errors import InputError


class Section(NamedTuple):
    """y[k] = (b0 + b1 z^-1 + b2 z^-2) / (1 + a1 z^-1 + a2 z^-2) e[k], by the states m1 and m2 of the transposed direct form."""

    b0: float
    b1: float = 0.0
    b2: float = 0.0
    a1: float = 0.0
    a2: float = 0.0

    def constants(self) -> list[float]:
        """Coefficients, and output and states at rest with an input of 1 (8,): b0, b1, b2, a1, a2, y, m1, m2."""
        rest = (self.b0 + self.b1 + self.b2) / (1.0 + self.a1 + self.a2)
        second = self.b2 - self.a2 * rest
        return [*self, rest, self.b1 - self.a1 * rest + second, second]


def low_pass_share(corner: float, sample_time: float) -> float:
    """Share of a step that a first-order low-pass of a corner in Hz passes within one sample; 1 for a corner of 0, without one."""
    return float(-np.expm1(-2.0 * np.pi * corner * sample_time)) if corner else 1.0


@dataclass(frozen=True)
class Filters:
    """Description of the filters; those with a frequency or a gain of 0 are left out. Raises `InputError` when a value makes no sense."""

    kd: float = 0.0  # V s per measurement unit
    derivative_corner: float = 0.0  # Hz, of its low-pass; 0 for none
    # Of every notch: frequency, Hz; damping ratio of its poles; gain at its frequency
    notch_frequency: tuple[float, ...] = (0.0,)
    notch_width: tuple[float, ...] = (0.7,)
    notch_depth: tuple[float, ...] = (0.1,)
    damping_gain: float = 0.0  # V per measurement unit
    damping_corner: float = 0.0  # Hz

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.all(np.isfinite(value)) and np.all(np.asarray(value) >= 0.0)):
                raise InputError(f"{name}: must be finite and not negative, got {value!r}")
        count = len(self.notch_frequency)
        for name in ("notch_width", "notch_depth"):
            if len(getattr(self, name)) not in (1, count):
                raise InputError(f"{name}: {len(getattr(self, name))} values for {count} notches: give one for all or one each")
        if any(self.notch_frequency) and not all(self.notch_width):
            raise InputError("notch_width: must be above 0")
        if self.damping_gain and not self.damping_corner:
            raise InputError("damping_corner: must be above 0 Hz with a damping_gain")

    def notches(self, sample_time: float) -> list[Section]:
        """Sections in series, which the error passes one after the other."""
        found = []
        for frequency, width, depth in np.broadcast(self.notch_frequency, self.notch_width, self.notch_depth):
            if frequency == 0.0:
                continue
            if not frequency * sample_time < 0.5:
                raise InputError(f"notch_frequency: {frequency:g} Hz must be below half the sample rate, {0.5 / sample_time:g} Hz")
            t = np.tan(np.pi * frequency * sample_time)
            scale = 1.0 + 2.0 * width * t + t * t
            middle = 2.0 * (t * t - 1.0) / scale
            zeros, poles = 2.0 * depth * width * t, 2.0 * width * t
            found.append(
                Section((1.0 + zeros + t * t) / scale, middle, (1.0 - zeros + t * t) / scale, middle, (1.0 - poles + t * t) / scale)
            )
        return found

    def beside(self, sample_time: float) -> list[Section]:
        """Sections in parallel with the proportional and integral parts, of the error behind the notches and the roll-off."""
        found = []
        if self.kd:
            share = low_pass_share(self.derivative_corner, sample_time)
            height = self.kd * share / sample_time
            found.append(Section(height, -height, a1=share - 1.0))
        if self.damping_gain:
            share = low_pass_share(self.damping_corner, sample_time)
            found.append(Section(-self.damping_gain * share, a1=share - 1.0))
        return found


def constants_of(sections: list[Section]) -> Array:
    """Constants of sections (S, 8), see `Section.constants`."""
    return np.array([section.constants() for section in sections]).reshape(-1, 8)


def response(section: Section, z: Complex) -> Complex:
    """Response (F,) of a section at points (F,) of the z plane."""
    back = 1.0 / z
    return np.asarray((section.b0 + back * (section.b1 + back * section.b2)) / (1.0 + back * (section.a1 + back * section.a2)))
