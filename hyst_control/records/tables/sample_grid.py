# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The regular ticks behind sample times that were rounded, jittered, repeated or passed over; interpolation where there are none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hyst_control.base.arrays import Array, Integers
from hyst_control.records.record import commonest_step
from hyst_control.records.stream.row_store import blocks

WINDOW = 2**10  # Rows over which times may not leave their ticks; between windows a clock may wander slowly
NEAREST = 0.45  # Steps by which a time may lie beside its tick: beyond half a step another tick is nearer

COARSE = 0.6
"""The same for times that repeat, in units of their resolution: all rows between two readings of the clock have one time."""

MAX_MISSING = 0.5
"""Ticks without a row, per row, up to which rows are missing: more are bursts, or rows at no regular times."""

ENDS = 2**16  # Rows at either end of the times, at most, from which the step is taken
SEARCHED = 0.03  # Relative width about a mean step within which the step of few times is searched

DAY = 86400.0

LONGEST_FILLED = 10  # Steps of a gap up to which values between its ends are interpolated


def gap_remedies(short: bool, rows: str) -> str:
    """Words on what to do about missing rows; `short`: whether every gap is short enough to be interpolated."""
    if short:
        return f"--resample interpolates {rows}, --allow-gaps leaves them out"
    return f"too many in a row for --resample (at most {LONGEST_FILLED - 1}): --allow-gaps leaves {rows} out"


@dataclass(frozen=True)
class Grid:
    """Ticks of some times (N,): row n lies at about origin + ticks[n] * step (ticks None: + n * step), `deviation` (s) at most beside."""

    step: float
    origin: float
    ticks: Integers | None
    deviation: float

    @property
    def missing(self) -> int:
        """Number of ticks without a row."""
        return 0 if self.ticks is None else int(self.ticks[-1]) + 1 - len(self.ticks)


def find_grid(time: Array, nearest: float = NEAREST) -> Grid | None:
    """The ticks of sample times (N,) of at least two rows that do not decrease, `nearest` steps at most beside; None: irregular."""
    if not time[-1] > time[0]:
        return None
    whole = _grid(time, None, nearest)
    if whole is not None:
        return whole
    grids = [_grid(time, ticks, NEAREST) for ticks in _ticks_with_gaps(time)]
    return min(
        (grid for grid in grids if grid is not None and grid.missing <= MAX_MISSING * len(time)),
        key=lambda grid: grid.missing,
        default=None,
    )


def _grid(time: Array, ticks: Integers | None, nearest: float) -> Grid | None:
    """The grid of times whose ticks are thought to be these, where no time lies too far beside its own."""
    part = min(max(len(time) // 3, 1), ENDS)
    last = len(time) - part
    first_tick, last_tick = (float(_ticks(ticks, slice(begin, begin + part)).mean()) for begin in (0, last))
    step = float((time[last : last + part].mean() - time[:part].mean()) / max(last_tick - first_tick, 1e-300))
    if len(time) <= 4 * WINDOW:
        step = _min_spread(time, _ticks(ticks, slice(0, len(time))), step)
    coarse, shortest = _resolution(time)
    most = max(nearest * step, COARSE * shortest if coarse else 0.0)
    deviation, before = 0.0, None
    for rows in _windows(len(time)):
        due = _ticks(ticks, rows) * step
        beside = time[rows] - due
        lowest, highest = float(beside.min()), float(beside.max())
        level, deviation = 0.5 * (highest + lowest), max(deviation, 0.5 * (highest - lowest))
        if deviation > most or (before is not None and abs(level - before) > most):
            return None
        before = level
    step = _rounded(step, 4.0 * deviation / len(time) ** 1.5)
    head = slice(0, min(WINDOW, len(time)))
    return Grid(step, float((time[head] - _ticks(ticks, head) * step).mean()), ticks, deviation)


def _min_spread(time: Array, ticks: Integers, step: float) -> float:
    """The step near a first one for which all times lie nearest to their ticks: few rounded times mislead a mean."""

    def spread(share: float) -> float:
        return float(np.ptp(time - share * step * ticks))

    from scipy.optimize import minimize_scalar

    found = minimize_scalar(spread, bounds=(1.0 - SEARCHED, 1.0 + SEARCHED), method="bounded", options={"xatol": 1e-9})
    return step * float(found.x) if found.fun < (1.0 - 1e-3) * spread(1.0) else step


def _ticks(ticks: Integers | None, rows: slice) -> Integers:
    return np.arange(rows.start, rows.stop) if ticks is None else ticks[rows]


def _windows(count: int) -> list[slice]:
    """Windows that cover all rows; a short last one is joined to that before it."""
    begins = list(range(0, max(count - WINDOW // 2, 1), WINDOW))
    return [slice(begin, end) for begin, end in zip(begins, [*begins[1:], count], strict=True)]


def midnights(time: Array) -> list[int]:
    """Rows of times (N,) in s before which a time of day starts again at midnight: it falls by a day less a few steps."""
    if len(time) < 2:
        return []
    most = min(LONGEST_FILLED * max(commonest_step(time), _resolution(time)[1]), 0.5 * DAY)
    rows: list[int] = []
    for part in blocks(len(time) - 1):
        steps = np.diff(time[part.start : part.stop + 1]) + DAY
        rows += (part.start + 1 + np.flatnonzero((steps > 0.0) & (steps < most))).tolist()
    return rows


def _resolution(time: Array) -> tuple[bool, float]:
    """True where a time stands twice, and the shortest step between two times, s."""
    coarse, shortest = False, np.inf
    for part in blocks(len(time) - 1):
        steps = np.diff(time[part.start : part.stop + 1])
        coarse = coarse or bool((steps == 0.0).any())
        shortest = min(shortest, float(steps[steps > 0.0].min(initial=np.inf)))
    return coarse, shortest


def _ticks_with_gaps(time: Array) -> list[Integers]:
    """Ticks that times may have some of which are passed over, with two guesses at the step."""
    steps = np.diff(time)
    median = float(np.median(steps))
    found = []
    for least, most in ((0.0, 2.5), (0.5, 1.5)):  # times as coarse as the step differ by none to two readings of the clock
        near = steps[(steps >= least * median) & (steps <= most * median)]
        usual = float(near.mean()) if len(near) else median
        if usual > 0.0:
            with np.errstate(over="ignore"):
                ticks = np.cumsum(np.maximum(np.rint(np.minimum(steps / usual, 2.0**31)), 1.0))
            found.append(np.concatenate([[0], ticks]).astype(np.int64))
    return found


def _rounded(step: float, uncertainty: float) -> float:
    """The step of the roundest sample rate within its uncertainty."""
    for digits in range(1, 13):
        rate = float(f"{1.0 / step:.{digits}g}")
        if abs(1.0 / rate - step) <= uncertainty:
            return 1.0 / rate
    return float(f"{step:.12g}")


def resampled(time: Array, values: Array, due: Array, step: float, held: bool) -> Array:
    """Values (N, A) at increasing times as values (M, A) at the times `due`: interpolated, or the means of a held command."""
    found = np.empty((len(due), values.shape[1]))
    for axis, (at, one) in enumerate(_known(time, values)):
        if held:  # the mean over each step moves a linear plant as the command itself does
            area = np.concatenate([[0.0], np.cumsum(one[:-1] * np.diff(at))])
            edges = np.concatenate([due, due[-1:] + step])
            beyond = np.maximum(edges - at[-1], 0.0) * one[-1]
            found[:, axis] = np.diff(np.interp(edges, at, area) + beyond) / step
        else:
            found[:, axis] = np.interp(due, at, one)
    return found


def _known(time: Array, values: Array) -> Iterator[tuple[Array, Array]]:
    """Times and values of each axis of values (N, A), where these are finite."""
    for one in values.T:
        finite = np.isfinite(one)
        yield (time, one) if finite.all() else (time[finite], one[finite])


def interpolation_error(time: Array, values: Array) -> float:
    """Rms error, relative to the range, of interpolating every second row of values (N, A) from its neighbors; of the worst axis."""
    worst = 0.0
    for at, one in _known(time, values):
        if len(at) > 2:
            missed = np.interp(at[1:-1:2], at[::2], one[::2]) - one[1:-1:2]
            worst = max(worst, float(np.sqrt(np.mean(missed**2))) / (float(np.ptp(one)) or 1.0))
    return worst
