# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Change of the measured mirror between drive levels: a factor on the command, a clock, or a shift per mode (docs/mirror_levels.md).

In plain numpy and scipy, apart from identification and diagnosis: poles of the lowest level by vector fitting, residues by least squares. A
hypothesis is fitted to the response of the highest level, and tested on realization 6 there and at the middle level.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from evaluation.reproduction.figures import write_page
from evaluation.reproduction.fsm_cubespec_records import LEVELS, PERIOD, SAMPLE_TIME, Level, load_levels
from hyst_control.reporting.tables import Table

PAIRS, ROUNDS = 26, 25
MIDDLE = float((np.sqrt(200.0) - np.sqrt(100.0)) / (np.sqrt(300.0) - np.sqrt(100.0)))
"""Share of a change from 100 to 300 mV that is there at 200 mV if it grows with the root of the level."""

Complex = NDArray[np.complex128]


def spectra(level: Level) -> tuple[Complex, Complex, NDArray[np.float64]]:
    """Commands and measurements (F, 3, 6) at the excited lines, periods averaged, and s = j omega."""
    command, measurement = (np.fft.rfft(rows.mean(axis=3), axis=0) for rows in (level.command, level.measurement))
    power = np.sum(np.abs(command) ** 2, axis=(1, 2))
    lines = np.flatnonzero(power > 1e-6 * power.max())
    return command[lines], measurement[lines], lines.astype(np.float64) * (2 * np.pi / (PERIOD * SAMPLE_TIME))


def response(command: Complex, measurement: Complex, realizations: Sequence[int]) -> Complex:
    """Frequency response (F, 3, 3) of some realizations."""
    u, y = command[:, :, realizations], measurement[:, :, realizations]
    adjoint = np.conj(np.swapaxes(u, 1, 2))
    found: Complex = y @ adjoint @ np.linalg.inv(u @ adjoint)
    return found


def vector_fit(values: Complex, rate: NDArray[np.float64]) -> Complex:
    """Poles above the real axis common to all entries of a response (F, 3, 3)."""
    s: Complex = np.asarray(1j * rate, dtype=np.complex128)
    flat = values.reshape(len(rate), -1)
    poles = rate[0] + (rate[-1] - rate[0]) * (np.arange(PAIRS) + 0.5) / PAIRS
    poles = (-0.01 + 1j) * poles
    for _ in range(ROUNDS):
        basis = _basis(s, poles)
        own = np.column_stack([basis, np.ones(len(s))])
        rows, right = [], []
        for entry in flat.T:
            full = np.column_stack([own, -entry[:, None] * basis])
            q, r = np.linalg.qr(np.vstack([full.real, full.imag]))
            b = q.T @ np.concatenate([entry.real, entry.imag])
            rows.append(r[own.shape[1] :, own.shape[1] :])
            right.append(b[own.shape[1] :])
        weights = np.linalg.lstsq(np.vstack(rows), np.concatenate(right), rcond=None)[0]
        a, b = np.zeros((2 * PAIRS, 2 * PAIRS)), np.tile([2.0, 0.0], PAIRS)
        for k, pole in enumerate(poles):
            a[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
        moved = np.linalg.eigvals(a - np.outer(b, weights))
        moved = moved[moved.imag > 0.0]
        moved = -np.abs(moved.real) + 1j * moved.imag
        spare = (-0.01 + 1j) * np.linspace(rate[0], rate[-1], PAIRS + 2)[1:-1]
        poles = np.concatenate([moved, spare[: PAIRS - len(moved)]])
    return np.asarray(sorted(poles, key=abs), dtype=complex)


def _basis(s: Complex, poles: Complex) -> Complex:
    """Partial fractions of pairs (F, 2 K), so that weights are real."""
    first, second = 1.0 / (s[:, None] - poles), 1.0 / (s[:, None] - np.conj(poles))
    return np.stack([first + second, 1j * (first - second)], axis=2).reshape(len(s), -1)


def residues(values: Complex, rate: NDArray[np.float64], poles: Complex) -> Complex:
    """Residues (K, 3, 3) and a constant behind them (1, 3, 3), by least squares."""
    own = np.column_stack([_basis(np.asarray(1j * rate, dtype=np.complex128), poles), np.ones(len(rate))])
    flat = values.reshape(len(rate), -1)
    found = np.linalg.lstsq(np.vstack([own.real, own.imag]), np.vstack([flat.real, flat.imag]), rcond=None)[0]
    pairs = found[:-1].reshape(len(poles), 2, 3, 3)
    whole: Complex = np.concatenate([pairs[:, 0] + 1j * pairs[:, 1], found[-1:].reshape(1, 3, 3)])
    return whole


def modal_response(rate: NDArray[np.float64], poles: Complex, held: Complex, moved: Complex) -> Complex:
    """Response with poles moved and the static response of each kept: its residue grows with the pole."""
    s = 1j * rate
    parts = held[:-1] * (moved / poles)[:, None, None]
    first = np.einsum("fk,kij->fij", 1.0 / (s[:, None] - moved), parts)
    second = np.einsum("fk,kij->fij", 1.0 / (s[:, None] - np.conj(moved)), np.conj(parts))
    return np.asarray(first + second + held[-1])


def moved_poles(hypothesis: str, poles: Complex, values: NDArray[np.float64]) -> Complex:
    """Poles of another level."""
    if hypothesis == "clock":
        return np.asarray(poles * (1.0 - values[0]))
    if hypothesis == "softening of all modes alike":
        return np.asarray(poles.real * (1.0 + values[1]) + 1j * poles.imag * (1.0 - values[0]))
    if hypothesis == "shift per mode":
        shift, damping = values.reshape(2, -1)
        return np.asarray(poles.real * (1.0 + damping) + 1j * poles.imag * (1.0 - shift))
    return poles


SIZES = {"low level as it is": 0, "common factor": 1, "factor per input": 3, "clock": 1, "softening of all modes alike": 2}
HYPOTHESES = (*SIZES, "shift per mode")


def predicted(hypothesis: str, rate: NDArray[np.float64], poles: Complex, held: Complex, values: NDArray[np.float64]) -> Complex:
    """Response of another level."""
    if hypothesis in ("common factor", "factor per input"):
        return modal_response(rate, poles, held, poles) * (1.0 + values)
    return modal_response(rate, poles, held, moved_poles(hypothesis, poles, values))


def relative_error(command: Complex, measurement: Complex, found: Complex, realizations: Sequence[int]) -> float:
    """Error of a response on realizations, % of rms."""
    y = measurement[:, :, realizations]
    return float(100.0 * np.sqrt(np.sum(np.abs(y - found @ command[:, :, realizations]) ** 2) / np.sum(np.abs(y) ** 2)))


def shifts(hypothesis: str, rate: NDArray[np.float64], poles: Complex, held: Complex, target: Complex) -> NDArray[np.float64]:
    """Numbers of a hypothesis that bring the low level's response closest to another one."""
    count = 2 * len(poles) if hypothesis == "shift per mode" else SIZES[hypothesis]
    if not count:
        return np.zeros(0)
    scale = float(np.sqrt(np.mean(np.abs(target) ** 2)))

    def left(values: NDArray[np.float64]) -> Any:
        error = (target - predicted(hypothesis, rate, poles, held, values)).reshape(-1) / scale
        weak = 1e-2 * np.sqrt(len(error) / max(count, 1)) * values  # a mode that is not seen stays where it is
        return np.concatenate([error.real, error.imag, weak])

    start = np.full(count, 1e-3)
    return np.asarray(least_squares(left, start, method="trf", x_scale=np.full(count, 0.01), max_nfev=40).x)


def calculate(levels: Sequence[Level]) -> dict[tuple[str, str], float]:
    """Errors (% of rms) by hypothesis and level, on the sixth realization; the middle level has no number fitted to it."""
    data = {mv: spectra(level) for mv, level in zip(LEVELS, levels, strict=True)}
    rate = data[100][2]
    low = response(*data[100][:2], (0, 1, 2, 3))
    poles = vector_fit(low, rate)
    held = residues(low, rate, poles)
    high = response(*data[300][:2], (0, 1, 2, 3))
    found = {("per line, own level", f"{level} mV"): relative_error(*data[level][:2], response(*data[level][:2], (0, 1, 2, 3)), (5,))
             for level in data}  # fmt: skip
    for hypothesis in HYPOTHESES:
        values = shifts(hypothesis, rate, poles, held, high)
        for level, share in ((300, 1.0), (200, MIDDLE)):
            error = relative_error(*data[level][:2], predicted(hypothesis, rate, poles, held, share * values), (5,))
            found[hypothesis, f"{level} mV"] = error
    found["low level as it is", "100 mV"] = relative_error(*data[100][:2], modal_response(rate, poles, held, poles), (5,))
    return found


def run(figures: str | None = None) -> Table:
    """Compare the hypotheses and return the table."""
    table = Table("reproduce mirror-levels")
    for (hypothesis, level), error in calculate(load_levels()).items():
        table.add("Change between levels, realization 6", level, hypothesis, "relative_error", "% of rms", error, n=1)
    if figures is not None:
        write_page(figures, table)
    return table
