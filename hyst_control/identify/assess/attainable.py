# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of a fit against those of two flexible references on the same rows, and what the rest follows.

The references are a linear model of order 8 and play operators with a cubic, each fitted to the rows on which the model does worst. White
noise is taken off all errors, so that only what has a shape counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.identify.assess.fit_report import noise_sigma
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

    def text(self) -> str:
        """As one line."""
        rest = f"the command's {self.follows} ({100 * self.share:.0f} % of it)" if self.follows else "nothing that the command does"
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
    plays = np.column_stack([_plays(data, axis, first + rows.start, len(command)), _powers(command)])
    by_poles = f"a linear model of order {len(linear.poles) + np.count_nonzero(linear.poles.imag)}"
    references = {
        by_poles: linear.error,
        "a chain of play operators with a cubic": _mean_square_left(plays, measurement),
    }
    best = min(references, key=lambda each: references[each])
    reference = float(np.sqrt(max(references[best] - noise, 0.0))) / span
    own = float(np.sqrt(max(mean_square(error[rows]) - noise, 0.0))) / span
    if left <= MUCH and own <= BETTER * reference:
        return None
    rate = np.gradient(command)
    causes = {
        "level": plays,
        "rate": np.column_stack([rate, np.abs(rate), rate * command, np.abs(rate) * command]),
        "frequency": np.column_stack(driven(window, linear.poles)),
    }
    power = float(np.var(error[rows]))
    shares = {each: 1.0 - _mean_square_left(columns, error[rows]) / power for each, columns in causes.items()}
    most = max(shares, key=lambda each: shares[each])
    return Poor(name, own, reference, best, most if shares[most] > 0.3 else "", shares[most], best == by_poles, len(error) > ROWS)


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


def _plays(data: Record, axis: int, begin: int, count: int) -> Array:
    """Play operators (count, n) of the command from a row on, from all that came before."""
    memory, _ = before(data)
    command = data.command[: begin + count, axis]
    command = command if memory is None else np.concatenate([memory[:, axis], command])
    reach = 0.5 * float(np.ptp(data.command[:, axis]))
    thresholds = reach * (np.arange(OPERATORS) / OPERATORS) ** 1.4
    return followed(np.ascontiguousarray(command), thresholds, np.zeros(OPERATORS), np.arange(len(command) - count, len(command)))


def _powers(command: Array) -> Array:
    scaled = (command - command.mean()) / np.ptp(command)
    return np.column_stack([scaled**2, scaled**3])


def _mean_square_left(columns: Array, target: Array) -> float:
    """Mean square of a target that columns, an offset and a drift leave."""
    rows = np.arange(len(target)) / len(target)
    table = np.column_stack([columns, np.ones(len(rows)), rows])
    table = table / np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    return mean_square(target - table @ np.linalg.lstsq(table, target, rcond=1e-9)[0])
