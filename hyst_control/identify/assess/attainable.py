# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of a fit against those of two flexible references on the same rows, and what the rest follows.

The references are a linear model of order 8 and play operators with a cubic, each fitted to the rows on which the model does worst. White
noise is taken off all errors, so that only what has a shape counts. Where the parts of a record answer alike commands differently, no
reference of some rows says what is possible: what is left then follows time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Complex, Integers
from hyst_control.identify.assess.fit_report import lag_one, noise_sigma
from hyst_control.identify.data.fit_windows import before
from hyst_control.identify.data.initial_memory import OPERATORS, followed
from hyst_control.identify.modal.vector_fitting import Partial, driven, residues_of, spread_poles, vector_fit
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.records.record import Record
from hyst_control.records.session_zero import without_zero
from hyst_control.records.stream.row_store import mean_square

ROWS, ORDER = 2**13, 8  # Rows that are compared, and order of the linear reference
DIES = 3.0  # Factors of e by which an oscillation of the linear reference decays over these rows, at least
LITTLE, MUCH, BETTER = 0.01, 0.05, 2.0
"""Shares of the range: less is no reason to look further, more is poor whatever the references leave; and how much less they leave."""


PARTS, ALIKE, MEAN_APART = 4, 1.3, 0.3
"""Parts of a record whose answers are compared, up to which ratio of their commands' ranges and speeds, and how far apart, in their range,
their means may lie."""
MIN_PART = 256  # Rows of a part
FOLLOWS, CHANGES = 0.3, 0.5
"""Share of the rest that follows a cause, and what is left of it by an answer for each part, in that left by one answer for all."""
WHITE = 0.1  # Correlation of neighboring residuals up to which they are white noise


@dataclass(frozen=True)
class Poor:
    """An axis that a model explains poorly: shares of the range that it and the better reference leave on its worst rows, and why."""

    axis: str
    left: float
    reference: float
    reference_name: str
    follows: str
    share: float
    linear: bool  # The reference is linear
    worst: bool  # The rows are not all
    gains: tuple[float, ...] = ()  # Of the parts of the record, in the model's, where what is left follows time

    def text(self) -> str:
        """As one line."""
        rest = f"the command's {self.follows} ({100 * self.share:.0f} % of it)" if self.follows else "nothing that the command does"
        if self.gains:
            several = ", ".join(f"{gain:.3g}" for gain in self.gains)
            rest = (
                f"time ({100 * self.share:.0f} % of it): the gains of the record's {PARTS} parts are {several} times the model's: "
            )
            rest += "identify them one by one (hyst edit --from, --to)"
        where = " on the worst rows" if self.worst else ""
        if self.left > BETTER * self.reference:  # a poor reference says nothing of what is possible
            where += f"{',' * self.worst} where {self.reference_name} leaves {100 * self.reference:.2g} %"
        return f"{self.axis}: explains poorly: {100 * self.left:.2g} % of the range is left{where}: what is left follows {rest}"


def poorly_explained(records: Sequence[Record], errors: Sequence[Array]) -> list[Poor]:
    """Axes of which a model leaves much, or much more than a reference; errors (N, A): of the last N rows of each record."""
    found = []
    cleaned = [without_zero(error)[0] for error in errors]
    for axis, name in enumerate(records[0].axes):
        columns, spans = [error[:, axis] for error in cleaned], [float(data.span[axis]) for data in records]
        left = max(map(_share_left, columns, spans))
        # A sweep passes a mode in few rows of a long record: where the error is small as a whole, those in which it changes most count.
        rows = [_worst_rows(column if left > LITTLE else np.diff(column)) for column in columns]
        shares = [_share_left(column[own], span) for column, own, span in zip(columns, rows, spans, strict=True)]
        worst = int(np.argmax(shares))
        if shares[worst] > LITTLE:
            poor = _compared(records[worst], columns[worst], rows[worst], axis, name, left)
            found += [poor] if poor is not None else []
    return found


def leaves_noise(records: Sequence[Record], errors: Sequence[Array], share: float) -> bool:
    """True where errors beyond a share of the range are white noise on every axis, so that no model leaves clearly less.

    errors (N, A): of the last N rows of each record.
    """

    def is_noise(error: Array, span: float) -> bool:
        is_small = float(np.sqrt(mean_square(error))) <= share * span
        return is_small or (_share_left(error, span) <= share and abs(lag_one(error)) <= WHITE)

    cleaned = [without_zero(error)[0] for error in errors]
    return all(
        is_noise(error[:, axis], float(data.span[axis]))
        for data, error in zip(records, cleaned, strict=True)
        for axis in range(len(data.axes))
    )


def _share_left(error: Array, span: float) -> float:
    """Rms of an error beside its white noise, as a share of the range; 0 where there is none."""
    sigma = noise_sigma([error[:, None]])[0] if len(error) > 3 else 0.0
    return float(np.sqrt(max(mean_square(error) - sigma**2, 0.0))) / span if span > 0.0 else 0.0


def _compared(data: Record, error: Array, rows: slice, axis: int, name: str, left: float) -> Poor | None:
    first = len(data.command) - len(error)
    command, measurement = data.command[first:, axis][rows], data.measurement[first:, axis][rows]
    noise, span = noise_sigma([error[rows, None]])[0] ** 2, float(data.span[axis])
    if not np.ptp(command) > 0.0:
        return None
    window = Window(command, measurement, data.sample_time, data.hold, 0, 0)
    linear = _linear_reference(window)
    operators = np.column_stack([plays(data, axis, first + np.arange(rows.start, rows.stop)), powers(command)])
    worst = len(error) > ROWS
    alone = " of these rows alone" if worst else ""
    by_poles = f"a linear model of order {len(linear.poles) + np.count_nonzero(linear.poles.imag)}{alone}"
    references = {
        by_poles: linear.error,
        f"a chain of play operators with a cubic{alone}": mean_square_left(operators, measurement),
    }
    best = min(references, key=lambda each: references[each])
    reference = float(np.sqrt(max(references[best] - noise, 0.0))) / span
    own = float(np.sqrt(max(mean_square(error[rows]) - noise, 0.0))) / span
    changing = _follows_time(data, error, axis, linear.poles, float(np.var(error[rows])))
    if left <= MUCH and own <= BETTER * reference and not changing:
        return None
    rate = np.gradient(command)
    causes = {
        "level": operators,
        "rate": np.column_stack([rate, np.abs(rate), rate * command, np.abs(rate) * command]),
        "frequency": np.column_stack(driven(window, linear.poles)),
    }
    power = float(np.var(error[rows]))
    shares = {each: 1.0 - mean_square_left(columns, error[rows]) / power for each, columns in causes.items()}
    most = max(shares, key=lambda each: shares[each])
    if changing and changing > max(shares["level"], shares["rate"]):
        return Poor(name, own, own, best, "time", changing, False, worst, _gains(data, error, axis))
    if left <= MUCH and own <= BETTER * reference:
        return None
    return Poor(name, own, reference, best, most if shares[most] > FOLLOWS else "", shares[most], best == by_poles, worst)


def _follows_time(data: Record, error: Array, axis: int, poles: Complex, worst: float) -> float:
    """Share of an error (N,) that an answer for each part of the record makes, far more than one for all.

    0 where the commands of the parts differ, or where much less is left than on the worst rows, of variance `worst`.
    """
    first = len(data.command) - len(error)
    parts = [slice(part[0], part[-1] + 1) for part in np.array_split(np.arange(len(error)), PARTS) if len(part) >= MIN_PART]
    commands = [data.command[first:, axis][part] for part in parts]
    if len(parts) < PARTS or not _alike(commands):
        return 0.0
    tables, rests = [], []
    for command, part in zip((each[:ROWS] for each in commands), parts, strict=True):
        window = Window(command, command, data.sample_time, data.hold, 0, 0)
        shapes = np.column_stack([np.ones(len(command)), np.linspace(-1.0, 1.0, len(command))])
        both = np.column_stack([*driven(window, poles, direct=True), error[part][:ROWS]])
        both -= shapes @ np.linalg.lstsq(shapes, both, rcond=None)[0]
        tables.append(both[:, :-1])
        rests.append(both[:, -1])
    whole = float(sum(rest @ rest for rest in rests))
    if whole < sum(map(len, rests)) * worst / BETTER**2:
        return 0.0
    by_part = sum(_square_left(table, rest) for table, rest in zip(tables, rests, strict=True))
    for_all = _square_left(np.concatenate(tables), np.concatenate(rests))
    share = 1.0 - by_part / max(whole, 1e-300)
    return share if share > FOLLOWS and by_part < CHANGES * for_all else 0.0


def _alike(commands: Sequence[Array]) -> bool:
    """True of commands (N,) of about the same range, mean and speed: a machine that does not change answers them alike."""
    ranges, speeds = ([float(np.std(each)) for each in values] for values in (commands, map(np.diff, commands)))
    means = [float(np.mean(each)) for each in commands]
    apart = max(means) - min(means) < MEAN_APART * min(float(np.ptp(each)) for each in commands)
    return apart and all(0.0 < max(each) <= ALIKE * min(each) for each in (ranges, speeds))


def _gains(data: Record, error: Array, axis: int) -> tuple[float, ...]:
    """Least-squares gain of the measurement over the model's output, for each part of a record."""
    measured = np.array_split(data.measurement[len(data.measurement) - len(error) :, axis], PARTS)
    models = [values - part for values, part in zip(measured, np.array_split(error, PARTS), strict=True)]
    about = [(model - model.mean(), values) for model, values in zip(models, measured, strict=True)]
    return tuple(float(model @ values) / max(float(model @ model), 1e-300) for model, values in about)


def _linear_reference(window: Window) -> Partial:
    """A linear model without poles that ring through all rows: these would imitate a hum."""
    rows = len(window.command)
    found = vector_fit([window], spread_poles(min(ORDER, rows // 16), rows), 0.0, True, relocations=4)
    dying = found.poles[(found.poles.imag == 0.0) | (-found.poles.real * rows > DIES)]
    return found if len(dying) == len(found.poles) else residues_of([window], dying, 0.0, True)


def _worst_rows(error: Array) -> slice:
    """The `ROWS` rows with the largest square error."""
    if len(error) <= ROWS:
        return slice(0, len(error))
    energy = np.concatenate([[0.0], np.cumsum(np.square(error))])
    begins = np.append(np.arange(0, len(error) - ROWS, ROWS // 4), len(error) - ROWS)
    begin = int(begins[np.argmax(energy[begins + ROWS] - energy[begins])])
    return slice(begin, begin + ROWS)


def plays(data: Record, axis: int, rows: Integers) -> Annotated[Array, "R n"]:
    """Play operators of the command at some rows, from all that came before; the first one is the command."""
    memory, _ = before(data)
    command, reach = data.command[: rows[-1] + 1, axis], 0.5 * float(np.ptp(data.command[:, axis]))
    if memory is not None:
        command, rows = np.concatenate([memory[:, axis], command]), rows + len(memory)
    thresholds = reach * (np.arange(OPERATORS) / OPERATORS) ** 1.4
    return followed(np.ascontiguousarray(command), thresholds, np.zeros(OPERATORS), rows)


def powers(command: Array) -> Array:
    """Square and cube of a command."""
    scaled = (command - command.mean()) / np.ptp(command)
    return np.column_stack([scaled**2, scaled**3])


def _square_left(columns: Array, target: Array) -> float:
    """Sum of the squares of a target that columns leave."""
    table = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    rest = target - table @ np.linalg.lstsq(table, target, rcond=1e-9)[0]
    return float(rest @ rest)


def mean_square_left(columns: Array, target: Array) -> float:
    """Mean square of a target that columns, an offset and a drift leave."""
    rows = np.arange(len(target)) / len(target)
    return _square_left(np.column_stack([columns, np.ones(len(rows)), rows]), target) / len(target)
