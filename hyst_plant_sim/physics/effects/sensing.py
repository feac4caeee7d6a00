# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects in the sensor, its converter, and on the path of the samples."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.effects.drive import gain_factor, low_pass_effect
from hyst_plant_sim.physics.effects.effect import Context, Effect, Pointwise, Timed
from hyst_plant_sim.physics.parts import Clip
from hyst_plant_sim.physics.signal_path import Part

FLICKER_LOWEST, FLICKER_PER_DECADE = 0.03, 2


class White(Part):
    """White noise that is independent of the sensor's."""

    def __init__(self, rms: float, context: Context) -> None:
        self._rms, self._context = rms, context

    def settle(self, value: float) -> float:
        """Restart the noise at a constant input."""
        self._stream = self._context.stream("sensor_noise")
        return value + self._rms * float(self._stream.standard_normal())

    def process(self, block: Array) -> Array:
        """Add white noise to a block."""
        return block + self._rms * self._stream.standard_normal(len(block))


class Flicker(Part):
    """Noise that falls as 1/f: first-order low-passed noises, two per decade from 0.03 Hz to half the sampling rate."""

    def __init__(self, rms: float, context: Context, exponent: float = 1.0) -> None:
        self._context = context
        decades = np.log10(0.5 / context.period / FLICKER_LOWEST)
        corners = FLICKER_LOWEST * 10.0 ** (np.arange(int(decades * FLICKER_PER_DECADE) + 1) / FLICKER_PER_DECADE)
        self._keep = np.exp(-2 * np.pi * corners * context.period)
        self._fresh = np.sqrt(1.0 - self._keep**2)
        self._size = (corners / corners[0]) ** (0.5 - 0.5 * exponent)
        self._rms = rms / float(np.sqrt(np.sum(self._size**2)))

    def settle(self, value: float) -> float:
        """Restart the noise, its low-passes already in their steady state."""
        self._stream = self._context.stream("flicker_noise")
        self._state = self._stream.standard_normal(len(self._keep))
        return value + self._rms * float(self._size @ self._state)

    def process(self, block: Array) -> Array:
        """Add 1/f noise to a block."""
        draws = self._stream.standard_normal((len(block), len(self._keep)))
        noise = np.empty(len(block))
        _coloured(draws, self._keep, self._fresh, self._size, self._state, noise)
        return block + self._rms * noise


class Outliers(Part):
    """Random samples that deviate, up or down, by half to all of a size."""

    def __init__(self, fraction: float, size: float, context: Context) -> None:
        self._fraction, self._size, self._context = fraction, size, context

    def settle(self, value: float) -> float:
        """Restart the random stream; the first sample is no outlier."""
        self._stream = self._context.stream("outliers")
        return value

    def process(self, block: Array) -> Array:
        """Add the outliers to a block."""
        draws = self._stream.random((len(block), 2))
        height = self._size * np.where(draws[:, 1] < 0.5, draws[:, 1] - 1.0, draws[:, 1])
        return block + np.where(draws[:, 0] < self._fraction, height, 0.0)


class Held(Part):
    """Random samples that repeat the one before."""

    def __init__(self, fraction: float, run: int, context: Context) -> None:
        self._fraction, self._run, self._context = fraction, run, context

    def settle(self, value: float) -> float:
        """Restart the random stream; the first sample is fresh."""
        self._stream, self._last, self._left = self._context.stream("held_samples"), value, 0
        return value

    def process(self, block: Array) -> Array:
        """Repeat the sample before wherever the random stream says so."""
        draws = self._stream.random(len(block))
        fresh = self._in_runs(draws) if self._run > 1 else draws >= self._fraction
        newest = np.maximum.accumulate(np.where(fresh, np.arange(len(block)), -1))
        output = np.where(newest < 0, self._last, block[newest])
        self._last = float(output[-1]) if len(output) else self._last
        return output

    def _in_runs(self, draws: Array) -> NDArray[np.bool_]:
        """False in runs of repeated samples that begin at random, as often as makes the fraction of the samples."""
        begin = draws < self._fraction / (self._run - (self._run - 1) * self._fraction)
        fresh = np.ones(len(draws), bool)
        for k in range(len(fresh)):
            if self._left == 0 and begin[k]:
                self._left = self._run
            fresh[k] = self._left == 0
            self._left = max(self._left - 1, 0)
        return fresh


@njit(cache=True, error_model="numpy")
def _coloured(draws: Array, keep: Array, fresh: Array, size: Array, state: Array, output: Array) -> None:
    for k in range(draws.shape[0]):
        total = 0.0
        for i in range(keep.size):
            state[i] = keep[i] * state[i] + fresh[i] * draws[k, i]
            total += size[i] * state[i]
        output[k] = total


def _arrived(times: Array, tau: float, law: float) -> Array:
    """Fraction of a drift that has occurred by each time.

    law 0: 1 - exp(-t / tau); 1: t / tau until then; 2: log10(1 + 9 t / tau); 3: -exp(-t / tau), which settles at the nominal value.
    """
    if law == 1:
        return np.minimum(times / tau, 1.0)
    if law == 2:
        return np.log10(1.0 + 9.0 * times / tau)
    return -np.exp(-times / tau) if law == 3 else -np.expm1(-times / tau)


def _nonlinearity(values: Mapping[str, float], context: Context) -> Pointwise:
    lower, upper = context.frame.stroke

    def bent(y: Array) -> Array:
        x = 2.0 * (y - lower) / (upper - lower) - 1.0
        return y + values["second"] * 0.5 * (3.0 * x * x - 1.0) + values["third"] * 0.5 * (5.0 * x * x - 3.0) * x

    return Pointwise(bent)


def _hum(values: Mapping[str, float], context: Context) -> Timed:
    phase = 2 * np.pi * context.stream("mains_hum").random()

    def hum(y: Array, times: Array) -> Array:
        angle = 2 * np.pi * values["frequency"] * times + phase
        odd = values["third"] * np.sin(3.0 * angle) + values["fifth"] * np.sin(5.0 * angle)
        return y + values["amplitude"] * (np.sin(angle) + values["second"] * np.sin(2.0 * angle) + odd)

    return Timed(hum, context)


EFFECTS = {
    "sensor_lowpass": low_pass_effect("sensor", "after the mechanics"),
    "sensor_nonlinearity": Effect(
        "insert",
        "sensor",
        {"second": 0.0, "third": 0.0},
        _nonlinearity,
        "Legendre polynomials of degree 2 and 3 over the stroke are added.",
        {"second": "unit", "third": "unit"},
    ),
    "output_saturation": Effect(
        "insert",
        "sensor",
        {"lower": -np.inf, "upper": np.inf},
        lambda v, c: Clip(v["lower"], v["upper"]),
        "What is measured ends at a side.",
        {"lower": "unit", "upper": "unit"},
    ),
    "gain": Effect(
        "insert",
        "sensor",
        {"gain": 0.0},
        gain_factor,
        "The sensor's gain is 1 + gain; `at: amplifier` or `at: piezo` puts it there.",
        {"gain": ""},
    ),
    "gain_drift": Effect(
        "insert",
        "sensor",
        {"change": 0.0},
        lambda v, c: Timed(lambda y, t: y * (1.0 + v["change"] * _arrived(t, v["tau"], v["law"])), c),
        "The gain drifts by change as 1 - exp(-t / tau), or by another `law`: 1 straight, 2 logarithm, 3 toward the nominal gain.",
        {"change": "", "tau": "s", "law": ""},
        {"tau": 1.0, "law": 0},
    ),
    "offset": Effect(
        "insert",
        "sensor",
        {"offset": 0.0},
        lambda v, c: Pointwise(lambda y: y + v["offset"]),
        "The sensor's zero is off.",
        {"offset": "unit"},
    ),
    "offset_drift": Effect(
        "insert",
        "sensor",
        {"change": 0.0},
        lambda v, c: Timed(lambda y, t: y + v["change"] * _arrived(t, v["tau"], v["law"]), c),
        "The zero drifts by change as 1 - exp(-t / tau), or by another `law`: 1 straight, 2 logarithm, 3 toward the nominal zero.",
        {"change": "unit", "tau": "s", "law": ""},
        {"tau": 1.0, "law": 0},
    ),
    "mains_hum": Effect(
        "insert",
        "sensor",
        {"amplitude": 0.0},
        _hum,
        "The mains, with shares of its harmonics.",
        {"amplitude": "unit", "frequency": "Hz", "second": "", "third": "", "fifth": ""},
        {"frequency": 50.0, "second": 0.0, "third": 0.3, "fifth": 0.1},
    ),
    "sensor_noise": Effect(
        "insert", "adc", {"rms": 0.0}, lambda v, c: White(v["rms"], c), "White noise besides the plant's own.", {"rms": "unit"}
    ),
    "flicker_noise": Effect(
        "insert",
        "adc",
        {"rms": 0.0},
        lambda v, c: Flicker(v["rms"], c, v["exponent"]),
        "Noise that falls as 1/f^exponent, from 0.03 Hz.",
        {"rms": "unit", "exponent": ""},
        {"exponent": 1.0},
    ),
    "outliers": Effect(
        "insert",
        "adc",
        {"fraction": 0.0},
        lambda v, c: Outliers(v["fraction"], v["size"], c),
        "A fraction of the samples is off by half to all of `size`.",
        {"fraction": "", "size": "unit"},
        {"size": 1.0},
    ),
    "quantization": Effect(
        "insert",
        "adc",
        {"step": 0.0},
        lambda v, c: Pointwise(lambda y: (np.floor if v["rounding"] else np.rint)(y / v["step"]) * v["step"]),
        "The measurement is quantized: rounded to the nearest value, or down (`rounding` 1).",
        {"step": "unit", "rounding": ""},
        {"rounding": 0},
    ),
    "held_samples": Effect(
        "insert",
        "transport",
        {"fraction": 0.0},
        lambda v, c: Held(v["fraction"], int(v["run"]), c),
        "A fraction of the samples, at random, repeats the one before, `run` of them in a row.",
        {"fraction": "", "run": ""},
        {"run": 1},
    ),
}
