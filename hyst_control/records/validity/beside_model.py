# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A record beside a given model: another unit, sign, sample rate, time shift or order of columns that the model explains clearly better.

The model is simulated on the record as it is, and on the record as it may have been meant. A hypothesis holds only where it leaves a small
part of what the record as it is leaves, so that what a machine does beyond its model is left to the diagnosis.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import permutations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.validity.findings import Finding, Simulation, Trial, times
from hyst_control.records.validity.time_shift import MIN_SECTIONS, SECTIONS, grown_lead_in_words, in_words
from hyst_control.records.validity.two_records import OPPOSED, PAIRED, SCALE

LONGEST = 2**16  # Rows, from the beginning, that are simulated
EXPLAINED = 1e-4  # Share of a measurement's power that a model leaves of a record without further checks
CLEAR = 8.0  # Ratio of what the model leaves of the record as it is and as it is corrected
POOR, LESS_POOR = 0.02, 0.1
"""Shares that a hypothesis may leave, and an exchange, which a model with a gain alone shows, too."""
UNEXPLAINED = 0.5  # Share of the power, of a record or of an octave, from which a model leaves it unexplained
FACTORS = (0.1, 0.2, 0.25, 0.5, 2.0, 4.0, 5.0, 10.0)
"""Ratios of the true sample time to the stated one, and of the true unit of a command."""
UNITS = (1e-6, 1e-3, 1e3, 1e6)
MIN_SHIFT = 3  # Rows of a shift that counts
MIN_SECTION = 256  # Rows of a section of a record in which a shift is looked for
MAX_AXES = 4
REFUTABLE = ("reversed_time", "reversed_command", "swapped_signals", "unrelated_measurement", "unplugged_sensor")
"""Findings that a model of the machine may refute."""


def misfit(expected: Array, measured: Array) -> float:
    """Share of a measurement's power that is not as expected, both (N,) or (N, A), without constants and straight lines."""
    wanted, left = _without_line(measured), _without_line(measured - expected)
    return float(np.sum(left**2)) / max(float(np.sum(wanted**2)), 1e-300)


def _without_line(rows: Array) -> Array:
    place = np.linspace(-1.0, 1.0, len(rows))
    centered = rows - rows.mean(axis=0)
    return np.asarray(centered - np.multiply.outer(place, place @ centered / (place @ place)), dtype=np.float64)


def best_order(expected: Array, measured: Array) -> tuple[int, ...] | None:
    """Order of the measured axes (N, A) that fits the expected ones clearly better than the given one; None where none does."""
    count = expected.shape[1]
    if not 2 <= count <= MAX_AXES:
        return None
    left = np.array([[misfit(expected[:, one], measured[:, other]) for other in range(count)] for one in range(count)])
    orders = {order: float(np.mean([left[k, order[k]] for k in range(count)])) for order in permutations(range(count))}
    best = min(orders, key=lambda order: orders[order])
    own = orders[tuple(range(count))]
    return best if own > EXPLAINED and orders[best] * CLEAR < own and orders[best] < 0.5 else None


def meant(command: Array, measured: Array, sample_time: float, simulate: Simulation) -> tuple[str, float] | None:
    """The name of what explains a record (N, A) clearly better, and its factor; None where nothing does.

    Names: scaled_command, wrong_rate (true over stated sample rate), swapped_signals, reversed_time. The times of a record are wrong only
    where the machine's own delay and gain explain less: a delay resembles a slower clock, and a tone's delay the reversed tone.
    """
    command, measured = command[:LONGEST], measured[:LONGEST]
    as_given = simulate(command, sample_time)
    own = misfit(as_given, measured)
    if own < EXPLAINED:
        return None
    # In another unit the simulation is a thousand times too large or too small, and explains nothing.
    units = UNITS if own > UNEXPLAINED else ()
    tried = {("scaled_command", factor): misfit(simulate(factor * command, sample_time), measured) for factor in units}
    at_rates = {1.0 / factor: simulate(command, factor * sample_time) for factor in FACTORS}
    tried |= {("wrong_rate", factor): misfit(expected, measured) for factor, expected in at_rates.items()}
    tried["swapped_signals", 1.0] = misfit(simulate(measured, sample_time), command)
    tried["reversed_time", 1.0] = misfit(simulate(command[::-1], sample_time)[::-1], measured)
    tried = {key: left for key, left in tried.items() if np.isfinite(left)}
    best = min(tried, key=lambda key: tried[key], default=None)
    late = _with_delay_and_gain(as_given, measured)
    if best is not None and best[0] in ("wrong_rate", "reversed_time"):
        own = min(own, misfit(late, measured))
    if best is not None and tried[best] * CLEAR < own and tried[best] < (LESS_POOR if best[0] == "swapped_signals" else POOR):
        return best
    rate = _other_rate([as_given, late], at_rates, measured)
    return None if rate is None else ("wrong_rate", rate)


def refutes(trial: Trial, index: int, name: str) -> bool:
    """True where the model contradicts a finding: it explains the axis as recorded better than reversed or exchanged."""
    # In a closed loop the command is computed from the measurement, so that a fit without physics works in either direction. A measurement
    # that the model explains is not unrelated to the command, even if the relation is nonlinear.
    if trial.simulate is None or trial.simulated is None or name not in REFUTABLE:
        return False
    command, measured = trial.command[:LONGEST], trial.measurement[:LONGEST]
    own = misfit(trial.simulated[:LONGEST, index], measured[:, index])
    if name in ("unrelated_measurement", "unplugged_sensor"):
        return own < UNEXPLAINED
    if name == "swapped_signals":
        other = misfit(trial.simulate(measured, trial.sample_time)[:, index], command[:, index])
    else:
        backwards = trial.simulate(command[::-1], trial.sample_time)[:, index]
        other = misfit(backwards[::-1], measured[:, index])
        if name == "reversed_command":
            other = min(other, misfit(backwards, measured[:, index]))
    return own < UNEXPLAINED and not other < own


def _with_delay_and_gain(expected: Array, measured: Array) -> Array:
    """The expected motion (N, A), delayed and scaled to fit the measurement best, with an offset and a drift added."""
    # The delay may be a part of a row: it is a sum of three neighboring ones.
    found = np.empty_like(expected)
    line = [np.ones(len(expected)), np.linspace(-1.0, 1.0, len(expected))]
    for index, (one, other) in enumerate(zip(expected.T, measured.T, strict=True)):
        first = max(_best_shift(one, other, len(one) // 8) - 1, 0)
        columns = np.column_stack([*(_later(one, first + rows) for rows in range(3)), *line])
        found[:, index] = columns @ np.linalg.lstsq(columns, other, rcond=1e-9)[0]
    return found


def _later(values: Array, rows: int) -> Array:
    return np.concatenate([np.repeat(values[:1], rows), values[: len(values) - rows]])


def _other_rate(as_given: Sequence[Array], at_rates: Mapping[float, Array], measured: Array) -> float | None:
    """The rate by which the model explains an octave of the measurement (N, A) that it leaves as given in each way, and none vice versa."""
    # Slow motion has most of the power and knows nothing of the rate, so that a model's own discrepancy there hides it from the whole.
    power = _octaves(measured)
    own = np.min([_octaves(measured - expected) for expected in as_given], axis=0) / power
    left = {rate: _octaves(measured - expected) / power for rate, expected in at_rates.items() if np.isfinite(expected).all()}
    best = min(left, key=lambda rate: float(np.mean(np.minimum(left[rate], 1.0))), default=None)
    if best is None:
        return None
    other = left[best]
    counts = power > EXPLAINED * power.sum()  # less is what a beginning amid a motion adds everywhere
    explained = counts & (own > UNEXPLAINED) & (other < LESS_POOR) & (other * CLEAR < own)
    spoiled = (other > UNEXPLAINED) & (own < LESS_POOR) & (own * CLEAR < other)
    return best if explained.any() and not spoiled.any() else None


def _octaves(rows: Array) -> Array:
    """Power of rows (N, A) by octave, without constants and straight lines."""
    from scipy.fft import dct  # takes long to import

    squares = np.sum(dct(_without_line(rows), axis=0, norm="ortho") ** 2, axis=1)
    first = 2 ** np.arange(2, int(np.log2(len(squares))))
    return np.asarray(np.maximum(np.add.reduceat(squares, [0, *first]), 1e-300), dtype=np.float64)


def time_shift(expected: Array, measured: Array) -> int:
    """Rows by which a measurement (N,) is later than expected, where that explains it clearly better; else 0."""
    expected, measured = expected[:LONGEST], measured[:LONGEST]
    reach = len(measured) // 8
    shift = _best_shift(expected, measured, reach)
    own, left = misfit(expected, measured), _shifted_misfit(expected, measured, shift)
    return shift if abs(shift) >= MIN_SHIFT and own > EXPLAINED and left * CLEAR < own else 0


def _best_shift(expected: Array, measured: Array, reach: int) -> int:
    """Rows from -reach to reach by which an expectation (N,) has to be later to correlate best with the measurement (N,)."""
    length = 2 ** int(np.ceil(np.log2(2 * len(measured))))
    one, other = _without_line(expected), _without_line(measured)
    product = np.fft.irfft(np.fft.rfft(other, length) * np.fft.rfft(one, length).conj(), length)
    shifts = np.r_[-reach : reach + 1]
    return int(shifts[int(np.argmax(product[shifts]))])


def _shifted_misfit(expected: Array, measured: Array, shift: int) -> float:
    count = len(measured) - abs(shift)
    return misfit(expected[max(-shift, 0) :][:count], measured[max(shift, 0) :][:count])


def lead_at_the_end(expected: Array, measured: Array) -> int:
    """Rows by which a measurement (N,) leads at the end, where its lead grows through the record, as after lost rows; else 0."""
    shifts, own, left = [], [], []
    for one, other in zip(np.array_split(expected, SECTIONS), np.array_split(measured, SECTIONS), strict=True):
        if len(one) < MIN_SECTION or not np.ptp(one) or not np.ptp(other):
            continue
        shift = _best_shift(one, other, len(one) // 8)
        if (misfit_there := _shifted_misfit(one, other, shift)) < UNEXPLAINED:
            shifts.append(shift)
            own.append(misfit(one, other))
            left.append(misfit_there)
    if len(shifts) < MIN_SECTIONS or np.any(np.diff(shifts) > 0) or shifts[0] - shifts[-1] < MIN_SHIFT:
        return 0
    return max(-shifts[-1], 0) if np.sum(left) * CLEAR < np.sum(own) else 0


def model_findings(trial: Trial, moving: Sequence[int]) -> list[Finding]:
    """Findings where a model explains a changed record clearly better than the record as it is, and notes."""
    if trial.simulated is None or not moving:
        return []
    expected, measured = trial.simulated[:LONGEST], trial.measurement[:LONGEST]
    moved = [index for index in moving if np.ptp(expected[:, index]) > 0 and np.ptp(measured[:, index]) > 0]
    nyquist = 0.5 / trial.sample_time
    aliased = [mode for mode in trial.modes if mode > nyquist]
    notes = []
    if aliased:
        detail = f"(Nyquist frequency {nyquist:.4g} Hz, mode at {aliased[0]:.4g} Hz)"
        notes = [Finding("slow_sampling", trial.name, "", nyquist, aliased[0], detail)]
    if moved and (order := best_order(expected[:, moved], measured[:, moved])) is not None:
        return [
            Finding("swapped_axes", trial.name, trial.axes[moved[k]], 1.0, PAIRED, "in the model")
            for k, other in enumerate(order)
            if other != k
        ]
    if (
        trial.simulate is not None
        and (found := meant(trial.command, trial.measurement, trial.sample_time, trial.simulate)) is not None
    ):
        return [_meant(trial, *found)]
    return [finding for index in moved for finding in _axis_against_the_model(trial, index)] + notes


def _meant(trial: Trial, name: str, factor: float) -> Finding:
    rate = 1.0 / trial.sample_time
    details = {
        "wrong_rate": f"(at {factor / trial.sample_time:.4g} Hz instead of {rate:.4g} Hz the model fits)",
        "scaled_command": f"(scaled by {factor:g} it fits)",
    }
    return Finding(name, trial.name, "", factor, 1.0, details.get(name, "(so the model fits)"))


def _axis_against_the_model(trial: Trial, index: int) -> Iterator[Finding]:
    assert trial.simulated is not None
    axis, step = trial.axes[index], trial.sample_time
    expected, measured = trial.simulated[:LONGEST, index], trial.measurement[:LONGEST, index]
    if lead := lead_at_the_end(expected, measured):
        yield Finding("lost_rows", trial.name, axis, lead * step, 0.0, grown_lead_in_words(lead * step))
        return
    shift = time_shift(expected, measured)
    ratio, correlation = float(np.ptp(measured) / np.ptp(expected)), float(np.corrcoef(expected, measured)[0, 1])
    against = misfit(-expected, measured) if correlation < OPPOSED else np.inf
    if against * CLEAR < _shifted_misfit(expected, measured, shift):  # a motion the other way often looks like a late one, too
        yield Finding("sign_turned", trial.name, axis, correlation, OPPOSED, f"(correlation {correlation:.2g})")
    elif -shift * step > trial.delay + MIN_SHIFT * step and correlation > OPPOSED:
        remedy = f"check that both recordings start together, or pass --shift {-shift * step:.3g}"
        yield Finding(
            "early_measurement", trial.name, axis, -shift * step, 0.0, f"by {in_words(-shift * step)} beside the model", remedy
        )
    elif shift > 0:
        remedy = f"if the machine has no such delay, pass --shift {-shift * step:.3g}"
        yield Finding(
            "late_measurement", trial.name, axis, shift * step, 0.0, f"by {in_words(shift * step)} beside the model", remedy
        )
    elif correlation < OPPOSED:
        yield Finding("sign_turned", trial.name, axis, correlation, OPPOSED, f"(correlation {correlation:.2g})")
    if not 1.0 / SCALE < ratio < SCALE:
        yield Finding("scaled_measurement", trial.name, axis, ratio, SCALE if ratio > 1 else 1.0 / SCALE, times(ratio))
