# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects in the mechanics and on the way from there to the sensor."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numba import njit

from hyst_plant_sim.physics import exact_discretization
from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.effects.effect import Context, Effect
from hyst_plant_sim.physics.parts import Straight
from hyst_plant_sim.physics.signal_path import Part


class Backlash(Part):
    """Play between input and output."""

    def __init__(self, half_width: float, side: float = 0.0) -> None:
        self._half_width, self._side, self._place = half_width, side, np.zeros(1)

    def settle(self, value: float) -> float:
        """Move from 0 to a constant input, as far as the play lets it push."""
        from_zero = np.clip(0.0, value - self._half_width, value + self._half_width)
        self._place[0] = value + self._side * self._half_width if self._side else from_zero
        return float(self._place[0])

    def process(self, block: Array) -> Array:
        """Follow a block with play."""
        output = np.empty(block.size)
        _play(block, self._half_width, self._place, output)
        return output


class AxisCoupling(Part):
    """Coupling from the next axis through a first-order low-pass; (A, M) in and out."""

    def __init__(self, coupling: float, corner: float, axis: int | None, axes: int, period: float) -> None:
        self._coupling, self._onto = coupling, range(axes) if axis is None else (axis,)
        self._axes = axes
        self._filters = [Straight(exact_discretization.lag(2 * np.pi * corner), period) for _ in self._onto]

    def settle(self, values: Array) -> Array:
        """Settle the low-passes and add the next axis' share."""
        output = values.copy()
        for onto, part in zip(self._onto, self._filters, strict=True):
            output[onto] += self._coupling * part.settle(float(values[(onto + 1) % self._axes]))
        return output

    def process(self, block: Array) -> Array:
        """Add the low-passed motion of the next axis to each coupled axis."""
        output = block.copy()
        for onto, part in zip(self._onto, self._filters, strict=True):
            output[onto] += self._coupling * part.process(block[(onto + 1) % self._axes])
        return output


class Vibration(Part):
    """A tone whose amplitude and phase wander over some hundred periods."""

    def __init__(self, amplitude: float, frequency: float, second: float, steadiness: float, context: Context) -> None:
        self._amplitude, self._frequency, self._second, self._context = amplitude, frequency, second, context
        self._keep = np.exp(-2 * np.pi * frequency / steadiness * context.period)

    def settle(self, value: float) -> float:
        """Restart the tone with a fresh random envelope."""
        self._count, self._stream = 0, self._context.stream("vibration")
        self._envelope = self._stream.standard_normal(2)
        return float(value + self._amplitude * (1.0 + self._second) * self._envelope[0] / np.sqrt(2.0))

    def process(self, block: Array) -> Array:
        """Add the wandering tone to a block."""
        draws = self._stream.standard_normal((len(block), 2))
        envelope = np.empty((len(block), 2))
        _wander(draws, self._keep, np.sqrt(1.0 - self._keep**2), self._envelope, envelope)
        angle = 2 * np.pi * self._frequency * self._context.times(self._count, len(block))
        self._count += len(block)
        wave: Array = envelope[:, 0] * np.cos(angle) + envelope[:, 1] * np.sin(angle)
        if self._second:
            wave = wave + self._second * (envelope[:, 0] * np.cos(2.0 * angle) + envelope[:, 1] * np.sin(2.0 * angle))
        return np.asarray(block + self._amplitude / np.sqrt(2.0) * wave, dtype=np.float64)


@njit(cache=True, error_model="numpy")
def _play(block: Array, half_width: float, place: Array, output: Array) -> None:
    for k in range(block.size):
        place[0] = min(max(place[0], block[k] - half_width), block[k] + half_width)
        output[k] = place[0]


@njit(cache=True, error_model="numpy")
def _wander(draws: Array, keep: float, fresh: float, state: Array, output: Array) -> None:
    for k in range(draws.shape[0]):
        for i in range(draws.shape[1]):
            state[i] = keep * state[i] + fresh * draws[k, i]
            output[k, i] = state[i]


def _wandering(values: Mapping[str, float], context: Context) -> dict[str, float]:
    return {"wander": values["change"], "period": values["period"], "phase": 2 * np.pi * context.stream("wandering_mode").random()}


EFFECTS = {
    "resonance": Effect(
        "mechanics",
        "mechanics",
        {"gain": 0.0},
        lambda v, c: {"modes": ((v["frequency"], v["damping"], v["gain"], v["velocity"]),)},
        "A further mode is fed with the mechanics' input; `gain` is its share of the mechanics' static gain, and of that `velocity` the "
        "share that is seen as the mode's velocity over its frequency.",
        {"frequency": "Hz", "damping": "", "gain": "", "velocity": ""},
        {"frequency": 600.0, "damping": 0.02, "velocity": 0.0},
    ),
    "added_mass": Effect(
        "mechanics",
        "mechanics",
        {"mass_ratio": 0.0},
        lambda v, c: {"added_mass": v["mass_ratio"]},
        "The main mode's mass is 1 + mass_ratio; stiffness and damping constant stay.",
        {"mass_ratio": ""},
    ),
    "duffing_stiffness": Effect(
        "mechanics",
        "mechanics",
        {"share": 0.0},
        lambda v, c: {"duffing": v["share"]},
        "The spring stiffens with the cube of the displacement: at full stroke it takes this share of the drive.",
        {"share": ""},
    ),
    "guide_friction": Effect(
        "mechanics",
        "mechanics",
        {"share": 0.0},
        lambda v, c: {"friction": v["share"]},
        "An elastic-slip friction in the guide, its slip force and its elastic way worth this share of the stroke.",
        {"share": ""},
    ),
    "cubic_stiffness": Effect(
        "mechanics",
        "mechanics",
        {"loss": 0.0},
        lambda v, c: {"cube": v["loss"] / (v["amplitude"] or c.frame.stroke[1] - c.frame.stroke[0]) ** 3},
        "The spring takes `loss` of the motion at the displacement `amplitude` (0: the stroke), by the cube of the displacement.",
        {"loss": "unit", "amplitude": "unit"},
        {"amplitude": 0.0},
    ),
    "dry_friction": Effect(
        "mechanics",
        "mechanics",
        {"slack": 0.0},
        lambda v, c: {"friction": v["slack"] / (c.frame.stroke[1] - c.frame.stroke[0])},
        "Dry friction of the guide, which holds back `slack` of the motion; it sticks elastically, over as much.",
        {"slack": "unit"},
    ),
    "clearance": Effect(
        "mechanics",
        "mechanics",
        {"excess": 0.0},
        lambda v, c: {"excess": v["excess"], "gap": v["half_width"]},
        "A joint has a gap of ± half_width about 0, beyond which the same drive moves further by `excess`.",
        {"half_width": "unit", "excess": "unit"},
        {"half_width": 0.1},
    ),
    "wandering_mode": Effect(
        "mechanics",
        "mechanics",
        {"change": 0.0},
        _wandering,
        "The main mode's frequency moves by ± change as a sine.",
        {"change": "", "period": "s"},
        {"period": 0.7},
    ),
    "backlash": Effect(
        "insert",
        "motion",
        {"half_width": 0.0},
        lambda v, c: Backlash(v["half_width"], v["side"]),
        "Play after the mechanics, which a record begins in with the output where a way from 0 pushed it, or at one `side`.",
        {"half_width": "unit", "side": ""},
        {"side": 0},
    ),
    "vibration": Effect(
        "insert",
        "motion",
        {"amplitude": 0.0},
        lambda v, c: Vibration(v["amplitude"], v["frequency"], v["second"], v["steadiness"], c),
        "A narrow-band disturbance, about its frequency / `steadiness` wide, with a share of a second harmonic.",
        {"amplitude": "unit", "frequency": "Hz", "second": "", "steadiness": ""},
        {"frequency": 173.0, "second": 0.0, "steadiness": 500.0},
    ),
    "cross_coupling": Effect(
        "mixing",
        "motion",
        {"coupling": 0.0},
        lambda v, c: AxisCoupling(v["coupling"], v["corner"], c.axis, len(c.frame.axes), c.period),
        "`coupling` of the other axis' motion, through a first-order low-pass at `corner`.",
        {"coupling": "", "corner": "Hz"},
        {"corner": 2000.0},
    ),
}
