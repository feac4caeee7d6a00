# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Functions out of universal files (UFF): text datasets of type 58, as analyzers of vibrations write them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError

MARK = "-1"  # The only word of the line before and behind a dataset
FORM_LINE, DATA_LINE = 7, 12  # Lines of a dataset from its type on: the one on the numbers' form, and their first
WIDTHS = {2: 13, 4: 20}  # Characters of a number, by the type of the ordinate: real, of single and of double precision
EVEN = "1"  # Mark of numbers at an even spacing of time; others stand in pairs with their times


def universal_arrays(path: Path) -> tuple[dict[str, Array], float | None]:
    """Real functions by the first line of their names, and the sample time (s) that all of them have."""
    found: dict[str, Array] = {}
    steps: set[float] = set()
    for lines in _datasets(path):
        title = lines[1].strip() or "function"
        kind, count, spacing, _, step = lines[FORM_LINE].split()[:5]
        if int(kind) not in WIDTHS:
            continue  # complex: a response over frequencies
        width = WIDTHS[int(kind)]
        cells = [line[at : at + width] for line in lines[DATA_LINE:] for at in range(0, len(line.rstrip()), width)]
        values = np.array(cells, dtype=np.float64)
        name = title if title not in found else f"{title} {len(found) + 1}"
        if spacing == EVEN:
            steps.add(float(step))
            found[name] = values[: int(count)]
        else:
            pairs = values[: 2 * int(count)].reshape(-1, 2)
            found[f"{name}.time"], found[name] = pairs[:, 0], pairs[:, 1]
    if not found:
        raise InputError(
            f"{path}: holds no whole text dataset of real numbers (type 58): check how it was written, or save it as CSV"
        )
    return found, steps.pop() if len(steps) == 1 else None


def _datasets(path: Path) -> Iterator[list[str]]:
    """Lines of each dataset of type 58, the one with its type first."""
    lines = path.read_text("latin-1").splitlines()
    marks = [number for number, line in enumerate(lines) if line.strip() == MARK]
    for begin, end in zip(marks[::2], marks[1::2], strict=False):
        within = lines[begin + 1 : end]
        kind = within[0].split()[0] if within and within[0].split() else ""
        if kind == "58b":
            raise InputError(f"{path}: holds binary datasets (58b): save it with text datasets (58), or as CSV")
        if kind == "58":
            yield within
