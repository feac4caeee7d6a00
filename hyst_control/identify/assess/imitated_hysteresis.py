# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Hysteresis that linear dynamics imitate: many slow poles follow its loops on the record they were fitted to, and on no other one.

Beside the outputs of the model's own poles, play operators are fitted to the record. A linear machine needs none of them. Where they
leave far less, the loops are no matter of the poles; where they alone leave as little, the record does not tell one from the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.signal import lfilter

from hyst_control.base.arrays import Array, Integers
from hyst_control.chain.linear.linear_stages import Delay
from hyst_control.identify.assess.attainable import LITTLE, ROWS, mean_square_left, plays, powers
from hyst_control.identify.assess.fit_report import is_linear, noise_sigma
from hyst_control.identify.assess.free_motion import ending_dynamics
from hyst_control.identify.data.fit_windows import before
from hyst_control.identify.data.initial_memory import OPERATORS
from hyst_control.model_file import Model
from hyst_control.records.record import Record

AS_LITTLE, WELL = 1.25, 0.1 * LITTLE
"""Ratio of mean squares, and share of the range, up to which play operators alone count as good an explanation as the model."""
MOST_ROWS = 2**20  # First rows of a longer record that are looked at
HALF = 0.5  # Share of what the model leaves, beside white noise, that play operators beside it take


@dataclass(frozen=True)
class Imitation:
    """An axis whose linear model stands for a hysteresis, or may; shares of the range."""

    axis: str
    loops: float  # Width of the hysteresis
    left: float  # By the model, beside white noise
    beside: float  # By the model with play operators beside it
    surely: bool  # Otherwise play operators alone explain the record as well

    def text(self) -> str:
        """As one line."""
        loops = f"hysteresis with loops of {100 * self.loops:.2g} % of the range"
        if self.surely:
            return (
                f"{self.axis}: explains poorly: the linear dynamics imitate a {loops}: play operators beside them leave "
                f"{100 * self.beside:.2g} % of the range, the dynamics alone {100 * self.left:.2g} %: identify with --model hapi"
            )
        return (
            f"{self.axis}: a {loops} explains this record as well, and would answer other commands differently: "
            "record loops of other sizes and rates, or compare with --model hapi"
        )


def imitated_hysteresis(model: Model, records: Sequence[Record], errors: Sequence[Array]) -> list[Imitation]:
    """Axes on which a linear model stands for a hysteresis; errors (N, A): of the last N rows of each record."""
    if not is_linear(model):
        return []
    found = []
    for axis in range(len(model.axes)):
        each = [one for data, error in zip(records, errors, strict=True) if (one := _imitation(model, data, error[:, axis], axis))]
        found += sorted(each, key=lambda one: (one.surely, one.loops))[-1:]
    return found


def _imitation(model: Model, data: Record, error: Annotated[Array, "N"], axis: int) -> Imitation | None:
    span, first = float(data.span[axis]), len(data.command) - len(error)
    error = error[:MOST_ROWS]
    count = len(error)
    data = data.rows(0, first + count)
    delays = [np.broadcast_to(stage.tau, len(model.axes))[axis] for stage in model.chain.stages if isinstance(stage, Delay)]
    late = round(sum(delays) / data.sample_time)
    if not (span > 0.0 and np.ptp(data.command[:, axis]) > 0.0 and count > ROWS // 64 + late):
        return None
    rows = np.unique(np.linspace(max(late - first, 0), count - 1, min(count, ROWS)).astype(np.int64))
    measured, operators = data.measurement[first + rows, axis], plays(data, axis, first + rows - late)
    own = np.column_stack([_pole_outputs(model, data, axis, first + rows - late), measured - error[rows]])
    noise = noise_sigma([error[:, None]])[0] ** 2
    alone, linear, both = (
        mean_square_left(columns, measured)
        for columns in (np.column_stack([operators, powers(operators[:, 0])]), own, np.column_stack([operators, own]))
    )
    gain, chance = linear - both, both * (OPERATORS + 3.0 * np.sqrt(2.0 * OPERATORS)) / len(rows)
    excess = linear - noise  # the fit of a linear machine leaves noise, of which operators take some by chance
    surely = min(gain, excess) > chance and gain > HALF * excess
    loops = _loops(operators, own if surely else powers(operators[:, 0]), measured) / span
    if loops < LITTLE or not (surely or alone < max(AS_LITTLE * linear, noise + (WELL * span) ** 2)):
        return None
    left, beside = (float(np.sqrt(max(each - noise, 0.0))) / span for each in (linear, both))
    return Imitation(data.axes[axis], loops, left, beside, surely)


def _pole_outputs(model: Model, data: Record, axis: int, rows: Integers) -> Annotated[Array, "R n"]:
    """Responses of the dynamics' poles to the command at some rows, from rest before the record."""
    running = ending_dynamics(model, data.sample_time, data.hold)
    memory, _ = before(data)
    command = data.command[:, axis] if memory is None else np.concatenate([memory[:, axis], data.command[:, axis]])
    at = rows + len(command) - len(data.command)
    columns = [command[at]]
    if running is not None:
        for pole in np.linalg.eigvals(running.a[axis if len(running.a) > 1 else 0]):
            if pole.imag >= 0.0:
                output = lfilter([0.0, 1.0 - abs(pole)], [1.0, -pole], command - command[0])[at]
                columns += [output.real, output.imag][: 1 + bool(pole.imag)]
    return np.column_stack(columns)


def _loops(operators: Annotated[Array, "R n"], others: Annotated[Array, "R m"], measured: Annotated[Array, "R"]) -> float:
    """Width of the loops that play operators make beside other columns: what no cubic of the command follows."""
    level = operators[:, 0]
    table = np.column_stack([operators, others, np.ones(len(level)), np.arange(len(level))])
    scale = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    weights = np.linalg.lstsq(table / scale, measured, rcond=1e-9)[0] / scale
    memory = operators[:, 1:] @ weights[1:OPERATORS]
    curve = np.column_stack([level, powers(level), np.ones(len(level))])
    return float(np.ptp(memory - curve @ np.linalg.lstsq(curve, memory, rcond=None)[0]))
