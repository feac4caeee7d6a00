# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records: signals with units and sample times, aligned on the control clock."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np

from hyst_control.base.arrays import Array, Integers
from hyst_control.base.errors import InputError
from hyst_control.records.actuator_following import APPLIED, ticks_not_followed
from hyst_control.records.stream.foreign_rows import admissible
from hyst_control.records.stream.row_store import all_finite, blocks, empty_rows, spread_parts

Cut = TypeVar("Cut", bound="Record")
AXES = ("x", "y", "z", "u", "v", "w")
TOPICS = ("command", "measurement")


def axis_names(count: int) -> tuple[str, ...]:
    """Default names of axes: x, y, z, or a0, a1, … where there are more than names."""
    return AXES[:count] if count <= len(AXES) else tuple(f"a{i}" for i in range(count))


MAX_TICKS = 2.0**52
"""Beyond it a float64 does not hold a tick's number and its fraction."""

LATEST_TIME = 9e9
"""s; beyond any clock, the seconds since 1970 among them, and far below where a tick's number would lose its last digit."""


def check_times(where: str, time: Array) -> None:
    """Check that sample times are finite and no later than a clock can show; `where` begins the message."""
    if not all_finite(time):
        raise InputError(f"{where}: the time column holds NaN or infinity: record again")
    if len(time) and (time.max() > LATEST_TIME or time.min() < -LATEST_TIME):
        worst = time[int(np.argmax(np.abs(time)))]
        raise InputError(f"{where}: the time column holds {worst:g} s, no clock goes beyond {LATEST_TIME:g} s: record again")


STEPS_LOOKED_AT, REGULAR_STEPS = 2**22, 2**16
"""Steps from which the commonest is taken of times with the reception's jitter, and of the control clock's own: all, or those of stretches
spread evenly over the record.
"""


def increasing(values: Array | Integers, equal: bool = False) -> bool:
    """Report whether values increase from each to the next, or are `equal` to it where that is allowed, block by block."""
    compare = np.greater_equal if equal else np.greater
    return all(
        bool(compare(values[part.start + 1 : part.stop + 1], values[part.start : part.stop][: len(values) - part.start - 1]).all())
        for part in blocks(len(values))
    )


def commonest_step(time: Array, steps: int = STEPS_LOOKED_AT) -> float:
    """Median step of two or more sample times, s; of very many, that of stretches spread evenly over them."""
    parts = spread_parts(len(time) - 1, steps, 64)
    return float(np.median(np.concatenate([np.diff(time[part.start : part.stop + 1]) for part in parts])))


def no_topic(source: object, topic: str, there: Iterable[str]) -> InputError:
    """The refusal of a record without a topic, naming the topics that are there."""
    known = ", ".join(sorted(there)) or "none"
    return InputError(f"{source}: has no topic {topic} (topics: {known}): record it, or remap the topic's name")


@dataclass(frozen=True)
class Signal:
    """One topic: sample times (N,) in s, values (N, A), the axes' names and their unit.

    timing: "layout" when the times are the control clock's own, "receive" when they are those of the reception and have its
    jitter in them. received: time of reception minus sample time, s, the median over the messages; NaN where it is not known.
    """

    time: Array
    values: Array
    axes: tuple[str, ...]
    unit: str
    timing: str = "layout"
    received: float = math.nan

    def consecutive_ticks(self, step: float) -> range | None:
        """Ticks round(t / step) of the samples where each is one more than that before; None where they are not.

        Of times of reception only the first counts: their jitter is not the sampling's. Block by block.
        """
        if not len(self.time) or max(abs(float(self.time[0])), abs(float(self.time[-1]))) / step > MAX_TICKS:
            return None
        first = int(np.rint(self.time[0] / step))
        if self.timing != "receive":
            for part in blocks(len(self.time)):
                due = np.arange(first + part.start, first + part.stop)
                if not np.array_equal(np.rint(self.time[part] / step), due):
                    return None
        return range(first, first + len(self.time))


def regular_times(count: int, step: float, first: int = 0) -> Array:
    """Compute equally spaced sample times, s, from tick `first` on; on a file where they are many."""
    time = empty_rows(count)
    for part in blocks(count):
        time[part] = np.arange(first + part.start, first + part.stop) * step
    return time


FOLLOWS = "amid a motion: behind the commands before the cut"
"""Beginning of a part of a record whose earlier commands are known."""


@dataclass(frozen=True)
class Beginning:
    """Memory with which a record begins, other than rest at 0 V, as an identification found it."""

    assumed: str  # In words
    memory: Array | None  # Commands (M, A) that precede the record, V; None where none are known
    row: int  # First row that counts
    moving: bool = False  # True where the dynamics move already: their state is estimated for every model


@dataclass(frozen=True)
class Record:
    """Signals by topic (last part of its name), where they come from, and sentences on what was met while reading."""

    signals: Mapping[str, Signal]
    source: str
    notes: tuple[str, ...] = field(default_factory=tuple)
    hold: str = "zoh"
    """The command between samples: "zoh" (a DAC holds it) or "foh" (a smooth source was sampled)."""
    history: tuple[str, ...] = ()
    """Steps of its preparation, in their order."""
    start: str | Beginning = "auto"
    """State at the first row: "settled" (at rest at the first command, reached from 0 V), "unknown", or "auto" (found from the record)."""
    states_hold: bool = False
    """True where the source says how the command is held; of others "zoh" is what is usual."""

    def __len__(self) -> int:
        return len(self.time)

    @property
    def name(self) -> str:
        """Last part of the source, for messages."""
        return Path(self.source).name

    @property
    def command(self) -> Array:
        """Commands (N, A), V."""
        return self.signal("command").values

    @property
    def measurement(self) -> Array:
        """Measurements (N, A), in `unit`."""
        return self.signal("measurement").values

    @property
    def values(self) -> dict[str, Array]:
        """Values (N, A) of the signals by topic."""
        return {topic: signal.values for topic, signal in self.signals.items()}

    @property
    def time(self) -> Array:
        """Sample times (N,) of the measurement, s."""
        return self._output.time

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the A axes of the measurement."""
        return self._output.axes

    @property
    def unit(self) -> str:
        """Unit of the measurement."""
        return self._output.unit

    @property
    def command_unit(self) -> str:
        """Unit of the command."""
        return self.signal("command").unit

    @property
    def span(self) -> Array:
        """Range (A,) of the measurement, the norm of NRMSE and NME."""
        span: Array = np.ptp(self.measurement, axis=0)
        return span

    @cached_property
    def sample_time(self) -> float:
        """Sample time of command and measurement, or of the signals that are there, s."""
        return self.common_step([topic for topic in TOPICS if topic in self.signals] or list(self.signals))

    @property
    def is_gapless(self) -> bool:
        """True where command and measurement have every tick of one clock, as in what `aligned` gives."""
        ticks = [self.signal(topic).consecutive_ticks(self.sample_time) for topic in TOPICS]
        return ticks[0] is not None and ticks[0] == ticks[1]

    @property
    def _output(self) -> Signal:
        """The measurement, or the last signal of a record without one."""
        topics = list(self.signals)
        return self.signal("measurement" if "measurement" in topics or not topics else topics[-1])

    def rows(self: Cut, begin: int, end: int) -> Cut:
        """Rows `begin` to `end` - 1 of a gapless record; a cut that does not begin at row 0 begins with unknown memory."""
        parts = {
            topic: replace(signal, time=signal.time[begin:end], values=signal.values[begin:end])
            for topic, signal in self.signals.items()
        }
        return replace(self, signals=parts, start=self.start if begin == 0 else "unknown")

    def with_values(self: Cut, **values: Array) -> Cut:
        """The record with other values (N, A) of some signals."""
        changed = {topic: replace(self.signal(topic), values=rows) for topic, rows in values.items()}
        for topic, signal in changed.items():
            due = len(signal.time), len(signal.axes)
            if np.shape(signal.values) != due:
                raise InputError(f"{topic}: has shape {np.shape(signal.values)}, the record {due}: give as many rows and axes")
        return replace(self, signals={**self.signals, **changed})

    def signal(self, topic: str) -> Signal:
        """A signal by topic. Raises `InputError` naming the topics that are there."""
        if topic not in self.signals:
            raise no_topic(self.source, topic, self.signals)
        return self.signals[topic]

    def between(self: Cut, begin: float | None, end: float | None) -> Cut:
        """The part of the record from begin to end, its own where None.

        Sample times in s. Raises `InputError` where no signal has a sample there.
        """
        if begin is None and end is None:
            return self
        first, last = -np.inf if begin is None else begin, np.inf if end is None else end
        parts, cut = {}, False
        for topic, signal in self.signals.items():
            rows = (signal.time >= first) & (signal.time <= last)
            cut |= len(rows) > 0 and not rows[0]
            parts[topic] = replace(signal, time=signal.time[rows], values=signal.values[rows])
        if not any(len(part.time) for part in parts.values()):
            known = [signal.time for signal in self.signals.values() if len(signal.time)]
            there = f": it lasts from {min(t[0] for t in known):.6g} to {max(t[-1] for t in known):.6g} s" if known else ""
            raise InputError(f"{self.source}: has no samples from {first:g} to {last:g} s{there}")
        return replace(self, signals=parts, start=self._start_at(first) if cut else self.start)

    def _start_at(self, first: float) -> str | Beginning:
        """State of the part that begins at a time, s: behind the commands before it, where these have no gap."""
        earlier = self.start.memory if isinstance(self.start, Beginning) else np.zeros((0, 1))
        signal = self.signals.get("command")
        if signal is not None and earlier is not None and self.start != "unknown" and len(signal.time) > 1:
            rows = slice(int(np.count_nonzero(signal.time < first)))  # no copy: it may be an hour
            before = replace(signal, time=signal.time[rows], values=signal.values[rows])
            if all_finite(before.values) and before.consecutive_ticks(commonest_step(signal.time)) is not None:
                memory = np.concatenate([earlier, before.values]) if earlier.size else before.values
                if len(memory):
                    return Beginning(FOLLOWS, memory, 0)
        return "auto" if self.start == "auto" else "unknown"

    def shifted(self, seconds: float) -> Record:
        """The record with its measurement taken later by some seconds, in whole samples; a note tells by how many."""
        if seconds == 0.0:
            return self
        if not np.isfinite(seconds):
            raise InputError(f"--shift {seconds:g}: is no time: give a number of s")
        signal = self.signal("measurement")
        step = self.sample_time
        ticks = round(seconds / step)
        if abs(ticks) >= len(signal.time) - 1:
            raise InputError(
                f"--shift {seconds:g}: the record {self.source} is only {len(signal.time) * step:g} s long: give a shorter time"
            )
        moved = replace(signal, time=signal.time + ticks * step)
        note = f"{self.source}: the measurement is shifted by {1e3 * ticks * step:.6g} ms ({ticks} samples)"
        return replace(self, signals={**self.signals, "measurement": moved}, notes=(*self.notes, note))

    def check(self, topics: Sequence[str]) -> None:
        """Raise `InputError` when a value of these topics is not finite or out of range, naming its time and how many there are."""
        for topic in topics:
            signal = self.signal(topic)
            if all(admissible(signal.values[part]).all() for part in blocks(len(signal.values))):
                continue
            bad = ~admissible(signal.values)
            first = signal.time[np.argmax(bad)]
            kind = "beyond 1e12" if np.isfinite(signal.values).all() else "NaN or infinite"
            raise InputError(
                f"{self.source}: {topic}: {int(bad.sum())} of {len(bad)} samples are {kind}, the first at "
                f"t = {first:g} s: cut them out or record again"
            )

    def check_axes(self) -> None:
        """Raise `InputError` when command and measurement have other axes, with what to do."""
        command, measurement = self.signal("command").axes, self.signal("measurement").axes
        if command == measurement:
            return
        if len(command) == 1 < len(measurement):
            remedy = "import one sensor at a time, or name the command once for each of them (command=u+u[V],measurement=y1+y2[um])"
        elif len(measurement) == 1 < len(command):
            remedy = "import one command at a time, of a record in which the others rest"
        else:
            remedy = "record both with the same axes in the same order"
        raise InputError(
            f"{self.source}: command has axes {', '.join(command)}, measurement has {', '.join(measurement)}: {remedy}"
        )

    def common_step(self, topics: Sequence[str]) -> float:
        """The common sample time (s) of these topics, from the commonest step of their times.

        Raises `InputError` when a topic has fewer than two samples or the topics differ.
        """
        steps = {}
        for topic in topics:
            time = self.signal(topic).time
            check_times(f"{self.source}: {topic}", time)
            if len(time) < 2:
                raise InputError(f"{self.source}: {topic}: {len(time)} sample{'s' * (len(time) != 1)}, at least two are needed")
            regular = self.signal(topic).timing == "layout"
            step = commonest_step(time, REGULAR_STEPS if regular else STEPS_LOOKED_AT)
            if step > 0 and regular:
                with np.errstate(over="ignore"):  # a step of next to nothing, which is no sample time
                    step = (time[-1] - time[0]) / max(np.rint((time[-1] - time[0]) / step), 1.0)
            steps[topic] = float(f"{step:.12g}")
        first = steps[topics[0]]
        for topic, step in steps.items():
            if step <= 0 or abs(step - first) > 0.01 * first:
                raise InputError(
                    f"{self.source}: {topic}: sample time {step:g} s, but {topics[0]} has {first:g} s: record both at one rate"
                )
        return first

    def not_followed(self, step: float) -> list[range]:
        """Stretches of ticks round(t / step) at which the actuator did not follow the command, as said on `applied`.

        None where nothing was said, or with the times of reception, which tell no ticks; see `ticks_not_followed`.
        """
        command, applied = self.signals.get("command"), self.signals.get(APPLIED)
        if command is None or applied is None or "receive" in (command.timing, applied.timing):
            return []
        if applied.axes != command.axes or applied.unit != command.unit or not len(command.time):
            return []
        return ticks_not_followed((command.time, command.values), (applied.time, applied.values), step)

    def aligned(self: Cut, topics: Sequence[str] = TOPICS, allow_gaps: bool = False) -> list[Cut]:
        """The gapless records, in order of time, in which each of the topics has every tick of the common clock; their times begin at 0.

        Ticks are round(t / sample time). What begins after a gap, or where the actuator began to follow the command, has an unknown
        start, unless how it starts is to be found. Where command and measurement are both wanted, ticks at which the actuator did not
        follow the command are left out. allow_gaps splits the record at missing ticks, which are refused otherwise. Raises
        `InputError` where values are not finite, times do not increase, topics share no tick, the actuator never followed its
        command, or ticks are missing and gaps not allowed.
        """
        self.check(topics)
        step = self.common_step(topics)
        ranges = [self.signal(topic).consecutive_ticks(step) for topic in topics]
        known = [found for found in ranges if found is not None]
        unusable = self.not_followed(step) if {"command", "measurement"} <= set(topics) else []
        begin, end = max((found.start for found in known), default=0), min((found.stop for found in known), default=0)
        if len(known) == len(topics) and begin < end and not any(part.start < end and part.stop > begin for part in unusable):
            values = {
                topic: self.signal(topic).values[begin - found.start : end - found.start]
                for topic, found in zip(topics, known, strict=True)
            }
            return [self._gapless(values, regular_times(end - begin, step))]
        ticks = {}
        for topic in topics:
            signal = self.signal(topic)
            latest = float(np.abs(signal.time).max())
            if latest / step > MAX_TICKS:
                raise InputError(f"{self.source}: {topic}: steps of {step:g} s at times of up to {latest:g} s: record again")
            found = np.rint(signal.time / step).astype(np.int64)
            if signal.timing == "receive":
                found = found[0] + np.arange(len(found))  # the reception's jitter is not the sampling's
            if np.any(np.diff(found) <= 0):
                at = int(np.argmax(np.diff(found) <= 0))
                raise InputError(
                    f"{self.source}: {topic}: the time does not increase at t = {signal.time[at + 1]:g} s: duplicate or "
                    "reordered samples; record again or repair the bag"
                )
            ticks[topic] = found
        common = ticks[topics[0]]
        for topic in topics[1:]:
            common = np.intersect1d(common, ticks[topic], assume_unique=True)
        if not len(common):
            raise InputError(f"{self.source}: {', '.join(topics)} share no sample time: they are not of one run")
        everywhere = common
        for part in unusable:
            common = common[(common < part.start) | (common >= part.stop)]
        if not len(common):
            raise InputError(
                f"{self.source}: the actuator never followed the command, as {APPLIED} says: record while its stage is active, and longer "
                "than it takes to approach the command"
            )
        breaks = np.flatnonzero(np.diff(common) > 1)
        if len(breaks) and not allow_gaps:
            at = common[breaks[0] + 1] * step
            within = everywhere[(everywhere >= common[0]) & (everywhere <= common[-1])]
            lost = int((np.diff(within) - 1).sum())
            trouble = [f"{lost} ticks are missing"] if lost else []
            if unfollowed := len(within) - len(common):
                trouble.append(f"the actuator did not follow the command in {unfollowed} ticks")
            raise InputError(
                f"{self.source}: {', and '.join(trouble)} in {len(breaks)} gaps, the first before t = {at:g} s: record "
                "again, or use the stretches between them (identify --allow-gaps)"
            )
        edges = np.concatenate([[0], breaks + 1, [len(common)]])
        stretches: list[Cut] = []
        for begin, end in zip(edges[:-1], edges[1:], strict=True):
            wanted = common[begin:end]
            values = {
                topic: np.ascontiguousarray(self.signal(topic).values[np.searchsorted(ticks[topic], wanted)]) for topic in topics
            }
            stretches.append(self._gapless(values, (wanted - wanted[0]) * step, len(stretches), bool(wanted[0] > everywhere[0])))
        return stretches

    def _gapless(self: Cut, values: Mapping[str, Array], time: Array, number: int = 0, amid: bool = False) -> Cut:
        """A stretch of the record; number: of those before it; amid: whether it begins later than its record."""
        signals = {topic: Signal(time, rows, self.signal(topic).axes, self.signal(topic).unit) for topic, rows in values.items()}
        unknown = number > 0 or (amid and self.start == "settled")
        source = self.source + (f"[{number}]" if number else "")
        return replace(self, signals=signals, source=source, start="unknown" if unknown else self.start)


def sampled_record(
    name: str,
    command: Annotated[Array, "N A"],
    measurement: Annotated[Array, "N A"],
    sample_time: float,
    axes: Sequence[str],
    unit: str,
    hold: str | None = None,
    start: str = "auto",
    command_unit: str = "V",
) -> Record:
    """Make a gapless record of arrays.

    Parameters
    ----------
    name
        Name for messages.
    command, measurement
        Samples (N, A), in the units below.
    sample_time
        Sample time, s.
    axes
        Names of the A axes.
    unit
        Unit of the measurement.
    hold, start
        As `Record` has them.
    command_unit
        Unit of the command.

    Returns
    -------
    Record
        The record.
    """
    time = regular_times(len(command), sample_time)
    signals = {
        "command": Signal(time, command, tuple(axes), command_unit),
        "measurement": Signal(time, measurement, tuple(axes), unit),
    }
    return Record(signals, name, hold=hold or "zoh", states_hold=hold is not None, start=start)
