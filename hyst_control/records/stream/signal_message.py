# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The signal message: a block of samples as std_msgs/msg/Float64MultiArray, packed and read as CDR bytes without ROS.

Layout (fixed): dim[0] = label "sample", size N, stride N C; dim[1] = label naming every column with its unit, such as
``t[s],x[um]``, size C, stride C; data_offset 0; data row-major. Column 0 is the sample time in s (tick index x period).
Many axes with numbered names are one entry of the label: ``t[s],a0..a4999[um]``.

A message object costs several microseconds to fill and to take; all but the sizes and the data is constant for a topic,
so the header is prepared once and the data is copied behind it. The byte layout is XCDR1 as every DDS vendor writes a
plain ROS 2 message: a 4-byte encapsulation header, then the fields, each aligned to its size counted from behind it.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError

MESSAGE_TYPE = "std_msgs/msg/Float64MultiArray"
ROW_LABEL = "sample"
TIME_COLUMN = "t[s]"

MANY_AXES = 16
"""Number of axes in a row with consecutively numbered names from which the label names only the first and the last."""
MAX_AXES = 100_000

_NUMBERED = re.compile(r"(.*?)(0|[1-9][0-9]{0,8})")
_RANGE = re.compile(r"(.*?)(0|[1-9][0-9]{0,8})\.\.(.*?)(0|[1-9][0-9]{0,8})")
_COLUMN = re.compile(r"([^\[\],]+)\[([^\[\],]*)\]")


def label_for(axes: Sequence[str], unit: str) -> str:
    """Column label of a signal: ``label_for(["x", "y"], "um")`` is ``t[s],x[um],y[um]``.

    From `MANY_AXES` on, axes in a row whose names are numbered consecutively become one entry, such as ``a0..a4999[um]``.

    Parameters
    ----------
    axes
        Names (A,) of the axes.
    unit
        Unit of every axis.

    Returns
    -------
    str
        Label with the time column first.
    """
    names: list[str] = []
    for run in _runs(axes):
        names += [f"{run[0]}..{run[-1]}"] if len(run) >= MANY_AXES else run
    return ",".join([TIME_COLUMN, *(f"{name}[{unit}]" for name in names)])


def parse_label(label: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Axes and their units from a column label, without the time column.

    Parameters
    ----------
    label
        Label such as ``t[s],x[um]`` or ``t[s],a0..a4999[um]``.

    Returns
    -------
    tuple[tuple[str, ...], tuple[str, ...]]
        Names (A,) and units (A,).

    Raises
    ------
    InputError
        The label has another form, names a column twice, or more than `MAX_AXES`.
    """
    columns = label.split(",")
    matches = [_COLUMN.fullmatch(column.strip()) for column in columns]
    if columns[0].strip() != TIME_COLUMN or len(columns) < 2 or None in matches:
        raise InputError(f"label: must be columns such as 't[s],x[um]', got {_shortened(label)}")
    axes: list[str] = []
    units: list[str] = []
    for match in matches[1:]:
        assert match is not None
        names = _names(match[1], MAX_AXES - len(axes))
        if names is None:
            raise InputError(f"label: names more than {MAX_AXES} columns, got {_shortened(label)}")
        axes += names
        units += [match[2]] * len(names)
    if len(set(axes)) != len(axes):
        raise InputError(f"label {_shortened(label)}: names a column twice")
    return tuple(axes), tuple(units)


def column_count(label: str) -> int:
    """Number of columns that a label names, time included; one an entry where it has another form than `parse_label` reads."""
    if ".." in label:
        try:
            return len(parse_label(label)[0]) + 1
        except InputError:
            pass
    return label.count(",") + 1


def _runs(axes: Sequence[str]) -> list[list[str]]:
    """Axes in parts with consecutively numbered names."""
    runs: list[list[str]] = []
    following = None
    for axis in axes:
        if runs and axis == following:
            runs[-1].append(axis)
        else:
            runs.append([axis])
        numbered = _NUMBERED.fullmatch(axis)
        following = None if numbered is None else f"{numbered[1]}{int(numbered[2]) + 1}"
    return runs


def _names(entry: str, most: int) -> list[str] | None:
    """Names that an entry of a label stands for; None where they are more than may be."""
    span = _RANGE.fullmatch(entry)
    if span is None or span[1] != span[3] or int(span[4]) < int(span[2]):
        return [entry] if most > 0 else None
    first, last = int(span[2]), int(span[4])
    return [f"{span[1]}{number}" for number in range(first, last + 1)] if last - first < most else None


def _shortened(label: str) -> str:
    return repr(label if len(label) <= 200 else label[:200] + "...")


class Encoder:
    """Packs blocks of one topic; the header for the block length used last is kept."""

    def __init__(self, label: str) -> None:
        """label: the column label, one column per value of a row, the time among them. Raises `InputError`."""
        parse_label(label)
        self.label = label
        self.columns = column_count(label)
        self._rows = -1
        self._header = b""

    def encode(self, block: Array) -> bytes:
        """The message of a block (N, C) float64. Raises `InputError` when the block has another number of columns."""
        rows = len(block)
        if rows != self._rows:
            self._header, self._rows = header(self.label, rows, self.columns), rows
        if block.shape[1] != self.columns:
            raise InputError(f"block of {block.shape[1]} columns: label {_shortened(self.label)} names {self.columns}")
        return self._header + block.tobytes()


class Decoder:
    """Reads messages of one topic; as long as the header is the one read last, only the data is looked at."""

    def __init__(self) -> None:
        self._header = b""
        self._length = -1
        self._label = ""
        self._shape = (0, 0)

    def decode(self, buffer: bytes) -> tuple[str, Array]:
        """Label and block (N, C), a view of the buffer. Raises `InputError` as `decode` does."""
        if len(buffer) == self._length and buffer.startswith(self._header):
            return self._label, np.frombuffer(buffer, np.float64, -1, len(self._header)).reshape(self._shape)
        label, block = decode(buffer)
        head = len(buffer) - block.nbytes
        if label and buffer[1] == 1:
            self._header, self._length = bytes(buffer[:head]), len(buffer)
            self._label, self._shape = label, (block.shape[0], block.shape[1])
        return label, block


def header(label: str, rows: int, columns: int) -> bytes:
    """Bytes before the data of a block: little-endian CDR with zero padding."""
    text = label.encode()
    parts = bytearray(b"\0\1\0\0" + struct.pack("<I", 2))  # little-endian CDR, two dimensions
    for name, size, stride in ((ROW_LABEL.encode(), rows, rows * columns), (text, columns, columns)):
        parts += struct.pack("<I", len(name) + 1) + name + b"\0"
        parts += bytes(-(len(parts) - 4) % 4) + struct.pack("<II", size, stride)
    parts += struct.pack("<II", 0, rows * columns)
    if rows * columns:
        parts += bytes(-(len(parts) - 4) % 8)
    return bytes(parts)


def decode(buffer: bytes | bytearray | memoryview) -> tuple[str, Array]:
    """Label and block of a serialized Float64MultiArray.

    A message without a layout gives the label "" and its data as one row (1, C).

    Parameters
    ----------
    buffer
        Serialized message, in either byte order.

    Returns
    -------
    tuple[str, Array]
        Label and block (N, C); the block is a view of the buffer where its byte order allows it.

    Raises
    ------
    InputError
        The bytes are no such message, or its layout is not the fixed one.
    """
    view = memoryview(buffer)
    if len(view) < 12 or view[0] != 0 or view[1] > 1:
        raise InputError(f"message of {len(view)} bytes: is not a serialized {MESSAGE_TYPE}")
    order = "<" if view[1] else ">"
    try:
        dimensions, position = _read_dimensions(view, order)
        offset, count = struct.unpack_from(order + "II", view, position)
    except (struct.error, UnicodeDecodeError):
        raise InputError(f"message of {len(view)} bytes: is not a serialized {MESSAGE_TYPE}") from None
    position += 8
    if count:
        position += -(position - 4) % 8
    if len(view) - position < 8 * count:
        raise InputError(f"message of {len(view)} bytes: cut short, {count} values are announced")
    if len(view) - position > 8 * count:
        raise InputError(f"message of {len(view)} bytes: {len(view) - position - 8 * count} bytes follow its {count} values")
    data = np.frombuffer(view, order + "f8", count, position)
    if order == ">":
        data = data.astype(np.float64)
    if not dimensions:
        return "", data.reshape(1, -1)
    if len(dimensions) != 2:
        raise InputError(f"layout: must have two dimensions, samples and columns, got {len(dimensions)}")
    (_, rows, stride), (label, columns, column_stride) = dimensions
    if rows * columns != count or stride != count or column_stride != columns or offset:
        raise InputError(
            f"layout ({rows} x {columns}, strides {stride} and {column_stride}, offset {offset}) does not fit its {count} values"
        )
    if not label:
        raise InputError("layout: label must be columns such as 't[s],x[um]', got none")
    if (named := column_count(label)) != columns:
        raise InputError(f"label {_shortened(label)}: names {named} columns, the layout has {columns}")
    return label, data.reshape(rows, columns)


def _read_dimensions(view: memoryview, order: str) -> tuple[list[tuple[str, int, int]], int]:
    """The layout's dimensions (label, size, stride) and the position behind them."""
    number = struct.unpack_from(order + "I", view, 4)[0]
    if number > 16:
        raise InputError(f"layout: must have two dimensions, samples and columns, got {number}")
    dimensions, position = [], 8
    for _ in range(number):
        position += -position % 4
        length = struct.unpack_from(order + "I", view, position)[0]
        position += 4
        if length > len(view) - position:
            raise InputError(f"message of {len(view)} bytes: cut short within its layout")
        label = bytes(view[position : position + length]).rstrip(b"\0").decode()
        position += length
        position += -position % 4
        size, stride = struct.unpack_from(order + "II", view, position)
        position += 8
        dimensions.append((label, size, stride))
    return dimensions, position
