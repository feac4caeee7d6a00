# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A measured piezo stack: PI PICMA P-885.91 on a flexure stage (Aye & Ang, "A Discrete Backlash Operator …", ICSTSD 2018).

Quasi-static loops at 1 Hz, 200 Hz sampling. Models are fitted on one full cycle of the first file and predict the nested loops of the
second, rows 7950-14150, from its command alone. NRMSE is over the range of those rows with the mean removed: the sensor's zero differs
between the files. Under `hold: zoh` a static model does better on either file; a lag of two to four samples is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from evaluation.reproduction.figures import write_page
from evaluation.reproduction.measured_data import data_folder, read
from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.identify import identify
from hyst_control.identify.assess.fit_report import record_rows, residual
from hyst_control.identify.data.initial_memory import with_beginning
from hyst_control.identify.data.reversal_points import turning_points
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record, sampled_record
from hyst_control.reporting.tables import Table

SAMPLE_TIME = 5e-3
SCORED = {"rows 7950-14150": slice(7950, 14150), "rows 7950-11950": slice(7950, 11950)}
"""Rows of the second file: loops whose amplitude shrinks and grows again, with and without the full loops that follow."""
OPERATORS = 12
CUT = 4700
"""Rows cut off the second file's beginning, its first third."""
PLAY = {"operators": OPERATORS, "nuisance": "offset"}
MODELS: dict[str, tuple[str, dict[str, Any]]] = {
    "Madelung, quintic": ("madelung", {}),
    "Madelung, piecewise cubic": ("madelung", {"knots": np.linspace(0.0, 1.0, 6)}),
    f"{OPERATORS} play operators, two-sided": ("pi", {**PLAY, "one_sided": False}),
    f"{OPERATORS} play operators, one-sided": ("pi", {**PLAY, "one_sided": True}),
}
"""Static models by name: family and options."""


@dataclass(frozen=True)
class Change:
    """Change of a record as another amplifier or sensor would have it: command sign · u + shift (V), measurement factor · y + zero (um)."""

    sign: float
    shift: float
    factor: float
    zero: float

    def of(self, record: Record, cut: int = 0) -> Record:
        """Change a record and cut off its first rows; how it begins is for the identification to find."""
        kept = record.rows(cut, len(record))
        command, measurement = self.sign * kept.command + self.shift, self.factor * kept.measurement + self.zero
        return replace(kept.with_values(command=command, measurement=measurement), start="auto")


CHANGES = {
    "bipolar drive": Change(1.0, -1.8, 1.0, 0.0),
    "bipolar drive, other zero": Change(1.0, -1.8, 1.0, 5.0),
    "negative drive": Change(-1.0, 0.0, 1.0, -3.0),
    "inverted bipolar drive and sensor": Change(-1.0, 1.5, -1.0, 2.0),
    "offset drive": Change(1.0, 2.5, 1.0, 0.0),
}
"""Other signs, offsets and beginnings of the same measurements; their first third is cut off besides."""


def load() -> tuple[Record, Record]:
    """Load the two files: full loops and nested loops."""
    folder = data_folder("pea_p885")
    records = []
    for name, columns in (("Model_Vi_Do.dat", 7), ("Test_Vi_Do_Di.dat", 11)):
        values = read(folder / name, np.loadtxt)
        if values.ndim != 2 or values.shape[1] != columns or len(values) < 8000:
            raise InputError(f"{folder / name}: shape {values.shape}, {columns} columns are due: fetch the file again")
        command, measurement = values[:, [0]].copy(), values[:, [4]].copy()
        records.append(sampled_record(name, command, measurement, SAMPLE_TIME, ("x",), "um", "zoh", "unknown"))
    return records[0], records[1]


def cycles(record: Record) -> list[Record]:
    """Split the first file into full cycles, each from one lowest command to the next."""
    command = record.command[:, 0]
    turns = turning_points(command)
    lowest = [int(turn) for turn in turns if command[turn] < 0.02 * command.max()]
    return [replace(record.rows(begin, end + 1), source=f"cycle {i + 1}") for i, (begin, end) in enumerate(zip(lowest, lowest[1:]))]


def score(nested: Record, rows: slice, predicted: Annotated[Array, "N"]) -> float:
    """Compute the NRMSE of some rows in % of their measured range, means removed."""
    measured = nested.measurement[rows, 0]
    return 100.0 * float(np.std(measured - predicted[rows])) / float(np.ptp(measured))


def predict(model: Model, record: Record) -> Annotated[Array, "N"]:
    """Predict a record from its command."""
    return simulate(model, record.command)[:, 0]


def run(figures: str | None = None) -> Table:
    """Compare every static model on held-out loops and return the table."""
    full, nested = load()
    available = cycles(full)
    table = Table("reproduce pea-p885")
    first = available[0]
    report(table, first, nested)
    report_cycles(table, available, nested)
    report_fitted_there(table, nested)
    report_changes(table, first, nested)
    if figures is not None:
        write_page(figures, table)
    return table


def report(table: Table, cycle: Record, nested: Record) -> None:
    """Fit every static model on one cycle, and add its held-out and fitted errors."""
    title = "P-885.91, fitted on one cycle, nested loops held out"
    for name, (family, options) in MODELS.items():
        model = identify([cycle], family, **options).model
        predicted, fitted = predict(model, nested), record_rows(model, [cycle])[0][0]["nrmse_centered"]
        for case, rows in SCORED.items():
            table.add(title, case, name, "nrmse", "%", score(nested, rows, predicted))
        table.add(title, "the cycle itself", name, "nrmse", "%", float(fitted))


def report_cycles(table: Table, available: Sequence[Record], nested: Record) -> None:
    """Add the scatter of the error when other cycles are fitted."""
    predicted = [predict(identify([cycle], "madelung").model, nested) for cycle in available[::4]]
    for case, rows in SCORED.items():
        errors = [score(nested, rows, each) for each in predicted]
        for name, value in (("mean", float(np.mean(errors))), ("least", min(errors)), ("greatest", max(errors))):
            title, n = "P-885.91, every fourth cycle in turn", len(errors)
            table.add(title, case, "Madelung, quintic", f"nrmse_{name}", "%", value, n=n)


def report_fitted_there(table: Table, nested: Record) -> None:
    """Add play operators fitted on the scored rows themselves: the least error that their predictions can reach."""
    name, title = f"{OPERATORS} play operators, two-sided", "P-885.91, fitted on the rows scored"
    family, options = MODELS[name]
    for case, rows in SCORED.items():
        model = identify([nested.rows(rows.start, rows.stop + 1)], family, **options).model
        table.add(title, case, name, "nrmse", "%", score(nested, rows, predict(model, nested)))


def report_changes(table: Table, cycle: Record, nested: Record) -> None:
    """Add the held-out error when signs, offsets and beginnings of the records are others."""
    for name, change in CHANGES.items():
        model = identify([change.of(cycle)], "madelung").model
        record = with_beginning(change.of(nested, CUT))
        error = residual(model, record)[:, 0]
        for case, rows in SCORED.items():
            behind = len(nested.command) - rows.stop
            part = error[len(error) - behind - (rows.stop - rows.start) : len(error) - behind]
            value = 100.0 * float(np.std(part)) / float(np.ptp(nested.measurement[rows, 0]))
            table.add(f"P-885.91, {name}, first third cut off", case, "Madelung, quintic", "nrmse", "%", value)
