# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Poles of a linear plant from records in time: vector fitting, a start for every order without a guess.

With poles p_i as they are, the sampled plant obeys y = Σ c_i φ_i[u] + d u - Σ k_i ψ_i[y] + what the record adds, φ_i being the response
of 1/(s - p_i) and ψ_i that of 1/(z - exp p_i), so the k_i are a linear least-squares problem; the zeros of 1 + Σ k_i/(z - exp p_i) are
better poles (Gustavsen and Semlyen, IEEE Trans. Power Delivery 14, 1999; in time: Grivet-Talocia, IEEE Trans. Circuits and Systems II
50, 2003). Time is counted in samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from hyst_control.base.arrays import Array
from hyst_control.identify.modal.modal_model import input_taps
from hyst_control.identify.solve.gram_sums import Window

RELOCATIONS, SETTLED = 10, 0.99
"""Most relocations of the poles; two in a row that leave more than this share of the least error end them."""
SLOWEST, MIN_DECAY = 0.05, 0.02  # Least rate of a real pole and least decay of a pair, in inverse record lengths
FASTEST = -20.0  # Fastest real pole, in inverse samples: a faster one is a direct path


@dataclass(frozen=True)
class Partial:
    """Partial fractions of a plant: poles (n,) with Im >= 0, the residue of each, the direct path, and the mean square error."""

    poles: np.ndarray
    residues: np.ndarray
    direct: float
    error: float


def vector_fit(windows: Sequence[Window], start: np.ndarray, delay: float, direct: bool, relocations: int = RELOCATIONS) -> Partial:
    """The best of the partial fractions met on the way from the poles of a start."""
    rows = max(len(window.command) for window in windows)
    equations = Equations.of(windows, start, delay, direct)
    best = equations.partial()
    stale = 0
    for _ in range(relocations):
        equations = Equations.of(windows, equations.relocated(rows), delay, direct)
        found = equations.partial()
        stale = stale + 1 if found.error > SETTLED * best.error else 0
        best = min(best, found, key=lambda each: each.error)
        if stale == 2:
            break
    return best


@dataclass(frozen=True)
class Equations:
    """Least-squares equations of records for given poles, as a triangle R whose Gram matrix R'R is that of all rows.

    Its columns are the responses to the command, the measurement, and the sampled responses to the measurement, all without what offset,
    drift and unknown initial state explain of them.
    """

    poles: np.ndarray
    direct: bool
    triangle: Array
    rows: int

    @classmethod
    def of(cls, windows: Sequence[Window], poles: np.ndarray, delay: float, direct: bool, own: bool = True) -> Equations:
        """Set up the equations; own: with the responses to the measurement, which only a relocation needs."""
        parts = []
        for window in windows:
            time = np.arange(len(window.command))
            session = [np.ones(len(time)), time / len(time) - 0.5, *_real(poles, [np.exp(pole * time) for pole in poles])]
            columns = [*driven(window, poles, delay, direct), window.measurement]
            if own:
                columns += _real(poles, _sampled_responses(poles, window.measurement - window.measurement[0]))
            if window.skip:  # rows that do not count tell free motion and drift all the same
                basis = qr(np.column_stack(session), mode="economic")[0]
                columns = [(column - basis @ (basis.T @ column))[window.skip :] for column in columns]
                parts.append(_triangle(columns))
            else:  # what the first columns explain is in the first rows of the triangle
                parts.append(_triangle([*session, *columns])[len(session) :, len(session) :])
        triangle = parts[0] if len(parts) == 1 else _triangle(list(np.vstack(parts).T))
        return cls(poles, direct, triangle, sum(len(window.command) - window.skip for window in windows))

    def partial(self) -> Partial:
        """The residues that fit best."""
        states = _states(self.poles)
        count = states + self.direct
        found, left = _solved(self.triangle[:, :count], self.triangle[:, count], 1e-11)
        residues, at = [], 0
        for pole in self.poles:
            residues.append(complex(found[at], found[at + 1] if pole.imag else 0.0))
            at += 2 if pole.imag else 1
        direct = float(found[states]) if self.direct else 0.0
        return Partial(self.poles, np.array(residues, dtype=complex), direct, float(left @ left) / self.rows)

    def relocated(self, rows: int) -> np.ndarray:
        """Better poles: the zeros of 1 + Σ k_i/(z - exp p_i), as records of so many rows show them."""
        states = _states(self.poles)
        count = states + self.direct
        others = np.delete(self.triangle, count, axis=1)
        others[:, count:] *= -1.0
        weights = _solved(others, self.triangle[:, count], 1e-12)[0][count:]
        transition, entry, at = np.zeros((states, states)), np.ones(states), 0
        for pole in self.poles:
            turn = np.exp(pole)
            if pole.imag:
                transition[at : at + 2, at : at + 2] = [[turn.real, turn.imag], [-turn.imag, turn.real]]
                entry[at : at + 2] = [2.0, 0.0]
                at += 2
            else:
                transition[at, at] = turn.real
                at += 1
        turns = np.linalg.eigvals(transition - np.outer(entry, weights)).astype(complex)
        lags = np.abs(turns.imag) <= 1e-9 * np.abs(turns)
        turns[lags] = np.maximum(turns[lags].real, np.exp(FASTEST))
        return _admissible(np.log(turns), rows)


def residues_of(windows: Sequence[Window], poles: np.ndarray, delay: float, direct: bool) -> Partial:
    """The residues that fit best for given poles."""
    return Equations.of(windows, poles, delay, direct, own=False).partial()


def spread_poles(order: int, rows: int) -> np.ndarray:
    """Poles to begin with: damped pairs, evenly spaced in the logarithm of frequency, and one lag if the order is odd."""
    pairs = order // 2
    angle = np.geomspace(4.0 * np.pi / rows, 1.0, pairs + 2)[1:-1]
    lag = [-np.sqrt(1.0 / rows)] if order % 2 else []
    return np.concatenate([-0.3 * angle + 1j * angle, np.array(lag, dtype=complex)])


def _admissible(poles: np.ndarray, rows: int) -> np.ndarray:
    """Stable poles with Im >= 0, none slower than a record shows or faster than its sampling."""
    poles = -np.abs(poles.real) + 1j * poles.imag
    real = np.abs(poles.imag) <= 1e-9 * np.abs(poles)
    lags = -np.clip(np.abs(poles[real].real), SLOWEST / rows, -FASTEST)
    pairs = poles[~real & (poles.imag > 0)]
    pairs = -np.maximum(-pairs.real, MIN_DECAY / rows) + 1j * np.minimum(pairs.imag, np.pi)
    return np.concatenate([pairs, np.sort(lags)])


def driven(window: Window, poles: np.ndarray, delay: float = 0.0, direct: bool = False) -> list[Array]:
    """Real columns (N,) of the responses of poles, and of a direct path, to the command of a window."""
    command = window.command - window.command[0]
    columns = _real(poles, _responses(poles, command, delay, window.hold))
    if direct:
        whole = int(np.floor(delay + 1e-9))
        late = delay - whole if window.hold == "foh" else 0.0
        shifted = _shifted(command, whole + (window.hold == "zoh"))
        columns.append((1.0 - late) * shifted + late * _shifted(shifted, 1))
    return columns


def _responses(poles: np.ndarray, signal: Array, delay: float, hold: str) -> list[np.ndarray]:
    """Responses (N,) of 1/(s - p) to a held signal, from rest."""
    from scipy.signal import lfilter  # takes a second

    whole = int(np.floor(delay + 1e-9))
    late = _shifted(signal, whole + (hold == "zoh"))
    return [
        lfilter(np.array(input_taps(pole, max(delay - whole, 0.0), hold)), [1.0, -np.exp(pole)], late.astype(complex))
        for pole in poles
    ]


def _sampled_responses(poles: np.ndarray, signal: Array) -> list[np.ndarray]:
    """Responses (N,) of 1/(z - exp p) to samples, from rest."""
    from scipy.signal import lfilter  # takes a second

    return [lfilter([0.0, 1.0], [1.0, -np.exp(pole)], signal.astype(complex)) for pole in poles]


def _shifted(signal: Array, rows: int) -> Array:
    return np.concatenate([np.zeros(min(rows, len(signal))), signal])[: len(signal)]


def _real(poles: np.ndarray, columns: Sequence[np.ndarray]) -> list[Array]:
    """Real columns of c φ + conj(c φ) for the real and the imaginary part of c."""
    found: list[Array] = []
    for pole, column in zip(poles, columns, strict=True):
        found += [2.0 * column.real, -2.0 * column.imag] if pole.imag else [column.real]
    return found


def _states(poles: np.ndarray) -> int:
    return len(poles) + int(np.count_nonzero(poles.imag))


def _triangle(columns: Sequence[Array]) -> Array:
    """Triangular factor (K, K) of columns (N,); rows of zeros where there are fewer than K."""
    block = np.empty((max(len(columns[0]), len(columns)), len(columns)), order="F")
    block[len(columns[0]) :] = 0.0
    for number, column in enumerate(columns):
        block[: len(column), number] = column
    _, triangle = qr(block, mode="raw", overwrite_a=True, check_finite=False)
    return np.asarray(triangle, dtype=np.float64)


def _solved(columns: Array, target: Array, rcond: float) -> tuple[Array, Array]:
    """Least-squares solution of the equations of a triangle, and its residual."""
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    found = np.linalg.lstsq(columns / scale, target, rcond=rcond)[0] / scale
    return found, target - columns @ found
