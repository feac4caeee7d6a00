# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of an MCAP file as they stand in it, from the first to the last whole chunk: finished or cut off.

Nothing but the records that carry messages is read (https://mcap.dev/spec); the index at the end is not needed for reading everything.
Every length is checked against what is there before it is used.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

from hyst_control.records.bags.decompression import Budget, Damage, decompress
from hyst_control.records.stream.signal_message import MESSAGE_TYPE

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, STATISTICS = 0x02, 0x03, 0x04, 0x05, 0x06, 0x0B

PIECE = 2**20  # Bytes read at a time of a record whose length cannot be checked beforehand

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")


class CutOff(Exception):
    """A file that ends before its footer."""


@dataclass
class McapStream:
    """One file being read."""

    stream: BinaryIO  # Its bytes
    size: int | None  # How many they are; None where only reading tells it
    budget: Budget  # Of what is decompressed
    chosen: Collection[str] | None = None  # Topics to read, whatever their type; None: those of signal messages
    topics: dict[int, str] = field(default_factory=dict)  # The topics that are read, by channel
    types: dict[str, tuple[str, str]] = field(default_factory=dict)
    """Type and definition of every topic of the file that has been met."""
    announced: int | None = None  # Messages that the file says it holds, of all channels
    found: int = 0  # Messages met so far, of all channels
    _schemas: dict[int, tuple[str, str]] = field(default_factory=dict)

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        """(topic, log time in ns, CDR bytes) of every message of these topics. Raises `Damage` or `CutOff` behind the last readable one."""
        if self._exactly(len(MAGIC)) != MAGIC:
            raise Damage("does not begin as an MCAP file does")
        while True:
            kind, length = _RECORD.unpack(self._exactly(_RECORD.size))
            if kind == CHUNK:
                yield from self._records(self._chunk(self._exactly(length)))
            elif kind in (SCHEMA, CHANNEL, MESSAGE):
                yield from self._records(_RECORD.pack(kind, length) + self._exactly(length))
            elif kind == FOOTER:
                self._exactly(length)
                if self._exactly(len(MAGIC)) != MAGIC:
                    raise Damage("does not end as an MCAP file does")
                return
            elif kind == STATISTICS:
                record = self._exactly(length)
                if len(record) < 8:
                    raise Damage("holds statistics cut short")
                self.announced = int.from_bytes(record[:8], "little")
            else:
                self._skip(length)

    def _chunk(self, record: bytes) -> bytes:
        """The records within a chunk."""
        if len(record) < _CHUNK.size + 4:
            raise Damage("holds a chunk cut short")
        _, _, size, checksum = _CHUNK.unpack_from(record)
        compression, position = _text(record, _CHUNK.size)
        if len(record) < position + 8 or len(record) - position - 8 != int.from_bytes(record[position : position + 8], "little"):
            raise Damage("holds a chunk of another length than it says")
        data = record[position + 8 :]
        found = decompress(data, compression, size, self.budget)
        if checksum and zlib.crc32(found) != checksum:
            raise Damage("holds a chunk whose checksum is wrong")
        return found

    def _records(self, data: bytes) -> Iterator[tuple[str, int, bytes]]:
        topics, position, end = self.topics, 0, len(data)
        while position < end:
            if end - position < _RECORD.size:
                raise Damage("holds a record cut short")
            kind, length = _RECORD.unpack_from(data, position)
            begin = position + _RECORD.size
            position = begin + length
            if position > end:
                raise Damage("holds a record that is longer than its chunk")
            if kind == MESSAGE:
                if length < _MESSAGE.size:
                    raise Damage("holds a message cut short")
                channel, _, time, _ = _MESSAGE.unpack_from(data, begin)
                self.found += 1
                topic = topics.get(channel)
                if topic is not None:
                    yield topic, time, data[begin + _MESSAGE.size : position]
            elif kind == SCHEMA:
                self._schema(data[begin:position])
            elif kind == CHANNEL:
                self._channel(data[begin:position])

    def _schema(self, record: bytes) -> None:
        if len(record) < 2:
            raise Damage("holds a schema cut short")
        name, position = _text(record, 2)
        encoding, position = _text(record, position)
        definition = record[position + 4 :].decode(errors="replace") if encoding == "ros2msg" else ""
        self._schemas[int.from_bytes(record[:2], "little")] = name, definition

    def _channel(self, record: bytes) -> None:
        if len(record) < 4:
            raise Damage("holds a channel cut short")
        number, schema = struct.unpack_from("<HH", record)
        topic, position = _text(record, 4)
        encoding, _ = _text(record, position)
        self.types[topic] = self._schemas.get(schema, ("", ""))
        if topic in self.chosen if self.chosen is not None else self.types[topic][0] == MESSAGE_TYPE:
            if encoding != "cdr":
                raise Damage(f"holds {topic} encoded as {encoding[:20]!r}, only cdr is read")
            if self.topics.setdefault(number, topic) != topic:
                raise Damage(f"gives the channel of {self.topics[number]} to {topic}")

    def _exactly(self, count: int) -> bytes:
        """The next `count` bytes. Raises `CutOff` where fewer are left, before any memory is taken for them."""
        if self.size is not None:
            if count > self.size - self.stream.tell():
                raise CutOff
            return self.stream.read(count)
        pieces = []
        while count:
            piece = self.stream.read(min(count, PIECE))
            if not piece:
                raise CutOff
            pieces.append(piece)
            count -= len(piece)
        return b"".join(pieces)

    def _skip(self, count: int) -> None:
        if self.size is None:
            while count:
                count -= len(self._exactly(min(count, PIECE)))
            return
        position = self.stream.tell()
        if count > self.size - position:
            raise CutOff
        self.stream.seek(position + count)


def _text(record: bytes, position: int) -> tuple[str, int]:
    """A text with its length before it, and the position behind it."""
    begin = position + 4
    end = begin + int.from_bytes(record[position:begin], "little")
    if end > len(record):
        raise Damage("holds a text cut short")
    try:
        return record[begin:end].decode(), end
    except UnicodeDecodeError:
        raise Damage("holds a text that is none") from None
