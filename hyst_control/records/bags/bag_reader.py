# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reading rosbag2 bags of signal messages: MCAP or SQLite3, finished or cut off, with a layout or without."""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np

from hyst_control.base.arrays import Array, Integers
from hyst_control.base.errors import InputError, Loss
from hyst_control.records.actuator_following import APPLIED
from hyst_control.records.bags.bag_fields import read_fields
from hyst_control.records.bags.bag_files import Bag
from hyst_control.records.record import Record, Signal, axis_names, check_times, commonest_step, increasing, no_topic
from hyst_control.records.stream.row_store import RowStore
from hyst_control.records.stream.signal_message import MESSAGE_TYPE, decode, parse_label
from hyst_control.records.tables.importing import is_table, read_table
from hyst_control.records.tables.regular_signals import on_one_clock, restarts

SIGNALS = ("reference", "feedforward", "feedback", "command", "measurement")
"""The topics that the package knows; another topic that is no signal is left out with a note instead of refused."""

COMMAND_SIDE = ("command", "feedforward", "feedback")
PENDING = 2048
"""Messages decoded at a time: enough for numpy's speed, few enough that the raw bytes take no room."""

MEDIAN_OF = 2**16
"""Messages, from the first on, of which a topic's clock is held against the time of reception."""

FOREIGN_SHARE = 0.1
"""Rows of another label or width, per row of the topic's own, up to which they are left out."""

LATEST = 2**63 - 1
"""ns; a damaged file may hold any time."""


def read_bag(
    path: str | Path,
    namespace: str | None = None,
    unit: str = "unknown",
    topics: Collection[str] | None = None,
    columns: str | None = None,
) -> Record:
    """Read every signal topic of a bag (a rosbag2 directory, or a single .mcap or .db3 file), or the columns of a table.

    Parameters
    ----------
    path
        Bag to read, or table.
    namespace
        Namespace of the topics, needed where several namespaces have a topic of the same name.
    unit
        Unit of measurement and reference in a bag whose messages have no layout.
    topics
        Last parts of the names of the topics to read, which must be there; all by default.
    columns
        Topics and fields that stand for the signals, such as "command=/drive.data[V],measurement=/joint_states.position[um]", for a
        bag of other messages; columns of a table, whose names and units need none where they say what each is.

    Returns
    -------
    Record
        Signals by the last part of their topic's name, with notes on what is missing or was left out.

    Raises
    ------
    InputError
        The bag cannot be read, holds no signal messages, or one of its signals is not valid; the text names file and remedy.
    """
    path = Path(path)
    if is_table(path):
        return read_table(path, columns)
    if columns is not None:
        return read_fields(path, columns)
    notes: list[str] = []
    bag = Bag(path, notes)
    found: dict[str, _Topic] = {}
    for topic, time, raw in bag.messages():
        if topic not in found:
            found[topic] = _Topic(topics is None or topic.rpartition("/")[2] in topics)
        found[topic].add(raw, time)
    if not found and (bag.topics or not bag.types):
        where = f" on {', '.join(sorted(bag.topics))}" if bag.topics else ""
        raise InputError(f"{path}: is empty: nothing was recorded{where}: record while the nodes run and publish")
    if not found:
        raise InputError(
            f"{path}: holds no {MESSAGE_TYPE} messages: check what was recorded, or name fields as in --columns "
            f'"command=/drive.data[V],measurement=/joint_states.position[um]" of its topics: {bag.listed()}'
        )
    short = _by_last_part(path, found, namespace)
    for topic in topics or ():
        if topic not in short and topic != APPLIED:  # which is there only while the actuator does not follow
            raise no_topic(path, topic, short)
    named = {name: found[topic] for name, topic in short.items() if found[topic].wanted}
    notes += [Loss(f"{path}: {topic}: holds no messages") for topic in sorted(bag.topics - set(found))]
    found.clear()
    origin = min((min(each.times) for each in named.values() if each.times), default=0)
    signals: dict[str, Signal] = {}
    for name in list(named):
        held = named.pop(name)  # its rows are given back as soon as the signal has them
        try:
            signals[name] = _signal(path, name, held, origin, unit, notes)
        except InputError as error:
            if name in SIGNALS or topics is not None:
                raise
            notes.append(Loss(f"{error} (left out)"))
            continue
        if not len(signals[name].time):
            notes.append(Loss(f"{path}: {name}: holds no rows"))
    if any(signal.timing == "receive" for signal in signals.values()):
        notes.append(f"{path}: messages without a layout: the time of reception stands for the sample time, with its jitter")
        received = {name: each for name, each in signals.items() if name in SIGNALS and len(each.time) > 1}
        if all(signal.timing == "receive" for signal in received.values()):
            with suppress(InputError):  # of several rates, or without any: told by who needs one
                regular, more = on_one_clock(str(path), received, bag.hold or "zoh", allow_gaps=True)
                signals |= regular
                notes += more
    record = Record(signals, str(path), tuple(notes), bag.hold or "zoh", bag.history, states_hold=bag.hold is not None)
    return replace(record, notes=(*record.notes, *_not_followed(record)))


def _not_followed(record: Record) -> list[str]:
    """A note on the samples that are no answer to their command, because the actuator did not follow it."""
    if not {"command", "measurement", APPLIED} <= set(record.signals):
        return []
    command, measurement = record.signals["command"].time, record.signals["measurement"].time
    if min(len(command), len(measurement)) < 2:
        return []
    step = commonest_step(command)
    begin, end = max(command[0], measurement[0]), min(command[-1], measurement[-1])
    parts = [part for part in record.not_followed(step) if part.start * step <= end and part.stop * step > begin]
    if not parts:
        return []
    seconds = sum(min(part.stop * step, end) - max(part.start * step, begin) for part in parts)
    return [
        f"{record.source}: the actuator did not follow the command for {seconds:.3g} s, the last time until t = "
        f"{parts[-1].stop * step:g} s: not used as its answer"
    ]


def _by_last_part(path: Path, topics: Collection[str], namespace: str | None) -> dict[str, str]:
    """Short name: topic. A topic that is none of `SIGNALS` keeps its full name where the short one is taken."""
    wanted = None if namespace is None else "/" + namespace.strip("/")
    chosen: dict[str, str] = {}
    for topic in sorted(topics):
        head, _, name = topic.rpartition("/")
        if wanted is not None and head.rstrip("/") != wanted.rstrip("/"):
            continue
        if name in chosen and name in SIGNALS:
            raise InputError(f"{path}: {chosen[name]} and {topic} are both a {name}: say which with the namespace")
        chosen[topic if name in chosen else name] = topic
    if not chosen:
        raise InputError(f"{path}: no topic in the namespace {namespace!r} (topics: {', '.join(sorted(topics))})")
    return chosen


Form = tuple[str, int]
"""Label and number of columns of messages."""


class _Rows:
    """Rows of one form: sample times apart from the values where there is a label, values alone where there is none."""

    def __init__(self, form: Form) -> None:
        label, width = form
        self.time = RowStore() if label else None
        self.values = RowStore(width - 1 if label else width)

    def append(self, rows: Array) -> None:
        if self.time is None:
            self.values.append(rows)
        else:
            self.time.append(rows[:, 0])
            self.values.append(rows[:, 1:])


class _Topic:
    """The messages of one topic, decoded as they come in; neither the raw bytes nor the rows of a long bag are held in memory."""

    def __init__(self, wanted: bool) -> None:
        self.wanted = wanted
        self.parts: list[tuple[Form, int]] = []  # successive messages of one form, and how many they are
        self.rows: dict[Form, _Rows] = {}
        self.times = array("q")
        self.error: InputError | None = None
        self._pending: list[bytes] = []

    def add(self, raw: bytes, time: int) -> None:
        """Take one message; time: ns, of its reception."""
        if self.wanted:
            self.times.append(min(time, LATEST))
            self._pending.append(raw)
            if len(self._pending) == PENDING:
                self._decode()

    def taken(self, notes: list[str], where: str) -> tuple[str, _Rows, Integers]:
        """Label, rows in their order and the times of their messages, once.

        A few messages of another label or width (of a second source that wrote the topic by mistake) are left out with a note. Raises
        the `InputError` of the first message that is no signal, or that there are two forms of about equal standing.
        """
        if self._pending:
            self._decode()
        if self.error is not None:
            raise self.error
        found, self.rows = self.rows, {}
        times = np.frombuffer(self.times, np.int64)
        counts = {form: rows.values.count for form, rows in found.items()}
        main = max(counts, key=lambda form: counts[form])
        if len(counts) > 1:
            foreign = sum(counts.values()) - counts[main]
            other = next(form for form in counts if form != main)
            if foreign > FOREIGN_SHARE * counts[main]:
                if other[0] == main[0]:
                    raise InputError(f"messages of {main[1]} and of {other[1]} values: record one plant per topic")
                raise InputError(
                    f"label changes from {next(iter(counts))[0]!r} to {list(counts)[1][0]!r}: record one plant per topic"
                )
            form = other[0] or f"{other[1]} values"
            notes.append(Loss(f"{where}: {foreign} rows of another form ({form!r}) were left out: who sent them?"))
            times = times[np.repeat([form == main for form, _ in self.parts], [messages for _, messages in self.parts])]
        return main[0], found[main], times

    def _decode(self) -> None:
        raws, self._pending = self._pending, []
        if self.error is None:
            try:
                self._append(raws)
            except InputError as error:
                self.error, self.parts, self.rows = error, [], {}

    def _append(self, raws: list[bytes]) -> None:
        """Messages of one size and header are read as one array, others one by one and joined as long as their form is one."""
        for size, group in groupby(raws, len):
            alike = list(group)
            label, block = decode(alike[0])
            head = size - block.nbytes
            table = np.frombuffer(b"".join(alike), np.uint8).reshape(-1, size)
            # The padding inside a header is whatever the sender's memory held: only a wholly equal one is taken as read.
            if alike[0][1] == 1 and (table[:, :head] == table[0, :head]).all():
                rows = np.ascontiguousarray(table[:, head:]).view("<f8").reshape(len(alike) * len(block), block.shape[1])
                self._keep(label, rows, len(alike))
                continue
            for (label, _), same in groupby(map(decode, alike), lambda message: (message[0], message[1].shape[1])):
                parts = [part for _, part in same]
                self._keep(label, np.concatenate(parts), len(parts))

    def _keep(self, label: str, rows: Array, messages: int) -> None:
        """Keep the rows (N, C) of successive messages."""
        form = label, rows.shape[1]
        self.parts.append((form, messages))
        if form not in self.rows:
            self.rows[form] = _Rows(form)
        self.rows[form].append(rows)


def _signal(path: Path, name: str, topic: _Topic, origin: int, unit: str, notes: list[str]) -> Signal:
    """The signal of a topic; origin: ns, from which times of reception count."""
    try:
        label, rows, stamps = topic.taken(notes, f"{path}: {name}")
        axes, units = parse_label(label) if label else (axis_names(rows.values.width or 0), ())
    except InputError as error:
        raise InputError(f"{path}: {name}: {error}") from None
    if not axes:
        raise InputError(f"{path}: {name}: messages hold no values: record the plant's signals")
    if len(set(units)) > 1:
        raise InputError(f"{path}: {name}: label must have one unit for all axes, got {label!r}")
    if rows.time is not None:
        time = rows.time.array()
        received = math.nan
        if len(time):
            rows_of_these = len(time) if len(stamps) <= MEDIAN_OF else max(len(time) * MEDIAN_OF // len(stamps), 1)
            received = float(np.median(stamps[:MEDIAN_OF]) * 1e-9 - np.median(time[:rows_of_these]))
        return _ordered(path, name, Signal(time, rows.values.array(), axes, units[0], received=received), notes)
    values = rows.values.array()
    if not increasing(stamps, equal=True):
        if edges := restarts(stamps):
            raise InputError(
                f"{path}: {name}: the clock was set back in message {edges[0]}: hyst import --columns makes a bag of each run: give these"
            )
        order = np.argsort(stamps, kind="stable")
        stamps, values = stamps[order], values[order]
    time = np.asarray((stamps - origin) * 1e-9, dtype=np.float64)
    return Signal(time, values, axes, "V" if name in COMMAND_SIDE else unit, "receive")


def _ordered(path: Path, name: str, signal: Signal, notes: list[str]) -> Signal:
    """The rows in order of their sample time; rows sent twice are kept once. What was mended is noted."""
    time = signal.time
    check_times(f"{path}: {name}", time)
    if increasing(time):
        return signal
    _, first = np.unique(time, return_index=True)
    repeated = np.setdiff1d(np.arange(len(time)), first)
    kept = first[np.searchsorted(time[first], time[repeated])]
    if not np.array_equal(signal.values[repeated], signal.values[kept], equal_nan=True):
        raise InputError(
            f"{path}: {name}: two different rows of one sample time: two sources wrote this topic, or the clock jumped"
        )
    if len(repeated):
        notes.append(f"{path}: {name}: {len(repeated)} rows were sent twice and kept once")
    if np.any(np.diff(first) < 0):
        notes.append(f"{path}: {name}: rows came out of order and were put in order of their time")
    return replace(signal, time=time[first], values=np.ascontiguousarray(signal.values[first]))
