# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Foreign recordings as records: columns, units and rate named by the caller, sample times on the ticks of one clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array, Integers, Mask
from hyst_control.base.errors import InputError
from hyst_control.base.files import appearing
from hyst_control.records.bags.rosbag2_writer import open_bag
from hyst_control.records.record import TOPICS, Record, Signal, axis_names, check_times
from hyst_control.records.stream.row_store import blocks, empty_rows
from hyst_control.records.stream.signal_message import Encoder, label_for
from hyst_control.records.tables.array_files import KINDS as ARRAYS
from hyst_control.records.tables.columns import TIME, Column, parse_columns
from hyst_control.records.tables.containers import CONTAINERS
from hyst_control.records.tables.frequency_response import response_record
from hyst_control.records.tables.listing import listed_columns, named_columns
from hyst_control.records.tables.regular_signals import on_one_clock, runs_of, without_repeated
from hyst_control.records.tables.sample_grid import DAY, LONGEST_FILLED, gap_remedies, midnights
from hyst_control.records.tables.selection import SHEETS, read_columns

__all__ = [
    "described_columns",
    "import_records",
    "import_table",
    "is_table",
    "parse_columns",
    "read_table",
    "write_bag",
    "write_bags",
]

TEXTS = (".csv", ".txt", ".tsv", ".dat", ".asc")
RATE_TOLERANCE = 0.01  # Relative difference between a rate that is given and that of the column of times

BLOCK = 50


def import_table(path: str | Path, columns: Sequence[Column], *how: Any, **named: Any) -> Record:
    """The record of a file that holds one run, read as by `import_records`."""
    found = import_records(path, columns, *how, **named)
    if len(found) > 1:
        raise InputError(f"{path}: holds {len(found)} runs: choose the rows of one")
    return found[0]


def is_table(path: Path) -> bool:
    """Check that a name is that of a file of columns, a text or arrays."""
    name = path.name.lower().removesuffix(".gz")
    return name.endswith((*TEXTS, *SHEETS, *ARRAYS, *CONTAINERS)) and path.is_file()


def read_table(path: Path, columns: str | None = None, topics: Sequence[str] = TOPICS) -> Record:
    """The record of a file that holds one run, by a description of its columns or by the names and units that it has itself."""
    return import_table(path, described_columns(path, topics=topics) if columns is None else parse_columns(columns), None)


def described_columns(
    path: Path, rate: float | None = None, remedy: str | None = None, topics: Sequence[str] = TOPICS
) -> list[Column]:
    """The columns of a file whose names and units say what each is. Raises `InputError` with a suggestion where these do not."""
    described = named_columns(path, has_rate=rate is not None, topics=topics)
    if described is None:
        lines, suggestion = listed_columns(path)
        found = "; ".join(line.strip() for line in lines[1:6]) + "; …" * (len(lines) > 6)
        remedy = remedy or f"try hyst import {path} --output BAG {suggestion}"
        raise InputError(f"{path}: names and units of its columns leave open which is which ({found}): {remedy}")
    return parse_columns(described)


def import_records(
    path: str | Path,
    columns: Sequence[Column],
    rate: float | None,
    rows: tuple[int, int | None] = (0, None),
    hold: str | None = None,
    variable: str | None = None,
    skip: int = 0,
    resample: float | None = None,
    allow_gaps: bool = False,
) -> list[Record]:
    """Records from a table or an array file, one for each run in it."""
    # path: A text table (.gz too), .npy, .npz, .mat, .xlsx, .parquet, .h5 or .tdms. A text may have an instrument's header above or
    # beside its numbers
    # columns: by number from 1 (from 0 where a column 0 is named), by the header's name, or by the name or path of an array: a
    # vector, a matrix (its columns are the axes, its rows the samples), or one column or row of a matrix as ``name(:,2)`` or
    # ``name(2,:)``. The topic `time` is the column of sample times
    path = Path(path)
    if rate is not None and (not np.isfinite(rate) or rate <= 0):
        raise InputError(f"rate: {rate!r} Hz, a positive rate is due")
    signal_columns = [column for column in columns if column.topic != TIME]
    times = [column for column in columns if column.topic == TIME]
    if not signal_columns:
        raise InputError("columns: name command and measurement (command=1[V],measurement=5[um])")
    selected = read_columns(path, [name for column in columns for name in column.columns], variable, skip)
    count = len(next(iter(selected.columns.values())))
    begin, end = rows[0], count if rows[1] is None else rows[1]
    if not 0 <= begin < end <= count:
        raise InputError(f"{path}: rows must be a range within 0:{count}, got {begin}:{end}")
    notes = list(selected.notes)
    held = {name: array[begin:end] for name, array in selected.columns.items()}
    if any(column.topic == "frequency" for column in columns):
        record = response_record(str(path), columns, held)
        return [replace(record, notes=(*notes, *record.notes))]
    if rate is None and not times:
        if not selected.sample_time:
            raise InputError("rate: is missing: give it in Hz, or name the column of sample times (time=1[s])")
        rate = 1.0 / selected.sample_time
        notes.append(f"{path}: the file states {rate:.6g} samples/s")
    numbers: Sequence[int] | Integers = range(begin, end)
    missing = 0
    if (resample is not None or allow_gaps) and not (whole := _whole_rows(held)).all():
        missing = int(np.sum(~whole))
        if end - begin - missing < 2:
            raise InputError(f"{path}: fewer than two rows hold finite numbers in all columns: choose other columns or rows")
        if resample is not None:  # what else such a row holds is kept, where its time is one
            clock = {name: held[name] for column in times for name in column.columns}
            whole |= _short_stretches(~whole) & (_whole_rows(clock) if clock else True)
        numbers, held = begin + np.flatnonzero(whole), {name: array[whole] for name, array in held.items()}
        notes.append(f"{path}: rows with no finite number in a column were taken as missing: {missing}")
    time = _times(path, times[0], held, numbers) if times else None
    values = {column.topic: _scaled(path, column, held, numbers, resample is not None) for column in signal_columns}
    for column in signal_columns:
        if column.topic == "measurement" and column.unit == "V":
            notes.append(f"{path}: measurement is in V: with a sensor of 5 um/V, say, write its unit as [5um/V]")
    units = {column.topic: column.unit for column in signal_columns}
    if time is None and missing:
        time, rate = (np.asarray(numbers) - numbers[0]) / rate, None
    if time is None:
        stamps = empty_rows(end - begin)
        for part in blocks(end - begin):
            stamps[part] = np.arange(part.start, part.stop) / rate
        for topic in values:
            check_times(f"{path}: {topic}", stamps)
        return [_record(str(path), stamps, values, units, notes, hold)]
    if passed := midnights(time):
        for row in passed:
            time[row:] += DAY
        notes.append(f"{path}: time: passes midnight in row {', '.join(str(numbers[row]) for row in passed)}: a day was added")
    check_times(f"{path}: time", time)
    found, runs = [], runs_of(str(path), time, numbers, gaps=resample is not None)
    for run in runs:
        parts = {topic: array[run] for topic, array in values.items()}
        found.append(record_of_run(path, time[run], parts, units, hold, rate, int(numbers[run.start]), resample, allow_gaps))
    if len(found) > 1:
        starts = ", ".join(str(numbers[run.start]) for run in runs[1:])
        what = "starts again" if resample is None else "starts again, or goes on behind a long gap,"
        notes.append(f"{path}: time: {what} in row {starts}: {len(found)} runs, each of which is a record")
    found[0] = replace(found[0], notes=(*notes, *found[0].notes))
    return found


def record_of_run(
    path: str | Path,
    time: Array,
    values: dict[str, Array],
    units: dict[str, str],
    hold: str | None,
    rate: float | None = None,
    begin: int = 0,
    resample: float | None = None,
    allow_gaps: bool = False,
) -> Record:
    """The record of a run, whose rows are counted from `begin`, on the ticks of its clock."""
    notes = []
    if time[0] != 0.0:
        time = time - time[0]
    kept = without_repeated(str(path), time, list(values.values()), begin)
    if kept is not None:
        notes.append(
            f"{path}: {int(np.sum(~kept))} rows are duplicates, with the time and values of the row before, and were left out"
        )
        time, values = time[kept], {topic: array[kept] for topic, array in values.items()}
    raw = _record(str(path), time, values, units, notes, hold)
    signals, more = on_one_clock(str(path), raw.signals, raw.hold, resample, allow_gaps)
    record = replace(raw, signals=signals, notes=(*notes, *more))
    if rate is not None and len(time) > 1:
        own = 1.0 / record.common_step(list(signals)[:1])
        if abs(own - rate) > RATE_TOLERANCE * rate:
            raise InputError(
                f"{path}: time: has {own:.6g} samples/s, --rate says {rate:g}: leave one of them out, or check the unit"
            )
    return record


def _record(
    source: str, time: Array, values: dict[str, Array], units: dict[str, str], notes: Sequence[str], hold: str | None
) -> Record:
    signals = {topic: Signal(time, array, axis_names(array.shape[1]), units[topic]) for topic, array in values.items()}
    return Record(signals, source, tuple(notes), hold or "zoh", states_hold=hold is not None)


def _whole_rows(held: dict[str, Array]) -> Mask:
    """Mask (N,) of the rows that hold a finite number in every column."""
    whole = np.ones(len(next(iter(held.values()))), dtype=bool)
    for part in blocks(len(whole)):
        for array in held.values():
            whole[part] &= _is_measured(array[part]).all(axis=1)
    return whole


def _is_measured(values: Array) -> Mask:
    """Mask of the numbers that are finite, and not what an instrument of SCPI has for an overload (9.9e37) or none (9.91e37)."""
    size = np.abs(values)
    return np.isfinite(size) & ~((size > 9.89e37) & (size < 9.92e37))


def _short_stretches(missing: Mask) -> Mask:
    """Mask (N,) of the rows in stretches of missing ones that are short enough to be filled."""
    edges = np.flatnonzero(np.diff(missing, prepend=False, append=False))
    short = np.zeros(len(missing), dtype=bool)
    for begin, end in edges.reshape(-1, 2):
        short[begin:end] = end - begin < LONGEST_FILLED
    return short


def _scaled(path: Path, column: Column, held: dict[str, Array], numbers: Sequence[int] | Integers, filled: bool = False) -> Array:
    """Values (N, A) of a signal in its unit. Raises `InputError` naming the first row without one, unless those are `filled` later."""
    arrays = [held[name] for name in column.columns]
    factors = [scale for array, scale in zip(arrays, column.scales, strict=True) for _ in range(array.shape[1])]
    scaled = empty_rows(len(numbers), len(factors))
    unusable, finite = np.zeros(len(numbers), dtype=bool), True
    for part in blocks(len(numbers)):
        found = np.concatenate([array[part] for array in arrays], axis=1)
        with np.errstate(over="ignore", invalid="ignore"):  # a signalling NaN, too, is found below
            scaled[part] = found * factors
        measured = _is_measured(found)
        scaled[part][~measured] = np.nan
        wrong = ~np.isfinite(scaled[part]).all(axis=1)
        if filled:
            wrong &= measured.all(axis=1)
        unusable[part], finite = wrong, finite and bool(measured[wrong].all())
    bad, first_bad = int(unusable.sum()), numbers[int(np.argmax(unusable))]
    if bad and finite:
        raise InputError(
            f"{path}: {column.topic}: row {first_bad} is too large for a number once it is in other units: check the unit"
        )
    if bad:
        if bad == len(numbers):
            raise InputError(
                f"{path}: {column.topic}: no row holds a finite number: name another column, or save formulas as values"
            )
        remedies = gap_remedies(bool(_short_stretches(unusable)[unusable].all()), "such rows")
        which = f"row {first_bad} holds" if bad == 1 else f"row {first_bad} and {bad - 1} more hold"
        raise InputError(
            f"{path}: {column.topic}: {which} no finite number: {remedies}, or choose other rows (--rows) or repair the file"
        )
    return scaled


def _times(path: Path, column: Column, held: dict[str, Array], numbers: Sequence[int] | Integers) -> Array:
    """Sample times (N,) in s, counted from the first, of the column of times, or of the sum of those that are its parts."""
    parts = _scaled(path, column, held, numbers)
    if parts.shape[1] != 1 and not column.summed:
        raise InputError(f"columns: time: {parts.shape[1]} columns, one is due")
    parts -= parts[0].copy()  # before the sum: seconds since 1970 leave few digits for the microseconds
    return np.ascontiguousarray(parts[:, 0]) if parts.shape[1] == 1 else np.asarray(parts.sum(axis=1))


def write_bag(path: str | Path, record: Record) -> None:
    """Write a record as a finished MCAP bag: under a temporary name, then renamed. Raises `InputError` when the path exists."""
    if not record.signals:
        raise InputError(f"{path}: there is nothing to write: {record.source} has no signals")
    said = {"hold": record.hold} if record.states_hold else {}
    if record.history:
        said["history"] = "\n".join(record.history)
    with appearing(Path(path)) as part, open_bag(part, said or None) as writer:
        encoders = {topic: Encoder(label_for(signal.axes, signal.unit)) for topic, signal in record.signals.items()}
        for topic in encoders:
            writer.add_topic(f"/{topic}")
        for begin in range(0, max(len(signal.time) for signal in record.signals.values()), BLOCK):
            for topic, signal in record.signals.items():
                rows = slice(begin, begin + BLOCK)
                block = np.column_stack([signal.time[rows], signal.values[rows]])
                if len(block):
                    at = max(int(round(block[-1, 0] * 1e9)), 0)
                    writer.write(f"/{topic}", encoders[topic].encode(np.ascontiguousarray(block)), at)


def write_bags(path: str | Path, records: Sequence[Record]) -> None:
    """Write one record as a bag, or several as bags 1, 2, … in a folder of this name. Raises `InputError` when it exists."""
    if len(records) == 1:
        write_bag(path, records[0])
        return
    with appearing(Path(path)) as part:
        for number, record in enumerate(records, start=1):
            write_bag(part / f"{number:0{len(str(len(records)))}d}", record)
