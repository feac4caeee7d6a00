# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The plainest feedforward: a static gain, what a user has before anything is identified."""

from __future__ import annotations

from dataclasses import dataclass

from hyst_control.base.arrays import Array
from hyst_control.chain.c_code.c_code import CCode, each_axis
from hyst_control.control.feedback.loop import Compensator


@dataclass(frozen=True)
class Proportional(Compensator):
    """feedforward = offset + gain reference; gain (A,) in V per measurement unit, offset (A,) in V."""

    gain: Array
    offset: Array
    preview: int = 0

    def settle(self, value: Array) -> Array:
        return self.offset + self.gain * value

    def process(self, block: Array) -> Array:
        return self.offset + self.gain * block

    def c_code(self) -> CCode:
        """The gain in C, see `chain.c_code`."""
        constants = {"gain": (self.gain, "V / measurement unit"), "offset": (self.offset, "V")}
        return each_axis("p->offset[i] + (p->gain[i] * u)", "proportional", constants)
