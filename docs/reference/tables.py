# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of the reference pages."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table(head: str, rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; the head's cells are separated by `|`."""
    heads = [cell.strip() for cell in head.split("|")]
    lines = [heads, ["---"] * len(heads), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)
