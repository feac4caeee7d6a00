# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Convert recordings of other tools to bags: text tables (.gz too), arrays and tables of other programs, other bags.

Read are .npy, .npz, .mat, .xlsx, .parquet, .h5, .tdms, .json and text datasets of universal files (.uff).

Without --columns the columns are taken by their names, if each says what it is and in which unit ("time [s],command [V],position [um]").
Else they are listed with a description of them that can be pasted. A bag of this package's signals needs
no columns, even if its recorder was killed: its readable part is written as a finished bag for other tools.

examples:
  hyst import run.csv                        # what is in it?
  hyst import Model_Vi_Do.dat --output model.bag --columns "command=1[V],measurement=5[um]" --rate 200 --rows 5: --hold foh
  hyst import run.csv --output run.bag --columns "command=drive[mV],measurement=pos[nm]" --rate 20e3
  hyst import run.mat --output fsm.bag --columns "command=ux+uy[V],measurement=tx+ty[rad]" --rate 5000
  hyst import sim.mat --output run.bag --columns "time=out.time[s],command=out.signals.values(:,1)[V],measurement=run(2).y[um]"
  hyst import scope.csv --output run.bag --columns "time=1[s],command=2[V],measurement=3[um]"
  hyst import log.csv --output run.bag --columns "time=ts[s]+tus[us],command=u[V],measurement=y[deg]" --resample
  hyst import robot.mcap --output run.bag --columns "command=/joint_states.effort[V],measurement=/joint_states.position(1)[um]"
  hyst import analyzer.csv --output response.bag --columns "frequency=1[Hz],magnitude=2[dB],phase=3[deg]"
  hyst import killed.bag --output repaired.bag
Columns are numbered from 1 (from 0 where a column 0 is named), or named by the header or the file's own arrays; several axes are joined
with +. A number before the unit is what one in the file stands for: volts of a sensor of 5 um/V are measurement=pos[5um/V]. A matrix is
taken with all its columns as axes, with one of them, measurement=data(:,2)[um], or with one row, data(2,:). Voltages become V, lengths
um, radians mrad; all other units stay (deg, arcsec, A, N, m/s^2, counts, %, ...). A field of a bag is /topic.field, of any message type.
Sample times are put on the nearest ticks of a regular clock. A time that starts again begins a further record: the bags are then
numbered in the folder BAG, which other commands take as all of them.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from hyst_control.cli.validate import add_shift
from hyst_control.reporting.result import CommandResult

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hyst_control.records.record import Record, Signal

NAME = "import"
HELP = "convert recordings of other tools to bags"
JSON = "list of written files"
READS = ("file",)
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("file", metavar="FILE", help="recording to convert")
    add("--output", metavar="BAG", help="bag to write, which must not exist")
    add("--columns", help="topic=column[unit], separated by commas")
    add("--rate", type=float, help="sample rate in Hz (not for a bag, nor for a table with a column of times)")
    add("--rows", default=":", help="rows as first:end, counted from 0 (default: all)")
    add("--skip", type=int, default=0, metavar="N", help="lines of a text to leave out at its beginning")
    add(
        "--resample",
        type=float,
        nargs="?",
        const=0.0,
        metavar="HZ",
        help="interpolate irregular times, several rates and gaps of at most 9 rows, at HZ or at the file's own rate; of a table, what "
        "follows a longer gap is a record of its own",
    )
    add("--allow-gaps", action="store_true", help="accept times that pass over rows, as identify --allow-gaps does")
    add(
        "--hold",
        choices=("zoh", "foh"),
        help="command between samples: zoh, held by a DAC; foh, a sampled smooth source (default: as a bag states it, else found later)",
    )
    add_shift(parser)
    add("--variable", help="array of an .npz or .mat file that columns are numbered in, or sheet of a workbook")


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from pathlib import Path

    from hyst_control.base import progress
    from hyst_control.base.errors import InputError
    from hyst_control.records.bags.bag_fields import read_runs
    from hyst_control.records.bags.bag_reader import read_bag
    from hyst_control.records.tables.importing import import_records, parse_columns
    from hyst_control.records.tables.listing import listed_columns, named_columns

    progress.step(f"read {arguments.file}")
    is_bag = Path(arguments.file).is_dir() or arguments.file.endswith((".mcap", ".db3"))
    asked = arguments.columns
    if asked is None and arguments.output is not None and not is_bag:
        asked = named_columns(Path(arguments.file), arguments.variable, arguments.skip, arguments.rate is not None)
        if asked is not None:
            print(f"--columns {asked!r}: by the names and units in {arguments.file}")
    if asked is None and not is_bag:
        lines, suggestion = listed_columns(Path(arguments.file), arguments.variable, arguments.skip)
        print("\n".join(lines))
        raise InputError(
            f"--columns is required. Name the columns found and their units (UNIT where none is known): try {suggestion}"
        )
    if arguments.output is None:
        raise InputError("--output: is missing: name the bag to write")
    columns = None if asked is None else parse_columns(asked)
    if columns is None:
        return written(arguments.output, [read_bag(arguments.file).shifted(arguments.shift)])
    if is_bag:
        records = read_runs(Path(arguments.file), columns, arguments.hold, arguments.resample, arguments.allow_gaps)
        return written(arguments.output, [record.shifted(arguments.shift) for record in records])
    try:
        first, _, last = arguments.rows.partition(":")
        rows = (int(first or 0), int(last) if last else None)
    except ValueError:
        raise InputError(f"--rows: must be first:end in whole numbers, got {arguments.rows!r}") from None
    table = arguments.rate, rows, arguments.hold, arguments.variable, arguments.skip
    records = import_records(arguments.file, columns, *table, arguments.resample, arguments.allow_gaps)
    return written(arguments.output, [record.shifted(arguments.shift) for record in records])


def written(output: str, records: Sequence[Record]) -> CommandResult:
    """Write records to a bag, or several to numbered bags in a folder, and describe them."""
    from pathlib import Path

    from hyst_control.base import progress
    from hyst_control.records.tables.importing import write_bags
    from hyst_control.reporting.artifacts import Artifacts

    progress.step(f"write {output}")
    write_bags(output, records)
    notes = [note for record in records for note in (*record.notes, *_doubts(record))]
    made = Artifacts("import", [output], lines=[f"note: {note}" for note in notes])
    for number, record in enumerate(records, start=1):
        for topic, signal in record.signals.items():
            where = f"{Path(output) / str(number)}: " if len(records) > 1 else ""
            made.lines.append(where + _described(topic, signal))
            made.add(f"{number} {topic}" if where else topic, "samples", "", len(signal.time))
    return made


def _doubts(record: Record) -> list[str]:
    """Notes where no model can be identified (command or measurement is missing, or they have other axes) or a unit may be wrong."""
    from hyst_control.base.errors import InputError
    from hyst_control.records.record import TOPICS
    from hyst_control.records.validity.checks import implausible_range

    if missing := [topic for topic in TOPICS if topic not in record.signals]:
        there = ", ".join(record.signals) or "no signals"
        return [f"{record.source}: has no {' and no '.join(missing)}, only {there}: hyst identify needs command and measurement"]
    try:
        record.check_axes()
    except InputError as error:
        return [str(error)]
    command, measurement = (record.signal(topic) for topic in TOPICS)
    if command.unit != "V" or not len(command.values) or not len(measurement.values):
        return []
    columns = zip(command.axes, command.values.T, measurement.values.T, strict=True)
    return [finding.text() for given in columns for finding in implausible_range(record.source, *given, measurement.unit)]


def _described(topic: str, signal: Signal) -> str:
    """Samples, rate, duration and ranges of a signal: a wrong unit is seen there."""
    from hyst_control.records.record import commonest_step

    count = len(signal.time)
    if count < 2:
        return f"{topic}: {count} samples, {', '.join(signal.axes)} in {signal.unit}"
    ranges = ", ".join(
        f"{axis} {values.min():.4g} to {values.max():.4g}" for axis, values in zip(signal.axes[:6], signal.values.T, strict=False)
    )
    more = ", …" if len(signal.axes) > 6 else ""
    step = commonest_step(signal.time)
    return f"{topic}: {count} samples at {1.0 / step:.6g} Hz, {signal.time[-1] - signal.time[0] + step:.6g} s, {ranges}{more} {signal.unit}"
