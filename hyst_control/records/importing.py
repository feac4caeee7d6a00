"""Foreign recordings as records: text tables, NumPy arrays and MATLAB files, with columns, units and rate named by the caller."""

from __future__ import annotations

import gzip
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.chain.stage import Array
from hyst_control.errors import InputError
from hyst_control.records.bag_writer import BagWriter
from hyst_control.records.record import Record, Signal, axis_names
from hyst_control.records.signal_message import Encoder, label_for

UNITS: dict[str, tuple[str, float]] = {
    "V": ("V", 1.0),
    "mV": ("V", 1e-3),
    "kV": ("V", 1e3),
    "um": ("um", 1.0),
    "µm": ("um", 1.0),
    "nm": ("um", 1e-3),
    "mm": ("um", 1e3),
    "m": ("um", 1e6),
    "mrad": ("mrad", 1.0),
    "urad": ("mrad", 1e-3),
    "µrad": ("mrad", 1e-3),
    "rad": ("mrad", 1e3),
}
"""Unit of the file: unit of the record, and the factor between them."""

BLOCK = 50

_ASSIGNMENT = re.compile(r"(?P<topic>\w+)=(?P<columns>[^\[\]=]+)\[(?P<unit>[^\]]+)\]")


@dataclass(frozen=True)
class Column:
    """Columns of a topic, by number from 1 or by name, one per axis, and their unit in the file."""

    topic: str
    columns: tuple[str, ...]
    unit: str


def parse_columns(text: str) -> list[Column]:
    """Columns from "command=1[V],measurement=5[um]"; several axes as "measurement=5+6[m]". Raises `InputError`."""
    found, rest = [], text.strip()
    while rest:
        match = _ASSIGNMENT.match(rest)
        if not match:
            raise InputError(f"columns: {rest!r}: topic=column[unit], separated by commas, is due (command=1[V],measurement=5[um])")
        if match["unit"] not in UNITS:
            raise InputError(f"columns: unit {match['unit']!r} is not known, one of {', '.join(UNITS)} is due")
        found.append(Column(match["topic"], tuple(part.strip() for part in match["columns"].split("+")), match["unit"]))
        rest = rest[match.end() :].lstrip(", ")
    if not found:
        raise InputError("columns: is empty: name command and measurement (command=1[V],measurement=5[um])")
    return found


def import_table(
    path: str | Path,
    columns: Sequence[Column],
    rate: float,
    rows: tuple[int, int | None] = (0, None),
    hold: str = "zoh",
    variable: str | None = None,
) -> Record:
    """A record from a table file: CSV or white space (.gz too), .npy, .npz or .mat.

    rate Hz; rows: first and one past the last; variable: which array of an .npz or .mat file, where there are several. Columns
    of an .npz or .mat file may also be the names of its own one-dimensional arrays. Raises `InputError` naming file and remedy.
    """
    path = Path(path)
    if not np.isfinite(rate) or rate <= 0:
        raise InputError(f"rate: {rate!r} Hz, a positive rate is due")
    table, names = _read(path, variable, columns)
    begin, end = rows[0], len(table) if rows[1] is None else rows[1]
    if not 0 <= begin < end <= len(table):
        raise InputError(f"{path}: rows {begin}:{end} of {len(table)}: a range within the file is due")
    signals = {}
    for column in columns:
        picked = np.stack([table[begin:end, _index(path, name, names, table.shape[1])] for name in column.columns], axis=1)
        bad = ~np.isfinite(picked).all(axis=1)
        if bad.any():
            raise InputError(
                f"{path}: {column.topic}: row {begin + int(np.argmax(bad))} and {int(bad.sum()) - 1} more hold no finite "
                "number: choose rows without them or repair the file"
            )
        unit, factor = UNITS[column.unit]
        time = np.arange(len(picked)) / rate
        signals[column.topic] = Signal(time, np.ascontiguousarray(picked * factor), axis_names(picked.shape[1]), unit)
    return Record(signals, str(path), (), hold)


def write_bag(path: str | Path, record: Record) -> None:
    """Write a record as a finished MCAP bag: under a temporary name, then renamed. Raises `InputError` when the path exists."""
    path = Path(path)
    if path.exists():
        raise InputError(f"{path}: exists already: choose another name or remove it")
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
                writer.write(f"/{topic}", encoders[topic].encode(np.ascontiguousarray(block)), int(round(block[-1, 0] * 1e9)))


def _read(path: Path, variable: str | None, columns: Sequence[Column]) -> tuple[Array, list[str]]:
    if not path.is_file():
        raise InputError(f"{path}: does not exist: give the path of a file")
    suffixes = [suffix.lower() for suffix in path.suffixes]
    kind = suffixes[-2] if suffixes[-1:] == [".gz"] and len(suffixes) > 1 else (suffixes[-1] if suffixes else "")
    if kind in (".npy", ".npz", ".mat"):
        return _read_arrays(path, kind, variable, columns)
    return _read_text(path)


def _read_text(path: Path) -> tuple[Array, list[str]]:
    try:
        with gzip.open(path, "rt", encoding="utf-8") if path.suffix == ".gz" else open(path, encoding="utf-8") as file:
            lines = [(number, line.strip()) for number, line in enumerate(file, start=1)]
    except (OSError, UnicodeDecodeError, EOFError) as error:
        raise InputError(f"{path}: cannot be read as text ({error}): give a CSV or white-space table, .npy, .npz or .mat") from None
    lines = [(number, line) for number, line in lines if line and not line.startswith(("#", "%"))]
    if not lines:
        raise InputError(f"{path}: holds no rows")
    separator = next((mark for mark in (",", ";", "\t") if mark in lines[0][1]), None)
    head = [cell.strip().strip('"') for cell in lines[0][1].split(separator)]
    names: list[str] = []
    if any(not _numeric(cell) for cell in head):
        names, lines = head, lines[1:]
    width = len(head)
    table = np.empty((len(lines), width))
    for row, (number, line) in enumerate(lines):
        cells = line.split(separator)
        if len(cells) != width:
            raise InputError(f"{path}: line {number} has {len(cells)} columns, the first has {width}: repair the line")
        try:
            table[row] = [float(cell) if cell.strip() else np.nan for cell in cells]
        except ValueError:
            wrong = next(index for index, cell in enumerate(cells) if not _numeric(cell))
            raise InputError(
                f"{path}: line {number}, column {wrong + 1}: {cells[wrong].strip()!r} is no number: repair the line"
            ) from None
    return table, names


def _read_arrays(path: Path, kind: str, variable: str | None, columns: Sequence[Column]) -> tuple[Array, list[str]]:
    try:
        if kind == ".npy":
            arrays: Mapping[str, Any] = {"": np.load(path, allow_pickle=False)}
        elif kind == ".npz":
            with np.load(path, allow_pickle=False) as archive:
                arrays = {name: archive[name] for name in archive.files}
        else:
            from scipy.io import loadmat

            arrays = {name: value for name, value in loadmat(path, squeeze_me=True).items() if not name.startswith("__")}
    except NotImplementedError:
        raise InputError(f"{path}: is a MATLAB 7.3 file: save it with -v7, or as .npz or CSV") from None
    except (OSError, ValueError, TypeError, EOFError, KeyError) as error:
        raise InputError(f"{path}: cannot be read as {kind} ({error})") from None
    numeric = {
        name: np.asarray(value, dtype=float)
        for name, value in arrays.items()
        if isinstance(value, np.ndarray) and np.issubdtype(value.dtype, np.number) and not np.iscomplexobj(value)
    }
    wanted = [name for column in columns for name in column.columns]
    if variable is None and all(name in numeric for name in wanted):
        vectors = {name: np.ravel(numeric[name]) for name in wanted}
        if len({len(vector) for vector in vectors.values()}) > 1:
            sizes = ", ".join(f"{name} {len(vector)}" for name, vector in vectors.items())
            raise InputError(f"{path}: the arrays differ in length ({sizes})")
        return np.stack(list(vectors.values()), axis=1), list(vectors)
    if variable is None and len(numeric) == 1:
        variable = next(iter(numeric))
    if variable not in numeric:
        raise InputError(f"{path}: name one of its arrays as the variable: {', '.join(numeric) or 'it holds none of numbers'}")
    table = numeric[variable]
    table = table[:, None] if table.ndim == 1 else table
    # Samples come first; further dimensions (channels, realisations, periods) become columns in their order.
    return np.ascontiguousarray(table.reshape(len(table), -1)), []


def _index(path: Path, name: str, names: Sequence[str], width: int) -> int:
    if name in names:
        return list(names).index(name)
    if name.isdigit():
        if not 1 <= int(name) <= width:
            raise InputError(f"{path}: column {name} of {width}: number them from 1 to {width}")
        return int(name) - 1
    raise InputError(f"{path}: has no column {name!r}: {', '.join(names) if names else f'number them from 1 to {width}'}")


def _numeric(cell: str) -> bool:
    try:
        float(cell) if cell.strip() else None
    except ValueError:
        return False
    return True
