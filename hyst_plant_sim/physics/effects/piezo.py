# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects in the piezo: its hysteresis, and creep."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hyst_plant_sim.physics import exact_discretization
from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.effects.effect import Context, Effect
from hyst_plant_sim.physics.parts import Held
from hyst_plant_sim.physics.signal_path import Frame, Part

CREEP_BEGIN, CREEP_PER_DECADE, CREEP_DECADES = 0.1, 2, 4


class Shape(Part):
    """A part plus a curve of the voltage, by default a parabola that is 0 at both ends of the rating."""

    def __init__(self, part: Part, amount: float, curve: int, frame: Frame) -> None:
        self._part, self._lower, self._span = part, frame.rating[0], frame.rating[1] - frame.rating[0]
        self._curve = curve
        self._height = amount * (part.settle(frame.rating[1]) - part.settle(frame.rating[0]))

    def _bend(self, voltage: Array) -> Array:
        share = (voltage - self._lower) / self._span
        if self._curve == 1:
            return np.asarray(self._height * np.sin(2.0 * np.pi * share), dtype=np.float64)
        if self._curve == 2:
            return np.asarray(self._height * (2.0 * share - 1.0), dtype=np.float64)
        if self._curve == 3:
            return np.asarray(self._height * np.sin(np.pi * share), dtype=np.float64)
        return np.asarray(self._height * 4.0 * share * (1.0 - share), dtype=np.float64)

    def settle(self, value: float) -> float:
        """Settle the part and add the parabola at a constant voltage."""
        return float(self._part.settle(value) + self._bend(np.array(value)))

    def process(self, block: Array) -> Array:
        """Add the parabola of a block's voltage to the part's output."""
        return self._part.process(block) + self._bend(block)


class Scheduled(Part):
    """A part whose memory grows with the averaged voltage: times 1 + amount · (voltage's place in the rating, 0 to 1)."""

    def __init__(self, part: Part, mean: Part, amount: float, tau: float, frame: Frame) -> None:
        self._part, self._mean, self._amount = part, mean, amount
        self._lower, self._span = frame.rating[0], frame.rating[1] - frame.rating[0]
        self._average = Held(exact_discretization.lag(1.0 / tau), frame.step)

    def settle(self, value: float) -> float:
        """Settle part and average at a constant voltage."""
        share = (self._average.settle(value) - self._lower) / self._span
        whole = self._part.settle(value)
        return float(whole + self._amount * share * (whole - self._mean.settle(value)))

    def process(self, block: Array) -> Array:
        """Scale the part's memory by the averaged voltage over a block."""
        share = (self._average.process(block) - self._lower) / self._span
        whole = self._part.process(block)
        return whole + self._amount * share * (whole - self._mean.process(block))


def hysteresis(parts: Any, changes: Mapping[str, float], frame: Frame) -> Part:
    """Construct an axis' hysteresis with changes."""
    inner = {name: value for name, value in changes.items() if name in ("width", "rate")}
    part = parts(inner, {})["hysteresis"][0]
    if changes.get("schedule", 0.0):
        mean = parts({**inner, "width": -1.0}, {})["hysteresis"][0]
        part = Scheduled(part, mean, changes["schedule"], changes["schedule_tau"], frame)
    return Shape(part, changes["amount"], int(changes["curve"]), frame) if changes.get("amount", 0.0) else part


def _creep(values: Mapping[str, float], context: Context) -> Held:
    """y + gamma Σ s_i (share of y that has come after time constant τ_i): after a step about gamma log10(1 + t / begin).

    law 0: τ_i = begin q^(i + 1/2), q = 10^(1/2), i = 0 … 7: two elements per decade, s_i = log10(q), from 0.1 to 1000 s for begin 0.1 s.
    law 1: the logarithm itself, whose spectrum over log10(1 / τ) is exp(-begin / τ), eight elements per decade.
    law 2: one element, τ = begin.
    """
    begin = values["begin"]
    if values["law"] == 2:
        rates, sizes = np.array([1.0 / begin]), np.ones(1)
    elif values["law"] == 1:
        rates = 10.0 ** np.arange(np.log10(1e-5 / begin), np.log10(20.0 / begin), 1.0 / 8.0)
        sizes = np.exp(-begin * rates) / 8.0
    else:
        count = CREEP_PER_DECADE * CREEP_DECADES
        rates = 1.0 / (begin * 10.0 ** ((np.arange(count) + 0.5) / CREEP_PER_DECADE))
        sizes = np.full(count, 1.0 / CREEP_PER_DECADE)
    return Held((np.diag(-rates), rates, values["gamma"] * sizes, 1.0), context.period)


EFFECTS = {
    "hysteresis_width": Effect(
        "hysteresis",
        "hysteresis",
        {"width": 0.0},
        lambda v, c: {"width": v["width"]},
        "The memory part is scaled by 1 + width; the mean curve (play operators: slope times voltage; Madelung: "
        "mean of the major branches; Bouc-Wen: without z) stays.",
        {"width": ""},
    ),
    "hysteresis_shape": Effect(
        "hysteresis",
        "hysteresis",
        {"amount": 0.0},
        lambda v, c: {"amount": v["amount"], "curve": v["curve"]},
        "A parabola of the voltage is added: 0 at the ends of the rating, `amount` of the stroke midway; or another `curve`: 1 a whole "
        "sine, 2 a tilt, 3 half a sine.",
        {"amount": "", "curve": ""},
        {"curve": 0},
    ),
    "hysteresis_rate": Effect(
        "hysteresis",
        "hysteresis",
        {"factor": 1.0},
        lambda v, c: {"rate": v["factor"]},
        "The rate part (m1 and m2, k1, drag, relaxation) is scaled by `factor`; 1 leaves it.",
        {"factor": ""},
    ),
    "gain_scheduled_hysteresis": Effect(
        "hysteresis",
        "hysteresis",
        {"amount": 0.0},
        lambda v, c: {"schedule": v["amount"], "schedule_tau": v["tau"]},
        "The memory part grows with the voltage averaged over tau.",
        {"amount": "", "tau": "s"},
        {"tau": 0.05},
    ),
    "creep": Effect(
        "insert",
        "piezo",
        {"gamma": 0.0},
        _creep,
        "After a step the output grows on by gamma log10(1 + t / begin) of it: a ladder of two elements per decade over four decades, "
        "or by another `law`: 1 the logarithm itself, 2 one element.",
        {"gamma": "1/decade", "begin": "s", "law": ""},
        {"begin": CREEP_BEGIN, "law": 0},
    ),
}
