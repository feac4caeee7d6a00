# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Foreign text in C: as a name, or within a comment. Names of models, axes and files may be anything, and no sign of them becomes code."""

from __future__ import annotations

import re
from collections.abc import Sequence

LONGEST_NAME = 40
HARMFUL = re.compile(r"[^ -~]|[\\*?]|(?<=/)/")
"""What could end a comment, begin another one, join two lines (also as a trigraph), or is no plain character."""


def c_identifier(text: str) -> str:
    """Name of C for a `text`: a letter, then letters, digits and underscores."""
    name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_").lower()[:LONGEST_NAME].strip("_")
    return f"m_{name}".strip("_") if not name or name[0].isdigit() else name


def c_identifiers(texts: Sequence[str]) -> list[str]:
    """Different names of C for `texts`: with their places where two were alike."""
    names = [c_identifier(text) for text in texts]
    return names if len(set(names)) == len(names) else [f"{name}_{place}" for place, name in enumerate(names)]


def c_comment(text: str) -> str:
    """A text as it stands in a comment: letters of any language as they are, what is harmful by its number, as C writes it."""

    def escaped(found: re.Match[str]) -> str:
        char, number = found[0], ord(found[0])
        if number > 127 and char.isprintable():
            return char
        return f"\\x{number:02x}" if number < 256 else f"\\u{number:04x}" if number < 65536 else f"\\U{number:08x}"

    return HARMFUL.sub(escaped, text)
