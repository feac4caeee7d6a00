# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects: possible faults of a plant, each at its physical place.

An effect is a mapping {name: delay, tau: 1e-4, axis: x, from: 0.5}: its name, its parameters, the axis (left out: every axis)
and the time in s from which it acts (left out: always). One that begins later has been running before without influence: the
output changes over at once, without a transient. `gain` and `delay` may be placed elsewhere with `at`. An effect whose
parameters make it absent (`absent`) is left out, so that it changes no bit.

Parameters are those of the gap report's vocabulary; `EFFECTS` holds their meaning, units and defaults. Where a plant has
several parts at a place, effects come after them, in the order of `EFFECTS`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from hyst_plant_sim.physics.effects import drive, motion, piezo, sensing
from hyst_plant_sim.physics.effects.effect import Context, Effect, PassThrough, Switch
from hyst_plant_sim.physics.signal_path import Frame, Line, PlantError

EFFECTS: dict[str, Effect] = {**drive.EFFECTS, **piezo.EFFECTS, **motion.EFFECTS, **sensing.EFFECTS}
"""Every effect by name, in the order in which a signal meets them."""

ELSEWHERE = {"gain": ("amplifier", "piezo", "sensor"), "delay": ("drive", "sensor")}
ADDED = ("delay", "modes")
"""Changes of a part that add up where there are several; of the others the newest is used."""

KEYS = ("name", "axis", "from", "at")


@dataclass(frozen=True)
class Present:
    """An effect that is present."""

    name: str  # Its name
    values: Mapping[str, float]  # Its parameters
    place: str  # One of `PLACES`
    axis: int | None  # Index of the axis; None: all axes
    start: float  # Time from which it acts, s

    @property
    def kind(self) -> str:
        """Kind of insertion: the effect's own at its usual place; anywhere else a part of its own."""
        effect = EFFECTS[self.name]
        return effect.kind if self.place == effect.place else "insert"


def read_effects(given: Any, frame: Frame) -> list[Present]:
    """Read a list of effects, without those that are absent by their parameters."""
    if not isinstance(given, Sequence) or isinstance(given, str) or not all(isinstance(item, Mapping) for item in given):
        raise PlantError("effects: must be a list of {name: …, parameters}")
    found = [_read(item, frame) for item in given]
    return sorted((item for item in found if item is not None), key=lambda item: list(EFFECTS).index(item.name))


def _read(item: Mapping[str, Any], frame: Frame) -> Present | None:
    name = item.get("name")
    if name not in EFFECTS:
        raise PlantError(f"effects: {name!r} is unknown: choose one of {', '.join(EFFECTS)}")
    effect, where = EFFECTS[name], f"effects: {name}"
    known = {**effect.absent, **effect.others}
    for key, value in item.items():
        if key not in known and key not in KEYS:
            raise PlantError(f"{where}: {key}: unknown parameter: choose one of {', '.join([*known, 'axis', 'from'])}")
        if key in known or key == "from":
            if isinstance(value, bool) or not isinstance(value, (int, float)) or np.isnan(value):
                raise PlantError(f"{where}: {key}: must be a number, got {value!r}")
    axis, place = item.get("axis"), item.get("at", effect.place)
    if axis is not None and axis not in frame.axes:
        raise PlantError(f"{where}: axis: {axis!r} is unknown: choose one of {', '.join(frame.axes)}")
    if place not in ELSEWHERE.get(name, (effect.place,)):
        raise PlantError(f"{where}: at: {place!r} is not possible: choose one of {', '.join(ELSEWHERE.get(name, (effect.place,)))}")
    if effect.kind == "mixing" and len(frame.axes) < 2:
        raise PlantError(f"{where}: the plant has one axis: choose another effect or plant")
    values = {key: item.get(key, default) for key, default in known.items()}
    for key in (
        "cutoff",
        "rate",
        "tau",
        "samples",
        "corner",
        "frequency",
        "period",
        "order",
        "begin",
        "damping",
        "steadiness",
        "run",
    ):
        if key in values and not (values[key] > 0 or (key == "tau" and "tau" in effect.absent and values[key] == 0)):
            raise PlantError(f"{where}: {key}: {values[key]!r}: must be positive")
    if all(values[key] == neutral for key, neutral in effect.absent.items()):
        return None
    return Present(name, values, place, None if axis is None else frame.axes.index(axis), float(item.get("from", 0.0)))


def insert_effects(line: Line, axis: int | None, parts: Any, present: Sequence[Present], frame: Frame) -> None:
    """Insert the effects of one axis into the line, or those that mix axes."""
    for item in present:
        effect = EFFECTS[item.name]
        if (item.kind == "mixing") != (axis is None) or axis is not None and item.axis not in (None, axis):
            continue
        context = Context(frame, item.place, item.axis if axis is None else axis, item.start)
        if item.kind in ("insert", "mixing"):
            part = effect.make(item.values, context)
            late = context.first > 0
            line[item.place].append((axis, Switch([(0, PassThrough()), (context.first, part)]) if late else part))
    if axis is not None:
        own = [item for item in present if item.axis in (None, axis)]
        _change(line, axis, "drive", ("delay",), own, frame, lambda changes: parts({}, changes)["drive"][0])
        _change(line, axis, "hysteresis", ("hysteresis",), own, frame, lambda changes: piezo.hysteresis(parts, changes, frame))
        _change(line, axis, "mechanics", ("mechanics", "delay"), own, frame, lambda changes: parts({}, changes)["mechanics"][0])


def _change(line: Line, axis: int, place: str, kinds: Sequence[str], present: Sequence[Present], frame: Frame, build: Any) -> None:
    """Replace the plant's own first part at a place by one with changes.

    Changes that begin at different times give one part after the other.
    """
    own = sorted((item for item in present if item.kind in kinds), key=lambda item: item.start)
    if not own:
        return
    at = next(i for i, (entered, _) in enumerate(line[place]) if entered == axis)
    changes: dict[str, Any] = {}
    stages = [(0, line[place][at][1])]
    for start, group in groupby(own, key=lambda item: item.start):
        context = Context(frame, place, axis, start)
        for item in group:
            fresh = EFFECTS[item.name].make(item.values, context)
            changes = {
                **changes,
                **{key: changes[key] + value if key in ADDED and key in changes else value for key, value in fresh.items()},
            }
        stages.append((context.first, build(changes)))
    stages = stages[max(i for i, (first, _) in enumerate(stages) if first <= 0) :]
    line[place][at] = (axis, stages[0][1] if len(stages) == 1 else Switch(stages))
