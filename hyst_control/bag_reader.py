"""Reading rosbag2 bags of signal messages: MCAP or SQLite3, finished or cut off, with a layout or without."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import yaml

from hyst_control.errors import InputError
from hyst_control.record import Record, Signal
from hyst_control.signal_message import MESSAGE_TYPE, decode, parse_label

SIGNALS = ("reference", "feedforward", "feedback", "command", "measurement")
MCAP_MAGIC = b"\x89MCAP0\r\n"
COMMAND_SIDE = ("command", "feedforward", "feedback")
AXIS_NAMES = ("x", "y", "z", "u", "v", "w")


def read_bag(path: str | Path, namespace: str | None = None, unit: str = "unknown") -> Record:
    """Every signal topic of a bag: a rosbag2 directory, or an .mcap or .db3 file by itself.

    Topics are known by the last part of their names; where several namespaces have one, `namespace` says which is meant. `unit`
    is that of measurement and reference in a bag whose messages carry no layout. Raises `InputError` naming file and remedy.
    """
    path = Path(path)
    notes: list[str] = []
    collected: dict[str, tuple[list[bytes], list[int]]] = {}
    for topic, time, raw in _messages(path, notes):
        raws, times = collected.setdefault(topic, ([], []))
        raws.append(raw)
        times.append(time)
    if not collected:
        raise InputError(f"{path}: holds no {MESSAGE_TYPE} messages: check what was recorded")
    signals = {}
    for name, topic in _by_last_part(path, collected, namespace).items():
        raws, times = collected.pop(topic)
        signals[name] = _signal(path, name, raws, times, unit)
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


def _by_last_part(path: Path, topics: Iterable[str], namespace: str | None) -> dict[str, str]:
    wanted = None if namespace is None else "/" + namespace.strip("/")
    chosen: dict[str, str] = {}
    for topic in sorted(topics):
        head, _, name = topic.rpartition("/")
        if wanted is not None and head.rstrip("/") != wanted.rstrip("/"):
            continue
        if name in chosen:
            raise InputError(f"{path}: {chosen[name]} and {topic} are both a {name}: say which with the namespace")
        chosen[name] = topic
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
        return
    yield from _finished(path, files)


def _files(path: Path) -> list[Path]:
    files = [path] if path.is_file() else sorted(file for pattern in ("*.mcap", "*.db3") for file in path.glob(pattern))
    if not files or any(file.suffix not in (".mcap", ".db3") for file in files):
        raise InputError(f"{path}: is no bag: a rosbag2 directory, or an .mcap or .db3 file, is due")
    return files


def _finished(path: Path, files: list[Path]) -> Iterator[tuple[str, int, bytes]]:
    from rosbags.rosbag2 import Reader, ReaderError

    if path.is_file():
        yield from _bare_file(path)
        return
    try:
        with Reader(path) as reader:
            connections = [connection for connection in reader.connections if connection.msgtype == MESSAGE_TYPE]
            if connections:
                for connection, time, raw in reader.messages(connections):
                    yield connection.topic, time, raw
    except ReaderError as error:
        raise InputError(f"{path}: {_first_line(error)}: the bag cannot be read; record again or repair it") from None
    except (KeyError, ValueError, TypeError, OSError, AssertionError) as error:
        raise InputError(f"{path}: is damaged ({_first_line(error) or type(error).__name__}): record again or repair it") from None


def _bare_file(file: Path) -> Iterator[tuple[str, int, bytes]]:
    """A .db3 file without its metadata."""
    import sqlite3

    try:
        with sqlite3.connect(f"file:{file}?mode=ro", uri=True) as database:
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
    from mcap.exceptions import McapError
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
    except (McapError, EOFError, ValueError, KeyError, OverflowError, MemoryError, RuntimeError, UnicodeDecodeError) as error:
        if not count:
            raise InputError(f"{file}: is damaged or cut off before its first whole chunk ({_first_line(error)}): record again") from None
    except Exception as error:  # struct.error and the decompressors' own
        if not count:
            raise InputError(f"{file}: is damaged or cut off before its first whole chunk ({_first_line(error)}): record again") from None
    if not _has_footer(file):
        if not count:
            raise InputError(f"{file}: is cut off before its first whole chunk: record again")
        notes.append(f"{file}: has no footer (recorder killed?): {count} messages up to its last whole chunk were read")


def _signal(path: Path, name: str, raws: list[bytes], times: list[int], unit: str) -> Signal:
    try:
        label, blocks = _decoded(raws)
    except InputError as error:
        raise InputError(f"{path}: {name}: {error}") from None
    if label:
        try:
            axes, units = parse_label(label)
        except InputError as error:
            raise InputError(f"{path}: {name}: {error}") from None
        if len(set(units)) > 1:
            raise InputError(f"{path}: {name}: label {label!r} mixes units: one unit per topic is due")
        return _ordered(path, name, Signal(blocks[:, 0], np.ascontiguousarray(blocks[:, 1:]), axes, units[0]))
    stamps = np.array(times, dtype=np.int64)
    order = np.argsort(stamps, kind="stable")
    time = (stamps[order] - stamps[order[0]]) * 1e-9
    count = blocks.shape[1]
    axes = AXIS_NAMES[:count] if count <= len(AXIS_NAMES) else tuple(f"a{i}" for i in range(count))
    return Signal(time, np.ascontiguousarray(blocks[order]), axes, "V" if name in COMMAND_SIDE else unit, "receive")


def _decoded(raws: list[bytes]) -> tuple[str, np.ndarray]:
    """Label and all rows (N, C) of a topic's messages. Messages of one form are read as one array."""
    label, first = decode(raws[0])
    size = len(raws[0])
    head = size - first.nbytes
    header = bytes(raws[0][:head])
    parts: list[np.ndarray] = []
    begin = 0
    while begin < len(raws):
        end = begin
        while end < len(raws) and len(raws[end]) == size:
            end += 1
        if end > begin:
            table = np.frombuffer(b"".join(raws[begin:end]), np.uint8).reshape(-1, size)
            # The padding inside a header is whatever the sender's memory held: only a wholly equal one is taken as read.
            alike = (table[:, :head] == np.frombuffer(header, np.uint8)).all(axis=1)
            if alike.all():
                parts.append(np.ascontiguousarray(table[:, head:]).view(np.float64).reshape(-1, first.shape[1]))
                begin = end
                continue
        end = max(end, begin + 1)
        for raw in raws[begin:end]:
            other, block = decode(raw)
            if other != label:
                raise InputError(f"label changes from {label!r} to {other!r}: record one plant per topic")
            if block.shape[1] != first.shape[1]:
                raise InputError(f"{block.shape[1]} values after messages of {first.shape[1]}: record one plant per topic")
            parts.append(block)
        begin = end
    return label, np.concatenate(parts)


def _ordered(path: Path, name: str, signal: Signal) -> Signal:
    """The rows in order of their sample time; rows sent twice are kept once."""
    time = signal.time
    if not np.isfinite(time).all():
        raise InputError(f"{path}: {name}: the time column holds NaN or infinity: record again")
    if np.all(np.diff(time) > 0):
        return signal
    _, first = np.unique(time, return_index=True)
    repeated = np.setdiff1d(np.arange(len(time)), first)
    kept = first[np.searchsorted(time[first], time[repeated])]
    if not np.array_equal(signal.values[repeated], signal.values[kept], equal_nan=True):
        raise InputError(f"{path}: {name}: two different rows of one sample time: two sources wrote this topic, or the clock jumped")
    return Signal(time[first], np.ascontiguousarray(signal.values[first]), signal.axes, signal.unit, signal.timing)


def _first_line(error: BaseException) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else ""
