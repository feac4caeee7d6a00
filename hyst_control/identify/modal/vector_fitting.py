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
    poles, best = start, residues_of(windows, start, delay, direct)
    stale = 0
    for _ in range(relocations):
        poles = _relocated(windows, poles, delay, direct)
        found = residues_of(windows, poles, delay, direct)
        stale = stale + 1 if found.error > SETTLED * best.error else 0
        best = min(best, found, key=lambda each: each.error)
        if stale == 2:
            break
    return best


def residues_of(windows: Sequence[Window], poles: np.ndarray, delay: float, direct: bool) -> Partial:
    """The residues that fit best for given poles."""
    parts = []
    for window in windows:
        columns = driven(window, poles, delay, direct)
        parts.append(_without_session(window, poles, [*columns, window.measurement]))
    found, left = _solved(parts, 1e-11)
    residues, at = [], 0
    for pole in poles:
        residues.append(complex(found[at], found[at + 1] if pole.imag else 0.0))
        at += 2 if pole.imag else 1
    rows = sum(len(part) for part in parts)
    return Partial(poles, np.array(residues, dtype=complex), float(found[at]) if direct else 0.0, float(left @ left) / rows)


def spread_poles(order: int, rows: int) -> np.ndarray:
    """Poles to begin with: damped pairs, evenly spaced in the logarithm of frequency, and one lag if the order is odd."""
    pairs = order // 2
    angle = np.geomspace(4.0 * np.pi / rows, 1.0, pairs + 2)[1:-1]
    lag = [-np.sqrt(1.0 / rows)] if order % 2 else []
    return np.concatenate([-0.3 * angle + 1j * angle, np.array(lag, dtype=complex)])


def _relocated(windows: Sequence[Window], poles: np.ndarray, delay: float, direct: bool) -> np.ndarray:
    parts, own_from = [], 0
    for window in windows:
        columns = driven(window, poles, delay, direct)
        own_from = len(columns)
        own = _real(poles, _sampled_responses(poles, window.measurement - window.measurement[0]))
        parts.append(_without_session(window, poles, [*columns, *(-column for column in own), window.measurement]))
    found, _ = _solved(parts, 1e-12)
    states = len(found) - own_from
    transition, entry, at = np.zeros((states, states)), np.ones(states), 0
    for pole in poles:
        turn = np.exp(pole)
        if pole.imag:
            transition[at : at + 2, at : at + 2] = [[turn.real, turn.imag], [-turn.imag, turn.real]]
            entry[at : at + 2] = [2.0, 0.0]
            at += 2
        else:
            transition[at, at] = turn.real
            at += 1
    turns = np.linalg.eigvals(transition - np.outer(entry, found[own_from:])).astype(complex)
    lags = np.abs(turns.imag) <= 1e-9 * np.abs(turns)
    turns[lags] = np.maximum(turns[lags].real, np.exp(FASTEST))
    return _admissible(np.log(turns), max(len(w.command) for w in windows))


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


def _without_session(window: Window, poles: np.ndarray, columns: Sequence[Array]) -> Array:
    """Columns (N, K) without what offset, drift and unknown initial state explain of them."""
    time = np.arange(len(window.command))
    own = [np.ones(len(time)), time / len(time) - 0.5, *_real(poles, [np.exp(pole * time) for pole in poles])]
    basis = qr(np.column_stack(own), mode="economic")[0]
    block = np.column_stack(columns)
    found: Array = block - basis @ (basis.T @ block)
    return found[window.skip :]


def _solved(parts: Sequence[Array], rcond: float) -> tuple[Array, Array]:
    """Least-squares solution of all rows [columns, target], and the residual of their triangular factor, which has the same norm."""
    triangle = qr(np.vstack(parts), mode="r", check_finite=False)[0][: parts[0].shape[1]]
    scale = np.maximum(np.linalg.norm(triangle[:, :-1], axis=0), 1e-300)
    found = np.linalg.lstsq(triangle[:, :-1] / scale, triangle[:, -1], rcond=rcond)[0] / scale
    return found, triangle[:, -1] - triangle[:, :-1] @ found
