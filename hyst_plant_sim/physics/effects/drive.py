# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects between the command and the voltage at the stack: converter, transport, driver, amplifier."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hyst_plant_sim.physics import exact_discretization
from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.effects.effect import Context, Effect, Pointwise
from hyst_plant_sim.physics.parts import Clip, Held, LateReading, Straight
from hyst_plant_sim.physics.signal_path import Part


class Hold(Part):
    """Every n-th command is taken and held."""

    def __init__(self, samples: int, step: float, phase: int = 0, rounding: int = 0) -> None:
        self._samples, self._step, self._phase, self._rounding = samples, step, phase % samples, rounding

    def _rounded(self, values: Array) -> Array:
        if not self._step:
            return values
        whole, part = np.divmod(values, self._step)
        if self._rounding == 0:
            return np.asarray((whole + (part > 0.5 * self._step)) * self._step, dtype=np.float64)
        if self._rounding == 2:
            whole = whole + ((values < 0.0) & (part > 0.0))
        return np.asarray((whole + (0.5 if self._rounding == 3 else 0.0)) * self._step, dtype=np.float64)

    def settle(self, value: float) -> float:
        """Take the input as the first command and hold it."""
        self._count, self._held = 0, float(self._rounded(np.array([value]))[0])
        return self._held

    def process(self, block: Array) -> Array:
        """Hold each n-th command of a block until the next, rounded to the step."""
        ticks = np.arange(self._count, self._count + len(block)) - self._phase
        taken = ticks // self._samples * self._samples + self._phase - self._count
        output = np.where(taken < 0, self._held, self._rounded(block)[np.maximum(taken, 0)])
        self._count += len(block)
        self._held = float(output[-1]) if len(output) else self._held
        return output


class Slew(Part):
    """Limit of the voltage's rate; the output is the mean over a step."""

    def __init__(self, rate: float, step: float, direction: float = 0.0) -> None:
        self._up = rate * step if direction >= 0.0 else np.inf
        self._down, self._last = rate * step if direction <= 0.0 else np.inf, np.zeros(1)

    def settle(self, value: float) -> float:
        """Rest at a voltage."""
        self._last[0] = value
        return value

    def process(self, block: Array) -> Array:
        """Limit the rate of a block; each output is the mean over its step."""
        output = np.empty(block.size)
        _slew(block, self._up, self._down, self._last, output)
        return output


class SlowClock(Part):
    """Slow clock of the drive: a command is late by a fraction of the time since the start."""

    def __init__(self, share: float, context: Context) -> None:
        self._share, self._context = share, context

    def settle(self, value: float) -> float:
        """Restart at a constant command, which also holds before the first sample."""
        self._first, self._past, self._count = value, np.zeros(0), 0
        return value

    def process(self, block: Array) -> Array:
        """Divide fractions of a step between the two held values, as in a constant delay."""
        known = np.concatenate([self._past, block])
        oldest = self._count - len(self._past)
        times = self._context.times(self._count, len(block))
        now = np.arange(self._count, self._count + len(block))
        late = now - self._share * np.maximum(times - self._context.start, 0.0) / self._context.period
        whole = np.floor(late).astype(np.int64)
        share = late - whole

        def at(index: NDArray[np.int64]) -> Array:
            return np.where(index < 0, self._first, known[np.clip(index - oldest, 0, len(known) - 1)])

        output = share * at(whole + (share > 0)) + (1.0 - share) * at(whole)
        self._count += len(block)
        self._past = known[max(int(whole[-1]) - oldest - 1, 0) :].copy() if len(block) else self._past
        return output


@njit(cache=True, error_model="numpy")
def _slew(block: Array, up: float, down: float, last: Array, output: Array) -> None:
    value = last[0]
    for k in range(block.size):
        way = block[k] - value
        most = up if way > 0.0 else down
        if abs(way) < most:  # there before the step is over
            output[k] = value + way * (1.0 - 0.5 * abs(way) / most)
            value = block[k]
        else:
            way = most if way > 0.0 else -most
            output[k] = value + 0.5 * way
            value += way
    last[0] = value


def _dead_band(values: Mapping[str, float], context: Context) -> Pointwise:
    center, half = 0.5 * sum(context.frame.rating), values["half_width"]

    def lost(voltage: Array) -> Array:
        distance = voltage - center
        return voltage - np.clip(distance, -half, half)

    return Pointwise(lost)


def dead_zone(half_width: float, center: float) -> Pointwise:
    """Part of a voltage beyond the zone, counted from the center of the zone."""

    def beyond(voltage: Array) -> Array:
        distance = voltage - center
        return np.asarray(center + np.sign(distance) * np.maximum(np.abs(distance) - half_width, 0.0), dtype=np.float64)

    return Pointwise(beyond)


def _clip(values: Mapping[str, float], context: Context) -> Clip | Pointwise:
    if not values["knee"]:
        return Clip(values["lower"], values["upper"])

    def bounded(voltage: Array) -> Array:
        """The hyperbola between voltage and limit whose distance from both is the knee where they meet."""
        for limit, side in ((values["upper"], 1.0), (values["lower"], -1.0)):
            if np.isfinite(limit):
                gap = limit - voltage
                voltage = limit - 0.5 * (gap + side * np.sqrt(gap * gap + 4.0 * values["knee"] ** 2))
        return voltage

    return Pointwise(bounded)


def low_pass(values: Mapping[str, float], context: Context) -> Held | Straight:
    """Construct equal first-order low-passes in series, or one of second order with a damping ratio of its own."""
    system = single = exact_discretization.lag(2 * np.pi * values["cutoff"])
    if values["damping"] != 1.0:
        rate = 2 * np.pi * values["cutoff"]
        companion = np.array([[-2.0 * values["damping"] * rate, -rate * rate], [1.0, 0.0]])
        system = (companion, np.array([1.0, 0.0]), np.array([0.0, rate * rate]), 0.0)
        return (Straight if context.place == "sensor" else Held)(system, context.period)
    for _ in range(int(values["order"]) - 1):
        system = exact_discretization.series(system, single)
    return (Straight if context.place == "sensor" else Held)(system, context.period)


def gain_factor(values: Mapping[str, float], context: Context) -> Pointwise:
    """Construct the factor 1 + gain."""
    return Pointwise(lambda block: (1.0 + values["gain"]) * block)


def _delay(values: Mapping[str, float], context: Context) -> LateReading | dict[str, float]:
    return LateReading(values["tau"], context.period) if context.place == "sensor" else {"delay": values["tau"]}


def low_pass_effect(place: str, where: str) -> Effect:
    """The effect of low-passes at a place."""
    return Effect(
        "insert",
        place,
        {"cutoff": np.inf},
        low_pass,
        f"Equal first-order low-passes in a row, as many as `order`, {where}.",
        {"cutoff": "Hz", "order": "", "damping": ""},
        {"order": 1, "damping": 1.0},
    )


EFFECTS = {
    "dac_hold": Effect(
        "insert",
        "dac",
        {"samples": 1, "step": 0.0},
        lambda v, c: Hold(int(v["samples"]), v["step"], int(v["phase"]), int(v["rounding"])),
        "Every n-th command is taken, from that of index `phase` on, and held; or commands are quantized: to the nearest "
        "value (`rounding` 0), down (1), toward zero (2), to the middle between two (3).",
        {"samples": "", "step": "V", "phase": "", "rounding": ""},
        {"phase": 0, "rounding": 0},
    ),
    "clock_rate_mismatch": Effect(
        "insert",
        "drive",
        {"share": 0.0},
        lambda v, c: SlowClock(v["share"], c),
        "The drive's clock runs slow: commands come later and later.",
        {"share": ""},
    ),
    "delay": Effect("delay", "drive", {"tau": 0.0}, _delay, "A transport delay; `at: sensor` puts it there.", {"tau": "s"}),
    "slew_limit": Effect(
        "insert",
        "drive",
        {"rate": np.inf},
        lambda v, c: Slew(v["rate"], c.period, v["direction"]),
        "The driver follows no faster; with `direction` 1 or -1 only upward or only downward.",
        {"rate": "V/s", "direction": ""},
        {"direction": 0},
    ),
    "saturation": Effect(
        "insert",
        "drive",
        {"lower": -np.inf, "upper": np.inf},
        _clip,
        "The driver clips; with `knee` on a hyperbola, that far from the corner.",
        {"lower": "V", "upper": "V", "knee": "V"},
        {"knee": 0.0},
    ),
    "crossover_dead_band": Effect(
        "insert",
        "drive",
        {"half_width": 0.0},
        _dead_band,
        "Around the middle of the rating the drive does not answer; beyond, it falls short by as much.",
        {"half_width": "V"},
    ),
    "dead_zone": Effect(
        "insert",
        "drive",
        {"half_width": 0.0},
        lambda v, c: dead_zone(v["half_width"], v["center"]),
        "Within ± half_width of `center` the drive rests; beyond, it falls short by as much.",
        {"half_width": "V", "center": "V"},
        {"center": 0.0},
    ),
    "amplifier_lowpass": low_pass_effect("amplifier", "before the hysteresis"),
}
