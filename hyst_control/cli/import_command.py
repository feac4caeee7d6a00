"""Convert recordings of other tools to bags: CSV, white-space tables (.gz too), .npy, .npz and MATLAB .mat files.

A bag is accepted too, even if its recorder was killed: its readable part is written as a finished bag for other tools.

examples:
  hyst import Model_Vi_Do.dat --output model.bag --columns "command=1[V],measurement=5[um]" --rate 200 --rows 5: --hold foh
  hyst import run.csv --output run.bag --columns "command=drive[mV],measurement=pos[nm]" --rate 20e3
  hyst import run.mat --output fsm.bag --columns "command=ux+uy[V],measurement=tx+ty[rad]" --rate 5000
  hyst import scope.csv --output run.bag --columns "time=1[s],command=2[V],measurement=3[um]"
  hyst import killed.bag --output repaired.bag
Columns are numbered from 1 (from 0 where a column 0 is named), or named by the header or the file's own arrays; several axes are joined
with +. A number before the unit is what one in the file stands for: volts of a sensor of 5 um/V are measurement=pos[5um/V]. A matrix is
taken with all its columns as axes, or with one of them: measurement=data(:,2)[um].
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hyst_control.records.record import Record
    from hyst_control.reporting.artifacts import Artifacts

NAME = "import"
HELP = "convert CSV, NPY, NPZ or MAT recordings to bags"
JSON = "list of written files"
READS = ("file",)
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("file", metavar="FILE", help="recording to convert")
    parser.add_argument("--output", metavar="BAG", required=True, help="bag to write, which must not exist")
    parser.add_argument("--columns", help="topic=column[unit], separated by commas (not for a bag)")
    parser.add_argument("--rate", type=float, help="sample rate in Hz (not for a bag, nor for a table with a column of times)")
    parser.add_argument("--rows", default=":", help="rows as first:end, counted from 0 (default: all)")
    parser.add_argument(
        "--hold",
        choices=("zoh", "foh"),
        default="zoh",
        help="command between samples: zoh, held by a DAC (default); foh, a sampled smooth source",
    )
    parser.add_argument("--variable", help="array to read from an .npz or .mat file")


def run(arguments: argparse.Namespace) -> Artifacts:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from pathlib import Path

    from hyst_control import progress
    from hyst_control.errors import InputError
    from hyst_control.records.bag_reader import read_bag
    from hyst_control.records.importing import import_table, parse_columns

    progress.step(f"read {arguments.file}")
    if Path(arguments.file).is_dir() or arguments.file.endswith((".mcap", ".db3")):
        record = read_bag(arguments.file)
        return written(arguments.output, record, [f"note: {note}" for note in record.notes])
    if arguments.columns is None:
        raise InputError("--columns: is missing: a table does not say it by itself")
    try:
        first, _, last = arguments.rows.partition(":")
        rows = (int(first or 0), int(last) if last else None)
    except ValueError:
        raise InputError(f"--rows: must be first:end in whole numbers, got {arguments.rows!r}") from None
    record = import_table(
        arguments.file, parse_columns(arguments.columns), arguments.rate, rows, arguments.hold, arguments.variable
    )
    return written(arguments.output, record, [f"note: {note}" for note in record.notes])


def written(output: str, record: Record, notes: list[str]) -> Artifacts:
    """Write a record to a bag and describe it.

    Parameters
    ----------
    output : str
        Bag to write.
    record : Record
        The record.
    notes : list of str
        Lines printed before the description.

    Returns
    -------
    Artifacts
        The written files, with the number of samples of every topic.
    """
    from hyst_control import progress
    from hyst_control.records.importing import write_bag
    from hyst_control.reporting.artifacts import Artifacts

    progress.step(f"write {output}")
    write_bag(output, record)
    made = Artifacts("import", [output], lines=notes)
    for topic, signal in record.signals.items():
        made.lines.append(f"{topic}: {len(signal.time)} samples, {', '.join(signal.axes)} in {signal.unit}")
        made.add(topic, "samples", "", len(signal.time))
    return made
