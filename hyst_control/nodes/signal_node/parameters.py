# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Node parameters: declared to ROS and checked from their declaration as `Quantity`, at the start and live."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from hyst_control.base.errors import InputError
from hyst_control.base.quantity import Quantity
from hyst_control.base.yaml_files import read_yaml

MIDDLEWARE = "qos_overrides."  # Beginning of parameters that belong to a publisher or subscription


@dataclass(frozen=True)
class Setting(Quantity):
    """One parameter of a node. Its type is that of the default; an integer is accepted for a real number and converted."""

    live: bool = False  # may be changed while the node runs; otherwise it is read once at the start
    # "higher" or "lower": the direction in which the value protects less. A live change may go that way as far as the value at the
    # start, or as `max_NAME` (`min_NAME`) given at the start; "" where neither direction does
    wider: str = ""
    off: bool = False  # 0 switches the protection off, which is the widest of all

    @property
    def bound_name(self) -> str:
        """Name of the parameter that bounds live changes."""
        return f"{'max' if self.wider == 'higher' else 'min'}_{self.name}"

    def bound(self, value: Any) -> Setting:
        """Parameter that bounds live changes; by default the `value` at the start."""
        return replace(
            self, name=self.bound_name, default=value, meaning=f"widest {self.name} of a live change", live=False, wider=""
        )

    def refuse_wider(self, value: Any, bound: Any) -> None:
        """Raise `InputError` when a value protects less than the bound does."""
        if self._width(value) > self._width(bound):
            widest = f"{bound:g} {self.unit}".rstrip()
            raise InputError(
                f"{self.name}: a live change may not widen it beyond {widest}, got {value:g}: restart the node, with {self.bound_name} "
                "for live changes"
            )

    def _width(self, value: Any) -> float:
        if self.off and not value:
            return math.inf
        return float(value if self.wider == "higher" else -value)

    def descriptor(self) -> ParameterDescriptor:
        """ROS descriptor; dynamically typed, so that an integer given for a real number reaches `convert`."""
        choices = f", one of {', '.join(self.choices)}" if self.choices else ""
        descriptor = ParameterDescriptor(
            description=f"{self.meaning}{choices}{f' [{self.unit}]' if self.unit else ''}",
            dynamic_typing=True,
            read_only=not self.live,
        )
        if self.bounds:
            lower, upper = max(self.lower, -1e300), min(self.upper, 1e300)
            kind = type(self.default[0]) if isinstance(self.default, tuple) else type(self.default)
            if kind is float:
                descriptor.floating_point_range = [FloatingPointRange(from_value=float(lower), to_value=float(upper))]
            elif kind is int:
                descriptor.integer_range = [IntegerRange(from_value=int(max(lower, -(2**62))), to_value=int(min(upper, 2**62)))]
        return descriptor


@cache
def _declarations() -> dict[str, dict[str, dict[str, Any]]]:
    declared: dict[str, dict[str, dict[str, Any]]] = read_yaml(Path(__file__).parents[1] / "settings.yaml")
    return declared


def settings_of(node: str) -> tuple[Setting, ...]:
    """Parameters of a node, or those that are `common`, as `settings.yaml` declares them."""
    lists: dict[str, dict[str, Any]] = {
        name: {key: tuple(value) if isinstance(value, list) else value for key, value in given.items()}
        for name, given in _declarations()[node].items()
    }
    return tuple(Setting(name, **given) for name, given in lists.items())


def declare(
    node: Node,
    settings: Iterable[Setting],
    changed: Callable[[str, Any], None],
    check_change: Callable[[Mapping[str, Any]], None] = lambda values: None,
    further: Callable[[SimpleNamespace], Iterable[Setting]] = lambda values: (),
    elsewhere: Collection[str] = (),
) -> SimpleNamespace:
    """Declare settings as parameters of a node."""
    values = SimpleNamespace()
    table = {setting.name: setting for setting in settings}  # a later one takes the place of one of the same name
    for setting in table.values():
        setattr(values, setting.name, _declared(node, setting))
    for setting in further(values):
        setattr(values, setting.name, _declared(node, setting))
        table[setting.name] = setting
    bounds = _declared_bounds(node, table.values(), values)
    _refuse_unknown(node, elsewhere)

    def check(parameters: list[Parameter]) -> SetParametersResult:
        try:
            new = {each.name: table[each.name].checked(each.value) for each in parameters if each.name in table}
            for name in bounds.keys() & new.keys():
                table[name].refuse_wider(new[name], bounds[name])
            if new:
                check_change(new)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def apply(parameters: list[Parameter]) -> None:
        new = {each.name: table[each.name].checked(each.value) for each in parameters if each.name in table}
        vars(values).update(new)  # all of them first, as one may depend on another
        for name, value in new.items():
            changed(name, value)

    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(apply)
    return values


def _declared(node: Node, setting: Setting) -> Any:
    """Value of a setting after its declaration."""
    default = list(setting.default) if isinstance(setting.default, tuple) else setting.default
    try:
        return setting.checked(node.declare_parameter(setting.name, default, setting.descriptor()).value)
    except InputError as error:
        raise InputError(f"{node.get_name()}: parameter {error}") from None
    except Exception as error:
        raise InputError(f"{node.get_name()}: parameter {setting.name}: {error}") from None


def _declared_bounds(node: Node, settings: Iterable[Setting], values: SimpleNamespace) -> dict[str, Any]:
    """Bounds of the live changes by parameter; one that is narrower than the value at the start is refused."""
    bounds = {}
    for setting in settings:
        if setting.wider and setting.live:
            value = getattr(values, setting.name)
            bounds[setting.name] = _declared(node, setting.bound(value))
            try:
                setting.refuse_wider(value, bounds[setting.name])
            except InputError:
                raise InputError(
                    f"{node.get_name()}: parameter {setting.bound_name}: is narrower than {setting.name}, {value:g}, got "
                    f"{bounds[setting.name]:g}"
                ) from None
    return bounds


def _refuse_unknown(node: Node, elsewhere: Collection[str]) -> None:
    """Raise `InputError` for a value that was given for a parameter that does not exist: it would act nowhere."""
    declared = list(node.get_parameters_by_prefix(""))
    for name in node._parameter_overrides:  # no public way leads to what was given
        if name not in declared and name not in elsewhere and not name.startswith(MIDDLEWARE):
            raise InputError(f"{node.get_name()}: parameter {name}: there is no such parameter{nearest(name, declared)}")


def matches(name: str, known: Iterable[str], likeness: float = 0.6) -> list[str]:
    """The known name that a name is most like, at least this much; none where there is no such one."""
    plain = {each.lower().replace("_", ""): each for each in known}
    return [plain[found] for found in difflib.get_close_matches(name.lower().replace("_", ""), plain, 1, likeness)]


def nearest(name: str, known: Iterable[str], otherwise: str = ": --help lists them") -> str:
    """Question after the name that was meant."""
    found = matches(name, known)
    return f": did you mean {found[0]}?" if found else otherwise
