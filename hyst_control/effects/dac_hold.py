# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A converter that holds, or that has few steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array, Integers
from hyst_control.chain.c_code.c_code import CCode, integers, reals
from hyst_control.chain.c_code.texts import c_texts
from hyst_control.chain.parameter import ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import Filter, Role, Sampling, Stage, frozen, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, RecordCheck, Surroundings, Values

C = c_texts(__file__)

ROUNDINGS = {"nearest": 0.0, "down": 1.0, "up": 2.0, "toward zero": 3.0, "midway": 4.0}
"""Manners of rounding to a quantization step, by the number that a model file has; midway: down, to half a step above its multiple."""


@register
@dataclass(frozen=True)
class DacHold(Stage):
    """Takes every `samples`-th command and holds it, rounded to a multiple of `step`.

    The record's first command is held until the command of index `phase` is taken, 0: it is the first one that is taken. step V,
    0: not rounded. rounding: see `ROUNDINGS`.
    """

    name: ClassVar[str] = "dac_hold"
    place: ClassVar[str] = "dac"
    ROLES: ClassVar[Role] = Role.CHANGES_WITH_TIME
    samples: ScalarPerAxis = scalar("", "for which a command is held", default=1, lower=1.0, whole=True, scatter=Scattering.NONE)
    step: ScalarPerAxis = scalar("V", "of the quantization; 0: none", default=0.0, lower=0.0)
    phase: ScalarPerAxis = scalar("", "command taken first", default=0, lower=0.0, upper=1e9, whole=True, scatter=Scattering.NONE)
    rounding: ScalarPerAxis = scalar(
        "", "0 nearest, 1 down, 2 up, 3 toward zero, 4 midway", default=0, lower=0.0, upper=4.0, whole=True, scatter=Scattering.NONE
    )

    def filter(self, sampling: Sampling) -> Filter:
        samples, step, phase, rounding = per_axis_scalars(self, sampling.axes, "samples", "step", "phase", "rounding")
        return DacHoldFilter(samples, step, phase, rounding, sampling.hold)


class DacHoldFilter(Filter):
    """Streaming `DacHold`."""

    def __init__(self, samples: Array, step: Array, phase: Array, rounding: Array, hold: str) -> None:
        self.hold = hold
        self.samples, self.step = samples.astype(np.int64), step
        self.phase, self.rounding = phase.astype(np.int64), rounding.astype(np.int64)
        self.held, self.count = np.zeros(len(step)), 0

    def settle(self, value: Array) -> Array:
        self.count = 0
        first = np.array(value, dtype=float).reshape(1, -1)
        ones, zeros = np.ones_like(self.samples), np.zeros_like(self.phase)
        take_and_hold(first, 0, ones, zeros, self.step, self.rounding, self.held, np.empty_like(first))
        return self.held.copy()

    def process(self, block: Array) -> Array:
        output = np.empty_like(block)
        take_and_hold(block, self.count, self.samples, self.phase, self.step, self.rounding, self.held, output)
        self.count += len(block)
        return output

    def c_code(self) -> CCode:
        return CCode(
            "dac hold",
            C["STEP"],
            C["SETTLE"],
            constants={
                "samples": integers(self.samples, "for which a value is held"),
                "step": reals(self.step, "V, of the quantization; 0: none"),
            },
            state={"held": reals(self.held, "V"), "count": integers(np.zeros(len(self.held)), "samples since the last one taken")},
            functions=(C["TAKEN"],),
        )


@njit(cache=True, error_model="numpy")
def take_and_hold(
    block: Array, count: int, samples: Integers, phase: Integers, step: Array, rounding: Integers, held: Array, output: Array
) -> None:
    """block, output (N, A); count of samples before the block; samples, phase, step, rounding (A,); held (A,), updated."""
    for row in range(block.shape[0]):
        for axis in range(block.shape[1]):
            if (count + row - phase[axis]) % samples[axis] == 0:
                value = block[row, axis]
                if step[axis] > 0.0:
                    steps, manner = value / step[axis], rounding[axis]
                    if manner == 0:
                        steps = np.rint(steps)
                    elif manner == 2:
                        steps = np.ceil(steps)
                    elif manner == 3:
                        steps = np.trunc(steps)
                    else:
                        steps = np.floor(steps) + (0.5 if manner == 4 else 0.0)
                    value = step[axis] * steps
                held[axis] = value
            output[row, axis] = held[axis]


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Samples, phase, step and manner of rounding; the value grid's steps are those that the record suggests."""
    reach = max(around.command[1] - around.command[0], 1e-9)
    return (
        Parameter("samples", "", 1.0, (2.0, 8.0), 1.0, 128.0, 3.0),
        Parameter("phase", "", 0.0, (0.0,), 0.0, 127.0, 1.0, told=False),
        Parameter(
            "step", "command", 0.0, (0.002 * reach, 0.01 * reach, 0.05 * reach), 0.0, 0.25 * reach, 0.01 * reach, suggested=True
        ),
        Parameter("rounding", "", 0.0, (0.0,), 0.0, 4.0, 1.0, told=False),
    )


def variants(around: Surroundings) -> tuple[Values, ...]:
    """Holds estimated from the gap; or a quantization step, with each manner of rounding."""
    crosses = around.command[0] < 0.0 < around.command[1]
    lattices = [
        {"samples": 1.0, "phase": 0.0, "rounding": value} for name, value in ROUNDINGS.items() if crosses or name != "toward zero"
    ]
    holds = [
        {"samples": float(samples), "phase": float(phase), "step": 0.0, "rounding": 0.0} for samples, phase in around.holds
    ]
    return (*lattices, *holds)


def stage(values: Values, around: Surroundings) -> DacHold:
    """The numbers that count are rounded to whole ones."""
    samples, phase, rounding = (
        frozen(np.maximum(np.rint(np.array(values.get(name, least), dtype=float)), least))
        for name, least in (("samples", 1.0), ("phase", 0.0), ("rounding", 0.0))
    )
    return DacHold(samples, values.get("step", 0.0), phase, rounding)


def distinct(values: Mapping[str, float], commands: Sequence[Array]) -> bool:
    """False for a hold that delays every step of these commands by the same time: that is a delay."""
    steps = [np.flatnonzero(np.any(np.diff(command, axis=0), axis=1)) + 1 for command in commands]
    late = np.concatenate([(values["phase"] - at) % values["samples"] for at in steps])
    return values["samples"] == 1.0 or len(np.unique(late)) > 1


EFFECT = Effect(
    "dac_hold",
    "dac",
    "The command is held over several samples, or rounded to a coarse quantization step.",
    parameters,
    stage,
    variants=variants,
    distinct=distinct,
    record_check=RecordCheck.COMMAND_LATTICE,
    exercised=lambda around: around.slew > 0,
    phrase="a held or coarsely rounded command",
)
