"""Effects that are put into measured records, single and outside the catalogue, and their strength for a given size.

Effects of the sensor act on the measurement; effects of the drive that can be inverted act backwards on the command: the recorded command
u is what the effect made of another one, c, and c takes its place. They are written here with numpy and scipy alone: nothing is shared
with the catalogue that is tested.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.signal import bilinear, lfilter, lfilter_zi

from hyst_control.blind_test.injected_machines import Clean

Array = NDArray[np.float64]

SCALES = np.geomspace(1e-6, 1e3, 37)
"""Strengths among which that of a given size is sought."""


@dataclass(frozen=True)
class Injection:
    """Effect that is put in: strength s > 0 to another command or measurement.

    Parameters
    ----------
    name
        In the gap report's vocabulary; "unknown" of the open set.
    apply
        (command (N, A), measurement (N, A), sample time, strength, random) to the two as recorded with the effect.
    realization
        Name among the realizations of the effect.
    """

    name: str
    apply: Callable[[Array, Array, float, float, np.random.Generator], tuple[Array, Array]]
    realization: str = ""


def _measured(change: Callable[[Array, float, float, np.random.Generator], Array]) -> Callable[..., tuple[Array, Array]]:
    return lambda u, y, step, s, random: (u, change(y, step, s, random))


def _commanded(change: Callable[[Array, float, float, np.random.Generator], Array]) -> Callable[..., tuple[Array, Array]]:
    return lambda u, y, step, s, random: (change(u, step, s, random), y)


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


def _ahead(u: Array, step: float, tau: float) -> Array:
    return _later(u[::-1], step, tau)[::-1]


SINGLES = (
    Injection("gain", _measured(lambda y, step, s, r: y * (1.0 + s)), "sensor"),
    Injection("gain", _commanded(lambda u, step, s, r: u / (1.0 + s)), "amplifier"),
    Injection("gain_drift", _measured(lambda y, step, s, r: y * (1.0 + s * _along(y))), "linear"),
    Injection("offset", _measured(lambda y, step, s, r: y + s * _span(y))),
    Injection("offset_drift", _measured(lambda y, step, s, r: y + s * _span(y) * _along(y)), "linear"),
    Injection("offset_drift", _measured(lambda y, step, s, r: y - s * _span(y) * np.expm1(-5.0 * _along(y))), "settling"),
    Injection("creep", _measured(lambda y, step, s, r: _creep(y, step, s, len(y) * step * np.array([0.01, 0.1, 1.0]))), "ladder"),
    Injection("delay", _measured(lambda y, step, s, r: _later(y, step, s * len(y) * step)), "sensor"),
    Injection("delay", _commanded(lambda u, step, s, r: _ahead(u, step, s * len(u) * step)), "command"),
    Injection("sensor_lowpass", _measured(lambda y, step, s, r: _lowpass(y, step, s * len(y) * step, 1)), "first"),
    Injection("sensor_lowpass", _measured(lambda y, step, s, r: _lowpass(y, step, s * len(y) * step, 2)), "second"),
    Injection("sensor_nonlinearity", _measured(lambda y, step, s, r: _bent(y, s, 0.0)), "even"),
    Injection("sensor_nonlinearity", _measured(lambda y, step, s, r: _bent(y, 0.3 * s, s)), "odd"),
    Injection("resonance", _measured(lambda y, step, s, r: _mode(y, step, s, 0.2 / step)), "sensor side"),
    Injection("backlash", _measured(lambda y, step, s, r: _play(y, s * _span(y)))),
    Injection("quantization", _measured(lambda y, step, s, r: s * _span(y) * np.round(y / (s * _span(y))))),
    Injection("held_samples", _measured(lambda y, step, s, r: _held(y, s, r))),
    Injection("mains_hum", _measured(lambda y, step, s, r: _line(y, step, 50.0, s * _span(y), r))),
    Injection("vibration", _measured(lambda y, step, s, r: _line(y, step, 0.31 / step, s * _span(y), r))),
    Injection("sensor_noise", _measured(lambda y, step, s, r: y + s * _span(y) * r.standard_normal(y.shape))),
    Injection("flicker_noise", _measured(lambda y, step, s, r: y + s * _span(y) * _flicker(y, r))),
    Injection("dac_hold", _commanded(lambda u, step, s, r: u + s * np.ptp(u, axis=0) * r.uniform(-0.5, 0.5, u.shape)), "rounding"),
)
OPEN_SET = (
    Injection("unknown", _measured(lambda y, step, s, r: y + s * _span(y) * 30.0 * (r.random(y.shape) < 0.001)), "spikes"),
    Injection(
        "unknown", _measured(lambda y, step, s, r: _later(y, step, 0.0) + _warped(y, step, s * len(y) * step)), "clock mismatch"
    ),
    Injection("unknown", _measured(lambda y, step, s, r: _dead_band(y, s * _span(y))), "dead band"),
    Injection(
        "unknown", _measured(lambda y, step, s, r: y * (1.0 + s * (np.sin(40.0 * _along(y)) > 0))), "gain that comes and goes"
    ),
)


def _warped(y: Array, step: float, whole: float) -> Array:
    """Change by a clock that is `whole` seconds late at the end."""
    axis = step * np.arange(len(y))
    return np.asarray(CubicSpline(axis, y)(axis - whole * axis / axis[-1]) - y, dtype=np.float64)


def _dead_band(y: Array, half: Array) -> Array:
    center = y.mean(axis=0)
    away = y - center
    return np.asarray(center + np.sign(away) * np.maximum(np.abs(away) - half, 0.0), dtype=np.float64)


def strength_of(
    injections: Sequence[Injection], clean: Clean, step: float, rms: float, seed: Sequence[int]
) -> tuple[float, Array, Array]:
    """Find the strength at which effects change the record by a given rms; effects of the drive, the command's equivalent.

    Parameters
    ----------
    injections
        Effects, all of the same relative strength.
    clean
        Clean record.
    step
        Sample time, s.
    rms
        Size of the change, measurement unit.
    seed
        Seed of what is random in them.

    Returns
    -------
    strength
        The common strength.
    command, measurement
        The record with the effects, (N, A).
    """
    slope = float(np.sqrt(np.mean(np.var(clean.measurement, axis=0)) / max(np.mean(np.var(clean.command, axis=0)), 1e-300)))

    def record(strength: float) -> tuple[Array, Array]:
        command, measurement = clean.command, clean.measurement
        for injection in injections:
            command, measurement = injection.apply(command, measurement, step, strength, np.random.default_rng(list(seed)))
        return np.asarray(command, dtype=np.float64), np.asarray(measurement, dtype=np.float64)

    def size(strength: float) -> float:
        command, measurement = record(strength)
        moved = measurement - clean.measurement
        return float(np.sqrt(np.mean(moved**2) + slope**2 * np.mean((command - clean.command) ** 2)))

    beyond = next((scale for scale in SCALES if size(scale) > rms), None)
    if beyond is None:
        strength = float(SCALES[-1])
    elif size(beyond / 2.0) > rms:
        strength = float(beyond)
    else:
        strength = float(np.exp(brentq(lambda x: size(float(np.exp(x))) - rms, np.log(beyond / 2.0), np.log(beyond), xtol=1e-3)))
    return (strength, *record(strength))
