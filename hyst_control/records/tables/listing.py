# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The columns that a file holds, and a description of them that can be pasted, for who does not know its form."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.records.record import TOPICS
from hyst_control.records.tables.columns import RESPONSE, TIME, TIME_UNITS, parse_columns, unit_and_scale
from hyst_control.records.tables.frequency_response import check_response_unit
from hyst_control.records.tables.header import Layout, unit_behind, without_unit
from hyst_control.records.tables.sample_grid import DAY, find_grid, midnights
from hyst_control.records.tables.selection import WIDE, open_table
from hyst_control.records.tables.text import TextTable
from hyst_control.records.tables.units import scaled_unit

LISTED = 40
UNKNOWN = "UNIT"  # To be replaced where the file does not state a unit
FAST_TICKS = 1000.0  # Least step of whole numbers that are ticks of a fast clock and no seconds
TIME_WORDS = ("t", "time", "x_value", "timestamp", "seconds", "zeit")
COMMAND_WORDS = ("u", "uk", "v", "in", "dac", "command", "cmd", "drive", "volt", "input", "target", "set", "excitation", "effort")
MEASUREMENT_WORDS = (
    *("y", "yk", "adc", "measurement", "meas", "pos", "sensor", "out", "output", "disp", "actual", "current pos", "micron"),
    *("angle", "strain"),
)
MOTION = ("um", "mrad", "deg", "arcsec")
SURE_WORDS = {
    TIME: ("t", "time", "timestamp", "zeit"),
    "command": ("command", "cmd", "drive", "u"),
    "measurement": ("measurement", "measured", "meas", "pos", "position", "displacement", "disp", "angle", "tilt", "sensor", "y"),
    "reference": ("reference", "ref"),
    "feedforward": ("feedforward",),
    "feedback": ("feedback",),
}
"""First words of names that say what a column is: an "output" may be a sensor's or a converter's, and is not among them."""
WORDS_BEHIND = frozenset("x y z axis stage piezo voltage signal value values".split())
"""Words that may follow: a "position error" is another thing."""

RESPONSE_WORDS = (
    ("frequency", ("freq", "omega", "f", "w")),
    ("magnitude", ("magnitude", "mag", "gain", "amplitude", "abs", "g", "h")),
    ("phase", ("phase", "argument", "arg", "angle")),
    ("real", ("real", "re")),
    ("imaginary", ("imag", "im")),
    ("coherence", ("coherence", "coh")),
)
RESPONSE_FORMS = (("frequency", "magnitude", "phase"), ("frequency", "real", "imaginary"))
NOT_IN_QUOTES = frozenset('"$`\\!')  # Characters that a shell changes between double quotes


@dataclass(frozen=True, eq=False)
class _Found:
    """A column: what it is asked for as, its name, its unit where one is said, and its numbers."""

    asked: str
    title: str
    unit: str | None
    values: Array


def listed_columns(path: Path, variable: str | None = None, skip: int = 0) -> tuple[list[str], str]:
    """Lines about the columns of a file, and options of import that take them. Raises `InputError` where it cannot be read."""
    found, sample_time = _columns_of(path, variable, skip)
    lines = [f"{path}: columns of numbers, with their ranges"]
    for one in found[:LISTED]:
        finite = one.values[np.isfinite(one.values)]
        span = f"{finite.min():.4g} to {finite.max():.4g}" if len(finite) else "no finite number"
        title = f" {one.title!r}" if one.title and one.title != one.asked else ""
        lines.append(f"  {one.asked}{title}: {len(one.values)} rows, {span}{f' {one.unit}' if one.unit else ''}")
    if len(found) > LISTED:
        lines.append(f"  and {len(found) - LISTED} more")
    return lines, _suggestion(found, sample_time)


def named_columns(
    path: Path, variable: str | None = None, skip: int = 0, has_rate: bool = False, topics: Sequence[str] = TOPICS
) -> str | None:
    """The description of a file whose names and units say alone what each column is; None where anything is left to guess.

    topics: those that it must have; where that is the measurement alone, every other column is one.
    """
    found, sample_time = _columns_of(path, variable, skip)
    groups: dict[str, list[_Found]] = {}
    for one in found:
        topic = _sure_topic(one) or (topics[0] if len(topics) == 1 else None)
        if topic is None or one.unit is None or not _is_accepted(topic, one.unit) or not _can_be_asked(one.asked):
            return None
        groups.setdefault(topic, []).append(one)
    times = len(groups.get(TIME, []))
    is_timed = times == 1 or (times == 0 and (has_rate or sample_time is not None))
    axes = {len(group) for topic, group in groups.items() if topic != TIME}
    lengths = {len(one.values) for one in found}
    if not set(topics) <= set(groups) or not is_timed or len(axes) > 1 or len(lengths) > 1:
        return None
    return ",".join(f"{topic}={_in_units(group)}" for topic, group in groups.items())


def _in_units(group: Sequence[_Found]) -> str:
    """Columns of a signal as the description has them, the unit once where they share it."""
    if len({one.unit for one in group}) == 1:
        return f"{'+'.join(one.asked for one in group)}[{group[0].unit}]"
    return "+".join(f"{one.asked}[{one.unit}]" for one in group)


def _sure_topic(one: _Found) -> str | None:
    """The signal that a name stands for, where all of its words say so."""
    parts = re.findall(r"[^\W\d_]+", without_unit(one.title or one.asked).lower().removesuffix(f"_{(one.unit or '').lower()}"))
    if not parts or not set(parts[1:]) <= WORDS_BEHIND:
        return None
    return next((topic for topic, words in SURE_WORDS.items() if parts[0] in words), None)


def _columns_of(path: Path, variable: str | None, skip: int) -> tuple[list[_Found], float | None]:
    """The columns of numbers in a file, and the sample time (s) where it states one. Raises `InputError` where it has none."""
    table = open_table(path, variable, skip)
    if isinstance(table, TextTable):
        layout = table.layout
        rows, _ = table.columns(layout.numeric)
        asked = [_asked(layout, index) for index in layout.numeric]
        found = [
            _Found(name, layout.title(index), layout.unit(index), rows[:, place])
            for place, (name, index) in enumerate(zip(asked, layout.numeric, strict=True))
        ]
        sample_time = layout.sample_time
    else:
        sample_time = table.sample_time
        arrays = {"": table.arrays[variable]} if variable in table.arrays else table.arrays
        found = [one for name, array in arrays.items() for one in _of_array(name, array)]
        columns = [name for name, array in arrays.items() if array.ndim == 1]
        if table.numbered and len({len(arrays[name]) for name in columns}) == 1:
            found = [
                one if _can_be_asked(one.asked) else replace(one, asked=str(columns.index(one.asked) + 1), title=one.asked)
                for one in found
            ]
    if not found:
        raise InputError(f"{path}: holds no columns of numbers: check how it was written, or save it as CSV")
    return found, sample_time


def _asked(layout: Layout, index: int) -> str:
    """Name of a column where it is a word of its own, else its number."""
    title = layout.title(index)
    with suppress(InputError):
        if title.isidentifier() and layout.column(title) == index:
            return title
    return str(index + 1) if layout.column(str(index + 1)) in (None, index) else title


def _of_array(name: str, array: Array) -> list[_Found]:
    """The columns of an array, or its rows where it is wide."""
    if array.ndim == 1 or (array.ndim == 2 and 1 in array.shape):
        return [_Found(name or "1", "", unit_behind(name), array.ravel())]
    if array.ndim != 2 or not array.size:
        return []
    wide = len(array) * WIDE <= array.shape[1]
    parts = array if wide else array.T
    return [
        _Found(f"{name}({number},:)" if wide else f"{name}(:,{number})" if name else str(number), "", unit_behind(name), part)
        for number, part in enumerate(parts, start=1)
    ]


def _suggestion(found: list[_Found], sample_time: float | None) -> str:
    """Options that take the columns for what their names, units and numbers say."""
    left = [one for one in found if len(one.values) > 1]
    response = _response(left[:LISTED])
    if response:
        return f'--columns "{",".join(response)}"'
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
        time = None if sample_time or _counts_fast_ticks(left[0].values) else left[0]
        left = left[1:]
    others = [one for one in left if not _named(one, MEASUREMENT_WORDS)]
    command = _first(others or left, COMMAND_WORDS, ("V", "A", "%"))
    left = [one for one in left if one is not command]
    measurement = _first(left, MEASUREMENT_WORDS, MOTION)
    if command is not None and measurement is not None and _has_unit(command, MOTION) and _has_unit(measurement, ("V",)):
        command, measurement = measurement, command  # a converter's "input [um]" is the sensor's
    chosen = ((TIME, time, "s"), ("command", command, UNKNOWN), ("measurement", measurement, UNKNOWN))
    parts = {topic: _entry(topic, one, usual) for topic, one, usual in chosen if one is not None and _can_be_asked(one.asked)}
    if not {"command", "measurement"} & set(parts):
        return "command=NAME[UNIT],measurement=NAME[UNIT], of columns of several rows whose names have no quotes, +, = or spaces at an end"
    rate = "" if TIME in parts or sample_time else " --rate HZ"
    return f'--columns "{",".join(parts.values())}"{rate}'


def _response(left: list[_Found]) -> list[str]:
    """The columns of a frequency response; none where these are not of one."""
    named = {topic: one for topic, words in RESPONSE_WORDS for one in reversed(left) if _is_of_response(one, words)}
    for form in RESPONSE_FORMS:
        if len({named[topic] for topic in form if topic in named and _can_be_asked(named[topic].asked)}) < len(form):
            continue
        frequency, second, third = (named[topic] for topic in form)
        if frequency.unit and not _is_accepted("frequency", frequency.unit):
            continue  # a force "f [N]"
        entries = [_entry("frequency", frequency, "rad/s" if _is_of_response(frequency, ("omega", "w")) else "Hz")]
        if form[1] == "magnitude":
            entries.append(_entry("magnitude", second, "dB" if (second.values < 0.0).any() else "um/V"))
            entries.append(_entry("phase", third, "deg" if (np.abs(third.values) > 2.0 * np.pi).any() else "rad"))
        else:
            entries += [_entry("real", second, "um/V"), _entry("imaginary", third, "um/V")]
        if "coherence" in named and _can_be_asked(named["coherence"].asked):
            entries.append(f"coherence={named['coherence'].asked}")
        return entries
    return []


def _is_of_response(one: _Found, words: tuple[str, ...]) -> bool:
    """Check that a name has one of these words, short ones apart from others: "arg" is not in "target"."""
    name = _name(one)
    parts = re.split(r"[^a-z0-9]+", name)
    return any(word in (name if len(word) > 3 else parts) for word in words)


def _entry(topic: str, one: _Found, usual: str) -> str:
    """A column as the description has it, in the unit that is said for it, or `usual` where that is none of this topic."""
    return f"{topic}={one.asked}[{one.unit if one.unit and _is_accepted(topic, one.unit) else usual}]"


def _is_accepted(topic: str, unit: str) -> bool:
    """Check with what reads the description that a column may be in this unit."""
    try:
        unit_and_scale(topic, unit)
        if topic in RESPONSE:
            check_response_unit(topic, unit)
    except InputError:
        return False
    return True


def _can_be_asked(name: str) -> bool:
    """Check that a name comes as it is through a shell's double quotes and what reads the description."""
    try:
        found = parse_columns(f"command={name}[V],measurement={name}[um]")
    except InputError:
        return False
    return name.isprintable() and not NOT_IN_QUOTES & set(name) and [one.columns for one in found] == [(name,), (name,)]


def _first(left: list[_Found], words: tuple[str, ...], units: tuple[str, ...]) -> _Found | None:
    """The first column of such a name, else of such a unit, else the first."""
    by_unit = [one for one in left if _has_unit(one, units)]
    return next(iter([*(one for one in left if _named(one, words)), *by_unit, *left]), None)


def _has_unit(one: _Found, units: tuple[str, ...]) -> bool:
    unit = (scaled_unit(one.unit) or ("",))[0] if one.unit else ""
    return any(unit == due or unit.endswith(due) for due in units)


def _name(one: _Found) -> str:
    return without_unit(one.title or one.asked.rpartition(".")[2]).lower()


def _named(one: _Found, words: tuple[str, ...], within: bool = True) -> bool:
    name = _name(one)
    parts = re.split(r"[^a-z0-9]+", name) if within else name.split(" ")[:1]
    return any(name == word or word in parts or (within and len(word) > 2 and word in name) for word in words)


def _increasing(one: _Found) -> bool:
    return bool(np.isfinite(one.values).all() and (np.diff(_through_midnight(one.values)) >= 0.0).all())


def _through_midnight(values: Array) -> Array:
    """Numbers that go on where, as the time of day, they start again at midnight."""
    days = np.zeros(len(values))
    days[midnights(values)] = DAY
    return values + np.cumsum(days)


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
    values = _through_midnight(values)
    if len(values) < 3 or not np.isfinite(values).all() or not (np.diff(values) > 0.0).all():
        return False
    grid = find_grid(values - values[0])
    return grid is not None and grid.step != 1.0
