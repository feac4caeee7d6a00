# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The columns that a file holds, and a description of them that can be pasted, for who does not know its form."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.records.tables.columns import TIME_UNITS
from hyst_control.records.tables.header import without_unit
from hyst_control.records.tables.sample_grid import find_grid
from hyst_control.records.tables.selection import WIDE, open_table
from hyst_control.records.tables.text import TextTable
from hyst_control.records.tables.units import scaled_unit

LISTED = 40
FAST_TICKS = 1000.0
"""Least step of whole numbers that are ticks of a fast clock and no seconds."""
TIME_WORDS = ("t", "time", "x_value", "timestamp", "seconds", "zeit")
COMMAND_WORDS = ("u", "uk", "v", "in", "dac", "command", "cmd", "drive", "volt", "input", "target", "set", "excitation", "effort")
MEASUREMENT_WORDS = (
    "y",
    "yk",
    "adc",
    "measurement",
    "meas",
    "pos",
    "sensor",
    "out",
    "output",
    "disp",
    "actual",
    "current pos",
    "micron",
    "angle",
    "strain",
)
RESPONSE_WORDS = (
    ("frequency", ("freq", "frequency"), "Hz"),
    ("magnitude", ("mag", "magnitude", "gain", "amplitude"), "dB"),
    ("phase", ("phase", "argument"), "deg"),
)


@dataclass(frozen=True, eq=False)
class _Found:
    """A column: what it is asked for as, its name, its unit where one is said, and its numbers."""

    asked: str
    title: str
    unit: str | None
    values: Array


def listed_columns(path: Path, variable: str | None = None, skip: int = 0) -> tuple[list[str], str]:
    """Lines about the columns of a file, and options of import that take them. Raises `InputError` where it cannot be read."""
    table = open_table(path, variable, skip)
    if isinstance(table, TextTable):
        layout = table.layout
        rows, _ = table.columns(layout.numeric)
        found = [
            _Found(str(index + 1), layout.title(index), layout.unit(index), rows[:, place])
            for place, index in enumerate(layout.numeric)
        ]
        sample_time = layout.sample_time
    else:
        sample_time = table.sample_time
        found = [one for name, array in table.arrays.items() for one in _of_array(name, array)]
    if not found:
        raise InputError(f"{path}: holds no columns of numbers: check how it was written, or save it as CSV")
    lines = [f"{path}: columns of numbers, with their ranges"]
    for one in found[:LISTED]:
        finite = one.values[np.isfinite(one.values)]
        span = f"{finite.min():.6g} to {finite.max():.6g}" if len(finite) else "no finite number"
        title = f" {one.title!r}" if one.title and one.title != one.asked else ""
        lines.append(f"  {one.asked}{title}: {len(one.values)} rows, {span}{f' {one.unit}' if one.unit else ''}")
    if len(found) > LISTED:
        lines.append(f"  and {len(found) - LISTED} more")
    return lines, _suggestion(found, sample_time)


def _of_array(name: str, array: Array) -> list[_Found]:
    """The columns of an array, or its rows where it is wide."""
    if array.ndim == 1 or (array.ndim == 2 and 1 in array.shape):
        return [_Found(name or "1", "", None, array.ravel())]
    if array.ndim != 2 or not array.size:
        return []
    wide = len(array) * WIDE <= array.shape[1]
    parts = array if wide else array.T
    return [
        _Found(f"{name}({number},:)" if wide else f"{name}(:,{number})" if name else str(number), "", None, part)
        for number, part in enumerate(parts, start=1)
    ]


def _suggestion(found: list[_Found], sample_time: float | None) -> str:
    """Options that take the columns for what their names, units and numbers say."""
    left = [one for one in found if len(one.values) > 1]
    response = [(topic, one, unit) for topic, words, unit in RESPONSE_WORDS for one in left[:LISTED] if _named(one, words)]
    if {"frequency", "magnitude", "phase"} <= {topic for topic, _, _ in response}:
        first = {topic: (one, unit) for topic, one, unit in reversed(response)}
        listed = [f"{topic}={one.asked}[{one.unit or unit}]" for topic, (one, unit) in sorted(first.items())]
        return f'--columns "{",".join(listed)}"'
    longest = max((len(one.values) for one in left), default=0)
    left = [one for one in left if len(one.values) == longest]
    time = next((one for one in left if _named(one, TIME_WORDS, False) and _increasing(one)), None)
    time = time or next((one for one in left if one.unit in TIME_UNITS), None)
    time = time or next((one for one in left if sample_time and not one.title and _has_step(one.values, sample_time)), None)
    left = [one for one in left if one is not time]
    if time is not None and time.unit is None and _counts_fast_ticks(time.values):
        time = None  # ticks of a clock of unknown rate
    left = [one for one in left if not _counts_or_rests(one.values)] or left
    if time is None and len(left) > 2 and _is_clock(left[0].values) and not _named(left[0], COMMAND_WORDS):
        time = None if sample_time else left[0]
        left = left[1:]
    others = [one for one in left if not _named(one, MEASUREMENT_WORDS)]
    command = _first(others or left, COMMAND_WORDS, ("V", "A", "%"))
    left = [one for one in left if one is not command]
    measurement = _first(left, MEASUREMENT_WORDS, ("um", "mrad", "deg", "arcsec"))
    parts = []
    if time is not None:
        parts.append(f"time={time.asked}[{time.unit if time.unit in TIME_UNITS else 's'}]")
    for topic, one, usual in (("command", command, "V"), ("measurement", measurement, "um")):
        if one is not None:
            parts.append(f"{topic}={one.asked}[{one.unit if one.unit and scaled_unit(one.unit) else usual}]")
    rate = "" if time is not None or sample_time else " --rate HZ"
    return f'--columns "{",".join(parts)}"{rate}'


def _first(left: list[_Found], words: tuple[str, ...], units: tuple[str, ...]) -> _Found | None:
    """The first column of such a name, else of such a unit, else the first."""
    known = [(one, (scaled_unit(one.unit) or ("",))[0] if one.unit else "") for one in left]
    by_unit = [one for one, unit in known if any(unit == due or unit.endswith(due) for due in units)]
    return next(iter([*(one for one in left if _named(one, words)), *by_unit, *left]), None)


def _named(one: _Found, words: tuple[str, ...], within: bool = True) -> bool:
    name = without_unit(one.title or one.asked.rpartition(".")[2]).lower()
    parts = re.split(r"[^a-z0-9]+", name) if within else name.split(" ")[:1]
    return any(name == word or word in parts or (within and len(word) > 2 and word in name) for word in words)


def _increasing(one: _Found) -> bool:
    return bool(np.isfinite(one.values).all() and (np.diff(one.values) >= 0.0).all())


def _counts_or_rests(values: Array) -> bool:
    """Check that numbers only count the rows, or never change: neither is a signal."""
    steps = np.unique(np.diff(values))
    return len(steps) == 1 and steps[0] in (0.0, 1.0)


def _has_step(values: Array, step: float) -> bool:
    """Check that numbers are times with this step in seconds."""
    return bool(np.allclose(np.diff(values), step, rtol=1e-3, atol=1e-3 * step))


def _counts_fast_ticks(values: Array) -> bool:
    """Check that numbers are whole ticks of a fast clock: as seconds, each row would come more than a quarter of an hour later."""
    return bool(np.all(values == np.rint(values)) and np.min(np.diff(values)) > FAST_TICKS)


def _is_clock(values: Array) -> bool:
    """Check that numbers are the ticks of a clock, and do not just count the rows."""
    if len(values) < 3 or not np.isfinite(values).all() or not (np.diff(values) > 0.0).all():
        return False
    grid = find_grid(values - values[0])
    return grid is not None and grid.step != 1.0
