"""A converter that holds, or that has few steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hyst_control.chain.c_code import CCode, integers, reals
from hyst_control.chain.parameter import Array, ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import Filter, Sampling, Stage, frozen, per_axis_scalar, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values


@register
@dataclass(frozen=True)
class DacHold(Stage):
    """Takes every `samples`-th command, the first of the record being the first taken, and holds it, rounded to a multiple of `step`.

    step V, 0: not rounded.
    """

    name: ClassVar[str] = "dac_hold"
    place: ClassVar[str] = "dac"
    samples: ScalarPerAxis = scalar("", "for which a command is held", default=1, lower=1.0, whole=True, scatter=Scattering.NONE)
    step: ScalarPerAxis = scalar("V", "of the lattice; 0: none", default=0.0, lower=0.0)

    @property
    def commutes_with_delay(self) -> bool:
        return False

    def filter(self, sampling: Sampling) -> Filter:
        axes = sampling.axes
        return DacHoldFilter(
            per_axis_scalar(self.samples, axes, "samples"), per_axis_scalar(self.step, axes, "step"), sampling.hold
        )


class DacHoldFilter(Filter):
    """Streaming `DacHold`."""

    def __init__(self, samples: Array, step: Array, hold: str) -> None:
        self.hold = hold
        self.samples, self.step = samples.astype(np.int64), step
        self.held, self.count = np.zeros(len(step)), 0

    def settle(self, value: Array) -> Array:
        self.count = 0
        take_and_hold(
            np.array(value, dtype=float).reshape(1, -1), 0, self.samples, self.step, self.held, np.empty((1, len(self.step)))
        )
        return self.held.copy()

    def process(self, block: Array) -> Array:
        output = np.empty_like(block)
        take_and_hold(block, self.count, self.samples, self.step, self.held, output)
        self.count += len(block)
        return output

    def c_code(self) -> CCode:
        return CCode(
            "dac hold",
            STEP,
            SETTLE,
            constants={
                "samples": integers(self.samples, "for which a value is held"),
                "step": reals(self.step, "V, of the lattice; 0: none"),
            },
            state={"held": reals(self.held, "V"), "count": integers(np.zeros(len(self.held)), "samples since the last one taken")},
            functions=(TAKEN,),
        )


TAKEN = """
static real taken_value(real value, real step)
{
    return (step > R(0.0)) ? (step * M(rint)(value / step)) : value;
}
"""

STEP = """
for (int i = 0; i < AXES; i++) {
    if (s->count[i] == 0) {
        s->held[i] = taken_value(in[i], p->step[i]);
    }
    s->count[i] = ((s->count[i] + 1) < p->samples[i]) ? (s->count[i] + 1) : 0;
    out[i] = s->held[i];
}
"""
"""`take_and_hold` in C."""

SETTLE = """
for (int i = 0; i < AXES; i++) {
    s->held[i] = taken_value(in[i], p->step[i]);
    s->count[i] = 0;
    out[i] = s->held[i];
}
"""
"""`DacHoldFilter.settle` in C."""


@njit(cache=True, error_model="numpy")
def take_and_hold(block: Array, count: int, samples: NDArray[np.int64], step: Array, held: Array, output: Array) -> None:
    """block, output (N, A); count of samples before the block; samples, step, held (A,), of which the last is updated."""
    for row in range(block.shape[0]):
        for axis in range(block.shape[1]):
            if (count + row) % samples[axis] == 0:
                value = block[row, axis]
                held[axis] = step[axis] * np.rint(value / step[axis]) if step[axis] > 0.0 else value
            output[row, axis] = held[axis]


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Either several samples or a coarse lattice is where a fit begins.

    Parameters
    ----------
    around
        Record that the sizes are judged by.
    """
    reach = max(around.command[1] - around.command[0], 1e-9)
    held = (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 16.0, 20.0)
    steps = (0.002 * reach, 0.01 * reach, 0.05 * reach)
    return (
        Parameter("samples", "", 1.0, (*held, *(1.0 for _ in steps)), 1.0, 20.0, 3.0, counted=True),
        Parameter("step", "V", 0.0, (*(0.0 for _ in held), *steps), 0.0, 0.2 * reach, 0.01 * reach),
    )


def stage(values: Values, around: Surroundings) -> DacHold:
    """The number of samples is rounded to a whole one.

    Parameters
    ----------
    values
        Of the parameters, by name.
    around
        Record that the sizes are judged by.
    """
    samples = frozen(np.maximum(np.rint(np.array(values.get("samples", 1.0), dtype=float)), 1.0))
    return DacHold(samples, values.get("step", 0.0))


EFFECT = Effect(
    "dac_hold",
    "dac",
    "The command is held over several samples, or rounded to a coarse lattice.",
    parameters,
    stage,
    exercised=lambda around: around.slew > 0,
)
