"""Node parameters as data: name, default, unit, meaning and range in one place, from which they are declared and checked."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from hyst_control.errors import InputError


@dataclass(frozen=True)
class Setting:
    """One parameter of a node. Its type is that of the default; an integer is accepted for a real number and converted.

    Attributes
    ----------
    name, unit, text : str
        Name, unit ("" for texts and booleans), and meaning.
    default : bool, int, float, str or tuple of one of them
        Default value.
    lower, upper : float, optional
        Range of the value, or of each value of a list.
    choices : tuple of str
        Allowed values; empty for all.
    live : bool
        True when it may be changed while the node runs; otherwise it is read once at the start.
    """

    name: str
    default: Any
    unit: str
    text: str
    lower: float | None = None
    upper: float | None = None
    choices: tuple[str, ...] = ()
    live: bool = False

    def convert(self, value: Any) -> Any:
        """Convert a value to the type of the default.

        Parameters
        ----------
        value : object
            The value as given; a list if the default is a tuple.

        Returns
        -------
        bool, int, float, str or tuple
            The converted value.

        Raises
        ------
        InputError
            When it has the wrong type or lies outside the range; names parameter, allowed values and the given one.
        """
        if isinstance(self.default, tuple):
            if isinstance(value, (str, bytes)) or not hasattr(value, "__iter__"):
                raise InputError(f"{self.name}: must be a list, got {value!r}")
            return tuple(self._scalar(item, type(self.default[0])) for item in value)
        return self._scalar(value, type(self.default))

    def _scalar(self, value: Any, kind: type) -> Any:
        """Convert one value to this type."""
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        given: type = type(value)
        if given is not kind:  # a boolean is not accepted for an integer
            names = {float: "a number", int: "an integer", bool: "true or false", str: "a text"}
            raise InputError(f"{self.name}: must be {names[kind]}{self._unit()}, got {value!r}")
        if isinstance(value, float) and not math.isfinite(value):
            raise InputError(f"{self.name}: must be a finite number{self._unit()}, got {value!r}")
        if self.lower is not None and value < self.lower or self.upper is not None and value > self.upper:
            lower, upper = (f"{limit:g}" if limit is not None else "any" for limit in (self.lower, self.upper))
            raise InputError(f"{self.name}: must be {lower} to {upper}{self._unit()}, got {value!r}")
        if self.choices and value not in self.choices:
            raise InputError(f"{self.name}: must be one of {', '.join(self.choices)}, got {value!r}")
        return value

    def descriptor(self) -> ParameterDescriptor:
        """ROS descriptor; dynamically typed, so that an integer given for a real number reaches `convert`."""
        choices = f", one of {', '.join(self.choices)}" if self.choices else ""
        descriptor = ParameterDescriptor(
            description=f"{self.text}{choices}{self._unit()}", dynamic_typing=True, read_only=not self.live
        )
        if self.lower is not None or self.upper is not None:
            lower = -1e300 if self.lower is None else self.lower
            upper = 1e300 if self.upper is None else self.upper
            if isinstance(self.default, float):
                descriptor.floating_point_range = [FloatingPointRange(from_value=float(lower), to_value=float(upper))]
            elif isinstance(self.default, int):
                descriptor.integer_range = [IntegerRange(from_value=int(max(lower, -(2**62))), to_value=int(min(upper, 2**62)))]
        return descriptor

    def _unit(self) -> str:
        return f" [{self.unit}]" if self.unit else ""


def declare(node: Node, settings: Iterable[Setting], changed: Callable[[str, Any], None]) -> SimpleNamespace:
    """Declare settings as parameters of a node.

    Parameters
    ----------
    node : Node
        The node.
    settings : iterable of Setting
        Its parameters.
    changed : callable
        Called with name and value after a live change.

    Returns
    -------
    SimpleNamespace
        Values by name; those of live parameters are kept up to date.

    Raises
    ------
    InputError
        When a value is not allowed; names node, parameter and remedy.
    """
    table = {setting.name: setting for setting in settings}
    values = SimpleNamespace()
    for setting in table.values():
        default = list(setting.default) if isinstance(setting.default, tuple) else setting.default
        if node.has_parameter(setting.name):  # declared from an override; declared again with its descriptor
            node.undeclare_parameter(setting.name)
        try:
            given = node.declare_parameter(setting.name, default, setting.descriptor()).value
            setattr(values, setting.name, setting.convert(given))
        except InputError as error:
            raise InputError(f"{node.get_name()}: parameter {error}") from None
        except Exception as error:
            raise InputError(f"{node.get_name()}: parameter {setting.name}: {error}") from None

    def check(parameters: list[Parameter]) -> SetParametersResult:
        try:
            for parameter in parameters:
                if parameter.name in table:
                    table[parameter.name].convert(parameter.value)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def apply(parameters: list[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name in table:
                value = table[parameter.name].convert(parameter.value)
                setattr(values, parameter.name, value)
                changed(parameter.name, value)

    node.add_on_set_parameters_callback(check)
    node.add_post_set_parameters_callback(apply)
    return values
