# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Decompression that is bounded by what a file can hold.

A few kilobytes of zstd stand for gigabytes where the writer wants them to. Recorded signals do not compress that far: every message has a
time of its own. So what comes out of a file is bounded by a multiple of its size.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from io import BytesIO, RawIOBase
from typing import TYPE_CHECKING, BinaryIO

if TYPE_CHECKING:
    import zstandard

MAX_RATIO = 200
"""Bytes that may come out of a byte of the file; messages of zeros alone, one sample each, reach about 40."""

ALWAYS = 64 * 2**20  # Bytes that may come out of any file


class Damage(Exception):
    """A file that cannot hold what it says, in a few words."""


class Budget:
    """Bytes that may still come out of a file."""

    def __init__(self, size: int) -> None:
        """size: of the file, in bytes."""
        self.left = max(ALWAYS, MAX_RATIO * size)

    def take(self, count: int) -> None:
        """Count further decompressed bytes, `count` of them. Raises `Damage` when the total is too large for the file."""
        self.left -= count
        if self.left < 0:
            raise Damage(f"expands to more than {MAX_RATIO} times its size")


def decompress(data: bytes, compression: str, size: int | None, budget: Budget) -> bytes:
    """Content of a compressed block."""
    if not compression:
        found = data
    else:
        most = budget.left if size is None else size
        if size is not None:
            budget.take(size)  # before anything is made
        if compression not in READERS:
            raise Damage(f"is compressed with {compression[:20]!r}, only zstd and lz4 are read")
        try:
            found = READERS[compression](data, most)
        except ModuleNotFoundError as error:  # rosdep has no key for either
            raise Damage(f"is compressed with {compression}, and the package {error.name} is not installed") from None
        if size is None:
            budget.take(len(found))
    if size is not None and len(found) != size:
        raise Damage(f"holds a block of {len(found)} bytes where {size} are announced")
    return found


@cache
def _decompressor() -> zstandard.ZstdDecompressor:
    import zstandard

    return zstandard.ZstdDecompressor()


def _zstd(data: bytes, most: int) -> bytes:
    import zstandard

    announced = zstandard.frame_content_size(data)
    if announced > most:
        raise Damage("holds a block that expands to more than is announced")
    if announced > 0:  # the decompressor makes room for that much and no more
        return _decompressor().decompress(data)
    with zstandard.ZstdDecompressor().stream_reader(BytesIO(data)) as stream:
        found = bytes(stream.read(most + 1))
        if len(found) > most:
            raise Damage("holds a block that expands to more than is announced")
    return found


def _lz4(data: bytes, most: int) -> bytes:
    import lz4.frame  # type: ignore[import-untyped]

    reader = lz4.frame.LZ4FrameDecompressor()
    found = bytes(reader.decompress(data, most + 1))
    if len(found) > most or not reader.eof:
        raise Damage("holds a block that expands to more than is announced, or is cut off")
    return found


READERS: dict[str, Callable[[bytes, int], bytes]] = {"zstd": _zstd, "lz4": _lz4}


class Expanded(RawIOBase):
    """The content of a zstd file as a stream that can only be read on."""

    def __init__(self, file: BinaryIO, budget: Budget) -> None:
        import zstandard

        self._stream = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        self._budget = budget

    def readable(self) -> bool:
        """True."""
        return True

    def readinto(self, buffer: bytearray | memoryview) -> int:  # type: ignore[override]
        """Read up to the buffer's length. Raises `Damage` where the file expands beyond its budget."""
        found = self._stream.read(len(buffer))
        self._budget.take(len(found))
        buffer[: len(found)] = found
        return len(found)
