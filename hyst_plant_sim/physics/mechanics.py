# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The mechanics of a plant: a linear system, and its possible faults (mass, spring, friction, a moving mode).

A plant gives its mechanics as a function `system(mass_ratio, frequency_ratio)`: the main mode with its mass times
1 + mass_ratio, stiffness and damping constant kept, then its frequency times frequency_ratio at the same damping ratio.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numba import njit

from hyst_plant_sim.physics import exact_discretization
from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.parts import Held, Sum, System
from hyst_plant_sim.physics.signal_path import Frame, Part

GRID = 201
"""Frequencies at which the steps of a moving mode are prepared."""


def oscillator(frequency: float, damping: float, mass_ratio: float = 0.0, frequency_ratio: float = 1.0) -> System:
    """Mode of unit static gain."""
    heavier = np.sqrt(1.0 + mass_ratio)
    return exact_discretization.oscillator(2 * np.pi * frequency * frequency_ratio / heavier, damping / heavier)


def mechanics(system: Callable[[float, float], System], frame: Frame, changes: Mapping[str, Any], late: float) -> Part:
    """Construct the mechanics for a set of changes."""
    if "modes" in changes:
        others = {name: value for name, value in changes.items() if name != "modes"}
        modes = [beside(system(0.0, 1.0), mode, frame.step, late) for mode in changes["modes"]]
        return Sum(mechanics(system, frame, others, late), *modes)
    mass_ratio = changes.get("added_mass", 0.0)
    irregular = ("duffing", "friction", "wander", "cube", "excess")
    if not any(changes.get(name, 0.0) for name in irregular):
        return Held(system(mass_ratio, 1.0), frame.step, late)
    return Irregular(system, frame, late, changes)


def beside(main: System, mode: tuple[float, float, float, float], step: float, late: float) -> Held:
    """Construct a further mode with the main system's input."""
    # mode: frequency (Hz), damping ratio, gain as a fraction of the main system's static gain, and the share of it that is seen as
    # the mode's velocity over its frequency
    frequency, damping, share, velocity = mode
    a, b, c, _ = main
    static = float(c @ exact_discretization.rest(a, b, 1.0))
    a, b, c, d = oscillator(frequency, damping)
    return Held((a, b, share * static * np.array([1.0 - velocity, velocity]) * c[0], d), step, late)


class Irregular(Part):
    """Mechanics that are not a fixed linear system.

    The forces are those of the displacement in the middle of a step, on the straight line through the ends of the last two.
    """

    def __init__(self, system: Callable[[float, float], System], frame: Frame, late: float, changes: Mapping[str, Any]) -> None:
        names = ("added_mass", "duffing", "friction", "wander", "phase", "cube", "excess")
        mass_ratio, duffing, friction, wander, phase, cube, excess = (changes.get(name, 0.0) for name in names)
        period, gap = changes.get("period", 1.0), changes.get("gap", 1.0)
        ratios = 1.0 + wander * np.linspace(-1.0, 1.0, GRID) if wander else np.ones(1)
        systems = [system(mass_ratio, ratio) for ratio in ratios]
        steps = [
            (*exact_discretization.held_step(a, b, frame.step), *exact_discretization.held_step(a, b, frame.step - late))
            for a, b, _, _ in systems
        ]
        self._phi, self._to = (np.stack([row[i] for row in steps]) for i in range(2))
        self._a, self._b, self._c, _ = systems[len(systems) // 2]
        self._read = np.stack([np.append(self._c @ state, self._c @ shift) for _, _, state, shift in steps])
        self._gain = float(self._c @ exact_discretization.rest(self._a, self._b, 1.0))
        span = frame.stroke[1] - frame.stroke[0]
        # Of the cube of the displacement; limit and way of the slip; what a gap takes from the spring, and its half-width.
        slip = friction * span
        self._force = np.array(
            [duffing / self._gain / span**2 + cube / self._gain, slip / self._gain, slip, excess / self._gain, gap]
        )
        self._turn = np.array([2 * np.pi * frame.step / period, phase])
        self.settle(0.0)

    def settle(self, value: float) -> float:
        """Rest at the equilibrium of a constant drive with the cubic spring."""
        spring, gap_force, gap = self._force[[0, 3, 4]]
        drive = value
        for _ in range(200):  # the forces are a part of the drive: halving the steps, this converges for any part below one third
            y = self._gain * drive
            drive = 0.5 * (drive + value - spring * y**3 + gap_force * min(max(y / gap, -1.0), 1.0))
        self._x = exact_discretization.rest(self._a, self._b, drive)
        y = float(self._c @ self._x)
        # displacement one step ago, place of the guide's slip element, internal steps so far
        self._memory = np.array([y, self._gain * drive, 0.0])
        return y

    def process(self, block: Array) -> Array:
        """Step the irregular mechanics through a block, each drive held over a step."""
        output = np.empty(block.size)
        _irregular(block, self._phi, self._to, self._c, self._read, self._force, self._turn, self._x, self._memory, output)
        return output


@njit(cache=True, error_model="numpy")
def _irregular(
    block: Array,
    phi: Array,
    gamma: Array,
    end: Array,
    read: Array,
    force: Array,
    turn: Array,
    x: Array,
    memory: Array,
    output: Array,
) -> None:
    order, middle = x.size, (phi.shape[0] - 1) // 2
    fresh = np.empty(order)
    y = (end * x).sum()
    for k in range(block.size):
        at = middle + int(np.rint(middle * np.sin(turn[0] * memory[2] + turn[1]))) if middle else 0
        ahead = 1.5 * y - 0.5 * memory[0]
        now = block[k] - force[0] * ahead * ahead * ahead + force[3] * min(max(ahead / force[4], -1.0), 1.0)
        if force[2] > 0:
            memory[1] = min(max(memory[1], ahead - force[2]), ahead + force[2])
            now -= force[1] * (ahead - memory[1]) / force[2]
        memory[0] = y
        value = read[at, order] * now
        for i in range(order):
            value += read[at, i] * x[i]
            moved = gamma[at, i] * now
            for j in range(order):
                moved += phi[at, i, j] * x[j]
            fresh[i] = moved
        y = 0.0
        for i in range(order):
            x[i] = fresh[i]
            y += end[i] * x[i]
        output[k] = value
        memory[2] += 1.0
