# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Texts in C that stand beside a module: NAME.c.in for NAME.py.

A line `//// NAME` begins a text; what follows the name explains it. In a text `@NAME@` stands for another one of the file, or for what
the caller gives.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from textwrap import indent

BEGIN = re.compile(r"^//// (\w+).*\n", re.MULTILINE)
PLACE = re.compile(r"^( *)@(\w+)@$|()@(\w+)@", re.MULTILINE)


def c_texts(module: str, **values: object) -> dict[str, str]:
    """Texts by name of the module whose `__file__` is given."""
    _, *parts = BEGIN.split(Path(module).with_suffix(".c.in").read_text(encoding="utf-8"))
    texts = {name: text.strip("\n") + "\n" for name, text in zip(parts[::2], parts[1::2], strict=True)}
    return {name: c_filled(text, {**texts, **{key: str(value) for key, value in values.items()}}) for name, text in texts.items()}


def c_filled(text: str, values: Mapping[str, str]) -> str:
    """A text with values at their places, indented as a place that has a line of its own."""

    def value(found: re.Match[str]) -> str:
        spaces, name = found[1] or "", found[2] or found[4]
        return indent(c_filled(values[name], values).strip("\n"), spaces) if name in values else found[0]

    return PLACE.sub(value, text)
