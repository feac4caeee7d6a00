# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The assignment of a file's columns to signals: "time=1[ms],command=drive[V],measurement=pos[5um/V]"."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.records.tables.units import scaled_unit

TIME = "time"  # Name that stands for the column of sample times, which is no signal

RESPONSE = ("frequency", "magnitude", "phase", "real", "imaginary", "coherence")
"""Names that stand for the columns of a frequency response."""

TIME_UNITS = {
    "s": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "usec": 1e-6, "µs": 1e-6, "\u03bcs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0,
}  # fmt: skip
"""Unit of a column of times, in s."""

_TOPIC = re.compile(r"(?P<topic>\w+)=")
_GROUP = re.compile(r"(?P<columns>[^=]+?)\[(?P<unit>[^\[\]]+)\](?=\+|[,\s]*(?:$|\w+=))")
"""The unit is what stands in the last brackets before the next column: a name may have brackets of its own ("u [V][V]")."""
_WITHOUT_UNIT = re.compile(r"(?P<columns>[^=]+?)(?P<unit>)(?=,\s*\w+=|$)")
_PLUS = re.compile(r"\+(?![^()]*\))")


@dataclass(frozen=True)
class Column:
    """Columns of a signal."""

    topic: str
    columns: tuple[str, ...]  # By number, name or path, one an axis
    unit: str  # Of the record
    scales: tuple[float, ...]  # How many of it one in each of the columns is
    summed: bool = False  # The columns are parts of one, such as seconds and microseconds


def parse_columns(text: str) -> list[Column]:
    """Columns in the order of a text such as "command=1[V],measurement=5+6[um]". Raises `InputError` where it has another form.

    Axes are joined with +. A number before the unit is what one in the file stands for: the volts of a sensor of 5 um/V are
    "measurement=5[5um/V]". A time may be the sum of columns with units of their own: "time=ts[s]+tus[us]". A coherence needs no unit.
    """
    found: list[Column] = []
    rest = text.strip()
    while rest:
        match = _TOPIC.match(rest)
        groups = [match and _GROUP.match(rest, match.end())]
        if match and match["topic"] == "coherence":
            groups = [groups[0] or _WITHOUT_UNIT.match(rest, match.end())]
        while groups[-1] and rest.startswith("+", groups[-1].end()):
            groups.append(_GROUP.match(rest, groups[-1].end() + 1))
        if not match or not groups[-1]:
            raise InputError(
                f"columns: must be topic=column[unit], separated by commas (command=1[V],measurement=5[um]), got {rest!r}"
            )
        if match["topic"] in (column.topic for column in found):
            raise InputError(f"columns: {match['topic']} stands twice: join its axes with + (measurement=2+3[um])")
        found.append(_column(match["topic"], [(group["columns"], group["unit"].strip()) for group in groups if group]))
        rest = rest[groups[-1].end() :].lstrip(", ")
    if not found:
        raise InputError("columns: is empty: name command and measurement (command=1[V],measurement=5[um])")
    topics = [column.topic for column in found]
    if "frequency" in topics and not set(topics) <= set(RESPONSE):
        raise InputError(f"columns: a frequency response is made of {', '.join(RESPONSE)}, got {', '.join(topics)}")
    return found


def _column(topic: str, groups: list[tuple[str, str]]) -> Column:
    """One signal from its groups of columns and their units."""
    names: list[str] = []
    scales: list[float] = []
    units: list[str] = []
    for columns, text in groups:
        unit, scale = unit_and_scale(topic, text)
        parts = [part.strip() for part in _PLUS.split(columns)]
        names += parts
        scales += [scale] * len(parts)
        units.append(unit)
    if len(set(units)) > 1:
        raise InputError(f"columns: {topic}: its axes must have one unit, got {' and '.join(dict.fromkeys(units))}")
    return Column(topic, tuple(names), units[0], tuple(scales), topic == TIME and len(groups) > 1)


def unit_and_scale(topic: str, text: str) -> tuple[str, float]:
    """Unit of a topic's signal and how many of it one in the file is, of a text such as "mV" or "5um/V"."""
    known = _time_unit(text) if topic == TIME else (text.strip(), 1.0) if topic in RESPONSE else scaled_unit(text)
    if known is None:
        examples = ", ".join(TIME_UNITS) if topic == TIME else "V, nm, um, mm, urad, mrad, deg, arcsec, A, N, m/s^2, counts, %, …"
        raise InputError(
            f"columns: {topic}: unit {text!r} is not known, must be one of {examples}, with a number before it where one in the file "
            "stands for so much ([5um/V])"
        )
    if not (known[1] and np.isfinite(known[1])):
        raise InputError(f"columns: {topic}: the number in {text!r} must be finite and not 0")
    return known


def _time_unit(text: str) -> tuple[str, float] | None:
    match = re.fullmatch(r"(?P<scale>[\d.eE+-]*?)\s*(?P<unit>[a-zµ\u03bc]+)", text)
    if not match or match["unit"] not in TIME_UNITS:
        return None
    try:
        return "s", float(match["scale"] or 1.0) * TIME_UNITS[match["unit"]]
    except ValueError:
        return None
