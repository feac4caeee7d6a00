# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The storage files of a rosbag2 bag: MCAP or SQLite3, compressed or not, finished or cut off."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from io import BufferedReader
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryDirectory

from hyst_control.base.errors import InputError, Loss
from hyst_control.base.foreign_readers import first_line
from hyst_control.base.yaml_files import read_yaml
from hyst_control.records.bags.decompression import Budget, Damage, Expanded, decompress
from hyst_control.records.bags.mcap_stream import MAGIC, PIECE, CutOff, McapStream
from hyst_control.records.bags.sqlite_bag import sqlite_messages

STORAGE = (".mcap", ".db3")
COMPRESSED = tuple(f"{suffix}.zstd" for suffix in STORAGE)


def bags_in(paths: Iterable[str | Path]) -> list[Path]:
    """Bags of these paths: a folder of nothing but bags stands for them, in order of their names."""
    found: list[Path] = []
    for path in map(Path, paths):
        inner = sorted(path.iterdir()) if path.is_dir() else []
        found += inner if inner and all(map(_is_bag_folder, inner)) else [path]
    return found


def one_bag(path: str | Path) -> Path:
    """The bag of a path, which may be a folder with nothing but one bag; raises `InputError` where it holds several."""
    found = bags_in([path])
    if len(found) > 1:
        raise InputError(f"{path}: holds {len(found)} bags: give one of them, such as {found[0]}")
    return found[0]


def _is_bag_folder(path: Path) -> bool:
    return path.is_dir() and any(file.name.endswith((*STORAGE, *COMPRESSED)) for file in path.iterdir())


@dataclass(frozen=True)
class _Metadata:
    """Content of metadata.yaml: storage files by name; compression "", "file" or "message"."""

    files: tuple[str, ...]
    compression: str
    hold: str | None
    history: tuple[str, ...]


@dataclass
class Bag:
    """A bag being read: what is known of it besides its messages."""

    path: Path
    notes: list[str]
    chosen: Collection[str] | None = None  # Topics to read, whatever their type; None: those of signal messages
    topics: set[str] = field(default_factory=set)  # Every topic to read that the bag knows, also those without a message
    types: dict[str, tuple[str, str]] = field(default_factory=dict)  # Type and definition of topics
    hold: str | None = None
    history: tuple[str, ...] = ()

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        """(topic, receive time in ns, CDR bytes) of every message of the topics to read."""
        path = self.path
        if not path.exists():
            raise InputError(f"{path}: does not exist: give the path of a bag")
        metadata = _metadata(path, self.notes)
        files = _files(path, metadata)
        for file in files:
            if file.stat().st_size == 0:
                raise InputError(f"{file}: is empty: the recording wrote nothing")
        if metadata is not None:
            self.hold, self.history = metadata.hold, metadata.history
        mode = metadata.compression if metadata is not None else ""
        finished = metadata is not None and all(file.suffix != ".mcap" or _has_footer(file) for file in files)
        for file in files:
            budget = Budget(file.stat().st_size)
            yield from self._of_file(file, finished, budget, mode == "message")

    def listed(self) -> str:
        """All topics that have been met, with their types."""
        return ", ".join(f"{topic} ({kind})" for topic, (kind, _) in sorted(self.types.items())) or "none"

    def _of_file(self, file: Path, finished: bool, budget: Budget, packed: bool) -> Iterator[tuple[str, int, bytes]]:
        """Messages of one storage file (`packed`: each compressed by itself); of an unfinished one all that can be read, with a note."""
        is_sqlite = file.name.endswith((".db3", ".db3.zstd"))
        count = 0
        try:
            for topic, time, raw in (self._sqlite if is_sqlite else self._mcap)(file, finished, budget):
                count += 1
                yield topic, time, decompress(raw, "zstd", None, budget) if packed else raw
        except CutOff:
            if finished:
                raise InputError(f"{self.path}: is damaged (a record is longer than the file): record again or repair it") from None
            if not count:
                raise InputError(f"{file}: is cut off before its first whole chunk: record again") from None
            read = f"{count} messages up to its last whole chunk were read"
            self.notes.append(Loss(f"{file}: has no footer (recorder killed?): {read}"))
        except InputError:
            raise
        except Exception as error:  # damage is also what a decompressor says of it
            if finished or is_sqlite:
                raise InputError(f"{file}: is damaged ({first_line(error)}): record again or repair it") from None
            if not count:
                raise InputError(
                    f"{file}: is damaged or cut off before its first whole chunk ({first_line(error)}): record again"
                ) from None
            self.notes.append(Loss(f"{file}: is damaged ({first_line(error)}): {count} messages before the damage were read"))

    def _mcap(self, file: Path, finished: bool, budget: Budget) -> Iterator[tuple[str, int, bytes]]:
        compressed = file.suffix == ".zstd"
        with open(file, "rb") as opened:
            stream = BufferedReader(Expanded(opened, budget), PIECE) if compressed else opened
            mcap = McapStream(stream, None if compressed else file.stat().st_size, budget, self.chosen, types=self.types)
            try:
                yield from mcap.messages()
            finally:
                self.topics.update(mcap.topics.values())
            if finished and mcap.announced is not None and mcap.announced != mcap.found:
                raise Damage(f"holds {mcap.found} messages where {mcap.announced} are announced")

    def _sqlite(self, file: Path, finished: bool, budget: Budget) -> Iterator[tuple[str, int, bytes]]:
        topics: dict[int, str] = {}
        try:
            if file.suffix != ".zstd":
                yield from sqlite_messages(file, finished, topics, self.chosen, self.types)
                return
            with TemporaryDirectory() as folder:  # SQLite reads files only
                whole = Path(folder) / file.stem
                with open(file, "rb") as stream, open(whole, "wb") as copy:
                    copyfileobj(BufferedReader(Expanded(stream, budget), PIECE), copy, PIECE)
                yield from sqlite_messages(whole, True, topics, self.chosen, self.types)
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
        said = custom if isinstance(custom, dict) else {}
        hold = said["hold"] if said.get("hold") in ("zoh", "foh") else None
        history = tuple(str(said.get("history", "")).splitlines())
        return _Metadata(tuple(Path(name).name for name in names), compression, hold, history)
    except InputError as error:
        reason = str(error).removeprefix(f"{file}: ")
    except (KeyError, TypeError, AttributeError, ValueError):
        reason = "it says nothing of a bag"
    notes.append(Loss(f"{file}: cannot be used ({reason}): the bag's files were read without it"))
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
        table = f"; a table needs its ending, such as .csv, or hyst import {path}" if path.is_file() else ""
        raise InputError(f"{path}: is no bag: must be a rosbag2 directory, or an .mcap or .db3 file{table}")
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
