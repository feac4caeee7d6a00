# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Signals whose sample times are put on the ticks of one regular clock, or interpolated on them where the caller wishes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hyst_control.base.arrays import Array, Integers, Mask
from hyst_control.base.errors import InputError, Loss
from hyst_control.records.record import Signal, commonest_step, regular_times
from hyst_control.records.stream.row_store import blocks
from hyst_control.records.tables.sample_grid import LONGEST_FILLED, Grid, find_grid, gap_remedies, interpolation_error, resampled

OWN_RATE = 0.0  # Rate to resample to that stands for the signals' own
SHORTEST_RUN = 10  # Rows of a run from which a time that starts again begins a new record, and is no disorder

LATEST = 20.0
"""Steps by which messages may be received beside their ticks: they come in bursts, but none is thought to be lost."""

MAX_RUNS = 100
ROWS_REMEDY = "choose rows in which it does, or leave the time out and give the rate"
ROUNDING = 1e-6  # Relative error of times that count as equal
RATES_DIFFER = 0.01
TOLD_DEVIATION = 0.01  # Steps by which times may lie beside their ticks without a note


def runs_of(where: str, time: Array, rows: Sequence[int] | Integers, gaps: bool) -> list[slice]:
    """The runs within times (N,) that start again, and with `gaps` those apart by long gaps; `rows` (N,) are the rows' numbers."""
    longest = LONGEST_FILLED * commonest_step(time) if gaps and len(time) > 1 else np.inf
    edges: list[int] = []
    for part in blocks(max(len(time) - 1, 0)):
        steps = np.diff(time[part.start : part.stop + 1])
        edges += (part.start + 1 + np.flatnonzero((steps < 0.0) | (steps > max(longest, 0.0)))).tolist()
    bounds = [0, *edges, len(time)]
    if len(bounds) > 2 and (len(bounds) - 1 > MAX_RUNS or min(np.diff(bounds)) < SHORTEST_RUN):
        if not (back := [edge for edge in edges if time[edge] < time[edge - 1]]):
            raise InputError(
                f"{where}: time: gaps of more than {LONGEST_FILLED - 1} rows, the first before row {rows[edges[0]]}, leave "
                f"{len(edges) + 1} parts, the shortest of {min(np.diff(bounds))} rows: --resample takes at most {MAX_RUNS} parts of at "
                f"least {SHORTEST_RUN} rows: choose rows beside the gaps (--rows), or give --allow-gaps in its place"
            )
        more = f" and {len(back) - 1} more" if len(back) > 1 else ""
        raise InputError(f"{where}: time: does not increase in row {rows[back[0]]}{more}: {ROWS_REMEDY}")
    return [slice(first, last) for first, last in zip(bounds, bounds[1:], strict=False)]


def restarts(time: Array | Integers) -> list[int]:
    """Rows at which times (N,) in the order of arrival fall by many rows and go on from there; not those that are a few places late."""
    falls = 1 + np.flatnonzero(np.diff(time) < 0.0)
    near = np.arange(SHORTEST_RUN)
    before = np.median(time[np.maximum(falls[:, None] - 1 - near, 0)], axis=1)  # which a single row elsewhere does not move
    after = np.median(time[np.minimum(falls[:, None] + near, len(time) - 1)], axis=1)
    return [int(row) for row in falls[after < before]]


def without_repeated(where: str, time: Array, values: list[Array], begin: int, remedy: str = ROWS_REMEDY) -> Mask | None:
    """Mask (N,) of the rows that do not repeat the row before them, its time included; None where all are kept."""
    parts = blocks(len(time) - 1)
    again = np.concatenate(
        [part.start + 1 + np.flatnonzero(np.diff(time[part.start : part.stop + 1]) == 0.0) for part in parts] or [[]]
    )
    again = again.astype(int)
    if not len(again):
        return None
    alike = [np.isclose(array[again], array[again - 1], 0.0, 0.0, equal_nan=True) for array in values]
    same = np.all([each.all(axis=1) for each in alike], axis=0)
    if not same.all():
        if find_grid(time) is None:
            raise InputError(
                f"{where}: time: does not increase in row {begin + int(again[np.argmin(same)])}: another row has the same time: {remedy}"
            )
        return None
    kept = np.ones(len(time), dtype=bool)
    kept[again] = False
    return kept


def on_one_clock(
    where: str, signals: Mapping[str, Signal], hold: str, resample: float | None = None, allow_gaps: bool = False
) -> tuple[dict[str, Signal], list[str]]:
    """Signals on the ticks of one clock, from 0 on, and notes on what was done for it.

    Times that lie near ticks are put on them. Irregular ones, gaps and several rates are refused, or interpolated at the rate
    `resample` (Hz, or `OWN_RATE`); with `allow_gaps` missing ticks stay missing. Raises `InputError` naming the remedy.
    """
    if resample is not None and not 0.0 <= resample < np.inf:
        raise InputError(f"{where}: resample: must be a rate in Hz, got {resample:g}")
    grids = {id(signal.time): _grid(where, topic, signal) for topic, signal in signals.items()}
    by_topic = {topic: grids[id(signal.time)] for topic, signal in signals.items()}
    known = [grid for grid in by_topic.values() if grid is not None]
    if resample is None and len(known) == len(by_topic):
        return _at_ticks(where, signals, {topic: grid for topic, grid in by_topic.items() if grid is not None}, allow_gaps)
    if resample is None:
        topic = next(topic for topic, grid in by_topic.items() if grid is None)
        steps = np.diff(signals[topic].time)
        usual, longest = float(np.median(steps)), int(np.argmax(steps))
        raise InputError(
            f"{where}: time: is irregular: steps of {steps.min():.3g} to {steps[longest]:.3g} s, the longest before its row "
            f"{longest + 1}, after {signals[topic].time[longest] - signals[topic].time[0]:.6g} s: "
            + (
                f"--resample interpolates it at {1.0 / usual:.4g} Hz, with an error that it tells"
                if steps[longest] <= LONGEST_FILLED * usual
                else "the clock jumped or rows are missing: of a table, --rows takes one side, --resample makes a record of each"
            )
        )
    return _interpolated(where, signals, by_topic, hold, resample)


def _grid(where: str, topic: str, signal: Signal) -> Grid | None:
    """The grid of a signal; times of reception are taken as consecutive where they are too late for their ticks."""
    if len(signal.time) < 2:
        raise InputError(f"{where}: {topic}: {len(signal.time)} samples, at least two are needed")
    grid = find_grid(signal.time)
    return find_grid(signal.time, LATEST) if grid is None and signal.timing == "receive" else grid


def _at_ticks(
    where: str, signals: Mapping[str, Signal], grids: dict[str, Grid], allow_gaps: bool
) -> tuple[dict[str, Signal], list[str]]:
    first_topic, longest = max(grids.items(), key=lambda item: len(signals[item[0]].time))
    step, origin = longest.step, min(grid.origin for grid in grids.values())
    notes: list[str] = []
    found: dict[str, Signal] = {}
    times: dict[int, Array] = {}
    for topic, grid in grids.items():
        signal = signals[topic]
        if abs(grid.step - step) > RATES_DIFFER * step:
            raise InputError(
                f"{where}: {topic} has {1.0 / grid.step:.6g} samples/s, {first_topic} {1.0 / step:.6g}: record both at one rate, or let "
                "--resample interpolate"
            )
        if id(signal.time) not in times:
            if grid.missing:
                notes.append(_refuse_gaps(where, signal.time, grid, allow_gaps))
            if grid.deviation > TOLD_DEVIATION * step:
                notes.append(
                    f"{where}: time: lies up to {grid.deviation:.2g} s beside the ticks of {1.0 / step:.6g} Hz, which stand for it"
                )
            shift = int(np.rint((grid.origin - origin) / step))
            own = regular_times(len(signal.time), step, shift) if grid.ticks is None else (grid.ticks + shift) * step
            times[id(signal.time)] = np.asarray(own, dtype=np.float64)
        timing = "layout" if grid.missing else signal.timing  # ticks that are known to be missing are no jitter
        found[topic] = replace(signal, time=times[id(signal.time)], timing=timing)
    return found, notes


def _refuse_gaps(where: str, time: Array, grid: Grid, allow_gaps: bool) -> Loss:
    """The note on missing ticks, or the refusal of them."""
    assert grid.ticks is not None
    gaps = np.flatnonzero(np.diff(grid.ticks) > 1)
    after = f"after {float(time[gaps[0]] - time[0]):.6g} s"
    rows = "1 row is missing" if grid.missing == 1 else f"{grid.missing} rows are missing"
    text = f"{where}: time: {rows}, {after if len(gaps) == 1 else f'in {len(gaps)} gaps, the first {after}'}"
    if allow_gaps:
        return Loss(f"{text}: what needs equal steps uses the stretches between (identify --allow-gaps)")
    remedies = gap_remedies(bool(np.diff(grid.ticks).max() <= LONGEST_FILLED), "them")
    raise InputError(f"{text}: {remedies}, or choose rows between them (--rows)")


def _interpolated(
    where: str, signals: Mapping[str, Signal], grids: Mapping[str, Grid | None], hold: str, rate: float
) -> tuple[dict[str, Signal], list[str]]:
    steps = {topic: grid.step if grid else float(np.median(np.diff(signals[topic].time))) for topic, grid in grids.items()}
    own = min(steps.values())
    step = 1.0 / rate if rate else own
    if step > 2.0 * own:
        raise InputError(f"{where}: resample: {rate:g} Hz is below half of {1.0 / own:.4g} Hz: faster parts would be aliased")
    clocks = {topic: _clock(signal, grids[topic]) for topic, signal in signals.items()}
    known = {topic: clocks[topic][np.isfinite(signal.values).all(axis=1)] for topic, signal in signals.items()}
    for topic, time in known.items():
        if len(time) < 2:
            raise InputError(f"{where}: {topic}: fewer than two rows hold finite numbers: choose another column")
        longest = float(np.diff(time).max())
        if longest > LONGEST_FILLED * (1.0 + ROUNDING) * steps[topic]:
            raise InputError(f"{where}: {topic}: a gap of {longest:.3g} s is too long to interpolate: choose rows beside it")
    begin, last = max(float(time[0]) for time in known.values()), min(float(time[-1]) for time in known.values())
    count = int(np.floor((last - begin) / step + ROUNDING)) + 1
    due = regular_times(max(count, 0), step)
    if count < 2:
        raise InputError(f"{where}: {' and '.join(signals)} are not of one time: they share no two samples")
    found, missed = {}, []
    for topic, signal in signals.items():
        held = hold == "zoh" and topic not in ("measurement", "reference")
        values = resampled(clocks[topic], signal.values, begin + due, step, held)
        found[topic] = replace(signal, time=due, values=values, timing="layout")
        if not held:
            missed.append(f"{100 * interpolation_error(signal.time, signal.values):.2g} % of the range of {topic}")
    told = f"; every second row, interpolated from its neighbors, is missed by {' and '.join(missed)}" if missed else ""
    return found, [f"{where}: interpolated at {1.0 / step:.6g} Hz{told}"]


def _clock(signal: Signal, grid: Grid | None) -> Array:
    """The ticks that a signal's times stand for, at which its values stay as they were measured; its times where these are elsewhere."""
    if grid is None:
        return signal.time
    due = grid.origin + (np.arange(len(signal.time)) if grid.ticks is None else grid.ticks) * grid.step
    return np.asarray(due) if np.abs(due - signal.time).max() < 0.5 * grid.step else signal.time  # a clock may wander
