# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Recorded signals as files of other tools: one message a row for players, tables for spreadsheets and data frames, arrays for MATLAB.

Of a block of rows a player draws the first only: the MCAP file made here has one message a row, whose log time is the sample time. Tables
have a row for every sample time of any signal; where a signal has no sample at that time its cell is empty.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.files import appearing, replacing
from hyst_control.records.bags.rosbag2_writer import open_bag
from hyst_control.records.record import Record
from hyst_control.records.stream.signal_message import Encoder, label_for

NANOSECONDS = 1e9


def export_record(record: Record, path: str | Path, form: str) -> None:
    """Write a record's signals in another tool's form; a file that is there is replaced as a whole."""
    if form not in FORMS:
        raise InputError(f"{form}: no form to export to, one of {', '.join(FORMS)} is due")
    if not any(len(signal.time) for signal in record.signals.values()):
        raise InputError(f"{record.source}: holds no rows: there is nothing to export")
    FORMS[form](record, Path(path))


def table_of(record: Record) -> tuple[list[str], Array]:
    """Put all signals into one table."""
    times = np.unique(np.concatenate([signal.time for signal in record.signals.values()]))
    names, columns = ["time [s]"], [times]
    for topic, signal in record.signals.items():
        rows = np.searchsorted(times, signal.time)
        for index, axis in enumerate(signal.axes):
            column = np.full(len(times), np.nan)
            column[rows] = signal.values[:, index]
            names.append(f"{topic}.{axis} [{signal.unit}]")
            columns.append(column)
    return names, np.column_stack(columns)


def _write_csv(record: Record, path: Path) -> None:
    names, table = table_of(record)
    with replacing(path) as file:
        file.write((",".join(names) + "\n").encode())
        for row in table:
            file.write((",".join("" if value != value else repr(value) for value in row.tolist()) + "\n").encode())


def _write_parquet(record: Record, path: Path) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise InputError("parquet: pyarrow is not installed: pip install pyarrow, or export to csv") from None
    names, table = table_of(record)
    columns = [pyarrow.array(column, from_pandas=True) for column in table.T]
    with replacing(path) as file:
        pyarrow.parquet.write_table(pyarrow.table(columns, names=names), file)


def _write_mat(record: Record, path: Path) -> None:
    from scipy.io import savemat

    structures: dict[str, Mapping[str, Any]] = {
        topic: {"time": signal.time[:, None], "values": signal.values, "axes": list(signal.axes), "unit": signal.unit}
        for topic, signal in record.signals.items()
    }
    with replacing(path) as file:
        savemat(file, structures, do_compression=True)


def _write_mcap(record: Record, path: Path) -> None:
    encoders = {topic: Encoder(label_for(signal.axes, signal.unit)) for topic, signal in record.signals.items()}
    times = np.concatenate([signal.time for signal in record.signals.values()])
    source = np.repeat(np.arange(len(record.signals)), [len(signal.time) for signal in record.signals.values()])
    index = np.concatenate([np.arange(len(signal.time)) for signal in record.signals.values()])
    # A player's clock begins at 1970: times before it are moved, so that none is negative.
    shift = max(0.0, -float(times.min()))
    topics, signals = list(record.signals), list(record.signals.values())
    with appearing(path) as part, open_bag(part, {"hold": record.hold} if record.states_hold else None) as writer:
        for topic in topics:
            writer.add_topic(f"/{topic}")
        for at in np.argsort(times, kind="stable").tolist():
            topic, signal, row = topics[source[at]], signals[source[at]], index[at]
            block = np.concatenate([[signal.time[row]], signal.values[row]])[None]
            writer.write(f"/{topic}", encoders[topic].encode(block), int(round((times[at] + shift) * NANOSECONDS)))


FORMS: dict[str, Callable[[Record, Path], None]] = {
    "mcap": _write_mcap,
    "csv": _write_csv,
    "parquet": _write_parquet,
    "mat": _write_mat,
}
"""Writers by the name of the form, which is the file's ending too."""
