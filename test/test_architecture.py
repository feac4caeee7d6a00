# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The ways through the code in docs/architecture.md: their functions exist, and there are no more of them than allowed."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

TEXT = (Path(__file__).resolve().parents[1] / "docs" / "architecture.md").read_text(encoding="utf-8")
WAYS = {"Record to model file": 20, "Record and model to report": 25, "Reference to command": 12}


def hops(way: str) -> list[tuple[str, str, str]]:
    """Number, function and words of every line of a way."""
    [block] = re.findall(rf"^\*\*{way}\*\*.*\n\n((?:\d+\. .*\n)+)", TEXT, re.MULTILINE)
    return re.findall(r"^(\d+)\. `(\S+)`: (.+)$", block, re.MULTILINE)


@pytest.mark.parametrize(("way", "most"), WAYS.items(), ids=list(WAYS))
def test_a_way_is_no_longer_than_allowed(way, most):
    found = hops(way)
    assert [int(number) for number, _, _ in found] == list(range(1, len(found) + 1)) and 0 < len(found) <= most
    assert all(3 <= len(words.split()) <= 10 for _, _, words in found)


@pytest.mark.parametrize("function", sorted({function for way in WAYS for _, function, _ in hops(way)}))
def test_a_function_of_a_way_exists(function):
    module, _, names = function.partition(":")
    found = importlib.import_module(module)
    for name in names.split("."):
        found = getattr(found, name)
    assert callable(found)
