# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a reference generator that describe its signal, made from what the kinds of signals say of themselves."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor

from hyst_control.base.errors import InputError
from hyst_control.nodes.signal_node.parameters import Setting
from hyst_control.records.excitation.excitation import KINDS
from hyst_control.records.excitation.parameters import COMMON, described
from hyst_control.records.stream.foreign_rows import LARGEST_VALUE

NOT_GIVEN = ""  # Value of a parameter that was not given; the signal says whether it needs it
OF_THE_GENERATOR = ("sample_time", "axes")


@dataclass(frozen=True)
class SignalSetting(Setting):
    """Parameter of a signal: a number, a truth value, or a list of numbers; the signal itself checks more."""

    def descriptor(self) -> ParameterDescriptor:
        """ROS descriptor; with the range also where nothing is given by default."""
        descriptor = super().descriptor()
        descriptor.floating_point_range = [FloatingPointRange(from_value=-LARGEST_VALUE, to_value=LARGEST_VALUE)]
        return descriptor

    def checked(self, value: Any) -> Any:
        if value == NOT_GIVEN:
            return NOT_GIVEN
        several = isinstance(value, Iterable) and not isinstance(value, (str, bytes))
        for item in value if several else (value,):
            if isinstance(item, (str, bytes)) or not math.isfinite(item) or abs(item) > LARGEST_VALUE:
                raise InputError(
                    f"{self.name}: must be {-LARGEST_VALUE:g} to {LARGEST_VALUE:g}, or a list of such numbers, got {item!r}"
                )
        return tuple(value) if several else value


def signal_settings(kind: str) -> tuple[SignalSetting, ...]:
    """Parameters of a kind of signal."""
    own = inspect.signature(KINDS[kind]).parameters
    defaults = {name: each.default for name, each in own.items() if name not in OF_THE_GENERATOR}
    defaults |= {name: None for name in COMMON if name not in own}
    found = []
    for name, default in defaults.items():
        given, meant = NOT_GIVEN if default in (inspect.Parameter.empty, None) else default, described(kind, name)
        found.append(SignalSetting(name, given, meant.unit, meant.meaning, -LARGEST_VALUE, LARGEST_VALUE, live=True))
    return tuple(found)
