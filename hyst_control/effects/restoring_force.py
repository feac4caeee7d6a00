# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Forces that act back on the mechanics: the response to u - f instead of u, where f follows from the motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array, Integers
from hyst_control.chain.c_code.c_code import MAXIMUM, MINIMUM, CCode, reals
from hyst_control.chain.c_code.texts import c_texts
from hyst_control.chain.linear.discretization import discretise
from hyst_control.chain.linear.linear_filter import reach_of
from hyst_control.chain.linear.linear_stages import LinearStage, LinearSystem, TransferFunction, realization
from hyst_control.chain.stage import Filter, Sampling, Stage
from hyst_control.effects.modifiers import beside_mechanics

C = c_texts(__file__)

FRICTION, SPEED_FRICTION, CUBIC, GAP = range(4)  # Laws of the force
NO_STATIC_GAIN = 0.01  # Share of the largest gain up to which that at rest counts as 0
MAX_STEPS = 64  # Steps after which a mechanics that goes to the other side has no friction
ROUNDS = 200  # Of the equilibrium: each halves the distance where the force is small beside the spring's
FARTHEST = 10.0  # Motion in units of the law's size beyond which the force grows no more: a trial of a fit must not run away


def with_force(name: str, before: tuple[Stage, ...], law: int, moves: Array, size: Array) -> tuple[Stage, ...]:
    """The stages with a force on their mechanics, beside these so that the linear part stays exact."""
    # moves: what the force moves the mechanics by at rest, output unit
    if not moves.any():
        return before
    return beside_mechanics(name, before, lambda mechanics: MovedByForce(mechanics, law, tuple(moves), tuple(size)))


@dataclass(frozen=True)
class MovedByForce(Stage):
    """Part that a force adds to the response of a linear stage; values per axis. Part of a started chain only."""

    base: LinearStage
    law: int
    moves: tuple[float, ...]  # Of the mechanics at rest: limit of the friction, or the force at the size; output unit
    size: tuple[float, ...]  # Output unit

    def linearized(self, axes: int) -> tuple[Stage, ...]:
        return (TransferFunction([0.0], [1.0]),)

    def filter(self, sampling: Sampling) -> Filter:
        return ForceFilter([realization(system) for system in self.base.systems(sampling.axes)], self, sampling)


class ForceFilter(Filter):
    """Streaming `MovedByForce`: the linear system, and what the force adds to its state."""

    hold = "foh"

    def __init__(self, systems: list[LinearSystem], stage: MovedByForce, sampling: Sampling) -> None:
        m, n = systems[0].B.shape[1], max(len(system.A) for system in systems)
        count = len(systems)
        self.a, self.b, self.push = np.zeros((count, n, n)), np.zeros((2, count, n, m)), np.zeros((count, n, m))
        self.c, self.rate, self.direct = np.zeros((count, m, n)), np.zeros((count, m, n)), np.zeros((count, m, m))
        for s, system in enumerate(systems):
            step, order = discretise(system, np.zeros(m), sampling), len(system.A)
            self.a[s, :order, :order], self.b[:, s, :order], self.c[s, :, :order] = step.A, step.B[:2], step.C
            self.push[s, :order] = step.B.sum(axis=0)
            if stage.law == SPEED_FRICTION:
                self.rate[s, :, :order] = system.C
            else:
                self.rate[s, :, :order], self.direct[s] = _where_it_goes(system, step.A, step.B.sum(axis=0), sampling.sample_time)
        self.acting = reach_of(self.a)
        # Change of that by a unit force that is held over a step.
        self.reach = np.einsum("smi,sim->sm", self.rate, self.push) + np.einsum("smm->sm", self.direct)
        gains = np.concatenate([reference_gains(system) for system in systems])
        self.law, self.size = stage.law, np.array(stage.size)
        self.force = np.array(stage.moves) / gains
        # `rest`: state at rest for a unit input; the states that fill up a shorter system stay 0.
        self.rest: Array = np.asarray(np.linalg.solve(np.eye(n) - self.a, self.push), dtype=np.float64)
        self.free, self.moved = np.zeros((count, n)), np.zeros((count, n))
        self.last, self.taken = np.zeros(sampling.axes), np.zeros(sampling.axes)

    def settle(self, value: Array) -> Array:
        self.last[:] = value
        output, memory = np.zeros(len(self.last)), (self.free, self.moved, self.last, self.taken)
        settle_force(self.rest, self.c, (self.law, self.force, self.size), memory, output)
        return output

    def process(self, block: Array) -> Array:
        output, memory = np.empty_like(block), (self.free, self.moved, self.last, self.taken)
        system = self.a, self.b, self.push, self.c, self.rate, self.direct, self.reach
        advance_force(block, system, self.acting, (self.law, self.force, self.size), memory, output)
        return output

    def c_code(self) -> CCode:
        count, n, m = self.push.shape
        return CCode(
            "force on the mechanics",
            C["ADVANCE"],
            C["COME_TO_REST"],
            {"SYSTEMS": count, "STATES": n, "INPUTS": m, "LAW": self.law, "ROUNDS": ROUNDS if self.law > SPEED_FRICTION else 2},
            {
                "a": reals(self.a, "[system][state][state]"),
                "b": reals(self.b, "[newest, older input][system][state][input]"),
                "push": reals(self.push, "[system][state][input], of an input held over a step"),
                "c": reals(self.c, "[system][output][state]"),
                "rate": reals(self.rate, "[system][output][state]"),
                "direct": reals(self.direct, "[system][output][input]"),
                "reach": reals(self.reach, "change of that by a unit force"),
                "rest": reals(self.rest, "[system][state][input], at rest"),
                "force": reals(self.force, "input unit"),
                "size": reals(self.size, "output unit"),
            },
            {
                "free": reals(self.free, "state without the force"),
                "moved": reals(self.moved, "what the force adds to it"),
                "last": reals(self.last, "input before"),
                "taken": reals(self.taken, "force before, input unit"),
            },
            (MAXIMUM, MINIMUM, C["LAW"]),
        )


def _where_it_goes(system: LinearSystem, carried: Array, push: Array, time: float) -> tuple[Array, Array]:
    """Rows (m, n) of the state and (m, m) of the held input by which the motion is a step ahead at its speed."""
    # Of the first step in which the output follows the input to its side: of an approximated delay it goes to the other one first.
    row, still = system.C + time * system.C @ system.A, time * system.C @ system.B
    rows, direct = np.zeros_like(system.C), np.zeros_like(still)
    for axis in range(len(row)):
        ahead, held = np.eye(len(carried)), np.zeros_like(push)
        for _ in range(MAX_STEPS):
            reached = held + ahead @ push
            rows[axis], direct[axis] = row[axis] @ ahead, row[axis] @ held + still[axis]
            if (system.C[axis] @ reached)[axis] > 0.0 and (rows[axis] @ push + direct[axis])[axis] > 0.0:
                break
            ahead, held = ahead @ carried, reached
    return rows, direct


def reference_gains(system: LinearSystem) -> Annotated[Array, "m"]:
    """Gain at rest of every axis; of an output that is 0 there, as an acceleration is, the largest gain at a mode."""
    rest = np.diag(system.static_gain())
    size, identity = len(system.A), np.eye(len(system.A))
    rates = np.abs(np.linalg.eigvals(system.A)) if size else np.zeros(0)
    at_modes = [np.abs(np.diag(system.C @ np.linalg.solve(1j * rate * identity - system.A, system.B))) for rate in rates]
    peak = np.max([np.abs(rest), *at_modes], axis=0)
    return np.asarray(np.where(np.abs(rest) > NO_STATIC_GAIN * peak, rest, np.maximum(peak, 1e-300)))


@njit(cache=True)
def _force_of(law: int, force: float, motion: float) -> float:
    if law == CUBIC:
        far = min(max(motion, -FARTHEST), FARTHEST)
        return float(force * far * far * far)
    return float(-force * min(max(motion, -1.0), 1.0))


@njit(cache=True)
def settle_force(
    rest: Annotated[Array, "S n m"],
    c: Annotated[Array, "S m n"],
    force_law: tuple[int, Array, Array],
    memory: tuple[Array, ...],
    output: Annotated[Array, "A"],
) -> None:
    """Rest at the equilibrium of the last input with the force; friction holds where a rise from 0 has come to."""
    (law, force, size), (free, moved, value, taken) = force_law, memory
    count, n, m = rest.shape
    taken[:] = 0.0
    for s in range(count):
        for _ in range(ROUNDS if law > SPEED_FRICTION else 2):
            for k in range(n):
                free[s, k] = 0.0
                moved[s, k] = 0.0
                for j in range(m):
                    free[s, k] += rest[s, k, j] * value[s * m + j]
                    moved[s, k] -= rest[s, k, j] * taken[s * m + j]
            for i in range(m):
                axis, motion, gain = s * m + i, 0.0, 0.0
                output[axis] = 0.0
                for k in range(n):
                    motion += c[s, i, k] * (free[s, k] + moved[s, k])
                    gain += c[s, i, k] * rest[s, k, i]
                    output[axis] += c[s, i, k] * moved[s, k]
                if law > SPEED_FRICTION:
                    taken[axis] = 0.5 * (taken[axis] + _force_of(law, force[axis], motion / size[axis]))
                elif gain > 0.0:
                    taken[axis] = min(max(taken[axis] + motion / gain, -force[axis]), force[axis])


@njit(cache=True)
def advance_force(
    block: Annotated[Array, "N A"],
    system: tuple[Array, ...],
    acting: Annotated[Integers, "S n 2"],
    force_law: tuple[int, Array, Array],
    memory: tuple[Array, ...],
    output: Annotated[Array, "N A"],
) -> None:
    """Run the mechanics under a force: that of the motion amid a step, or the friction that stops it within two steps if it can."""
    a, b, push, c, rate, direct, reach = system
    (law, force, size), (free, moved, last, taken) = force_law, memory
    count, n, m = push.shape
    ahead, shift = np.empty(n), np.empty(n)
    for row in range(block.shape[0]):
        for s in range(count):
            for k in range(n):
                ahead[k] = 0.0
                shift[k] = 0.0
                for q in range(acting[s, k, 0], acting[s, k, 1]):
                    ahead[k] += a[s, k, q] * free[s, q]
                    shift[k] += a[s, k, q] * moved[s, q]
                for j in range(m):
                    ahead[k] += b[0, s, k, j] * block[row, s * m + j] + b[1, s, k, j] * last[s * m + j]
            for i in range(m):
                axis, value = s * m + i, 0.0
                if law <= SPEED_FRICTION:
                    for k in range(n):
                        value += rate[s, i, k] * (ahead[k] + shift[k])
                        if law == FRICTION:
                            value -= c[s, i, k] * (free[s, k] + moved[s, k])
                    for j in range(m):
                        value += direct[s, i, j] * block[row, s * m + j]
                    value = value / reach[s, i] if reach[s, i] > 0.0 else 0.0
                    taken[axis] = min(max(value, -force[axis]), force[axis])
                else:
                    for k in range(n):
                        value += c[s, i, k] * (free[s, k] + moved[s, k] + ahead[k] + shift[k] - push[s, k, i] * taken[axis])
                    taken[axis] = _force_of(law, force[axis], 0.5 * value / size[axis])
            for k in range(n):
                for i in range(m):
                    shift[k] -= push[s, k, i] * taken[s * m + i]
                free[s, k] = ahead[k]
                moved[s, k] = shift[k]
            for i in range(m):
                value = 0.0
                for k in range(n):
                    value += c[s, i, k] * moved[s, k]
                last[s * m + i] = block[row, s * m + i]
                output[row, s * m + i] = value
