# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of models on records: the same table for one model or several, as a whole and by frequency and amplitude."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hyst_control.base import progress
from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.identify.assess.fit_report import error_rows, residual
from hyst_control.identify.data.initial_memory import with_beginning
from hyst_control.identify.data.record_segmentation import stretches_between_rests
from hyst_control.identify.trial_beside_model import trial_beside
from hyst_control.identify.workflow import AUTO, LONGEST_JUDGED, gapless_records
from hyst_control.model_file import Model, load_model
from hyst_control.records.bags.bag_files import bags_in
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import TOPICS, Record
from hyst_control.records.session_zero import SHAPES, without_zero
from hyst_control.records.stream.clock_alignment import aligned_by_reception
from hyst_control.records.stream.row_store import blocks, mean_square
from hyst_control.records.validity.checks import examined
from hyst_control.reporting.tables import Table

NOT_DESCRIBED = 20.0  # Error in % of the range, without session effects, from which a model does not describe a record
BY_MOTION = "by frequency and amplitude, % of the range of each motion"
MAX_MOTIONS = 24  # Most motions between rests that are listed one by one: a sum of sines has hundreds


@dataclass(frozen=True)
class Motion:
    """Motion between two rests."""

    # frequency, amplitude: Of the command, Hz and V
    frequency: float
    amplitude: float
    span: float  # Range of the measurement, its unit
    error: float  # Rms, the same unit
    rows: int  # Their number


def validate_bags(
    models: Sequence[str | Path],
    bags: Sequence[str | Path],
    source: str,
    hold: str | None = None,
    start: str = "auto",
    namespace: str | None = None,
    unit: str = "unknown",
    columns: str | None = None,
    shift: float = 0.0,
    strict: bool = False,
) -> Table:
    """Score every model on every record."""
    loaded = {_name(path, models): load_model(path) for path in models}
    table = Table(source)
    for bag in bags_in(bags):
        progress.step(f"read {bag}")
        record = read_bag(bag, namespace, unit, columns=columns).shifted(shift)
        found = validate_record(loaded, record, source, hold, start)
        table.rows += found.rows
        table.notes += found.notes
        table.exit_status = max(table.exit_status, found.exit_status if strict else 0)
    table.notes = list(dict.fromkeys(table.notes))
    return table


def validate_record(
    models: Mapping[str, Model], record: Record, source: str = "validate", hold: str | None = None, start: str = "auto"
) -> Table:
    """Score models by name on a record; the table is that of `validate_bags` with `strict`."""
    table = Table(source)
    for name, model in models.items():
        stretches, compared = compared_stretches(record, model, hold, start, name), 0
        for data in stretches:
            progress.step(f"{name} on {data.name}")
            compared += add_rows(table, name, model, data)
            faults = _remarks(table, name, model, data)
            table.notes += [*check_pair(name, model, data), *faults]
            table.exit_status = 3 if faults else table.exit_status
        table.notes += _left_out(name, record, sum(map(len, stretches)), compared)
    return table


def _left_out(name: str, record: Record, usable: int, compared: int) -> list[str]:
    """A sentence on the rows of a record that are not compared with a model, with the reasons."""
    rows = len(record.signal("measurement").time)
    reasons = {
        "before the hysteresis memory is known": usable - compared,
        "without a command at the same time, while the actuator did not follow it, or between close gaps": rows - usable,
    }
    listed = "; ".join(f"{count} {words}" for words, count in reasons.items() if count > 0)
    return [f"{record.source}: {rows - compared} of {rows} samples are not compared with {name}: {listed}"] if listed else []


def _remarks(table: Table, name: str, model: Model, data: Record) -> list[str]:
    """Sentences on the faults of a record, or of a model of it."""
    looked_at = data.rows(0, LONGEST_JUDGED)
    trial = trial_beside(model, data.name, looked_at.command, looked_at.measurement, data.sample_time, data.hold)
    found = [each.text() for findings in examined([trial]) for each in findings]
    for axis, label in enumerate(data.axes):
        where = f"{data.name} {label}" if len(data.axes) > 1 else data.name
        span = float(data.span[axis]) or 1.0
        error, zero = (table.value(where, name, quantity) for quantity in ("nrmse_own_zero", "zero"))
        if error > NOT_DESCRIBED:
            found.append(
                f"{where}: {name} does not describe this record: without session effects the error is {error:.4g} % of the measured range; "
                "check units, sample rate and columns, or identify a model from this machine"
            )
        if abs(zero) > span:
            found.append(
                f"{where}: the sensor offset is {zero:.4g} {data.unit}, {abs(zero) / span:.3g} times the measured range: the sensor's zero "
                "differs from the model's, or the unit is another"
            )
    return found


def compared_stretches(record: Record, model: Model, hold: str | None = None, start: str = "auto", name: str = "") -> list[Record]:
    """Gapless stretches of a record with the memory that each begins with, as a model is compared on them; it knows how they are held."""
    if hold in (None, AUTO) and not record.states_hold:
        hold = model.hold
    found = gapless_records(aligned_by_reception(record, TOPICS), hold, start, allow_gaps=True)
    check_pair(name or model.name, model, found[0])
    return [with_beginning(data) for data in found]


def check_pair(name: str, model: Model, data: Record) -> list[str]:
    """Check that model and record have as many axes in the same units; a note where the names differ, which are matched in their order."""
    own, theirs = ", ".join(model.axes), ", ".join(data.axes)
    if len(model.axes) != len(data.axes):
        raise InputError(f"{name}: has the axes {own}, the record {data.name} {theirs}: use a model of this plant")
    if model.units != {"command": data.command_unit, "measurement": data.unit}:
        raise InputError(
            f"{name}: is in {model.units['measurement']} of {model.units['command']}, the record {data.name} in {data.unit} of "
            f"{data.command_unit}: use a model of this plant, or import the record with its units"
        )
    if own != theirs and set(model.axes) == set(data.axes):
        raise InputError(
            f"{name}: has the axes {own}, the record {data.name} {theirs}: import the record with its axes in that order"
        )
    return [] if own == theirs else [f"{data.name}: its axes {theirs} are taken for the axes {own} of {name}, in this order"]


def add_rows(table: Table, name: str, model: Model, data: Record) -> int:
    """Add the figures of one model on one record, as a whole and by frequency and amplitude; return the number of rows compared."""
    error = residual(model, data)
    skipped = len(data.command) - len(error)
    rest, _ = without_zero(error)
    for axis, row in enumerate(error_rows([data], [error])):
        where = f"{data.name} {row['axis']}" if len(data.axes) > 1 else data.name
        for quantity in ("nrmse_own_zero", "nrmse", "nrmse_centered", *SHAPES, "nme", "rmse"):
            unit = data.unit if quantity in (*SHAPES, "rmse") else "%"
            table.add("validation", where, name, quantity, unit, row[quantity], n=row["samples"])  # type: ignore[literal-required]
        outside = fraction_outside(model, data, axis)
        if outside > 0:
            table.add("validation", where, name, "outside_valid_command", "%", 100 * outside, n=row["samples"])
        for words, error_share, rows in by_motion(_motions(data, axis, rest[:, axis], skipped)):
            table.add(BY_MOTION, f"{where} {words}", name, "nrmse_own_zero", "%", 100 * error_share, n=rows)
    return len(error)


def _motions(data: Record, axis: int, error: Array, skipped: int) -> list[Motion]:
    """The motions between rests of one axis; error (N,): of the rows behind the first `skipped` ones, without the record's own zero."""
    found = []
    for stretch in stretches_between_rests(data, 0, axis):
        rows = slice(max(stretch.begin - skipped, 0), max(stretch.end - skipped, 0))
        span = float(np.ptp(data.measurement[stretch.begin : stretch.end, axis]))
        if stretch.kind == "motion" and rows.stop - rows.start >= 10 and span > 0:
            found.append(
                Motion(stretch.frequency, stretch.amplitude, span, float(np.sqrt(mean_square(error[rows]))), rows.stop - rows.start)
            )
    return found


def by_motion(motions: Sequence[Motion]) -> list[tuple[str, float, int]]:
    """Errors of motions of one frequency and amplitude, or, where there are more than `MAX_MOTIONS`, of one octave of each."""
    groups: dict[str, list[Motion]] = {}
    if len(motions) <= MAX_MOTIONS:
        for one in motions:
            groups.setdefault(f"{one.frequency:.4g} Hz, {one.amplitude:.4g} V", []).append(one)
    else:
        for one in sorted(motions, key=lambda each: (_octave(each.frequency), _octave(each.amplitude))):
            groups.setdefault(f"{_octave_text(one.frequency)} Hz, {_octave_text(one.amplitude)} V", []).append(one)
    found = []
    for words, alike in groups.items():
        rows = np.array([one.rows for one in alike])
        share = np.sqrt(rows @ np.array([(one.error / one.span) ** 2 for one in alike]) / rows.sum())
        found.append((words + f" ({len(alike)} motions)" * (len(alike) > 1), float(share), int(rows.sum())))
    return found


def _octave(value: float) -> int:
    """Power of two at or below a size."""
    return int(np.floor(np.log2(max(value, 1e-300))))


def _octave_text(value: float) -> str:
    """The octave of a size, from and to."""
    return f"{2.0 ** _octave(value):g}-{2.0 ** (_octave(value) + 1):g}"


def fraction_outside(model: Model, data: Record, axis: int) -> float:
    """Fraction of a record's command outside the range over which the model was fitted."""
    valid = model.valid.get("command")
    if valid is None:
        return 0.0
    lower, upper = np.array(valid, dtype=float).reshape(-1, 2)[axis if np.ndim(valid) == 2 else 0]
    slack = 1e-6 * (upper - lower)
    command = data.command[:, axis]
    outside = sum(
        int(np.count_nonzero((command[part] < lower - slack) | (command[part] > upper + slack))) for part in blocks(len(command))
    )
    return outside / len(command)


def _name(path: str | Path, among: Sequence[str | Path]) -> str:
    stem = Path(path).stem
    return stem if sum(Path(other).stem == stem for other in among) == 1 else str(path)
