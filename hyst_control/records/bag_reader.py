"""Reading rosbag2 bags of signal messages: MCAP or SQLite3, finished or cut off, with a layout or without."""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from io import BufferedReader
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryDirectory
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from hyst_control.errors import InputError
from hyst_control.foreign_readers import first_line
from hyst_control.records.actuator_following import APPLIED
from hyst_control.records.decompression import Budget, Damage, Expanded, decompress
from hyst_control.records.mcap_stream import MAGIC, PIECE, CutOff, McapStream
from hyst_control.records.record import Record, Signal, axis_names, check_times, commonest_step, increasing
from hyst_control.records.row_store import RowStore
from hyst_control.records.signal_message import MESSAGE_TYPE, decode, parse_label
from hyst_control.records.sqlite_bag import sqlite_messages
from hyst_control.yaml_files import read_yaml

SIGNALS = ("reference", "feedforward", "feedback", "command", "measurement")
"""The topics that the package knows; another topic that is no signal is left out with a note instead of refused."""

COMMAND_SIDE = ("command", "feedforward", "feedback")
STORAGE = (".mcap", ".db3")
COMPRESSED = tuple(f"{suffix}.zstd" for suffix in STORAGE)
PENDING = 2048
"""Messages decoded at a time: enough for numpy's speed, few enough that the raw bytes take no room."""

MEDIAN_OF = 2**16
"""Messages, from the first on, of which a topic's clock is held against the time of reception."""

FOREIGN_SHARE = 0.1
"""Rows of another label or width, per row of the topic's own, up to which they are left out."""

LATEST = 2**63 - 1
"""ns; a damaged file may hold any time."""

Array = NDArray[np.float64]


def read_bag(
    path: str | Path, namespace: str | None = None, unit: str = "unknown", topics: Collection[str] | None = None
) -> Record:
    """Read every signal topic of a bag: a rosbag2 directory, or a single .mcap or .db3 file.

    Parameters
    ----------
    path
        Bag to read.
    namespace
        Namespace of the topics, needed where several namespaces have a topic of the same name.
    unit
        Unit of measurement and reference in a bag whose messages have no layout.
    topics
        Last parts of the names of the topics to read; all by default.

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
    notes: list[str] = []
    bag = _Bag(path, notes)
    found: dict[str, _Topic] = {}
    for topic, time, raw in bag.messages():
        if topic not in found:
            found[topic] = _Topic(topics is None or topic.rpartition("/")[2] in topics)
        found[topic].add(raw, time)
    if not found:
        raise InputError(f"{path}: holds no {MESSAGE_TYPE} messages: check what was recorded")
    named = {name: found[topic] for name, topic in _by_last_part(path, found, namespace).items() if found[topic].wanted}
    notes += [f"{path}: {topic}: holds no messages" for topic in sorted(bag.topics - set(found))]
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
            notes.append(f"{error} (left out)")
            continue
        if not len(signals[name].time):
            notes.append(f"{path}: {name}: holds no rows")
    if any(signal.timing == "receive" for signal in signals.values()):
        notes.append(f"{path}: messages without a layout: the time of reception stands for the sample time, with its jitter")
    record = Record(signals, str(path), tuple(notes), bag.hold)
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


@dataclass(frozen=True)
class _Metadata:
    """Content of metadata.yaml: storage files by name; compression "", "file" or "message"."""

    files: tuple[str, ...]
    compression: str
    hold: str


@dataclass
class _Bag:
    """A bag being read: what is known of it besides its messages."""

    path: Path
    notes: list[str]
    topics: set[str] = field(default_factory=set)
    """Every signal topic that the bag knows, also those without a message."""
    hold: str = "zoh"

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        """(topic, receive time in ns, CDR bytes) of every Float64MultiArray message."""
        path = self.path
        if not path.exists():
            raise InputError(f"{path}: does not exist: give the path of a bag")
        metadata = _metadata(path, self.notes)
        files = _files(path, metadata)
        for file in files:
            if file.stat().st_size == 0:
                raise InputError(f"{file}: is empty: the recording wrote nothing")
        if metadata is not None:
            self.hold = metadata.hold
        mode = metadata.compression if metadata is not None else ""
        finished = metadata is not None and all(file.suffix != ".mcap" or _has_footer(file) for file in files)
        for file in files:
            budget = Budget(file.stat().st_size)
            yield from self._of_file(file, finished, budget, mode == "message")

    def _of_file(self, file: Path, finished: bool, budget: Budget, packed: bool) -> Iterator[tuple[str, int, bytes]]:
        """Messages of one storage file; of one that nobody finished all that can be read, with a note on the rest.

        packed: every message is compressed by itself.
        """
        compressed = file.suffix == ".zstd"
        count = 0
        try:
            if file.name.endswith((".db3", ".db3.zstd")):
                for topic, time, raw in self._sqlite(file, finished, budget, compressed):
                    count += 1
                    yield topic, time, decompress(raw, "zstd", None, budget) if packed else raw
                return
            with ExitStack() as opened:
                stream: BinaryIO = opened.enter_context(open(file, "rb"))
                if compressed:
                    stream = BufferedReader(Expanded(stream, budget), PIECE)
                mcap = McapStream(stream, None if compressed else file.stat().st_size, budget)
                try:
                    for topic, time, raw in mcap.messages():
                        count += 1
                        yield topic, time, decompress(raw, "zstd", None, budget) if packed else raw
                finally:
                    self.topics.update(mcap.topics.values())
                if finished and mcap.announced is not None and mcap.announced != mcap.found:
                    raise Damage(f"holds {mcap.found} messages where {mcap.announced} are announced")
        except CutOff:
            if finished:
                raise InputError(f"{self.path}: is damaged (a record is longer than the file): record again or repair it") from None
            if not count:
                raise InputError(f"{file}: is cut off before its first whole chunk: record again") from None
            self.notes.append(f"{file}: has no footer (recorder killed?): {count} messages up to its last whole chunk were read")
        except InputError:
            raise
        except Exception as error:  # damage is also what a decompressor says of it
            if finished or file.name.endswith((".db3", ".db3.zstd")):
                raise InputError(f"{file}: is damaged ({first_line(error)}): record again or repair it") from None
            if not count:
                raise InputError(
                    f"{file}: is damaged or cut off before its first whole chunk ({first_line(error)}): record again"
                ) from None
            self.notes.append(f"{file}: is damaged ({first_line(error)}): {count} messages before the damage were read")

    def _sqlite(self, file: Path, finished: bool, budget: Budget, compressed: bool) -> Iterator[tuple[str, int, bytes]]:
        topics: dict[int, str] = {}
        try:
            if not compressed:
                yield from sqlite_messages(file, finished, topics)
                return
            with TemporaryDirectory() as folder:  # SQLite reads files only
                whole = Path(folder) / file.stem
                with open(file, "rb") as stream, open(whole, "wb") as copy:
                    copyfileobj(BufferedReader(Expanded(stream, budget), PIECE), copy, PIECE)
                yield from sqlite_messages(whole, True, topics)
        finally:
            self.topics.update(topics.values())


def _metadata(path: Path, notes: list[str]) -> _Metadata | None:
    """Content of metadata.yaml; None where it is missing or cannot be used, which is noted."""
    file = path / "metadata.yaml"
    if not path.is_dir() or not file.exists():
        return None
    try:
        if not file.is_file():
            raise InputError("is no file")
        said = read_yaml(file)
        found = said["rosbag2_bagfile_information"]
        names = found["relative_file_paths"]
        mode = str(found.get("compression_mode") or "").lower()
        compression = "" if mode == "none" else mode
        if compression not in ("", "file", "message"):
            raise InputError(f"compression mode {mode[:20]!r} is not known")
        if compression and found.get("compression_format") != "zstd":
            raise InputError(f"compression format {str(found.get('compression_format'))[:20]!r} is not known")
        if not isinstance(names, list) or not names or not all(isinstance(name, str) and Path(name).name for name in names):
            raise InputError("relative_file_paths is no list of names")
        custom = found.get("custom_data")
        hold = "foh" if isinstance(custom, dict) and custom.get("hold") == "foh" else "zoh"
        return _Metadata(tuple(Path(name).name for name in names), compression, hold)
    except InputError as error:
        reason = str(error).removeprefix(f"{file}: ")
    except (KeyError, TypeError, AttributeError, ValueError):
        reason = "it says nothing of a bag"
    notes.append(f"{file}: cannot be used ({reason}): the bag's files were read without it")
    return None


def _files(path: Path, metadata: _Metadata | None) -> list[Path]:
    """The storage files of a bag, in the order that its metadata has them in."""
    known = (*STORAGE, *COMPRESSED)
    if metadata is not None:
        files = [path / name for name in metadata.files]
        if missing := [file.name for file in files if not file.is_file()]:
            raise InputError(
                f"{path}: its metadata names files that are not there ({', '.join(missing)[:200]}): copy the whole bag"
            )
        # rosbag2 names the file before it was compressed in some versions
    elif path.is_file():
        files = [path]
    else:
        files = sorted(file for file in path.iterdir() if file.name.endswith(known))
    if not files or not all(file.name.endswith(known) for file in files):
        raise InputError(f"{path}: is no bag: must be a rosbag2 directory, or an .mcap or .db3 file")
    if len({file.name.removesuffix(".zstd").rpartition(".")[2] for file in files}) > 1:
        raise InputError(f"{path}: holds both MCAP and SQLite3 files: keep one bag per directory")
    return files


def _has_footer(file: Path) -> bool:
    with open(file, "rb") as stream:
        stream.seek(0, 2)
        if stream.tell() < 2 * len(MAGIC):
            return False
        stream.seek(-len(MAGIC), 2)
        return stream.read() == MAGIC


Form = tuple[str, int]
"""Label and number of columns of messages."""


@dataclass(frozen=True)
class _Part:
    """Successive messages of one form, the first of them counted from 0, and how many they are."""

    form: Form
    first: int
    messages: int


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
        self.parts: list[_Part] = []
        self.rows: dict[Form, _Rows] = {}
        self.times = array("q")
        self.error: InputError | None = None
        self._pending: list[bytes] = []
        self._decoded = 0

    def add(self, raw: bytes, time: int) -> None:
        """Take one message; time: ns, of its reception."""
        if self.wanted:
            self.times.append(min(time, LATEST))
            self._pending.append(raw)
            if len(self._pending) == PENDING:
                self._decode()

    def taken(self, notes: list[str], where: str) -> tuple[str, _Rows, NDArray[np.int64]]:
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
            notes.append(
                f"{where}: {foreign} rows of another form ({other[0] or f'{other[1]} values'!r}) were left out: who sent them?"
            )
            kept = np.zeros(len(times), bool)
            for part in self.parts:
                kept[part.first : part.first + part.messages] = part.form == main
            times = times[kept]
        return main[0], found[main], times

    def _decode(self) -> None:
        raws, self._pending = self._pending, []
        if self.error is None:
            try:
                self._append(raws)
            except InputError as error:
                self.error, self.parts, self.rows = error, [], {}
        self._decoded += len(raws)

    def _append(self, raws: list[bytes]) -> None:
        """Messages of one size and header are read as one array, others one by one."""
        begin = 0
        while begin < len(raws):
            size = len(raws[begin])
            end = begin + 1
            while end < len(raws) and len(raws[end]) == size:
                end += 1
            label, first = decode(raws[begin])
            head = size - first.nbytes
            table = np.frombuffer(b"".join(raws[begin:end]), np.uint8).reshape(-1, size)
            # The padding inside a header is whatever the sender's memory held: only a wholly equal one is taken as read.
            if raws[begin][1] == 1 and (table[:, :head] == table[0, :head]).all():
                rows = np.ascontiguousarray(table[:, head:]).view("<f8").reshape((end - begin) * len(first), first.shape[1])
                self._keep(label, rows, self._decoded + begin, end - begin)
            else:
                self._append_singly(raws[begin:end], self._decoded + begin)
            begin = end

    def _append_singly(self, raws: list[bytes], first: int) -> None:
        """Messages of differing headers, joined as long as their form is one."""
        found = [decode(raw) for raw in raws]
        begin = 0
        while begin < len(found):
            label, block = found[begin]
            end = begin + 1
            while end < len(found) and found[end][0] == label and found[end][1].shape[1] == block.shape[1]:
                end += 1
            rows = np.concatenate([rows for _, rows in found[begin:end]])
            self._keep(label, rows, first + begin, end - begin)
            begin = end

    def _keep(self, label: str, rows: Array, first: int, messages: int) -> None:
        """Keep the rows (N, C) of successive messages."""
        form = label, rows.shape[1]
        self.parts.append(_Part(form, first, messages))
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
            received = float(np.median(stamps[:MEDIAN_OF]) * 1e-9 - np.median(time[: _share(MEDIAN_OF, len(stamps), len(time))]))
        return _ordered(path, name, Signal(time, rows.values.array(), axes, units[0], received=received), notes)
    values = rows.values.array()
    if not increasing(stamps, equal=True):
        order = np.argsort(stamps, kind="stable")
        stamps, values = stamps[order], values[order]
    time = np.asarray((stamps - origin) * 1e-9, dtype=np.float64)
    return Signal(time, values, axes, "V" if name in COMMAND_SIDE else unit, "receive")


def _share(count: int, messages: int, rows: int) -> int:
    """Rows that so many messages hold."""
    return rows if count >= messages else max(rows * count // messages, 1)


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
