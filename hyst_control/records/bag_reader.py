"""Reading rosbag2 bags of signal messages: MCAP or SQLite3, finished or cut off, with a layout or without."""

from __future__ import annotations

import sqlite3
from array import array
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from hyst_control.errors import InputError
from hyst_control.records.record import Record, Signal, axis_names
from hyst_control.records.signal_message import MESSAGE_TYPE, decode, parse_label

SIGNALS = ("reference", "feedforward", "feedback", "command", "measurement")
"""The topics that the package knows; another topic that is no signal is left out with a note instead of refused."""

MCAP_MAGIC = b"\x89MCAP0\r\n"
COMMAND_SIDE = ("command", "feedforward", "feedback")
STORAGE = (".mcap", ".db3")
COMPRESSED = tuple(f"{suffix}.zstd" for suffix in STORAGE)
PENDING = 2048
"""Messages decoded at a time: enough for numpy's speed, few enough that the raw bytes take no room."""

LATEST = 2**63 - 1
"""ns; a damaged file may hold any time."""

Array = NDArray[np.float64]


def read_bag(
    path: str | Path, namespace: str | None = None, unit: str = "unknown", topics: Collection[str] | None = None
) -> Record:
    """Every signal topic of a bag: a rosbag2 directory, or an .mcap or .db3 file by itself.

    Topics are known by the last part of their names; where several namespaces have one, `namespace` says which is meant. `unit`
    is that of measurement and reference in a bag whose messages carry no layout. `topics`: only these, by the last part of
    their names. Raises `InputError` naming file and remedy.
    """
    path = Path(path)
    notes: list[str] = []
    found: dict[str, _Topic] = {}
    for topic, time, raw in _messages(path, notes):
        if topic not in found:
            found[topic] = _Topic(topics is None or topic.rpartition("/")[2] in topics)
        found[topic].add(raw, time)
    if not found:
        raise InputError(f"{path}: holds no {MESSAGE_TYPE} messages: check what was recorded")
    named = {name: found[topic] for name, topic in _by_last_part(path, found, namespace).items() if found[topic].wanted}
    found.clear()
    origin = min((min(each.times) for each in named.values() if each.times), default=0)
    signals: dict[str, Signal] = {}
    for name in list(named):
        held = named.pop(name)  # its blocks are given back as soon as the signal has them
        try:
            signals[name] = _signal(path, name, held, origin, unit, notes)
        except InputError as error:
            if name in SIGNALS or topics is not None:
                raise
            notes.append(f"{error} (left out)")
    if any(signal.timing == "receive" for signal in signals.values()):
        notes.append(f"{path}: messages without a layout: the time of reception stands for the sample time, with its jitter")
    return Record(signals, str(path), tuple(notes), _hold(path))


def _hold(path: Path) -> str:
    """The hold that an import noted in the bag's metadata; zoh where nothing is said."""
    try:
        metadata = yaml.safe_load((path / "metadata.yaml").read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        return "foh" if (metadata.get("custom_data") or {}).get("hold") == "foh" else "zoh"
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, AttributeError):
        return "zoh"


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


def _messages(path: Path, notes: list[str]) -> Iterator[tuple[str, int, bytes]]:
    """(topic, receive time in ns, CDR bytes) of every Float64MultiArray message."""
    if not path.exists():
        raise InputError(f"{path}: does not exist: give the path of a bag")
    files = _files(path)
    for file in files:
        if file.stat().st_size == 0:
            raise InputError(f"{file}: is empty: the recording wrote nothing")
    finished = (path / "metadata.yaml").exists() if path.is_dir() else False
    if all(file.suffix == ".mcap" for file in files) and (not finished or not all(_has_footer(file) for file in files)):
        for file in files:
            yield from _unfinished_mcap(file, notes)
    elif finished:
        yield from _finished(path)
    else:
        for file in files:
            yield from _bare_file(file)


def _files(path: Path) -> list[Path]:
    """The storage files of a bag; compressed ones only where metadata.yaml says how to read them."""
    known: tuple[str, ...] = STORAGE
    if path.is_file():
        files = [path]
    else:
        known += COMPRESSED if (path / "metadata.yaml").exists() else ()
        files = sorted(file for file in path.iterdir() if file.name.endswith(known))
    if not files or not all(file.name.endswith(known) for file in files):
        raise InputError(f"{path}: is no bag: a rosbag2 directory, or an .mcap or .db3 file, is due")
    if len({file.suffix for file in files}) > 1:
        raise InputError(f"{path}: holds both MCAP and SQLite3 files: keep one bag per directory")
    return files


def _finished(path: Path) -> Iterator[tuple[str, int, bytes]]:
    from rosbags.rosbag2 import Reader, ReaderError

    try:
        with Reader(path) as reader:
            connections = [connection for connection in reader.connections if connection.msgtype == MESSAGE_TYPE]
            if connections:
                for connection, time, raw in reader.messages(connections):
                    yield connection.topic, time, bytes(raw)
    except ReaderError as error:
        raise InputError(f"{path}: {_first_line(error)}: the bag cannot be read; record again or repair it") from None
    except Exception as error:  # damage shows as anything, the decompressors' own exceptions among it
        raise InputError(f"{path}: is damaged ({_first_line(error) or type(error).__name__}): record again or repair it") from None


def _bare_file(file: Path) -> Iterator[tuple[str, int, bytes]]:
    """A .db3 file without its metadata."""
    try:
        with closing(sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)) as database:
            topics = dict(database.execute("SELECT id, name FROM topics WHERE type = ?", (MESSAGE_TYPE,)))
            for topic, time, data in database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id"):
                if topic in topics:
                    yield topics[topic], time, data
    except sqlite3.Error as error:
        raise InputError(f"{file}: is no SQLite3 bag ({error}): record again or repair it") from None


def _has_footer(file: Path) -> bool:
    with open(file, "rb") as stream:
        stream.seek(0, 2)
        if stream.tell() < 2 * len(MCAP_MAGIC):
            return False
        stream.seek(-len(MCAP_MAGIC), 2)
        return stream.read() == MCAP_MAGIC


def _unfinished_mcap(file: Path, notes: list[str]) -> Iterator[tuple[str, int, bytes]]:
    """All whole chunks of an MCAP file, also of one whose recorder was killed."""
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import StreamReader

    topics: dict[int, str] = {}
    schemas: dict[int, str] = {}
    count = 0
    try:
        with open(file, "rb") as stream:
            for record in StreamReader(stream).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record.name
                elif isinstance(record, Channel):
                    if schemas.get(record.schema_id) == MESSAGE_TYPE:
                        topics[record.id] = record.topic
                elif isinstance(record, Message) and record.channel_id in topics:
                    count += 1
                    yield topics[record.channel_id], record.log_time, record.data
    except Exception as error:  # mcap's own, struct's and the decompressors'
        if not count:
            raise InputError(
                f"{file}: is damaged or cut off before its first whole chunk ({_first_line(error)}): record again"
            ) from None
        if _has_footer(file):
            notes.append(f"{file}: is damaged: {count} messages before the damage were read")
    if not _has_footer(file):
        if not count:
            raise InputError(f"{file}: is cut off before its first whole chunk: record again")
        notes.append(f"{file}: has no footer (recorder killed?): {count} messages up to its last whole chunk were read")


class _Topic:
    """The messages of one topic, decoded as they come in: the raw bytes of a long bag are never held together."""

    def __init__(self, wanted: bool) -> None:
        self.wanted = wanted
        self.label = ""
        self.columns = -1
        self.parts: list[Array] = []
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

    def rows(self) -> list[Array]:
        """All blocks (N, C) in their order. Raises the `InputError` of the first message that is no signal."""
        if self._pending:
            self._decode()
        if self.error is not None:
            raise self.error
        return self.parts

    def _decode(self) -> None:
        raws, self._pending = self._pending, []
        if self.error is None:
            try:
                self._append(raws)
            except InputError as error:
                self.error, self.parts = error, []

    def _append(self, raws: list[bytes]) -> None:
        """Messages of one size and header are read as one array, others one by one."""
        begin = 0
        while begin < len(raws):
            size = len(raws[begin])
            end = begin + 1
            while end < len(raws) and len(raws[end]) == size:
                end += 1
            first = self._checked(raws[begin])
            head = size - first.nbytes
            table = np.frombuffer(b"".join(raws[begin:end]), np.uint8).reshape(-1, size)
            # The padding inside a header is whatever the sender's memory held: only a wholly equal one is taken as read.
            if raws[begin][1] == 1 and (table[:, :head] == table[0, :head]).all():
                self.parts.append(np.ascontiguousarray(table[:, head:]).view("<f8").reshape(-1, first.shape[1]))
            else:
                self.parts.append(np.concatenate([self._checked(raw) for raw in raws[begin:end]]))
            begin = end

    def _checked(self, raw: bytes) -> Array:
        label, block = decode(raw)
        if self.columns < 0:
            self.label, self.columns = label, block.shape[1]
        if label != self.label:
            raise InputError(f"label changes from {self.label!r} to {label!r}: record one plant per topic")
        if block.shape[1] != self.columns:
            raise InputError(f"{block.shape[1]} values after messages of {self.columns}: record one plant per topic")
        return block


def _signal(path: Path, name: str, topic: _Topic, origin: int, unit: str, notes: list[str]) -> Signal:
    """The signal of a topic; origin: ns, from which times of reception count."""
    try:
        blocks = topic.rows()
        axes, units = parse_label(topic.label) if topic.label else (axis_names(topic.columns), ())
    except InputError as error:
        raise InputError(f"{path}: {name}: {error}") from None
    if not axes:
        raise InputError(f"{path}: {name}: messages hold no values: record the plant's signals")
    if len(set(units)) > 1:
        raise InputError(f"{path}: {name}: label {topic.label!r} mixes units: one unit per topic is due")
    if units:
        time = np.concatenate([block[:, 0] for block in blocks])
        values = np.concatenate([block[:, 1:] for block in blocks])
        blocks.clear()
        return _ordered(path, name, Signal(time, values, axes, units[0]), notes)
    stamps = np.frombuffer(topic.times, np.int64)
    order = np.argsort(stamps, kind="stable")
    time = np.asarray((stamps[order] - origin) * 1e-9, dtype=np.float64)
    return Signal(time, np.concatenate(blocks)[order], axes, "V" if name in COMMAND_SIDE else unit, "receive")


def _ordered(path: Path, name: str, signal: Signal, notes: list[str]) -> Signal:
    """The rows in order of their sample time; rows sent twice are kept once. What was mended is noted."""
    time = signal.time
    if not np.isfinite(time).all():
        raise InputError(f"{path}: {name}: the time column holds NaN or infinity: record again")
    if np.all(np.diff(time) > 0):
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
    return Signal(time[first], np.ascontiguousarray(signal.values[first]), signal.axes, signal.unit, signal.timing)


def _first_line(error: BaseException) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else ""
