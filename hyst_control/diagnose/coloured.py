"""Noise that falls with frequency: flicker noise in a residual, told from what follows the command."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.signal import butter, sosfiltfilt

from hyst_control.chain.stage import Array

SEGMENTS = 24


@dataclass(frozen=True)
class Flicker:
    """1/f noise beside white noise: its rms (in the residual's unit), 90 % interval, and the gain in log-likelihood (nats)."""

    rms: float
    ci90: tuple[float, float]
    gain: float
    stationary: bool


def flicker(residual: Array, command: Array) -> Flicker:
    """Fit a + b/f to the periodogram of a residual (N,) by Whittle's likelihood; a the white part, b the flicker.

    stationary: whether what is slow in the residual is about as large where the command (N,) rests as where it moves.
    """
    count = len(residual)
    power = np.abs(np.fft.rfft(residual)[1:count // 2]) ** 2 / count
    k = np.arange(1, len(power) + 1)
    white = float(np.mean(power[len(power) // 2:]))

    def misfit(logs: Array) -> float:
        spectrum = np.exp(logs[0]) + np.exp(logs[1]) / k
        return float(np.sum(np.log(spectrum) + power / spectrum))

    alone = float(np.sum(np.log(np.mean(power)) + power / np.mean(power)))
    best = min((minimize(misfit, [np.log(white), np.log(white * start)], method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3})
                for start in (1e-1, 1e2)), key=lambda found: found.fun)
    b = float(np.exp(best.x[1]))
    variance = 2.0 * b * float(np.sum(1.0 / k)) / count
    # The information on log b is the sum of the squared share of the flicker in every bin.
    share = (b / k) / (np.exp(best.x[0]) + b / k)
    spread = min(1.645 * 0.5 / np.sqrt(max(float(np.sum(share ** 2)), 1e-9)), 10.0)
    rms = float(np.sqrt(variance))
    return Flicker(rms, (rms * np.exp(-spread), rms * np.exp(spread)), alone - float(best.fun), _stationary(residual, command))


def _stationary(residual: Array, command: Array) -> bool:
    slow = sosfiltfilt(butter(2, 0.1, output="sos"), residual)
    length = max(len(residual) // SEGMENTS, 1)
    edges = range(0, len(residual) - length + 1, length)
    energy = np.array([np.mean(slow[a:a + length] ** 2) for a in edges])
    activity = np.array([np.mean(np.abs(np.diff(command[a:a + length]))) for a in edges])
    order = np.argsort(activity)
    third = max(len(order) // 3, 1)
    quiet, busy = np.median(energy[order[:third]]), np.median(energy[order[-third:]])
    return bool(busy < 6.0 * quiet)
