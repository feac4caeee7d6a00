# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of physical parameters that every plant shares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from hyst_plant_sim.physics.signal_path import PlantError


def check_positive(parameters: Any, positive: Sequence[str], vectors: Mapping[str, int | None] | None = None) -> None:
    """Check that every parameter is a finite number of at least 0, and those named above 0."""
    for field in fields(parameters):
        given, values = getattr(parameters, field.name), (getattr(parameters, field.name),)
        if vectors and field.name in vectors:
            length = vectors[field.name]
            if not isinstance(given, (list, tuple)) or len(given) != (len(given) if length is None else length):
                raise PlantError(f"{field.name}: must be a list of {'' if length is None else f'{length} '}numbers, got {given!r}")
            values = tuple(given)
        for value in values:
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value) or value < 0:
                raise PlantError(f"{field.name}: must be a number of at least 0, got {value!r}")
            if field.name in positive and value == 0:
                raise PlantError(f"{field.name}: must be positive")
