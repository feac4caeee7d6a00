# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of an SQLite3 bag file. SQLite keeps a value of any type in any column, so every type is looked at."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing
from pathlib import Path

from hyst_control.records.bags.decompression import Damage
from hyst_control.records.stream.signal_message import MESSAGE_TYPE


def sqlite_messages(
    file: Path,
    finished: bool,
    topics: dict[int, str],
    chosen: Collection[str] | None = None,
    types: dict[str, tuple[str, str]] | None = None,
) -> Iterator[tuple[str, int, bytes]]:
    """Messages in the order in which they came; that of their times, a clock that was set back would mix."""
    log = file.with_name(f"{file.name}-wal")
    size = file.stat().st_size + (log.stat().st_size if not finished and log.is_file() else 0)
    try:
        with closing(
            sqlite3.connect(f"{Path(os.path.realpath(file)).as_uri()}?{'immutable=1' if finished else 'mode=ro'}", uri=True)
        ) as database:
            if hasattr(database, "setlimit"):  # since Python 3.11
                database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(min(size, 2**30), 2**16))
            _check_tables(database)
            topics.update(_topics(database, chosen, types if types is not None else {}))
            if not topics:
                return
            marks = ", ".join("?" * len(topics))
            rows = database.execute(
                f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY id", tuple(topics)
            )
            left = size
            for topic, time, data in rows:
                if not isinstance(time, int) or time < 0 or not isinstance(data, bytes) or not isinstance(topic, int):
                    raise Damage(f"holds a message whose time is {str(time)[:40]!r} and whose data is {type(data).__name__}")
                left -= len(data)
                if left < 0:
                    raise Damage("holds more than its size")
                yield topics[topic], time, data
    except (sqlite3.Error, OverflowError) as error:
        raise Damage(f"is no SQLite3 bag ({error})") from None


def _check_tables(database: sqlite3.Connection) -> None:
    """Both tables are tables: a view can compute without an end."""
    for table in ("topics", "messages"):
        if not _is_table(database, table):
            raise Damage(f"is no SQLite3 bag (it has no table {table})")
        hidden = database.execute("SELECT count(*) FROM pragma_table_xinfo(?) WHERE hidden <> 0", (table,)).fetchone()
        if hidden != (0,):
            raise Damage(f"is no SQLite3 bag (its table {table} computes columns)")


def _is_table(database: sqlite3.Connection, table: str) -> bool:
    found = database.execute("SELECT type, sql FROM sqlite_master WHERE name = ?", (table,)).fetchall()
    return len(found) == 1 and found[0][0] == "table" and "virtual" not in str(found[0][1]).lower()


def _topics(database: sqlite3.Connection, chosen: Collection[str] | None, types: dict[str, tuple[str, str]]) -> dict[int, str]:
    found: dict[int, str] = {}
    definitions: dict[str, str] = {}
    if chosen is not None and _is_table(database, "message_definitions"):
        said = "SELECT topic_type, encoded_message_definition FROM message_definitions WHERE encoding = 'ros2msg'"
        definitions = {str(name): str(text) for name, text in database.execute(said)}
    for number, name, kind, encoding in database.execute("SELECT id, name, type, serialization_format FROM topics"):
        if isinstance(name, str):
            types[name] = str(kind), definitions.get(str(kind), "")
        if chosen is None and kind != MESSAGE_TYPE:
            continue
        if not isinstance(number, int) or not isinstance(name, str) or not name:
            raise Damage(f"names the topic {str(name)[:40]!r} and its number {str(number)[:40]!r}")
        if chosen is not None and name not in chosen:
            continue
        if encoding != "cdr":
            raise Damage(f"holds {name} encoded as {str(encoding)[:20]!r}, only cdr is read")
        found[number] = name
    return found
