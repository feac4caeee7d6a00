# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The catalogue of effects: every module of this package with an `EFFECT` is one. Importing it makes their stages known."""

from importlib import import_module
from pkgutil import iter_modules

from hyst_control.base.plugins import Registry
from hyst_control.effects.effect import PLACES, Effect, Surroundings
from hyst_control.effects.placement import insert

_modules = [import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)]
_usual = Surroundings(1e-4, 1.0, (0.0, 100.0), 1e5, (0.0, 1.0), 2)

EFFECTS: Registry[Effect] = Registry(
    "effects",
    "an Effect of this name",
    lambda name, value: isinstance(value, Effect) and value.name == name,
    {module.EFFECT.name: module.EFFECT for module in _modules if hasattr(module, "EFFECT")},
    order=lambda effect: (PLACES.index(effect.place), len(effect.parameters(_usual)), effect.name),
)
"""Every effect by name: in signal order, and at one place the simplest first."""


def ending_as() -> tuple[tuple[str, str], ...]:
    """Effects that become a simpler one at an end of their ranges, each with that one."""
    return tuple((name, effect.ends_as) for name, effect in EFFECTS.items() if effect.ends_as is not None)


def shares_elsewhere() -> tuple[tuple[str, str], ...]:
    """Effects that are a share of the motion below a frequency of their own, each with those that are one at every frequency."""
    rich = [name for name, effect in EFFECTS.items() if effect.static_elsewhere]
    return tuple((name, plain) for name in rich for plain, effect in EFFECTS.items() if effect.static)


__all__ = ["EFFECTS", "ending_as", "insert", "shares_elsewhere"]
