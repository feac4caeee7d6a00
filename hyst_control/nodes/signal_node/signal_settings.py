# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of a reference generator that describe its signal, made from what the kinds of signals say of themselves."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor

from hyst_control.base.errors import InputError
from hyst_control.nodes.signal_node.parameters import Setting
from hyst_control.records.excitation.excitation import KINDS
from hyst_control.records.stream.foreign_rows import LARGEST_VALUE

NOT_GIVEN = ""
"""Value of a parameter that was not given; the signal says whether it needs it."""
OF_THE_GENERATOR = ("sample_time", "axes")
COMMON = {
    "lower": "Lowest value that the signal may have, signal unit.",
    "upper": "Highest value that the signal may have, signal unit.",
    "slew_limit": "Greatest rate that the signal may have, signal unit/s.",
    "axis": "Index of the axis that moves; all if not given.",
    "idle": "Value of the other axes, signal unit.",
}
"""Parameters that every kind of signal has."""


@dataclass(frozen=True)
class SignalSetting(Setting):
    """Parameter of a signal: a number, a truth value, or a list of numbers; the signal itself checks more."""

    def descriptor(self) -> ParameterDescriptor:
        """ROS descriptor; with the range also where nothing is given by default."""
        descriptor = super().descriptor()
        descriptor.floating_point_range = [FloatingPointRange(from_value=-LARGEST_VALUE, to_value=LARGEST_VALUE)]
        return descriptor

    def checked(self, value: Any) -> Any:
        """Check a value."""
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
    function = KINDS[kind]
    described, settings = _described(function), []
    for name, parameter in inspect.signature(function).parameters.items():
        if name not in OF_THE_GENERATOR:
            default = NOT_GIVEN if parameter.default in (inspect.Parameter.empty, None) else parameter.default
            settings.append(_setting(name, default, described[name]))
    own = {setting.name for setting in settings}
    return (*settings, *(_setting(name, NOT_GIVEN, text) for name, text in COMMON.items() if name not in own))


def _setting(name: str, default: Any, text: str) -> SignalSetting:
    found = re.search(r", ((?:signal unit|Hz|rad|s|V)\S*?)(?=[.;,]|$)", text)
    unit, rest = (found.group(1), text.replace(found.group(0), "", 1)) if found else ("", text)
    return SignalSetting(name, default, unit, rest.rstrip("."), -LARGEST_VALUE, LARGEST_VALUE, live=True)


def _described(function: Callable[..., Any]) -> dict[str, str]:
    """Texts of the parameters in a docstring, by name."""
    section = (inspect.getdoc(function) or "").partition("Parameters\n----------\n")[2].partition("\n\n")[0]
    texts: dict[str, str] = {}
    names: list[str] = []
    for line in section.splitlines():
        if line.startswith(" "):
            texts |= {name: f"{texts.get(name, '')} {line.strip()}".strip() for name in names}
        else:
            names = [name.strip() for name in line.split(",")]
    return texts
