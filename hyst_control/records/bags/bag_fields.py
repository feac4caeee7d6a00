# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Signals from any topic and field of a bag: numbers of messages of any type, with their header's stamps where they have some."""

from __future__ import annotations

import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array, Integers
from hyst_control.base.errors import InputError
from hyst_control.base.foreign_readers import first_line
from hyst_control.records.bags.bag_files import Bag
from hyst_control.records.record import Record, Signal, axis_names, increasing
from hyst_control.records.stream.row_store import RowStore
from hyst_control.records.stream.signal_message import MESSAGE_TYPE, decode, parse_label
from hyst_control.records.tables.columns import TIME, Column, parse_columns
from hyst_control.records.tables.regular_signals import MAX_RUNS, SHORTEST_RUN, on_one_clock, restarts, without_repeated

PENDING = 2048
LONGEST_DEFINITION = 200_000

_FIELD = re.compile(r"(?P<path>[^()]*)(\((?P<item>[^()]+)\))?")


@dataclass
class _Field:
    """A field that is being read: `scale` of the unit is one in it."""

    topic: str
    path: tuple[str, ...]
    item: str | None
    scale: float
    names: tuple[str, ...] = ()  # Of its items, in the order of the first message
    rows: RowStore | None = None
    pending: list[Array] = field(default_factory=list)

    def add(self, values: Array) -> None:
        """Append values (N, A)."""
        if self.rows is None:
            self.rows = RowStore(values.shape[1])
        if values.shape[1] != self.rows.width:
            raise ValueError(f"holds {values.shape[1]} values after messages of {self.rows.width}")
        self.pending.append(values)
        if len(self.pending) == PENDING:
            self.array()

    def array(self) -> RowStore:
        """All rows so far."""
        assert self.rows is not None
        if self.pending:
            self.rows.append(np.concatenate(self.pending) * self.scale)
            self.pending = []
        return self.rows


@dataclass
class _Times:
    """Sample times of a topic: those of its rows (s), its stamps (ns) or of reception (ns), the first of them that there are."""

    rows: list[Array] = field(default_factory=list)
    stamps: array[int] = field(default_factory=lambda: array("q"))
    received: array[int] = field(default_factory=lambda: array("q"))

    def nanoseconds(self) -> Integers:
        """Times in ns; those of reception where a stamp is missing."""
        return np.frombuffer(self.stamps if self.is_stamped else self.received, np.int64)

    @property
    def is_stamped(self) -> bool:
        """True where every message has a stamp."""
        return len(self.stamps) == len(self.received) and all(self.stamps)


def read_fields(
    path: Path, columns: str | Sequence[Column], hold: str | None = None, resample: float | None = None, allow_gaps: bool = False
) -> Record:
    """The record of the fields of a bag that holds one run, read as by `read_runs`."""
    found = read_runs(path, columns, hold, resample, allow_gaps)
    if len(found) > 1:
        raise InputError(
            f"{path}: its clock was set back: {len(found)} runs: hyst import --columns makes a bag of each: give these"
        )
    return found[0]


def read_runs(
    path: Path, columns: str | Sequence[Column], hold: str | None = None, resample: float | None = None, allow_gaps: bool = False
) -> list[Record]:
    """Records of the fields that columns name: "command=/drive.data[V],measurement=/joint_states.position(2)[um]".

    Each run between two moments at which the clock was set back is one. Items of a field that is a list are numbered from 1, or named
    where the message has names beside it. Raises `InputError` naming the topics that are there.
    """
    named = parse_columns(columns) if isinstance(columns, str) else list(columns)
    if any(column.topic == TIME for column in named):
        raise InputError("columns: time: a bag's messages have their own times: leave it out")
    wanted = {
        column.topic: [_field_of(name, scale) for name, scale in zip(column.columns, column.scales, strict=True)]
        for column in named
    }
    every = [one for fields in wanted.values() for one in fields]
    notes: list[str] = []
    bag = Bag(path, notes, chosen=sorted({one.topic for one in every}))
    times = _read(bag, every)
    if missing := [one.topic for one in every if one.topic not in times]:
        raise InputError(f"{path}: has no messages of {missing[0]}: its topics are {bag.listed()}")
    hold = bag.hold if hold is None else hold
    found = []
    for parts in _signals(path, wanted, times, {column.topic: column.unit for column in named}, notes):
        regular, more = on_one_clock(str(path), parts, hold or "zoh", resample, allow_gaps)
        signals = {
            topic: _joined([regular[f"{topic} {index}"] for index in range(len(fields))]) for topic, fields in wanted.items()
        }
        found.append(Record(signals, str(path), tuple(more), hold or "zoh", states_hold=hold is not None))
    found[0] = replace(found[0], notes=(*notes, *found[0].notes))
    return found


def _field_of(name: str, scale: float) -> _Field:
    topic, _, rest = name.partition(".")
    match = _FIELD.fullmatch(rest)
    if match is None:
        raise InputError(f"columns: {name!r}: must be /topic.field, or /topic.field(2) for an item of a list")
    return _Field(f"/{topic.strip('/')}", tuple(filter(None, match["path"].split("."))), match["item"], scale)


def _read(bag: Bag, fields: Sequence[_Field]) -> dict[str, _Times]:
    """Fill the fields, and return the times of their topics."""
    by_topic: dict[str, list[_Field]] = {}
    for one in fields:
        by_topic.setdefault(one.topic, []).append(one)
    found: dict[str, _Times] = {}
    reader = _Reader()
    for topic, time, raw in bag.messages():
        times = found.setdefault(topic, _Times())
        kind, definition = bag.types[topic]
        try:
            if kind == MESSAGE_TYPE:
                _add_rows(raw, by_topic[topic], times)
            else:
                reader.add(raw, kind, definition, by_topic[topic], times)
        except InputError as error:
            raise InputError(f"{bag.path}: {topic}: {error}") from None
        except Exception as error:  # a damaged message is anything to a deserializer
            raise InputError(f"{bag.path}: {topic}: cannot be read as {kind} ({first_line(error)}): record again") from None
        times.received.append(min(time, 2**63 - 1))
    return found


def _add_rows(raw: bytes, fields: Sequence[_Field], times: _Times) -> None:
    """Take a signal message; a block that names its columns has its own times."""
    label, block = decode(raw)
    axes = parse_label(label)[0] if label else ()
    if label:
        times.rows.append(block[:, 0])
        block = block[:, 1:]
    for one in fields:
        if one.path in ((), ("data",)):
            one.add(_items(block, one, axes))
        elif len(one.path) == 1 and one.path[0] in axes:
            one.add(block[:, [axes.index(one.path[0])]])
        else:
            raise InputError(f"has no field {'.'.join(one.path)}: name it by its topic alone, or data(1)")


def _items(block: Array, one: _Field, names: Sequence[str]) -> Array:
    """All columns of a block (N, A), or the one that is wanted."""
    if one.item is None:
        return block
    if one.item in names:
        index = list(names).index(one.item)
    elif one.item.isdecimal() and 1 <= int(one.item) <= block.shape[1]:
        index = int(one.item) - 1
    else:
        known = f" or {', '.join(names)}" if names else ""
        raise InputError(f"{'.'.join(one.path)}: has no item {one.item}: must be 1 to {block.shape[1]}{known}")
    return block[:, [index]]


class _Reader:
    """Messages of any type, by the types that ROS 2 Jazzy has or the definitions in the bag."""

    def __init__(self) -> None:
        self._store: Any = None

    def add(self, raw: bytes, kind: str, definition: str, fields: Sequence[_Field], times: _Times) -> None:
        """Take a message."""
        message = self._typestore(kind, definition).deserialize_cdr(raw, kind)
        stamp = getattr(getattr(message, "header", None), "stamp", None)
        if stamp is not None:
            times.stamps.append(stamp.sec * 10**9 + stamp.nanosec)
        for one in fields:
            value = message
            for index, name in enumerate(one.path or ("data",)):
                if name not in getattr(value, "__dataclass_fields__", ()):
                    there = ", ".join(each for each in getattr(value, "__dataclass_fields__", ()) if not each.startswith("_"))
                    raise InputError(
                        f"has no field {'.'.join(one.path[: index + 1]) or 'data'}: {kind} has {there or 'none there'}"
                    )
                value = getattr(value, name)
            numbers = np.asarray(value)
            if numbers.dtype.kind not in "biuf":
                raise InputError(f"{'.'.join(one.path) or 'data'} is no number: name a field of numbers within it")
            row, names = numbers.astype(np.float64).reshape(1, -1), tuple(getattr(message, "name", ()))
            one.names = one.names or names
            if names != one.names and one.item not in names and row.shape[1] == len(names):
                if sorted(names) != sorted(one.names):
                    raise InputError(f"{'.'.join(one.path)}: is of {', '.join(names)} after {', '.join(one.names)}: name an item")
                row, names = row[:, [names.index(name) for name in one.names]], one.names  # joints in another order
            one.add(_items(row, one, names))

    def _typestore(self, kind: str, definition: str) -> Any:
        if self._store is None:
            try:
                from rosbags.typesys import Stores, get_typestore
            except ModuleNotFoundError:
                raise InputError(f"is {kind}, and rosbags, which reads it, is not installed: pip install rosbags") from None
            self._store = get_typestore(Stores.ROS2_JAZZY)
        if kind not in self._store.types:
            if not definition or len(definition) > LONGEST_DEFINITION:
                raise InputError(f"the bag does not define its type {kind}")
            from rosbags.typesys import get_types_from_msg

            self._store.register(get_types_from_msg(definition, kind))
        return self._store


def _signals(
    path: Path, wanted: dict[str, list[_Field]], times: dict[str, _Times], units: dict[str, str], notes: list[str]
) -> list[dict[str, Signal]]:
    """A raw signal for every field, run by run; those of one topic share their times."""
    kinds = {
        topic: "their rows" if one.rows else "header stamps" if one.is_stamped else "reception" for topic, one in times.items()
    }
    if len(set(kinds.values())) > 1:
        said = ", ".join(f"{topic} those of {kind}" for topic, kind in kinds.items())
        notes.append(f"{path}: the times are of different clocks ({said}): a shift between them would look like a delay")
    if "reception" in kinds.values():
        notes.append(f"{path}: messages without a stamp: the time of reception stands for the sample time")
    stamped = [one.nanoseconds() for one in times.values() if not one.rows]
    origin = min((int(one.min()) for one in stamped), default=0)
    clocks: dict[str, Array] = {
        topic: np.concatenate(one.rows) if one.rows else np.asarray((one.nanoseconds() - origin) * 1e-9, dtype=np.float64)
        for topic, one in times.items()
    }
    runs = {topic: _runs(path, topic, clock, notes) for topic, clock in clocks.items()}
    if len({len(each) for each in runs.values()}) > 1:
        said = ", ".join(f"{topic} {len(each)}" for topic, each in runs.items())
        raise InputError(f"{path}: a clock was set back, which leaves runs of different number ({said}): record all by one clock")
    read = {
        topic: {
            f"{name} {i}": one.array().array()
            for name, fields in wanted.items()
            for i, one in enumerate(fields)
            if one.topic == topic
        }
        for topic in clocks
    }
    found: list[dict[str, Signal]] = []
    for parts in zip(*runs.values(), strict=True):
        mine = dict(zip(clocks, parts, strict=True))
        begin = min(float(clocks[topic][rows].min()) for topic, rows in mine.items())
        found.append({})
        for topic, rows in mine.items():
            values = {name: numbers[rows] for name, numbers in read[topic].items()}
            clock, values = _in_order(f"{path}: {topic}", clocks[topic][rows] - begin, values, kinds[topic] != "reception", notes)
            timing = "receive" if kinds[topic] == "reception" else "layout"
            for name, numbers in values.items():
                bad = ~np.isfinite(numbers).all(axis=1)
                if bad.any():
                    raise InputError(
                        f"{path}: {topic}: {int(bad.sum())} messages hold NaN or infinity, the first is "
                        f"{rows.start + int(np.argmax(bad))}"
                    )
                unit = units[name.partition(" ")[0]]
                found[-1][name] = Signal(clock, numbers, axis_names(numbers.shape[1]), unit, timing)
    return found


def _runs(path: Path, topic: str, clock: Array, notes: list[str]) -> list[slice]:
    """The runs within times (N,) in the order of arrival, apart where the clock was set back."""
    edges = restarts(clock)
    bounds = [0, *edges, len(clock)]
    if edges and (len(edges) >= MAX_RUNS or min(np.diff(bounds)) < SHORTEST_RUN):
        raise InputError(
            f"{path}: {topic}: the clock was set back {len(edges)} times, first in message {edges[0]}, which leaves a run of "
            f"{min(np.diff(bounds))} messages: at most {MAX_RUNS} of at least {SHORTEST_RUN} are read: record with a steady clock"
        )
    if edges:
        first = ", ".join(map(str, edges))
        notes.append(
            f"{path}: {topic}: the clock was set back in message {first}: {len(edges) + 1} runs, each of which is a record"
        )
    return [slice(first, last) for first, last in zip(bounds, bounds[1:], strict=False)]


def _in_order(
    where: str, clock: Array, values: dict[str, Array], stamped: bool, notes: list[str]
) -> tuple[Array, dict[str, Array]]:
    """Times (N,) and values (N, A) of a run in the order of time, those that were sent twice once."""
    if not increasing(clock, equal=True):
        order = np.argsort(clock, kind="stable")
        clock, values = clock[order], {name: rows[order] for name, rows in values.items()}
        notes.append(f"{where}: messages came out of order and were put in order of their time")
    if stamped:
        remedy = "two sources wrote it, or its clock was set back: record it again"
        if (kept := without_repeated(where, clock, list(values.values()), 0, remedy)) is not None:
            clock, values = clock[kept], {name: rows[kept] for name, rows in values.items()}
            notes.append(f"{where}: {int(np.sum(~kept))} messages were sent twice and kept once")
    return np.ascontiguousarray(clock), values


def _joined(parts: Sequence[Signal]) -> Signal:
    """The axes of a signal as one, at the ticks that all of them have."""
    first = parts[0]
    if len(parts) == 1:
        return Signal(first.time, first.values, first.axes, first.unit)
    common = first.time
    for part in parts[1:]:
        common = np.intersect1d(common, part.time)
    values = np.column_stack([part.values[np.isin(part.time, common)] for part in parts])
    return Signal(common, values, axis_names(values.shape[1]), first.unit)
