# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The amplifier's bandwidth, in front of the hysteresis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.chain import Averaged
from hyst_control.chain.stage import Stage, frozen, register
from hyst_control.effects.lowpass import AtSamples, Lowpass, Rebuilt, lowpass_effect


@register
@dataclass(frozen=True)
class AmplifierLowpass(Lowpass, Averaged):
    """A low-pass of a held command: `order` equal ones in a row, or one of second order with another `damping`.

    A hysteresis behind it is followed at the samples, exactly; in between its output is taken to bend as the voltage does, from
    order 3 on like one first-order lag of `order` times the time constant, until the next linear stage (`chain.arrange`). No half
    sample is lost, and an infinite cutoff is the held command itself. A stage with dynamics of its own gets the mean over each
    interval.
    """

    name: ClassVar[str] = "amplifier_lowpass"
    place: ClassVar[str] = "drive"
    last_at_place: ClassVar[bool] = True

    def at_samples(self) -> Stage:
        """The voltage at the ends of the intervals."""
        return AtSamples(self)

    def between_samples(self) -> tuple[Stage, ...]:
        """Stages that bend a signal known at the samples as this low-pass bends the voltage."""
        order = np.array(self.order)
        many = order > 2
        cutoff = np.array(self.cutoff, dtype=float) / np.where(many, order, 1)
        shape = frozen(cutoff), frozen(np.where(many, 1, order)), frozen(np.where(many, 1.0, np.array(self.damping)))
        return Rebuilt(*shape), AmplifierLowpass(*shape)


EFFECT = lowpass_effect(
    "amplifier_lowpass",
    "drive",
    "The amplifier is slower than the model says: a low-pass of first or second order before the hysteresis.",
    AmplifierLowpass,
    "an amplifier low-pass at {cutoff}",
)
