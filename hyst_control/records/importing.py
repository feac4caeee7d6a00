"""Foreign recordings as records: text tables, NumPy arrays and MATLAB files, with columns, units and rate named by the caller."""

from __future__ import annotations

import codecs
import gzip
import os
import re
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO

import numpy as np

from hyst_control.errors import InputError
from hyst_control.foreign_readers import foreign_reader
from hyst_control.records.array_files import KINDS, read_arrays
from hyst_control.records.bag_writer import BagWriter
from hyst_control.records.decompression import Budget
from hyst_control.records.record import Array, Record, Signal, axis_names, check_times, commonest_step, increasing
from hyst_control.records.row_store import RowStore, blocks, empty_rows
from hyst_control.records.signal_message import Encoder, label_for

UNITS: dict[str, tuple[str, float]] = {
    "V": ("V", 1.0),
    "mV": ("V", 1e-3),
    "kV": ("V", 1e3),
    "um": ("um", 1.0),
    "µm": ("um", 1.0),
    "\u03bcm": ("um", 1.0),
    "nm": ("um", 1e-3),
    "mm": ("um", 1e3),
    "m": ("um", 1e6),
    "mrad": ("mrad", 1.0),
    "urad": ("mrad", 1e-3),
    "µrad": ("mrad", 1e-3),
    "\u03bcrad": ("mrad", 1e-3),
    "rad": ("mrad", 1e3),
}
"""Unit of the file: unit of the record, and the factor between them."""

TIME = "time"
"""Name that stands for the column of sample times, which is no topic."""

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "\u03bcs": 1e-6, "ns": 1e-9}
"""Unit of a column of times, in s."""

RATE_TOLERANCE = 0.01
"""Relative difference between a rate that is given and that of the column of times."""

BLOCK = 50

ENCODING_SAMPLE = 2**12
"""Bytes of a text from which its encoding is judged."""

PREAMBLE_LINES = 100
"""Lines among which the header is looked for, where an instrument writes its settings above it."""

_ASSIGNMENT = re.compile(r"(?P<topic>\w+)=(?P<columns>[^\[\]=]+)\[(?P<unit>[^\]]+)\]")
_SCALED_UNIT = re.compile(r"(?P<scale>[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)\s*\*?\s*(?P<unit>[^\d\s/*]+)(\s*/\s*\w+)?")

_MATRIX_COLUMN = re.compile(r"(?P<name>.+)\(:,(?P<number>\d{1,6})\)")
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")
_UNIT_CELL = re.compile(r"\([^()]*\)|\[[^\[\]]*\]")
_UNIT_BEHIND = re.compile(r"\s*(\([^()]*\)|\[[^\[\]]*\])\s*$")
_DECIMAL_COMMAS = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?(\s+[-+]?\d+,\d+([eE][-+]?\d+)?)+")


@dataclass(frozen=True)
class Column:
    """Columns of a topic, by number from 1 or by name, one per axis; one in the file is `scale` of the unit."""

    topic: str
    columns: tuple[str, ...]
    unit: str
    scale: float = 1.0


def parse_columns(text: str) -> list[Column]:
    """Parse the assignment of columns to topics, such as "command=1[V],measurement=5[um]".

    Parameters
    ----------
    text
        Assignments separated by commas; several axes are joined as in "measurement=5+6[m]". A number before the unit is what one in
        the file stands for: the volts of a sensor of 5 um/V are "measurement=5[5um/V]".

    Returns
    -------
    list[Column]
        Columns in the order of the text.

    Raises
    ------
    InputError
        The text is empty or of another form, a unit is not known, or a topic stands twice.
    """
    found: list[Column] = []
    rest = text.strip()
    while rest:
        match = _ASSIGNMENT.match(rest)
        if not match:
            raise InputError(
                f"columns: must be topic=column[unit], separated by commas (command=1[V],measurement=5[um]), got {rest!r}"
            )
        unit, scale = unit_and_scale(match["topic"], match["unit"])
        if match["topic"] in (column.topic for column in found):
            raise InputError(f"columns: {match['topic']} stands twice: join its axes with + (measurement=2+3[um])")
        found.append(Column(match["topic"], tuple(part.strip() for part in match["columns"].split("+")), unit, scale))
        rest = rest[match.end() :].lstrip(", ")
    if not found:
        raise InputError("columns: is empty: name command and measurement (command=1[V],measurement=5[um])")
    return found


def unit_and_scale(topic: str, text: str) -> tuple[str, float]:
    """Unit of a topic's column and the size of one in the file, of a text such as "mV" or "5um/V"; `InputError` where it is not known."""
    known = TIME_UNITS if topic == TIME else UNITS
    scaled = _SCALED_UNIT.fullmatch(text.strip())
    unit, scale = (scaled["unit"], float(scaled["scale"])) if scaled else (text.strip(), 1.0)
    if unit not in known:
        raise InputError(
            f"columns: {topic}: unit {text!r} is not known, must be one of {', '.join(known)}, with a number "
            "before it where one in the file stands for so much ([5um/V])"
        )
    if not (scale and np.isfinite(scale)):
        raise InputError(f"columns: {topic}: the number in {text!r} must be finite and not 0")
    return unit, scale


def import_table(
    path: str | Path,
    columns: Sequence[Column],
    rate: float | None,
    rows: tuple[int, int | None] = (0, None),
    hold: str = "zoh",
    variable: str | None = None,
) -> Record:
    """A record from a table file: CSV or white space (.gz too), .npy, .npz or .mat.

    Parameters
    ----------
    path
        The file. A text table may have a header, settings of an instrument above it, a line of units in brackets below it, a byte-order
        mark, and decimal commas where its columns are not separated by commas.
    columns
        By number from 1 (from 0 where a column 0 is named), by the header's name, or by the name of an array of an .npz or .mat file: a
        vector, a matrix (its columns are the axes, its rows the samples), or one column of a matrix as ``name(:,2)``. The topic
        `time` is the column of sample times.
    rate
        Hz; None: from the column of times.
    rows
        First and one past the last.
    hold
        "zoh" or "foh", the command between samples.
    variable
        Array of an .npz or .mat file that columns are numbered in, where there are several.

    Raises
    ------
    InputError
        Naming file and remedy.
    """
    path = Path(path)
    if rate is not None and (not np.isfinite(rate) or rate <= 0):
        raise InputError(f"rate: {rate!r} Hz, a positive rate is due")
    signal_columns = [column for column in columns if column.topic != TIME]
    times = [column for column in columns if column.topic == TIME]
    if rate is None and not times:
        raise InputError("rate: is missing: give it in Hz, or name the column of sample times (time=1[s])")
    if not signal_columns:
        raise InputError("columns: name command and measurement (command=1[V],measurement=5[um])")
    table, names = _read(path, variable, columns)
    begin, end = rows[0], len(table) if rows[1] is None else rows[1]
    if not 0 <= begin < end <= len(table):
        raise InputError(f"{path}: rows must be a range within 0:{len(table)}, got {begin}:{end}")
    first = 0 if any(name == "0" and name not in names for column in columns for name in column.columns) else 1
    notes = [f"{path}: columns are numbered from 0, since a column 0 is named"] if not first else []

    def picked(column: Column, factor: float) -> Array:
        wanted = [index for name in column.columns for index in column_indices(path, name, names, table.shape[1], first)]
        scaled = empty_rows(end - begin, len(wanted))
        bad, first_bad, finite = 0, 0, True
        for part in blocks(end - begin):
            found = table[begin + part.start : begin + part.stop][:, wanted]
            with np.errstate(over="ignore", invalid="ignore"):  # a signalling NaN, too, is found below
                scaled[part] = found * factor
            wrong = ~np.isfinite(scaled[part]).all(axis=1)
            if wrong.any():
                first_bad = first_bad if bad else begin + part.start + int(np.argmax(wrong))
                bad, finite = bad + int(wrong.sum()), finite and bool(np.isfinite(found).all())
        if bad and finite:
            raise InputError(
                f"{path}: {column.topic}: row {first_bad} is too large for a number once it is in other units: check the unit"
            )
        if bad:
            which = f"row {first_bad} holds" if bad == 1 else f"row {first_bad} and {bad - 1} more hold"
            raise InputError(f"{path}: {column.topic}: {which} no finite number: choose other rows or repair the file")
        return scaled

    time = _times(path, times[0], picked(times[0], times[0].scale * TIME_UNITS[times[0].unit]), rate, begin) if times else None
    if time is not None:
        notes += _missing(path, time)
    stamps = empty_rows(end - begin) if time is None else time
    if time is None and rate is not None:
        for part in blocks(end - begin):
            stamps[part] = np.arange(part.start, part.stop) / rate
    signals = {}
    for column in signal_columns:
        unit, factor = UNITS[column.unit]
        values = picked(column, column.scale * factor)
        if column.topic == "measurement" and unit == "V":
            notes.append(f"{path}: measurement is in V: with a sensor of 5 um/V, say, write [5um/V] in place of [{column.unit}]")
        check_times(f"{path}: {column.topic}", stamps)
        signals[column.topic] = Signal(stamps, values, axis_names(values.shape[1]), unit)
    return Record(signals, str(path), tuple(notes), hold)


def _times(path: Path, column: Column, found: Array, rate: float | None, begin: int) -> Array:
    """Sample times (N,) in s, counted from the first, of a column of times (N, 1)."""
    if found.shape[1] != 1:
        raise InputError(f"columns: time: {found.shape[1]} columns, one is due")
    time = found[:, 0]
    time -= float(time[0])
    if not increasing(time):
        back = np.flatnonzero(np.diff(time) <= 0)
        raise InputError(
            f"{path}: time: does not increase in row {begin + int(back[0]) + 1}: choose rows in which it does, or leave the time out and "
            "give the rate"
        )
    if rate is not None and len(time) > 1:
        own = 1.0 / commonest_step(time)
        if abs(own - rate) > RATE_TOLERANCE * rate:
            raise InputError(
                f"{path}: time: has {own:.6g} samples/s, --rate says {rate:g}: leave one of them out, or check the unit"
            )
    return np.ascontiguousarray(time)


def _missing(path: Path, time: Array) -> list[str]:
    """Note on rows that a column of times (N,) passes over."""
    if len(time) < 3:
        return []
    step, rows, gaps, first = commonest_step(time), 0, 0, 0.0
    for part in blocks(len(time) - 1):
        skipped = np.rint(np.diff(time[part.start : part.stop + 1]) / step) - 1.0
        if (skipped > 0.0).any():
            first = first if gaps else float(time[part.start + int(np.argmax(skipped > 0.0))])
            rows, gaps = rows + int(skipped[skipped > 0.0].sum()), gaps + int(np.count_nonzero(skipped > 0.0))
    if not gaps:
        return []
    where = f"after {first:.6g} s" if gaps == 1 else f"in {gaps} gaps, the first after {first:.6g} s"
    missing = "1 row is missing" if rows == 1 else f"{rows} rows are missing"
    return [f"{path}: time: {missing}, {where}: what needs equal steps uses the stretches between"]


def write_bag(path: str | Path, record: Record) -> None:
    """Write a record as a finished MCAP bag: under a temporary name, then renamed. Raises `InputError` when the path exists."""
    path = Path(path)
    if os.path.lexists(path):
        raise InputError(f"{path}: exists already: choose another name or remove it")
    if not record.signals:
        raise InputError(f"{path}: there is nothing to write: {record.source} has no signals")
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}-") as temporary:
        part = Path(temporary) / path.name
        with BagWriter(part, {"hold": record.hold} if record.hold != "zoh" else None) as writer:
            _write_signals(writer, record)
        part.rename(path)


def _write_signals(writer: BagWriter, record: Record) -> None:
    encoders = {topic: Encoder(label_for(signal.axes, signal.unit)) for topic, signal in record.signals.items()}
    for topic in encoders:
        writer.add_topic(f"/{topic}")
    longest = max(len(signal.time) for signal in record.signals.values())
    for begin in range(0, longest, BLOCK):
        for topic, signal in record.signals.items():
            part = slice(begin, begin + BLOCK)
            block = np.column_stack([signal.time[part], signal.values[part]])
            if len(block):
                writer.write(
                    f"/{topic}", encoders[topic].encode(np.ascontiguousarray(block)), max(int(round(block[-1, 0] * 1e9)), 0)
                )


def _read(path: Path, variable: str | None, columns: Sequence[Column]) -> tuple[Array, list[str]]:
    """Table (N, C) and the names of its columns, where they have some."""
    if not path.is_file():
        raise InputError(f"{path}: does not exist: give the path of a file")
    suffixes = [suffix.lower() for suffix in path.suffixes]
    kind = suffixes[-2] if suffixes[-1:] == [".gz"] and len(suffixes) > 1 else (suffixes[-1] if suffixes else "")
    if kind in KINDS:
        return _columns_of_arrays(path, kind, variable, columns)
    return _read_text(path)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines of a text with their numbers, without those that are empty or comments."""
    budget = Budget(path.stat().st_size)
    with open(path, "rb") as plain:
        file: IO[bytes] = gzip.open(plain) if path.suffix.lower() == ".gz" else plain  # type: ignore[assignment]
        encoding = _encoding(file.read(ENCODING_SAMPLE))
        file.seek(0)
        for number, line in enumerate(codecs.getreader(encoding)(file), start=1):
            budget.take(len(line))
            line = line.strip()
            if line and not line.startswith(("#", "%")):
                yield number, line


def _encoding(start: bytes) -> str:
    """Encoding of a text that begins with these bytes: Unicode, else the one in which western instruments write their µ."""
    if start[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return "utf-16"
    try:
        codecs.getincrementaldecoder("utf-8-sig")().decode(start)
    except UnicodeDecodeError:
        return "utf-8-sig" if _CONTROL.search(start) else "cp1252"
    return "utf-8-sig"


TEXT_ROWS = 2**14
"""Lines of a text that are held at a time."""


def _read_text(path: Path) -> tuple[Array, list[str]]:
    """Table and names of a text, which is read twice: for its form, and for its numbers."""
    first: list[str] = []
    count, commas = 0, False
    with foreign_reader(path, "text", "give a CSV or white-space table, .npy, .npz or .mat"):
        for _, line in _lines(path):
            count += 1
            if len(first) < PREAMBLE_LINES:
                first.append(line)
            if count > 1 and not commas:
                commas = "," in line
    if not count:
        raise InputError(f"{path}: holds no rows")
    header, above = _header(first, commas)
    separator, comma = _form(first[header : header + 1] + first[above : above + 1], commas)
    head = _cells(first[header], separator)
    names: list[str] = []
    if any(not _numeric(cell.replace(",", ".") if comma else cell) for cell in head):
        names = [name if name not in head[:index] else "" for index, name in enumerate(head)]
        if count == 1:
            raise InputError(f"{path}: holds no rows below its first line ({head[0][:40]!r}, … are taken as names): repair it")
    width = len(head)
    store, lines = RowStore(width), _lines(path)
    for _ in range(above if names else 0):
        next(lines)
    while piece := list(islice(lines, TEXT_ROWS)):
        table = np.empty((len(piece), width))
        for row, (number, line) in enumerate(piece):
            cells = (line.replace(",", ".") if comma else line).split(separator)
            if len(cells) != width:
                raise InputError(f"{path}: line {number} has {len(cells)} columns, the first has {width}: repair the line")
            try:
                table[row] = [float(cell) if cell.strip() else np.nan for cell in cells]
            except ValueError:
                wrong = next(index for index, cell in enumerate(cells) if not _numeric(cell))
                raise InputError(
                    f"{path}: line {number}, column {wrong + 1}: {line.split(separator)[wrong].strip()!r} is no number: repair the "
                    "line"
                ) from None
        store.append(table)
    return store.array(), names


def _cells(line: str, separator: str | None) -> list[str]:
    return [cell.strip().strip('"').strip() for cell in line.split(separator)]


def _header(first: Sequence[str], commas: bool) -> tuple[int, int]:
    """Index of the header among the first lines, and that of the first row of numbers.

    An instrument may write its settings above the names, in lines of words, and units in brackets below them. What stands between a
    header and the numbers otherwise is left to the reader of the rows, which refuses it.
    """
    for number in range(2, len(first)):
        above = number - 1
        separator, comma = _form(first[above : number + 1], commas)
        row, words = (_cells(line, separator) for line in (first[number], first[above]))
        following = [_cells(line, separator) for line in first[number + 1 : number + 2]]
        if not all(len(cells) == len(row) and _numbers(cells, comma) for cells in (row, *following)):
            continue
        earlier = [_cells(line, separator) for line in first[:above]]
        if (
            len(words) != len(row)
            or not _wordy(words, comma)
            or any(len(cells) == len(row) and _numbers(cells, comma) for cells in earlier)
        ):
            break
        units = all(not cell or _UNIT_CELL.fullmatch(cell) for cell in words)
        if units and len(earlier[-1]) == len(row) and _wordy(earlier[-1], comma):
            above -= 1
        return above, number
    return 0, 1


def _numbers(cells: Sequence[str], comma: bool) -> bool:
    return all(_numeric(cell.replace(",", ".") if comma else cell) for cell in cells)


def _wordy(cells: Sequence[str], comma: bool) -> bool:
    """True where cells are names or units: there are some, and none is a number."""
    return any(cells) and not any(cell and _numeric(cell.replace(",", ".") if comma else cell) for cell in cells)


def _form(first: Sequence[str], commas: bool) -> tuple[str | None, bool]:
    """Separator of the columns (None: white space), and a flag for decimal commas.

    first: the first two lines, a header and numbers; commas: whether there is one behind the first line.
    """
    for mark in (";", "\t"):
        if all(mark in line for line in first):
            return mark, commas if len(first) > 1 else "," in first[0]
    if _DECIMAL_COMMAS.fullmatch(first[-1]):
        return None, True
    if not any(mark in first[0] for mark in ",;\t"):
        return None, commas
    return ("," if "," in first[0] else ";" if ";" in first[0] else "\t" if "\t" in first[0] else None), False


def _columns_of_arrays(path: Path, kind: str, variable: str | None, columns: Sequence[Column]) -> tuple[Array, list[str]]:
    """Columns of the arrays that are named, or of the one that columns are numbered in."""
    numeric = read_arrays(path, kind)
    wanted = [name for column in columns for name in column.columns]
    named = {name: _array_of(name, numeric) for name in wanted}
    if variable is None and all(name is not None for name in named.values()):
        tables = {name: _named(numeric[array]) for name, array in named.items() if array is not None}
        for name in tables:
            if match := _MATRIX_COLUMN.fullmatch(name):
                number = int(match["number"])
                if not 1 <= number <= tables[name].shape[1]:
                    raise InputError(f"{path}: {name}: {match['name']} has {tables[name].shape[1]} columns: number them from 1")
                tables[name] = tables[name][:, number - 1 : number]
        if len({len(table) for table in tables.values()}) > 1:
            sizes = ", ".join(f"{name} {len(table)} x {table.shape[1]}" for name, table in tables.items())
            raise InputError(
                f"{path}: the arrays differ in length ({sizes}): rows are samples and columns axes; transpose what is not so"
            )
        names = [name for name, table in tables.items() for _ in range(table.shape[1])]
        return np.concatenate(list(tables.values()), axis=1), names
    if variable is None and len(numeric) == 1:
        variable = next(iter(numeric))
    missing = [name for name, array in named.items() if array is None and not name.isdigit()]
    if variable is None and missing and numeric:
        raise InputError(f"{path}: has no array {', '.join(missing)}: name one of {', '.join(numeric)}")
    if variable not in numeric:
        raise InputError(f"{path}: name one of its arrays as the variable: {', '.join(numeric) or 'it holds none of numbers'}")
    return _table(numeric[variable]), []


def _array_of(name: str, arrays: dict[str, Array]) -> str | None:
    """The array that a column's name stands for; None where there is none."""
    if name in arrays:
        return name
    match = _MATRIX_COLUMN.fullmatch(name)
    return match["name"] if match and match["name"] in arrays else None


def _table(array: Array) -> Array:
    """Rows by columns: samples come first; further dimensions (channels, realizations, periods) become columns in their order."""
    if array.ndim < 2:
        return array.reshape(-1, 1)
    return array.reshape(len(array), -1) if array.size else np.empty((len(array), 0))


def _named(array: Array) -> Array:
    """The same for an array that a column names: a row vector is a column then."""
    return array.reshape(-1, 1) if array.ndim == 2 and len(array) == 1 else _table(array)


def column_indices(path: str | Path, name: str, names: Sequence[str], width: int, first: int = 1) -> list[int]:
    """Numbers from 0 of the columns of this name, with its unit or without, or of this number; a matrix has several."""
    if name in names:
        return [index for index, other in enumerate(names) if other == name]
    bare = [_UNIT_BEHIND.sub("", other) for other in names]
    if bare.count(_UNIT_BEHIND.sub("", name)) == 1:
        return [bare.index(_UNIT_BEHIND.sub("", name))]
    if name.isdecimal():
        if not first <= int(name) < first + width:
            raise InputError(f"{path}: column {name} of {width}: number them from {first} to {width - 1 + first}")
        return [int(name) - first]
    raise InputError(f"{path}: has no column {name!r}: {', '.join(names) if names else f'number them from 1 to {width}'}")


def _numeric(cell: str) -> bool:
    try:
        float(cell) if cell.strip() else None
    except ValueError:
        return False
    return True
