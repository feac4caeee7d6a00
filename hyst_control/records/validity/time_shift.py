# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A measurement that is earlier or later than its command: by the same time everywhere, or by one that grows."""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.validity.findings import Finding, Trial
from hyst_control.records.validity.reference_model import (
    MAX_ROWS,
    Reference,
    averaged,
    continued,
    independent_sines,
    reference,
    shift_curve,
    surely_better,
)
from hyst_control.records.validity.rows import CLEAR, CLEAR_LEAD, HALF, MAX_PAIRED, MIN_SINES, SOUND, CondensedRows
from hyst_control.records.validity.sensor import MODELED

LATE = 10.0  # Ratio of the powers that a model leaves without and with a delay from which the delay is reported
SMALL_LEAD, MAX_SMALL_LEAD = 2, 8  # Rows of a lead that is always tried, and up to which it is doubled

SECTIONS, MAX_SECTION, MIN_SECTIONS, MIN_SECTION_SINES = 8, 8192, 3, 3.0
"""Sections of a record in which a lead is sought that grows, the rows of one, how many must show it, and by how many sines each."""

MAX_RATE = 5e-3  # Difference of two clocks at most: oscillators are off by a ten-thousandth, timers in software by a thousandth
MIN_ROWS, FINEST_ROWS, MOST = 256, 2**18, 0.5
"""Rows that are compared with a simulation at least and at most, and share of the rms beside one clock that a difference of two leaves."""
TOGETHER = (1024, 256, 64, 16, 4, 1)  # Rows whose means are compared with those of a simulation, in turn
CLOCK_STEPS = 4  # Fits, each with the times corrected by what the one before found
EVEN = 0.25  # Variance about a straight line, in that of rows lost at random times, up to which a shift grows as between two clocks


def in_words(seconds: float) -> str:
    """Time for a person, in ms or s."""
    return f"{1e3 * seconds:.3g} ms" if seconds < 10.0 else f"{seconds:.3g} s"


def grown_lead_in_words(seconds: float) -> str:
    """Detail of the finding of lost rows."""
    return f"(the measurement leads the command by a time that grows to {in_words(seconds)})"


def time_shifts(trial: Trial, rows: CondensedRows, index: int, own: Reference) -> tuple[Reference, Reference, float, list[Finding]]:
    """The model of the rows with its delay, and begun with a lead's poles; what a lead leaves, and findings on either."""
    command, measured = rows.inputs(index), rows.measurement[:, index]
    reach, informative = len(measured) // 8, independent_sines(rows.command[:, index]) >= MIN_SINES
    curves = [shift_curve(command, measured, poles, reach) for poles in (own.poles, own.poles[:0])]

    def finding(name: str, shift: int, text: str) -> list[Finding]:
        seconds = rows.together * trial.sample_time * shift
        remedy = f"{text} --shift {-seconds:.3g}"
        return [Finding(name, trial.name, trial.axes[index], abs(seconds), 0.0, f"by {in_words(abs(seconds))}", remedy)]

    delays = {int(np.argmin(curve[reach:])) for curve in curves if curve[reach:].min() < 0.5 * curve[reach]}
    later = {each: _continued_at(each, command, measured, own) for each in delays}
    best = min(later, key=lambda each: later[each].unexplained, default=0)
    inside = SMALL_LEAD < best < reach - SMALL_LEAD  # a periodic command is explained by every period of delay
    if informative and inside and surely_better(later[best], own, LATE):
        return later[best], later[best], np.inf, finding("late_measurement", best, "if the machine has no such delay, pass")
    own = delayed = min([own, *later.values()], key=lambda fit: fit.unexplained)
    if not informative:
        return delayed, own, np.inf, []
    early = {-SMALL_LEAD} | {
        int(np.argmin(curve[:reach])) - reach for curve in curves if curve[:reach].min() < 0.5 * curve[reach:].min()
    }
    leads = {each: _continued_at(each, command, measured, own) for each in early}
    shift = -2 * SMALL_LEAD
    while shift >= -MAX_SMALL_LEAD and leads[shift // 2].unexplained < 0.5 * own.unexplained:
        leads[shift] = _continued_at(shift, command, measured, leads[shift // 2])
        shift *= 2
    best = min(leads, key=lambda each: leads[each].unexplained)
    if leads[best].unexplained < own.unexplained:
        own = min(own, continued(command, measured, leads[best]), key=lambda fit: fit.unexplained)
    # Where periods repeat, no model saw the phases that are held out in all of them, and chance decides how well it goes on there.
    identifiable = leads[best].fitted * CLEAR < own.fitted
    if identifiable and leads[best].unexplained < HALF and surely_better(leads[best], own, CLEAR_LEAD):
        found = finding("early_measurement", best, "check that both recordings start together, or pass")
        return delayed, own, leads[best].unexplained, found
    return delayed, own, np.inf, []


def growing_lead(trial: Trial, index: int) -> list[Finding]:
    """A lead that is not the same everywhere in a record, as where rows of the measurement were lost and closed up."""
    command, measured = trial.command, trial.measurement[:, index]
    if command.shape[1] > MAX_PAIRED:
        command = command[:, [index]]
    count = min(len(measured) // SECTIONS, MAX_SECTION)
    reach, static = count // 8, np.zeros(0, complex)
    intervals = []
    for begin in np.linspace(0, len(measured) - count, SECTIONS).astype(int):
        rows = slice(begin, begin + count)
        if independent_sines(trial.command[rows, index]) < MIN_SECTION_SINES:
            continue
        curve = shift_curve(command[rows], measured[rows], static, reach)
        if curve.min() < MODELED:
            possible = np.flatnonzero(curve <= 1.25 * max(curve.min(), 0.01 * SOUND)) - reach
            if np.ptp(possible) <= reach // 8:
                intervals.append((int(possible[0]), int(possible[-1])))
    if len(intervals) < MIN_SECTIONS or np.any(np.diff(np.mean(intervals, axis=1)) >= 0.0):
        return []
    earliest = intervals[-1][1]
    if earliest >= -SMALL_LEAD or intervals[0][0] - earliest <= SMALL_LEAD:
        return []
    lead = -earliest * trial.sample_time
    return [Finding("lost_rows", trial.name, trial.axes[index], lead, 0.0, grown_lead_in_words(lead))]


def clock_difference(trial: Trial, index: int) -> list[Finding]:
    """A shift that grows evenly through the record, as where command and measurement were sampled by different clocks."""
    count = len(trial.command)
    together = -(-count // MAX_ROWS)  # the whole record: its ends are furthest apart
    command = trial.command if trial.command.shape[1] <= MAX_PAIRED else trial.command[:, [index]]
    rows, measured = averaged(command, together), averaged(trial.measurement[:, [index]], together)[:, 0]
    first = reference(rows, measured)
    fit, corrected, rate = first, measured, 0.0
    for _ in range(CLOCK_STEPS):
        step, sure = _rate(fit.predicted, corrected)
        if not sure:
            break
        rate += step
        corrected = at_rate(measured, rate)
        fit = continued(rows, corrected, fit)
    grown = abs(rate) * count
    departures = together * _section_shifts(fit.predicted, corrected)
    # Of a fit that stopped early, a further one leaves less without a correction, too.
    own = min(first, continued(rows, measured, fit), key=lambda each: each.unexplained)
    if not (abs(rate) < MAX_RATE and _is_even(departures, grown)) or fit.unexplained > HALF or not surely_better(fit, own, CLEAR):
        return []
    return [_clock_finding(trial, index, rate)]


def clock_beside_model(trial: Trial, index: int) -> list[Finding]:
    """A difference of clocks that is most of what a measurement and its simulation differ by, beside a shift and a gain."""
    if trial.simulated is None or len(trial.command) < MIN_ROWS or not np.ptp(trial.simulated[:, index]):
        return []
    rate, rows = 0.0, len(trial.command)
    for together in (each for each in TOGETHER if MIN_ROWS * each <= rows <= FINEST_ROWS * each):
        # Means of many rows first: the shift at the end may be several periods of a mode.
        expected, measured = (averaged(of[:, [index]], together)[:, 0] for of in (trial.simulated, trial.measurement))
        for _ in range(CLOCK_STEPS):
            step, sure = _rate(expected, at_rate(measured, rate))
            if not sure or abs(rate + step) > MAX_RATE:
                break
            rate += step
    kept = slice(int(len(measured) * (1.0 - abs(rate))))  # behind it a slow clock has no measurements
    corrected = at_rate(measured, rate)
    before, after = (_beside_gain_and_shift(expected[kept], values[kept]) for values in (measured, corrected))
    even = _is_even(together * _section_shifts(expected[kept], corrected[kept]), abs(rate) * rows)
    return [_clock_finding(trial, index, rate)] if even and after < MOST * before else []


def _is_even(departures: Array, grown: float) -> bool:
    """True where a shift grows as between two clocks: that of rows lost at random times departs as a random walk does that comes back."""
    return bool(np.var(departures) < EVEN * grown / 6.0)


def _clock_finding(trial: Trial, index: int, rate: float) -> Finding:
    seconds = abs(rate) * len(trial.command) * trial.sample_time
    detail = f"by {1e6 * abs(rate):.3g} ppm (the measurement's clock is the {'slower' if rate > 0 else 'faster'} one)"
    detail += f", {in_words(seconds)} over the record"
    remedy = f"record both by one clock, or bring the measurement to the command's (hyst edit --clock {1e6 * rate:.4g})"
    return Finding("clock_difference", trial.name, trial.axes[index], 1e6 * rate, 0.0, detail, remedy)


def _beside_gain_and_shift(simulated: Array, measured: Array) -> float:
    """Rms of what a gain, a zero and a small shift of a simulation (N,) leave of a measurement."""
    columns = np.column_stack([simulated, np.gradient(simulated), np.ones(len(simulated))])
    left = measured - columns @ np.linalg.lstsq(columns, measured, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def _rate(expected: Array, measured: Array) -> tuple[float, bool]:
    """Rows by which a measurement (N,) gets earlier from row to row than expected, to first order, and whether they are no chance."""
    slope = np.gradient(expected)
    columns = np.column_stack([slope * np.linspace(-0.5, 0.5, len(slope)), slope, np.ones(len(slope))])
    found, left = np.linalg.lstsq(columns, measured - expected, rcond=None)[:2]
    deviation = np.sqrt(np.linalg.pinv(columns.T @ columns)[0, 0] * float(np.sum(left)) / len(slope))
    return float(found[0]) / len(slope), bool(abs(found[0]) > 3.0 * deviation)


def at_rate(measured: Array, rate: float) -> Array:
    """A measurement (N,) as if its clock had not been slower by a rate, from a common beginning on."""
    if rate == 0.0:
        return measured
    from scipy.interpolate import CubicSpline  # takes long to import

    place = np.arange(len(measured))
    return np.asarray(CubicSpline(place, measured)(np.minimum(place / (1.0 + rate), place[-1])), dtype=np.float64)


def _section_shifts(expected: Array, measured: Array) -> Array:
    """Rows by which each section of a measurement (N,) is earlier than expected, to first order."""
    sections = zip(np.array_split(np.gradient(expected), SECTIONS), np.array_split(measured - expected, SECTIONS), strict=True)
    return np.array([slope @ left / max(float(slope @ slope), 1e-300) for slope, left in sections])


def _continued_at(shift: int, command: Array, measured: Array, begun: Reference) -> Reference:
    """A model of a measurement that is taken `shift` rows later."""
    end = len(measured) - abs(shift)
    return continued(command[max(-shift, 0) :][:end], measured[max(shift, 0) :][:end], begun)
