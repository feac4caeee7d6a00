"""Checks of physical parameters that every plant shares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from hyst_plant_sim.physics.signal_path import PlantError


def check_positive(parameters: Any, positive: Sequence[str], vectors: Mapping[str, int | None] | None = None) -> None:
    """Every parameter is a number that is not negative, those named positive.

    vectors: parameters that are lists of such numbers, and how many are due (None: any number).
    Raises `PlantError` naming the parameter.
    """
    for field in fields(parameters):
        given, values = getattr(parameters, field.name), (getattr(parameters, field.name),)
        if vectors and field.name in vectors:
            due = vectors[field.name]
            if not isinstance(given, (list, tuple)) or len(given) != (len(given) if due is None else due):
                raise PlantError(f"{field.name}: {given!r}: a list of {'' if due is None else f'{due} '}numbers is due")
            values = tuple(given)
        for value in values:
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value) or value < 0:
                raise PlantError(f"{field.name}: {value!r}: a number that is not negative is due")
            if field.name in positive and value == 0:
                raise PlantError(f"{field.name}: must be positive")
