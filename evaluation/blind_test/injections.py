# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects that are put into measured records, single and outside the catalogue, and their strength for a given size.

Effects of the drive act backwards on the command: the recorded command u is what the effect made of another one, c, and c takes its
place. They are written with numpy and scipy alone: nothing is shared with the catalogue that is tested.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.signal import bilinear, lfilter, lfilter_zi

from hyst_control.base.arrays import Array
from hyst_control.records.record import Record

SCALES = np.geomspace(1e-6, 1e3, 37)
"""Strengths among which that of a given size is sought."""
COMPANIONS = ("offset", "offset_drift")
"""Differ between sessions that nothing was done to."""

Change = Callable[[Array, float, float, np.random.Generator], Array]
"""(rows (N, A), sample time, strength, random) to the rows with the effect."""


@dataclass(frozen=True)
class Injection:
    """Effect that is put in: strength s > 0 to another command or measurement."""

    name: str  # In the gap report's vocabulary; "unknown" of the open set
    change: Change  # Of the measurement, or backwards of the command
    realization: str = ""  # Name among the realizations of the effect
    # (strength, measurement, sample time) to the true value of each parameter that the gap report defines alike, by axis or for all
    truth: Callable[[float, Array, float], dict[str, Array | float]] = lambda s, y, step: {}
    drive: bool = False  # True where the command is changed

    def apply(
        self, command: Array, measurement: Array, step: float, strength: float, random: np.random.Generator
    ) -> tuple[Array, Array]:
        """The record with the effect in it."""
        if self.drive:
            return self.change(command, step, strength, random), measurement
        return command, self.change(measurement, step, strength, random)


def _along(rows: Array) -> Array:
    return np.linspace(0.0, 1.0, len(rows))[:, None]


def _span(y: Array) -> Array:
    return np.asarray(np.ptp(y, axis=0), dtype=np.float64)


def _later(rows: Array, step: float, tau: float) -> Array:
    time_axis = step * np.arange(len(rows))
    return np.asarray(CubicSpline(time_axis, rows)(np.clip(time_axis - tau, 0.0, time_axis[-1])), dtype=np.float64)


def _lowpass(y: Array, step: float, tau: float, order: int) -> Array:
    b, a = bilinear([1.0], [tau, 1.0], 1.0 / step)
    for _ in range(order):
        y = lfilter(b, a, y, axis=0, zi=lfilter_zi(b, a)[:, None] * y[:1])[0]
    return np.asarray(y, dtype=np.float64)


def _creep(y: Array, step: float, share: float, times: Array) -> Array:
    slow = np.zeros_like(y)
    for tau in times:
        slow += _lowpass(y - y[0], step, tau, 1) / len(times)
    return np.asarray(y + share * slow, dtype=np.float64)


def _play(y: Array, half: Array) -> Array:
    found, state = np.empty_like(y), y[0].copy()
    for k, row in enumerate(y):
        state = np.clip(state, row - half, row + half)
        found[k] = state
    return found


def _bent(y: Array, second: float, third: float) -> Array:
    low, span = y.min(axis=0), _span(y)
    x = 2.0 * (y - low) / span - 1.0
    return np.asarray(y + 0.5 * span * (second * (1.5 * x**2 - 0.5) + third * (2.5 * x**3 - 1.5 * x)), dtype=np.float64)


def _line(y: Array, step: float, frequency: float, amplitude: Array, random: np.random.Generator) -> Array:
    angle = 2.0 * np.pi * frequency * step * np.arange(len(y))[:, None]
    return np.asarray(y + amplitude * np.sin(angle + random.uniform(0.0, 2.0 * np.pi, y.shape[1])), dtype=np.float64)


def _mode(y: Array, step: float, gain: float, frequency: float) -> Array:
    w = 2.0 * np.pi * frequency
    b, a = bilinear([w**2], [1.0, 0.04 * w, w**2], 1.0 / step)
    return np.asarray(y + gain * lfilter(b, a, y - y[0], axis=0), dtype=np.float64)


def _flicker(y: Array, random: np.random.Generator) -> Array:
    spectrum = np.fft.rfft(random.standard_normal(y.shape), axis=0)
    spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))[:, None]
    spectrum[0] = 0.0
    rows = np.fft.irfft(spectrum, len(y), axis=0)
    return np.asarray(rows / rows.std(axis=0), dtype=np.float64)


def _held(y: Array, share: float, random: np.random.Generator) -> Array:
    rows = np.arange(len(y))
    repeated = random.random(len(y)) < min(share, 0.9)
    repeated[0] = False
    rows[repeated] = 0
    return y[np.maximum.accumulate(rows)]


def _as_share(parameter: str) -> Callable[[float, Array, float], dict[str, Array | float]]:
    """Truth of a parameter whose strength is a share of the measurement's span."""
    return lambda s, y, step: {parameter: s * _span(y)}


def _as_gain(s: float, y: Array, step: float) -> dict[str, Array | float]:
    return {"gain": s}


def _as_delay(s: float, y: Array, step: float) -> dict[str, Array | float]:
    return {"tau": s * len(y) * step}


def _as_cutoff(s: float, y: Array, step: float) -> dict[str, Array | float]:
    return {"cutoff": 1.0 / (2.0 * np.pi * s * len(y) * step)}


SINGLES = (
    Injection("gain", lambda y, step, s, r: y * (1.0 + s), "sensor", _as_gain),
    Injection("gain", lambda u, step, s, r: u / (1.0 + s), "amplifier", _as_gain, drive=True),
    Injection("gain_drift", lambda y, step, s, r: y * (1.0 + s * _along(y)), "linear"),
    Injection("offset", lambda y, step, s, r: y + s * _span(y), truth=_as_share("offset")),
    Injection("offset_drift", lambda y, step, s, r: y + s * _span(y) * _along(y), "linear"),
    Injection("offset_drift", lambda y, step, s, r: y - s * _span(y) * np.expm1(-5.0 * _along(y)), "settling"),
    Injection("creep", lambda y, step, s, r: _creep(y, step, s, len(y) * step * np.array([0.01, 0.1, 1.0])), "ladder"),
    Injection("delay", lambda y, step, s, r: _later(y, step, s * len(y) * step), "sensor", _as_delay),
    Injection("delay", lambda u, step, s, r: _later(u[::-1], step, s * len(u) * step)[::-1], "command", _as_delay, drive=True),
    Injection("sensor_lowpass", lambda y, step, s, r: _lowpass(y, step, s * len(y) * step, 1), "first", _as_cutoff),
    Injection("sensor_lowpass", lambda y, step, s, r: _lowpass(y, step, s * len(y) * step, 2), "second"),
    Injection("sensor_nonlinearity", lambda y, step, s, r: _bent(y, s, 0.0), "even"),
    Injection("sensor_nonlinearity", lambda y, step, s, r: _bent(y, 0.3 * s, s), "odd"),
    Injection("resonance", lambda y, step, s, r: _mode(y, step, s, 0.2 / step), "sensor side"),
    Injection("backlash", lambda y, step, s, r: _play(y, s * _span(y)), truth=_as_share("half_width")),
    Injection("quantization", lambda y, step, s, r: s * _span(y) * np.round(y / (s * _span(y))), truth=_as_share("step")),
    Injection("held_samples", lambda y, step, s, r: _held(y, s, r), truth=lambda s, y, step: {"fraction": min(s, 0.9)}),
    Injection("mains_hum", lambda y, step, s, r: _line(y, step, 50.0, s * _span(y), r), truth=_as_share("amplitude")),
    Injection("vibration", lambda y, step, s, r: _line(y, step, 0.31 / step, s * _span(y), r)),
    Injection("sensor_noise", lambda y, step, s, r: y + s * _span(y) * r.standard_normal(y.shape), truth=_as_share("rms")),
    Injection("flicker_noise", lambda y, step, s, r: y + s * _span(y) * _flicker(y, r)),
    Injection("dac_hold", lambda u, step, s, r: u + s * _span(u) * r.uniform(-0.5, 0.5, u.shape), "rounding", drive=True),
)
OPEN_SET = (
    Injection("unknown", lambda y, step, s, r: y + s * _span(y) * _spikes(y, r), "spikes"),
    Injection("unknown", lambda y, step, s, r: y + _warped(y, step, s * len(y) * step), "clock mismatch"),
    Injection("unknown", lambda y, step, s, r: _dead_band(y, s * _span(y)), "dead band"),
    Injection("unknown", lambda y, step, s, r: y * (1.0 + s * (np.sin(40.0 * _along(y)) > 0)), "gain that comes and goes"),
)


def _spikes(y: Array, random: np.random.Generator) -> Array:
    """Some single samples far off, of either sign."""
    found = np.zeros_like(y)
    for column in found.T:
        column[random.permutation(len(y))[: max(3, len(y) // 500)]] = random.choice([-20.0, 20.0])
    return found


def _warped(y: Array, step: float, whole: float) -> Array:
    """Change by a clock that is `whole` seconds late at the end."""
    axis = step * np.arange(len(y))
    return np.asarray(CubicSpline(axis, y)(axis - whole * axis / axis[-1]) - y, dtype=np.float64)


def _dead_band(y: Array, half: Array) -> Array:
    center = y.mean(axis=0)
    away = y - center
    return np.asarray(center + np.sign(away) * np.maximum(np.abs(away) - half, 0.0), dtype=np.float64)


def apply_all(
    injections: Sequence[Injection], strengths: Sequence[float], clean: Record, step: float, seed: Sequence[int]
) -> tuple[Array, Array]:
    """Put effects into a record, one after the other."""
    command, measurement = clean.command, clean.measurement
    for injection, strength in zip(injections, strengths, strict=True):
        command, measurement = injection.apply(command, measurement, step, strength, np.random.default_rng(list(seed)))
    return np.asarray(command, dtype=np.float64), np.asarray(measurement, dtype=np.float64)


def structural_rms(rows: Annotated[Array, "N A"], first: int) -> float:
    """Rms of a difference from row `first` on, without a zero, a drift and a curvature of its own, which differ between sessions."""
    counted = rows[first:]
    basis = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(counted)), 2)
    rest = counted - basis @ np.linalg.lstsq(basis, counted, rcond=None)[0]
    return float(np.sqrt(np.mean(rest**2)))


def size_of(command: Annotated[Array, "N A"], measurement: Annotated[Array, "N A"], clean: Record, first: int) -> float:
    """Size of a change of a record; of its command, by the record's mean slope."""
    slope = float(np.sqrt(np.mean(np.var(clean.measurement, axis=0)) / max(np.mean(np.var(clean.command, axis=0)), 1e-300)))
    moved, driven = structural_rms(measurement - clean.measurement, first), structural_rms(command - clean.command, first)
    return float(np.hypot(moved, slope * driven))


def strength_of(injection: Injection, clean: Record, step: float, rms: float, seed: Sequence[int], first: int = 0) -> float:
    """Find the strength at which an effect changes the record by a given rms; see `size_of`."""

    def size(strength: float) -> float:
        command, measurement = apply_all([injection], [strength], clean, step, seed)
        if injection.name in COMPANIONS:
            return float(np.sqrt(np.mean((measurement - clean.measurement)[first:] ** 2)))
        return size_of(command, measurement, clean, first)

    beyond = next((scale for scale in SCALES if size(scale) > rms), None)
    if beyond is None:
        return float(SCALES[-1])
    if size(beyond / 2.0) > rms:
        return float(beyond)
    return float(np.exp(brentq(lambda x: size(float(np.exp(x))) - rms, np.log(beyond / 2.0), np.log(beyond), xtol=1e-3)))
