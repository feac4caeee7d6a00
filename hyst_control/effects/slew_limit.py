"""A driver that follows no faster than a rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from hyst_control.chain.c_code import CCode, reals
from hyst_control.chain.parameter import Array, ScalarPerAxis, scalar
from hyst_control.chain.stage import Filter, Sampling, Stage, per_axis_scalar, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings


@register
@dataclass(frozen=True)
class SlewLimit(Stage):
    """Follows its input no faster than `rate` (V/s); infinite: not limited.

    Of a held input the output runs up to it within the interval; it is handed on held at its mean over the interval, which
    is right to second order in the sample time for what is linear behind it.
    """

    name: ClassVar[str] = "slew_limit"
    place: ClassVar[str] = "drive"
    only_limits: ClassVar[bool] = True
    rate: ScalarPerAxis = scalar("V/s", "greatest slope of the output", above=0.0, infinite=True)

    def filter(self, sampling: Sampling) -> Filter:
        return SlewFilter(per_axis_scalar(self.rate, sampling.axes, "rate") * sampling.sample_time, sampling.hold)


class SlewFilter(Filter):
    """Streaming `SlewLimit`; most: largest change (A,) in a sample."""

    def __init__(self, most: Array, hold: str) -> None:
        self.hold = hold
        self.most, self.state = most, np.zeros(len(most))

    def settle(self, value: Array) -> Array:
        self.state[:] = value
        return self.state.copy()

    def process(self, block: Array) -> Array:
        output = np.empty_like(block)
        follow(block, self.most, self.hold == "zoh", self.state, output)
        return output

    def c_code(self) -> CCode:
        return CCode(
            "slew limit",
            STEP,
            "for (int i = 0; i < AXES; i++) {\n    s->value[i] = in[i];\n    out[i] = in[i];\n}",
            {"MEAN": int(self.hold == "zoh")},
            {"most": reals(self.most, "signal unit, largest change in a sample")},
            {"value": reals(self.state, "signal unit, at the end of the interval")},
        )


STEP = """
for (int i = 0; i < AXES; i++) {
    const real distance = in[i] - s->value[i];
    if (M(fabs)(distance) <= p->most[i]) {
        s->value[i] = in[i];
        out[i] = s->value[i] - ((MEAN != 0) ? (((R(0.5) * distance) * M(fabs)(distance)) / p->most[i]) : R(0.0));
    } else {
        const real step = (distance > R(0.0)) ? p->most[i] : -p->most[i];
        s->value[i] += step;
        out[i] = s->value[i] - ((MEAN != 0) ? (R(0.5) * step) : R(0.0));
    }
}
"""
"""`follow` in C."""


@njit(cache=True, error_model="numpy")
def follow(block: Array, most: Array, mean: bool, state: Array, output: Array) -> None:
    """block, output (N, A); most (A,) a sample; state (A,), the value at the end of an interval, is updated.

    mean: the output is the mean over the interval, in which the value runs up to a held input, else the value at its end.
    """
    for row in range(block.shape[0]):
        for axis in range(block.shape[1]):
            distance = block[row, axis] - state[axis]
            if abs(distance) <= most[axis]:
                state[axis] = block[row, axis]
                output[row, axis] = state[axis] - (0.5 * distance * abs(distance) / most[axis] if mean else 0.0)
            else:
                step = most[axis] if distance > 0.0 else -most[axis]
                state[axis] += step
                output[row, axis] = state[axis] - (0.5 * step if mean else 0.0)


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Rates that the record's command exceeds.

    Parameters
    ----------
    around
        Record that the sizes are judged by.
    """
    starts = tuple(share * around.slew for share in (0.7, 0.3, 0.1, 0.03))
    return (Parameter("rate", "V/s", np.inf, starts, 1e-3 * around.slew, around.slew, 1.5, True),)


EFFECT = Effect(
    "slew_limit",
    "drive",
    "The driver follows the command no faster than a rate.",
    parameters,
    lambda values, around: SlewLimit(values["rate"]),
    exercised=lambda around: bool(np.isfinite(around.slew) and around.slew > 0),
)
