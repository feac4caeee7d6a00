# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The reference of the nodes' parameters: unit, range and default of every parameter that a node declares."""

from __future__ import annotations

import importlib
import math

import pytest

from docs.reference.nodes import node_pages
from hyst_control.nodes.signal_node.common_parameters import COMMON
from hyst_control.processes.node_list import NODES

COMPOSED = {name: entry for name, entry in NODES.items() if entry.node_class}


def rows(name: str) -> dict[str, list[str]]:
    """Cells of a page's table by parameter."""
    lines = [line.split(" | ") for line in node_pages()[name].splitlines() if line.startswith("| `")]
    return {cells[0].strip("|` "): [cell.strip() for cell in cells[1:]] for cells in lines}


@pytest.mark.parametrize("name", ["common", *COMPOSED])
def test_a_reader_finds_unit_range_and_default(name):
    entry = COMPOSED.get(name)
    settings = COMMON if entry is None else getattr(importlib.import_module(entry.module), entry.node_class).SETTINGS
    found = rows(name)
    assert set(found) == {setting.name for setting in settings}
    for setting in settings:
        _, unit, allowed, default, live, *_ = found[setting.name]
        assert unit == setting.unit and live.startswith("live") == setting.live
        values = setting.default if isinstance(setting.default, tuple) else (setting.default,)
        shown = [part.strip("[] ") for part in default.split(",")]
        for value, text in zip(values, shown, strict=True):
            if isinstance(value, bool):
                assert text == str(value).lower()
            elif isinstance(value, (int, float)):
                assert float(text) == pytest.approx(value, rel=1e-5)
            else:
                assert text == value
        if setting.choices:
            assert [choice.strip("` ") for choice in allowed.split(",")] == list(setting.choices)
        elif math.isfinite(setting.lower) and math.isfinite(setting.upper):
            bounds = [float(bound) for bound in allowed.removeprefix("from ").split(" to ")]
            assert bounds == pytest.approx([setting.lower, setting.upper], rel=1e-5)
