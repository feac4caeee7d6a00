# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Linear dynamics of axes that drive each other, fitted to the spectra of their records.

A record is in general not periodic, so the transient at its ends is estimated with the model (see `modal_fit`); the static line is left
out, which frees the fit of each record's offset. A long record is taken in parts, as if they were records. The number of states is chosen
on held-out data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from hyst_control.base.arrays import Array
from hyst_control.identify.assess.assembly import fit_of
from hyst_control.identify.data.excited_band import REACH
from hyst_control.identify.data.fit import Fit, OrderRow
from hyst_control.identify.modal.linear_options import LinearOptions
from hyst_control.identify.modal.modal_candidate import Candidate, axis_fit, equations, error_of, information, refined
from hyst_control.identify.modal.modal_fit import subspace
from hyst_control.identify.modal.modal_model import ModalModel, Spectra
from hyst_control.records.record import Record
from hyst_control.records.stream.row_store import blocks

MAX_LINES = 6000
"""Largest number of lines of one record in a fit: those where the command is strongest.

Lines that it hardly reaches count, too: without them a mode could ring there as it liked, at the first jump of a command.
"""
WHOLE_ROWS, PART_ROWS = 2**22, 2**20
"""Rows of a record up to which its spectrum is taken as a whole, and of the parts of a longer one."""
PART_LINES, FEWEST_LINES = 4 * MAX_LINES, 200
"""Largest number of lines of all parts of a long record, and that of one part where there are very many."""
NEGLIGIBLE_IMPROVEMENT = 0.01
"""A model is preferred to a larger one that is better on held-out data by no more than this fraction of the error."""
NOTHING_HELD_OUT = (
    "No part of the records could be held out: the number of states was chosen by an information criterion. "
    "A second record, or a longer one with the same kind of excitation, would test it."
)
DRIFT_LAGS, DRIFT_ROWS = 64, 50_000
"""Taps of the response that stands for the plant, and rows at most to which it is fitted."""
WORTHWHILE_DRIFT = 0.03  # Least share of what that response leaves of a record that a drift explains, to be removed
DISTINCT = 0.2  # Share of a ramp that the command must not explain for a drift to be told from the plant's answer
COUPLED_ORDERS = (2, 4, 6, 8, 10, 12, 16, 20, 26, 32, 40)
UNSURE_DECAY = 1.0  # Standard deviation of the logarithm of a pole's decay from which the data do not determine it
TRIAL_ITERATIONS = 12  # Most steps of the refinement of a model that is compared


def fit(records: Sequence[Record], options: LinearOptions) -> Fit:
    """Identify one `state_space` of all axes."""
    chosen, table = _search(without_drift(records), options)
    found = axis_fit(chosen, records[0].sample_time)
    if all(row["held_out"] is None for row in table):
        found = replace(found, notes=lambda _: [NOTHING_HELD_OUT])
    more: dict[str, Any] = {"orders": table, "states": chosen.model.states}
    if np.isfinite(chosen.held_out):
        motion = np.sqrt(sum(len(data) * np.var(data.measurement, axis=0) for data in records) / sum(map(len, records)))
        more["held_out_nrmse"] = (100.0 * chosen.held_out * motion / np.max([data.span for data in records], axis=0)).tolist()
    return fit_of(records, [found], "linear", options.method, offset=0.0, by_axis=True, more=more)


def spectra_of_records(records: Sequence[Record]) -> list[Spectra]:
    """Take the spectra of records, of a long one those of its parts."""
    found = []
    for data in records:
        n = len(data.command)
        if n <= WHOLE_ROWS:
            found.append(spectra_of(data))
            continue
        parts = n // PART_ROWS
        size = n // parts & -1024  # a length whose transform is quick
        cuts = [data.rows(part * size, (part + 1) * size) for part in range(parts)]
        moving = [cut for cut in cuts if np.any(np.ptp(cut.command, axis=0) > 0)]
        found += [spectra_of(cut, most=max(PART_LINES // len(moving), FEWEST_LINES)) for cut in moving]
    return found


def spectra_of(data: Record, most: int = MAX_LINES) -> Spectra:
    """Take a record's discrete Fourier transform at the lines where the command has most power, except the static line.

    Scaled to the root of the number of samples, so that sums of squares are those of the samples.
    """
    command, measurement = data.command, data.measurement
    n = len(command)
    u = np.fft.rfft(command - command[0], axis=0) / np.sqrt(n / 2)
    y = np.fft.rfft(measurement - measurement[0], axis=0) / np.sqrt(n / 2)
    power = np.sum(np.abs(u / np.maximum(np.std(command, axis=0), 1e-300)) ** 2, axis=1)
    power[0] = 0.0
    if n % 2 == 0:
        power[-1] = 0.0
    lines = np.flatnonzero(power > 0.0)
    if len(lines) > most:
        lines = np.sort(lines[np.argsort(power[lines])[-most:]])
    return Spectra(2 * np.pi * lines / n, u[lines][:, :, None], y[lines][:, :, None], False)


def held_out_split(records: Sequence[Record]) -> tuple[list[Record], list[Record]]:
    """Divide records into those to fit and those to judge by: every third record, or a third of a single record, the last that moves.

    Of the longest record too, where the records to fit would have fewer rows than those to judge by. No data are held out when the rest
    would not excite every axis, or the held-out part would hardly move.
    """
    records = list(records)
    held = records[2::3] or records[1:]
    kept = [data for data in records if not any(data is other for other in held)]
    splits = [(kept, held)]
    if not held or sum(map(len, kept)) < sum(map(len, held)):
        longest = max(records, key=len)
        others = [data for data in records if data is not longest]
        edges = [number * len(longest) // 3 for number in range(4)]
        thirds = [longest.rows(*rows) for rows in pairwise(edges)]
        splits = [
            ([*others, longest.rows(0, edges[2])], thirds[2:]),
            ([*others, thirds[0], thirds[2]], thirds[1:2]),
            ([*others, longest.rows(edges[1], edges[3])], thirds[:1]),
        ]

    def motion(part: list[Record]) -> Array:
        found: Array = np.sqrt(sum(_mean_square_step(data.command) for data in part) / len(part))
        return found

    least = 0.2 * motion(records)
    for kept, held in splits:
        if np.all(motion(kept) >= least) and np.all(motion(held) >= least) and min(map(len, held)) >= 64:
            return kept, held
    return records, []


def _mean_square_step(command: Array) -> Array:
    """Mean square (A,) of the steps of a command (N, A), block by block."""
    total = np.zeros(command.shape[1])
    for part in blocks(len(command)):
        total += np.sum(np.diff(command[part.start : part.stop + 1], axis=0) ** 2, axis=0)
    return total / (len(command) - 1)


def negligible_improvement(held_out: Sequence[Spectra]) -> float:
    """Share of the error on held-out data by which a larger model has to be better; 0 without such data."""
    count = equations(held_out)
    # Of few data at least the standard error of the error: 1 / sqrt(2 E) of E equations with a white error.
    return max(NEGLIGIBLE_IMPROVEMENT, float(1.0 / np.sqrt(2.0 * count))) if count else 0.0


def beyond_reach(model: ModalModel, data: Sequence[Spectra]) -> bool:
    """Report whether a pole lies so far beyond the lines that were excited that the data cannot tell it from a delay or a direct path."""
    highest = max(float(spectra.angle.max()) for spectra in data)
    return bool(np.any(np.abs(model.poles) > REACH * highest))


def grown(model: ModalModel, data: Sequence[Spectra], order: int) -> ModalModel:
    """A model with the poles of what it leaves beside its own, up to an order."""
    left = [replace(each, measurement=each.measurement - model.response(each.angle) @ each.command) for each in data]
    more = subspace(left, [order - model.states], model.delay, model.hold, direct=False)[0]
    return replace(
        model,
        poles=np.concatenate([model.poles, more.poles]),
        outputs=np.vstack([model.outputs, more.outputs]),
        inputs=np.vstack([model.inputs, more.inputs]),
    )


def determined_poles(candidate: Candidate) -> NDArray[np.bool_]:
    """True for poles (n,) whose decay the data determine, which they do not for a mode that is made of noise."""
    index, spread = candidate.covariance()
    decays = candidate.layout.indices("pole", -1, 2)[:, 0]
    found: NDArray[np.bool_] = np.diag(spread)[np.isin(index, decays)] <= UNSURE_DECAY**2
    return found


def with_poles(model: ModalModel, kept: NDArray[np.bool_]) -> ModalModel:
    """A model with some of its poles."""
    return replace(model, poles=model.poles[kept], outputs=model.outputs[kept], inputs=model.inputs[kept])


def _search(records: Sequence[Record], options: LinearOptions) -> tuple[Candidate, list[OrderRow]]:
    """The smallest model that is as good as any on held-out data, fitted to all; growing ends after three orders without a gain."""
    first = records[0]
    inputs = len(first.axes)
    kept, held = held_out_split(records)
    train, test = spectra_of_records(kept), spectra_of_records(held)
    lines = sum(len(spectra.angle) * inputs for spectra in train)
    orders: Sequence[int] = [options.order] if options.order else COUPLED_ORDERS
    orders = [order for order in orders if order * 2 * inputs + inputs * inputs < lines] or [1]
    # Delay, direct path, and whether the delay is free. It can be separated from the modes' own lag where the model is strictly
    # proper; the direct path would take its place.
    variants = [(np.zeros(inputs), options.direct, False)]
    if options.delay == "estimate":
        late = dead_time(train, first.hold)
        variants += [(delay, False, True) for delay in ([late, 0.5 * late] if np.any(late) else [late + 0.25])]
    else:
        variants = [(np.full(inputs, float(options.delay) / first.sample_time), options.direct, False)]
    starts = [subspace(train, orders, delay, first.hold, direct) for delay, direct, _ in variants]
    negligible = negligible_improvement(test)
    rows: list[OrderRow] = []
    tried: list[tuple[float, int, Candidate]] = []
    lowest, stale = np.inf, 0
    for index, order in enumerate(orders):
        fresh = [
            (number, refined(train, starts[number][index], direct, free, TRIAL_ITERATIONS))
            for number, (_, direct, free) in enumerate(variants)
        ]
        if tried:
            _, number, smaller = min(tried, key=lambda each: each[0])
            if order > smaller.model.states and min(each.fitted for _, each in fresh) > smaller.fitted:
                # A larger model fits no worse than a smaller one from where that ended.
                fresh.append((number, refined(train, grown(smaller.model, train, order), *variants[number][1:], TRIAL_ITERATIONS)))
        # The best one is fitted to the end: what it has not reached yet would count for the next order.
        number, best = min(fresh, key=lambda each: each[1].fitted)
        fresh.append((number, refined(train, best.model, *variants[number][1:], options.iterations)))
        sure = determined_poles(fresh[-1][1])
        if options.order is None and np.any(sure) and not np.all(sure):  # without its noise it may be the best one of fewer states
            fresh.append((number, refined(train, with_poles(fresh[-1][1].model, sure), *variants[number][1:], options.iterations)))
        for number, candidate in fresh:
            candidate = replace(candidate, held_out=error_of(candidate.model, test) if test else np.nan)
            rows.append(
                {
                    "order": order,
                    "states": candidate.model.states,
                    "parameters": candidate.model.parameters,
                    "fitted": candidate.fitted,
                    "held_out": candidate.held_out if test else None,
                    "seconds": candidate.seconds,
                    "delay_samples": [float(value) for value in candidate.model.delay],
                }
            )
            if not index or (np.all(determined_poles(candidate)) and not beyond_reach(candidate.model, train)):
                tried.append((candidate.held_out if test else information(candidate, train), number, candidate))
        before, lowest = lowest, min(score for score, _, _ in tried)
        stale = stale + 1 if np.isfinite(before) and lowest >= before - negligible * abs(before) else 0
        if stale >= 3:
            break
    good = [each for each in tried if each[0] <= lowest + negligible * abs(lowest)]
    _, number, chosen = min(good, key=lambda each: (each[2].model.parameters, each[1]))
    final = refined(spectra_of_records(records), chosen.model, *variants[number][1:], options.iterations)
    return replace(final, held_out=chosen.held_out), rows


def dead_time(data: Sequence[Spectra], hold: str, order: int = 3) -> Array:
    """Find the delay, the same for all inputs, at which a model of few states without a direct path fits best."""
    inputs = data[0].command.shape[1]
    grid = [0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0]
    costs = []
    for late in grid:
        model = subspace(data, [order * inputs], np.full(inputs, late), hold, direct=False)[0]
        costs.append(refined(data, model, False, False, 4).fitted)
    return np.full(inputs, grid[int(np.argmin(costs))])


def without_drift(records: Sequence[Record]) -> list[Record]:
    """Remove the drift of every record in which it shows.

    A slow ramp has power at every low frequency, where a linear model takes it for poles of the plant.
    """
    cleaned = []
    for data in records:
        slope = drift(data.command, data.measurement)
        ramp = np.linspace(-1.0, 1.0, len(data.command))[:, None] * slope
        cleaned.append(data.with_values(measurement=data.measurement - ramp) if np.any(slope) else data)
    return cleaned


def drift(command: Annotated[Array, "N A"], measurement: Annotated[Array, "N A"]) -> Annotated[Array, "A"]:
    """Drift of a record, beside what follows the command."""
    lags = min(DRIFT_LAGS, max(len(command) // 8, 1))
    rows = np.unique(np.linspace(lags, len(command) - 1, min(DRIFT_ROWS, len(command) - lags)).astype(int))
    taps = [command[rows - lag] for lag in range(lags)]
    time = (2.0 * rows / (len(command) - 1) - 1.0)[:, None]
    plain = np.hstack([*taps, np.ones((len(rows), 1))])
    # The ramp, and the measurement, without what the command and a constant explain of them.
    left = np.hstack([time, measurement[rows]])
    left = left - plain @ np.linalg.lstsq(plain, left, rcond=1e-9)[0]
    ramp, rest = left[:, 0], left[:, 1:]
    energy = float(ramp @ ramp)
    if energy < DISTINCT * float(np.sum((time - time.mean()) ** 2)):
        return np.zeros(measurement.shape[1])
    slope = ramp @ rest / energy
    explained = slope**2 * energy
    found: Array = np.where(explained > WORTHWHILE_DRIFT * np.sum(rest**2, axis=0), slope, 0.0)
    return found
