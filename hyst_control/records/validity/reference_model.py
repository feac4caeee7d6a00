# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reference models of a record: how much of a measurement some stable, causal model of moderate order makes of the commands.

A model is a bank of first-order filters with common poles, real or in conjugate pairs, behind the commands and behind play operators of
them; a constant and a straight line are free. The poles are relocated as in vector fitting (Gustavsen and Semlyen, IEEE Trans. Power
Delivery 14, 1999), in the time domain. What it explains is counted on rows that were held out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array, Complex, Integers

Poles = Complex

MAX_ROWS = 8192
"""Rows that a model of one command is fitted to, half of them with several: of a longer record neighbors are averaged."""
KEPT_POWER = 0.9  # Share of a command's power that averaging over neighbors must keep
PAIRS = 4  # Pairs of poles to begin with, spread over the frequencies of the record
ITERATIONS = 5
CONVERGED = 0.9  # Ratio of what successive iterations leave from which there is no further one
THRESHOLDS = (0.01, 0.03, 0.07, 0.14, 0.22, 0.32)  # Thresholds of the play operators, as shares of the command's range
BLOCKS, HELD_OUT = 40, 5  # Blocks of a record, and every how many-th is held out
SURE, FLOOR = 2.0, 1e-2
"""Student's t from which a mean over held-out blocks is no chance, and the share of the mean that a block counts at least."""
APART, CHANCE = 4, 3.0
"""Rows from which on averaged ones share no samples, and standard deviations by which such rows of white noise are alike by chance."""
LINES_OF_A_SINE = 3.0  # Lines that a sine has in a spectrum with Hann's window
MIN_DECAY = 0.3
"""By how many factors of e an oscillation decays over the record, at least: one that goes on for ever needs no command."""
RIDGE = 1e-10  # Regularization of the normal equations, relative to their diagonal


@dataclass(frozen=True)
class Reference:
    """A fitted reference model."""

    unexplained: float  # Share of the measurement's power on held-out rows
    fitted: float  # The same on the rows that it was fitted to
    by_block: Array  # That in each held-out block
    left_beyond_noise: float  # That without white noise, which has no part in the products of rows that share no samples
    without_command: float  # The same of the model's constant, line and initial states alone
    predicted: Array  # (N,), measurement unit
    poles: Poles  # Of the filters
    hysteresis: bool  # Whether there are play operators


def surely_better(one: Reference, other: Reference, ratio: float) -> bool:
    """True where a model leaves less than another by a ratio, and by more than held-out blocks scatter (a paired t-test of logarithms)."""
    if one.unexplained * ratio >= other.unexplained:
        return False
    gain = np.log(other.by_block + FLOOR * other.unexplained) - np.log(one.by_block + FLOOR * one.unexplained)
    return bool(np.mean(gain) > SURE * np.std(gain, ddof=1) / np.sqrt(len(gain)))


def independent_sines(command: Array) -> float:
    """Number of sines that a command (N,) is made of but for a hundredth of its power: what a record can tell of a model."""
    place = np.linspace(0.0, 1.0, len(command))
    motion = command - command[0] - place * (command[-1] - command[0])
    power = np.sort(np.abs(np.fft.rfft((motion - motion.mean()) * np.hanning(len(motion)))) ** 2)[::-1]
    lines = int(np.searchsorted(np.cumsum(power), 0.99 * power.sum())) + 1
    return lines / LINES_OF_A_SINE


def condensed(command: Array, measurement: Array) -> tuple[Array, Array, int]:
    """At most about `MAX_ROWS` rows of a record that hold its command's motion, and how many neighbors are averaged in each of them."""
    most = MAX_ROWS if command.shape[1] == 1 else MAX_ROWS // 2
    together = -(-len(command) // most)
    whole = np.var(command, axis=0)
    while together > 1 and not np.all(np.var(averaged(command, together), axis=0) >= KEPT_POWER * whole):
        together //= 2
    length = most * together
    begins = np.unique(np.linspace(0, max(len(command) - length, 0), 16).astype(int))
    moved = [float(np.sum(np.ptp(command[begin : begin + length : together], axis=0) ** 2)) for begin in begins]
    begin = int(begins[int(np.argmax(moved))])
    rows = slice(begin, begin + length)
    return averaged(command[rows], together), averaged(measurement[rows], together), together


def averaged(rows: Array, together: int) -> Array:
    """Every `together`-th of the means, twice over, of twice as many neighboring rows (N, A)."""
    if together == 1:
        return rows
    # Plain means fold what is faster than the new rate, and a plant's lag of a part of a new row is causal only for what is slower.
    # The weights of means twice over rise over two parts of `together` rows and fall over the next two: sums of parts will do.
    parts = rows[: len(rows) // together * together].reshape(-1, together, rows.shape[1])
    plain, rising = parts.sum(axis=1), np.einsum("pra,r->pa", parts, np.arange(1.0, together + 1.0))
    falling = together * plain - rising
    found = rising[:-3] + (rising[1:-2] + together * plain[1:-2]) + (falling[2:-1] + together * plain[2:-1]) + falling[3:]
    return np.asarray(found / (2 * together) ** 2)


def reference(command: Array, measured: Array) -> Reference:
    """The better of a linear model and one with hysteresis of one measured axis (N,), from commands (N, A)."""
    return min(linear_reference(command, measured), hysteretic_reference(command, measured), key=lambda fit: fit.unexplained)


def hysteretic_reference(command: Array, measured: Array) -> Reference:
    """The model with hysteresis of one measured axis (N,), from commands (N, A)."""
    return _fit(command, measured, _thresholds(command), None)


def continued(command: Array, measured: Array, begun: Reference) -> Reference:
    """A model of the structure of another one, whose poles it begins with."""
    return _fit(command, measured, _thresholds(command) if begun.hysteresis else (), begun.poles)


def linear_reference(command: Array, measured: Array, pairs: int = PAIRS) -> Reference:
    """The linear model of one measured axis (N,), from commands (N, A), with so many pairs of poles."""
    return _fit(command, measured, (), initial_poles(len(measured), pairs))


def _thresholds(command: Array) -> tuple[float, ...]:
    return THRESHOLDS if command.shape[1] == 1 else THRESHOLDS[1::2]


def shift_curve(command: Array, measured: Array, poles: Poles, reach: int) -> Array:
    """Unexplained shares (2 reach + 1,) where the measurement (N,) is taken -reach ... reach rows later, by a model of fixed poles."""
    # The model's columns stay the same for all shifts: what they explain is a correlation with each of an orthonormal set of them.
    count = len(measured) - 2 * reach
    rows = slice(reach, reach + count)
    inputs = _inputs(command, THRESHOLDS[1::2])
    lines = np.stack([np.ones(count), np.linspace(-1.0, 1.0, count)])
    filtered = np.empty((len(inputs) * _width(poles), len(measured)))
    _filter(inputs, poles, np.arange(len(measured)), filtered, with_inputs=True)
    columns = np.concatenate([filtered[:, rows], lines])
    columns /= np.sqrt(np.sum(columns**2, axis=1))[:, None] + 1e-150
    powers, directions = np.linalg.eigh(columns @ columns.T)
    kept = powers > 1e-12 * powers[-1]
    orthonormal = (directions[:, kept] / np.sqrt(powers[kept])).T @ columns
    values = measured - measured.mean()
    length = 2 ** int(np.ceil(np.log2(len(values) + count)))
    spectrum = np.fft.rfft(values, length)
    explained = np.zeros(2 * reach + 1)
    for column in orthonormal:
        explained += np.fft.irfft(spectrum * np.fft.rfft(column, length).conj(), length)[: 2 * reach + 1] ** 2
    sums = np.concatenate([[0.0], np.cumsum(values**2)])
    return np.asarray(1.0 - explained / np.maximum(sums[count:] - sums[: 2 * reach + 1], 1e-300), dtype=np.float64)


def initial_poles(count: int, pairs: int = PAIRS) -> Poles:
    """Poles of moderately damped oscillations from a few periods in `count` rows to a third of the sample rate."""
    angle = np.geomspace(4.0 * np.pi / count, 2.0, pairs)
    return np.asarray(np.exp((1j - 0.3) * angle), dtype=np.complex128)


def _fit(command: Array, measured: Array, thresholds: Sequence[float], poles: Poles | None) -> Reference:
    """The model with the poles, of all iterations, that fit best on the rows that are not held out."""
    count, size = len(measured), max(float(np.std(measured)), 1e-300)
    held_out = np.arange(count) * BLOCKS // count % HELD_OUT == HELD_OUT // 2
    order = np.argsort(held_out, kind="stable")  # rows that are fitted first, so that their columns are no copy
    place, fitted = np.empty_like(order), count - int(held_out.sum())
    place[order] = np.arange(count)
    values = (measured - measured[0]) / size
    wanted = values[order]
    seen = wanted[:fitted]
    inputs = _inputs(command, thresholds)
    poles = initial_poles(count) if poles is None else poles
    best: tuple[float, Array, Array, Poles] = np.inf, wanted, wanted, poles
    states = _width(poles) - 1
    filtered = len(inputs) * (states + 1)
    model = filtered + 2 + states
    columns = np.empty((model + states, count))
    columns[filtered], columns[filtered + 1] = 1.0, np.linspace(-1.0, 1.0, count)[order]
    impulse = np.zeros((1, count))
    impulse[0, 0] = 1.0
    for _ in range(ITERATIONS):
        _filter(inputs, poles, place, columns[:filtered], with_inputs=True)
        # What the filters' states at the start add; and the measurement, whose weights tell where the filters' poles should be.
        _filter(impulse, poles, place, columns[filtered + 2 : model], with_inputs=False)
        _filter(values[None], poles, place, columns[model:], with_inputs=False)
        rows = columns[:, :fitted]
        normal, product = rows @ rows.T, rows @ seen
        sizes = np.sqrt(np.diag(normal)) + 1e-150
        normal /= np.outer(sizes, sizes)
        product /= sizes
        normal[np.diag_indices_from(normal)] += RIDGE
        predicted = (np.linalg.solve(normal[:model, :model], product[:model]) / sizes[:model]) @ columns[:model]
        left = float(np.mean((seen - predicted[:fitted]) ** 2))
        done = left > CONVERGED * best[0]
        if left < best[0]:
            within = slice(filtered, model)
            alone = (np.linalg.solve(normal[within, within], product[within]) / sizes[within]) @ columns[within]
            best = left, predicted, alone, poles
        if done:
            break
        poles = _relocated(poles, np.linalg.solve(normal, product)[model:] / sizes[model:], count)
    left, predicted, alone, poles = best
    remainder = (wanted - predicted)[fitted:]
    unexplained, without_command = float(np.mean(remainder**2)), float(np.mean((wanted - alone)[fitted:] ** 2))
    beyond = max(float(np.mean(remainder[APART:] * remainder[:-APART])), CHANCE * unexplained / float(np.sqrt(len(remainder))))
    number = (np.arange(count) * BLOCKS // count // HELD_OUT)[held_out]
    by_block = np.bincount(number, remainder**2) / np.bincount(number)
    made = measured[0] + predicted[place] * size
    return Reference(unexplained, left, by_block, beyond, without_command, made, poles, bool(thresholds))


def _inputs(command: Array, thresholds: Sequence[float]) -> Array:
    """Every command (N, A) about its first value, at which the filters are settled, and play operators of it; of deviation 1 (K, N)."""
    found = []
    for values in np.ascontiguousarray(command.T):
        span = float(np.ptp(values))
        for each in (values, *(_play(values, share * span) for share in thresholds)):
            found.append((each - each[0]) / max(float(np.std(each)), 1e-300))
    return np.array(found)


@njit(cache=True)
def _play(values: Array, threshold: float) -> Array:
    """A play operator that begins at the first value."""
    found = np.empty(len(values))
    state = values[0]
    for row in range(len(values)):
        state = min(max(state, values[row] - threshold), values[row] + threshold)
        found[row] = state
    return found


def _width(poles: Poles) -> int:
    """Columns of an input: itself and the filters' states."""
    return 1 + len(poles) + int(np.count_nonzero(poles.imag))


def _filter(inputs: Array, poles: Poles, place: Integers, found: Array, *, with_inputs: bool) -> None:
    """Write what a filter of each pole makes of the values of inputs (K, N) before; of a pair the real and the imaginary part."""
    gains = np.array([_gain(pole) for pole in poles])
    _filter_bank(np.ascontiguousarray(inputs), poles.astype(np.complex128), gains, place, found, with_inputs)


@njit(cache=True)
def _filter_bank(inputs: Array, poles: Poles, gains: Array, place: Integers, found: Array, with_inputs: bool) -> None:
    """Write the columns of inputs into `found`, each value of row k at `place[k]`."""
    at = 0
    states = np.empty(len(poles), np.complex128)
    for values in inputs:
        if with_inputs:
            for row in range(len(values)):
                found[at, place[row]] = values[row]
            at += 1
        states[:] = 0.0
        for row in range(len(values)):
            column, to, value = at, place[row], values[row]
            for k in range(len(poles)):  # side by side, so that no step waits for the one before
                pole, state = poles[k], states[k]
                found[column, to] = state.real
                if pole.imag:
                    found[column + 1, to] = state.imag
                    column += 2
                    states[k] = pole * state + gains[k] * value
                else:
                    column += 1
                    states[k] = complex(pole.real * state.real + gains[k] * value)
        for pole in poles:
            at += 2 if pole.imag else 1


def _gain(pole: complex) -> float:
    return max(1.0 - abs(pole), 1e-4)


def _relocated(poles: Poles, weights: Array, count: int) -> Poles:
    """Zeros of the weight with which the measurement enters, mirrored into the unit circle: the poles of the next iteration."""
    each = iter(weights.tolist())
    every: list[complex] = []
    residues: list[complex] = []
    for pole in poles:
        if pole.imag:
            residue = 0.5 * _gain(pole) * complex(next(each), -next(each))
            every += [pole, pole.conjugate()]
            residues += [residue, residue.conjugate()]
        else:
            every.append(complex(pole.real))
            residues.append(complex(_gain(pole) * next(each)))
    # The measurement enters with a plus sign here: 1 - sum of residue / (z - pole).
    zeros = np.linalg.eigvals(np.diag(every) + np.outer(np.ones(len(every)), residues))
    zeros = np.where(np.abs(zeros) > 1.0, zeros / np.maximum(np.abs(zeros), 1e-300) ** 2, zeros)
    oscillating = zeros[zeros.imag > 1e-9]
    oscillating = oscillating * np.minimum(1.0, np.exp(-MIN_DECAY / count) / np.maximum(np.abs(oscillating), 1e-300))
    return np.concatenate([oscillating, zeros[np.abs(zeros.imag) <= 1e-9].real])
