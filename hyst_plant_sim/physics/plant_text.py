# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reading a plant's YAML text, with limits: a text of a few hundred bytes can stand for gigabytes, or nest until the process ends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from hyst_plant_sim.physics.signal_path import PlantError

LONGEST = 2**20
"""Bytes of a plant file."""

DEEPEST = 32
"""Lists and mappings within each other."""

LARGEST = 100_000
"""Values, aliases counted as what they stand for."""


def read_plant_text(path: Path) -> Any:
    """Read a plant file as plain YAML values. Raises `OSError` where it cannot be opened.

    Size, depth and number of values are limited before anything is constructed.
    """
    with open(path, "rb") as file:
        data = file.read(LONGEST + 1)
    if len(data) > LONGEST:
        raise PlantError(f"is longer than {LONGEST} bytes: give a plant file")
    try:
        text = data.decode("utf-8")
        _limited(text)
        return yaml.safe_load(text)
    except PlantError:
        raise
    except Exception:  # yaml's own, and whatever a wrong tag's parser meets
        raise PlantError("is not valid YAML") from None


def _limited(text: str) -> None:
    size = 0
    starts: list[tuple[str | None, int]] = []
    sizes: dict[str | None, int] = {}
    for event in yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, start = starts.pop()
            if anchor:
                sizes[anchor] = size - start
            continue
        if isinstance(event, yaml.AliasEvent):
            if event.anchor in (anchor for anchor, _ in starts):
                raise PlantError(f"*{event.anchor} stands within itself: write the values out")
            size += sizes.get(event.anchor, 1)
        elif isinstance(event, yaml.NodeEvent):
            size += 1
            if isinstance(event, yaml.ScalarEvent) and len(event.value) > 10_000:
                raise PlantError(f"holds a value of {len(event.value)} characters: give a plant file")
        if isinstance(event, yaml.CollectionStartEvent):
            starts.append((event.anchor, size - 1))
        if len(starts) > DEEPEST or size > LARGEST:
            raise PlantError(f"holds more than {LARGEST} values or is nested more than {DEEPEST} deep: give a plant file")
