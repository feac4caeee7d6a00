# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Duhem hysteresis of Bouc and Wen's form: a memory of one number, asymmetric and saturating.

    y = slope u + z,    dz/du = alpha (1 + growth u) - (beta sgn(u̇ z) + gamma) |z|^exponent,    z = 0 at u = 0 on the virgin curve

R. Bouc, Forced vibrations of a mechanical system with hysteresis, 1967; Y.-K. Wen, Method for random vibration of hysteretic systems, ASCE
J. Eng. Mech. Div. 102, 1976. Unlike Prandtl-Ishlinskii and Madelung hysteresis it does not return to a turning point when an inner loop is
left: its loops creep together. With alpha < 0 the memory holds the output back, as in a piezo; gamma bends either branch alike,
`growth` makes the loop wider towards one end of the drive. It is rate-independent: dz/du is integrated along the way of the command.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.chain.c_code.c_code import CCode, reals
from hyst_control.chain.chain import Parallel
from hyst_control.chain.memoryless import Gain
from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import Filter, Sampling, Stage, frozen, per_axis_scalar, per_axis_scalars, register

STEP = 0.05
"""Largest step of the integration, as a share of the way over which the memory saturates; at the kink z = 0 it leaves 1e-5 of z."""

MAX_PIECES = 100_000
"""Largest number of steps of the integration between two samples: a command that leaps farther is integrated coarsely."""

LOADING = 2000
"""Parts of the way from 0 V to the first command."""


@njit(cache=True, error_model="numpy")
def memory_slope(
    u: float, z: float, direction: float, alpha: float, growth: float, beta: float, gamma: float, exponent: float
) -> float:
    """Slope dz/du at a command."""
    same = 1.0 if z * direction > 0.0 else -1.0
    slope: float = alpha * (1.0 + growth * u) - (beta * same + gamma) * abs(z) ** exponent
    return slope


@njit(cache=True, error_model="numpy")
def duhem(
    command: Annotated[Array, "N A"],
    slope: Annotated[Array, "A"],
    alpha: Annotated[Array, "A"],
    growth: Annotated[Array, "A"],
    beta: Annotated[Array, "A"],
    gamma: Annotated[Array, "A"],
    exponent: Annotated[Array, "A"],
    previous: Annotated[Array, "A"],
    memory: Annotated[Array, "A"],
    output: Annotated[Array, "N A"],
) -> None:
    """Advance the memory over a block, all axes, by Runge and Kutta's rule of fourth order along the command's way."""
    for row in range(command.shape[0]):
        for axis in range(command.shape[1]):
            u, z, n = previous[axis], memory[axis], exponent[axis]
            way = command[row, axis] - u
            if way != 0.0:
                a, g, b, c = alpha[axis], growth[axis], beta[axis], gamma[axis]
                reach = abs(z) + abs(a * (1.0 + g * u) * way)
                pace = (abs(b) + abs(c)) * n * reach ** (n - 1.0) if reach > 0.0 else 0.0
                wanted = np.ceil(abs(way) * pace / STEP) if pace < 1e12 else 1.0
                pieces = MAX_PIECES if wanted >= MAX_PIECES else int(wanted) if wanted > 1.0 else 1
                part, direction = way / pieces, 1.0 if way > 0.0 else -1.0
                for _ in range(pieces):
                    first = memory_slope(u, z, direction, a, g, b, c, n)
                    second = memory_slope(u + 0.5 * part, z + 0.5 * part * first, direction, a, g, b, c, n)
                    third = memory_slope(u + 0.5 * part, z + 0.5 * part * second, direction, a, g, b, c, n)
                    fourth = memory_slope(u + part, z + part * third, direction, a, g, b, c, n)
                    z += part * (first + 2.0 * second + 2.0 * third + fourth) / 6.0
                    u += part
                previous[axis], memory[axis] = command[row, axis], z
            output[row, axis] = slope[axis] * command[row, axis] + z


SLOPE = """
/* Slope dz/du of the memory at a command; direction is 1 while it rises, -1 while it falls. */
static double memory_slope(double u, double z, double direction, const double law[5])
{
    const double same = ((z * direction) > 0.0) ? 1.0 : -1.0;
    return (law[0] * (1.0 + (law[1] * u))) - (((law[2] * same) + law[3]) * pow(fabs(z), law[4]));
}
"""
"""`memory_slope` in C, of alpha, growth, beta, gamma and exponent; as the integration, in double also where signals are float."""

FOLLOW = """
/* Memory z when the command has gone from u by a way. */
static double followed_memory(double u_from, double z_from, double way, const double law[5])
{
    const double reach = fabs(z_from) + fabs((law[0] * (1.0 + (law[1] * u_from))) * way);
    const double steepness = (fabs(law[2]) + fabs(law[3])) * law[4];
    const double pace = (reach > 0.0) ? (steepness * pow(reach, law[4] - 1.0)) : 0.0;
    const double wanted = (pace < 1e12) ? ceil((fabs(way) * pace) / STEP_SIZE) : 1.0;
    const int pieces = (wanted >= MAX_PIECES) ? (int)MAX_PIECES : ((wanted > 1.0) ? (int)wanted : 1);
    const double part = way / (double)pieces;
    const double direction = (way > 0.0) ? 1.0 : -1.0;
    double u = u_from;
    double z = z_from;
    for (int piece = 0; piece < pieces; piece++) {
        const double first = memory_slope(u, z, direction, law);
        const double second = memory_slope(u + (0.5 * part), z + ((0.5 * part) * first), direction, law);
        const double third = memory_slope(u + (0.5 * part), z + ((0.5 * part) * second), direction, law);
        const double fourth = memory_slope(u + part, z + (part * third), direction, law);
        z += (part * (((first + (2.0 * second)) + (2.0 * third)) + fourth)) / 6.0;
        u += part;
    }
    return z;
}
""".replace("STEP_SIZE", repr(STEP)).replace("MAX_PIECES", repr(float(MAX_PIECES)))

ADVANCE = """
for (int i = 0; i < AXES; i++) {
    const double now = (double)in[i];
    const double way = now - s->previous[i];
    if (way != 0.0) {
        s->memory[i] = followed_memory(s->previous[i], s->memory[i], way, p->law[i]);
        s->previous[i] = now;
    }
    out[i] = (real)((p->slope[i] * now) + s->memory[i]);
}
"""
"""`duhem` in C."""

LOAD = """
for (int i = 0; i < AXES; i++) {
    s->previous[i] = 0.0;
    s->memory[i] = 0.0;
}
for (int row = 1; row <= LOADING; row++) {
    real part[AXES];
    for (int i = 0; i < AXES; i++) {
        part[i] = (real)(((row < LOADING) ? ((double)row * LOADING_STEP) : 1.0) * (double)in[i]);
    }
    SELF_step(s, part, out);
}
""".replace("LOADING_STEP", repr(1.0 / LOADING))
"""`DuhemFilter.settle` in C."""


class DuhemFilter(Filter):
    """Streaming Duhem hysteresis."""

    def __init__(self, parameters: list[Array], hold: str) -> None:
        self.hold = hold
        self.parameters = parameters
        self.previous, self.memory = np.zeros(len(parameters[0])), np.zeros(len(parameters[0]))

    def settle(self, value: Array) -> Array:
        self.previous[:], self.memory[:] = 0.0, 0.0
        way = np.linspace(0.0, 1.0, LOADING + 1)[1:, None] * np.array(value, dtype=float)
        first: Array = self.process(way)[-1]
        return first

    def process(self, block: Array) -> Array:
        output = np.empty_like(block)
        slope, alpha, growth, beta, gamma, exponent = self.parameters
        duhem(block, slope, alpha, growth, beta, gamma, exponent, self.previous, self.memory, output)
        return output

    def c_code(self) -> CCode:
        slope, *law = self.parameters
        return CCode(
            "duhem",
            ADVANCE,
            LOAD,
            {"LOADING": LOADING},
            {
                "slope": reals(slope, "output unit / V", wide=True),
                "law": reals(np.stack(law, axis=1), "alpha, growth, beta, gamma, exponent", wide=True),
            },
            {
                "previous": reals(self.previous, "V, command before", wide=True),
                "memory": reals(self.memory, "output unit", wide=True),
            },
            (SLOPE, FOLLOW),
        )


@register
@dataclass(frozen=True)
class Duhem(Stage):
    """Duhem hysteresis of Bouc and Wen's form: a memory z of one number, asymmetric and saturating."""

    name: ClassVar[str] = "duhem"
    equation: ClassVar[str] = (
        r"y = \mathrm{slope}\, u + z, \quad \frac{dz}{du} = \mathrm{alpha} (1 + \mathrm{growth}\, u) - \left(\mathrm{beta}\, "
        r"\mathrm{sign}(\dot{u} z) + \mathrm{gamma}\right) |z|^{\mathrm{exponent}}"
    )
    slope: ScalarPerAxis = scalar("output unit / V", "of the straight line beside the memory")
    alpha: ScalarPerAxis = scalar("output unit / V", "growth of the memory from rest; negative where it holds the output back")
    beta: ScalarPerAxis = scalar("1 / (V output unit^(exponent - 1))", "approach to saturation, against the motion", lower=0.0)
    gamma: ScalarPerAxis = scalar("1 / (V output unit^(exponent - 1))", "approach to saturation, whichever way", default=0.0)
    exponent: ScalarPerAxis = scalar("", "sharpness of that approach", default=1.0, lower=0.5, upper=10.0)
    growth: ScalarPerAxis = scalar("1 / V", "relative change of alpha with the command", default=0.0)

    @property
    def is_hysteresis(self) -> bool:
        return True

    def mean_slope(self, axes: int) -> Array:
        return per_axis_scalar(self.slope, axes, "slope")

    def with_loop_width(self, width: Array) -> Parallel:
        """The memory is scaled, the straight line kept."""
        line = Gain(frozen(-width * per_axis_scalar(self.slope, len(width), "slope")))
        return Parallel(((self, Gain(frozen(1.0 + width))), (line,)))

    def filter(self, sampling: Sampling) -> Filter:
        names = ("slope", "alpha", "growth", "beta", "gamma", "exponent")
        return DuhemFilter(per_axis_scalars(self, sampling.axes, *names), sampling.hold)
