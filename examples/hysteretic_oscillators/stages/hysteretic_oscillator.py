# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Mechanics with a hysteretic force inside their feedback, the common part of such stages.

    mass ÿ + damping ẏ + stiffness y + z = u,    dz/dy = the slope of a branch at z, one for rising y and one for falling y

The force z depends on the path of the displacement y and not on its speed, but y follows from z through inertia and damping: no chain
of a hysteresis with dynamics behind it has this structure. A stage says what its branches are: `laws`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import CCode, integers, reals
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import Filter, Sampling, Stage, frozen, per_axis_scalars

RESOLUTION = 0.05
"""Longest step of the integration, in units of the fastest time constant of the linear part: its error is then that of the
reversals, where the slope of the force jumps: a few 1e-5 of the range under a random command."""
MAX_STEPS = 10_000
"""Largest number of steps between two samples."""
STATIC_STEPS, SETTLING_STEPS = 100, 10_000
"""Steps of the integration over one change of the command without inertia, and over the whole way from 0 to where a record begins."""


@dataclass(frozen=True)
class Law:
    """Branches of a hysteretic force along one axis: a formula, or a table where there are knots."""

    # (4,): alpha, beta, gamma, exponent of dz/dy = alpha - (±beta sign z + gamma) |z|^exponent, + for rising y
    formula: Annotated[Array, "4"]
    knots: Annotated[Array, "K"]  # (K,): forces z of the table, V; empty for the formula
    # rising, falling: (K,): dz/dy at the knots, V/measurement unit; straight between them and beyond
    rising: Annotated[Array, "K"]
    falling: Annotated[Array, "K"]


@njit(cache=True, error_model="numpy")
def branch_slope(z: float, upward: bool, formula: Array, knots: Array, rising: Array, falling: Array) -> float:
    """Slope dz/dy of the branch through a force."""
    if knots.size == 0:
        power = abs(z) if formula[3] == 1.0 else abs(z) ** formula[3]
        against = formula[1] if (z > 0.0) == upward else -formula[1]
        slope: float = formula[0] - (against + formula[2]) * power
        return slope
    at = 0
    while at < knots.size - 2 and z >= knots[at + 1]:
        at += 1
    share = (z - knots[at]) / (knots[at + 1] - knots[at])
    branch = rising if upward else falling
    inside: float = branch[at] + share * (branch[at + 1] - branch[at])
    return inside


@njit(cache=True, error_model="numpy")
def unbent_slope(z: float, upward: bool, formula: Array) -> float:
    """`branch_slope` of a formula whose exponent is 1, short enough for the compiler to inline it: a third of the time."""
    against = formula[1] if (z > 0.0) == upward else -formula[1]
    slope: float = formula[0] - (against + formula[2]) * abs(z)
    return slope


@njit(cache=True, error_model="numpy")
def advance_interval(
    at: tuple[float, float, float],
    drive: tuple[float, float],
    unbent: bool,
    step: float,
    steps: int,
    mechanics: Array,
    formula: Array,
    knots: Array,
    rising: Array,
    falling: Array,
) -> tuple[float, float, float]:
    """Integrate over one interval by the classical Runge-Kutta method of fourth order."""
    # unbent: whether the law is a formula of exponent 1. Calls say it as a constant: for each the compiler makes code of its own
    y, v, z = at
    u, rise = drive
    mass, damping, stiffness = mechanics
    half, sixth = 0.5 * step, step / 6.0
    for _ in range(steps):
        middle = u + 0.5 * rise
        a1 = (u - damping * v - stiffness * y - z) / mass
        f1 = v * (unbent_slope(z, v > 0.0, formula) if unbent else branch_slope(z, v > 0.0, formula, knots, rising, falling))
        v2, z2 = v + half * a1, z + half * f1
        a2 = (middle - damping * v2 - stiffness * (y + half * v) - z2) / mass
        f2 = v2 * (unbent_slope(z2, v2 > 0.0, formula) if unbent else branch_slope(z2, v2 > 0.0, formula, knots, rising, falling))
        v3, z3 = v + half * a2, z + half * f2
        a3 = (middle - damping * v3 - stiffness * (y + half * v2) - z3) / mass
        f3 = v3 * (unbent_slope(z3, v3 > 0.0, formula) if unbent else branch_slope(z3, v3 > 0.0, formula, knots, rising, falling))
        u += rise
        v4, z4 = v + step * a3, z + step * f3
        a4 = (u - damping * v4 - stiffness * (y + step * v3) - z4) / mass
        f4 = v4 * (unbent_slope(z4, v4 > 0.0, formula) if unbent else branch_slope(z4, v4 > 0.0, formula, knots, rising, falling))
        y += sixth * (v + 2.0 * (v2 + v3) + v4)
        v += sixth * (a1 + 2.0 * (a2 + a3) + a4)
        z += sixth * (f1 + 2.0 * (f2 + f3) + f4)
    return y, v, z


@njit(cache=True, error_model="numpy")
def advance_oscillator(
    command: Annotated[Array, "N"],
    held: bool,
    step: float,
    steps: int,
    mechanics: Annotated[Array, "3"],
    formula: Array,
    knots: Array,
    rising: Array,
    falling: Array,
    state: Annotated[Array, "6"],
    output: Annotated[Array, "N"],
) -> None:
    """Integrate one axis over a block."""
    y, v, z, before, least, greatest = state
    unbent = knots.size == 0 and formula[3] == 1.0
    for row in range(command.size):
        now = command[row]
        drive = (now, 0.0) if held else (before, (now - before) / steps)
        if unbent:
            y, v, z = advance_interval((y, v, z), drive, True, step, steps, mechanics, formula, knots, rising, falling)
        else:
            y, v, z = advance_interval((y, v, z), drive, False, step, steps, mechanics, formula, knots, rising, falling)
        before = now
        least, greatest = min(least, z), max(greatest, z)
        output[row] = y
    state[0], state[1], state[2], state[3], state[4], state[5] = y, v, z, before, least, greatest


@njit(cache=True, error_model="numpy")
def advance_without_inertia(
    command: Annotated[Array, "N"],
    steps: int,
    stiffness: float,
    formula: Array,
    knots: Array,
    rising: Array,
    falling: Array,
    state: Annotated[Array, "6"],
    output: Annotated[Array, "N"],
) -> None:
    """Follow the equilibrium stiffness y + z = u of one axis over a block of commands, each approached without overshoot."""
    z, before = state[2], state[3]
    for row in range(command.size):
        now = command[row]
        if now != before:
            h, upward = (now - before) / steps, now > before
            for _ in range(steps):
                # dz/du: a change of u is shared between z and the spring.
                g = branch_slope(z, upward, formula, knots, rising, falling)
                f1 = g / (stiffness + g)
                g = branch_slope(z + 0.5 * h * f1, upward, formula, knots, rising, falling)
                f2 = g / (stiffness + g)
                g = branch_slope(z + 0.5 * h * f2, upward, formula, knots, rising, falling)
                f3 = g / (stiffness + g)
                g = branch_slope(z + h * f3, upward, formula, knots, rising, falling)
                f4 = g / (stiffness + g)
                z += h * (f1 + 2.0 * (f2 + f3) + f4) / 6.0
            before = now
        output[row] = (now - z) / stiffness
    state[0], state[1], state[2], state[3] = (before - z) / stiffness, 0.0, z, before
    state[4], state[5] = min(state[4], z), max(state[5], z)


BRANCH = """
/* Slope dz/dy of the branch through a force: a formula, or a table where there are knots. */
typedef struct {
    const double *formula;
    const double *knots;
    const double *rising;
    const double *falling;
    int size;
} hysteretic_law;

static double branch_slope(double z, int upward, const hysteretic_law *law)
{
    double slope = 0.0;
    if (law->size == 0) {
        const double power = (law->formula[3] == 1.0) ? fabs(z) : pow(fabs(z), law->formula[3]);
        const int outward = (z > 0.0) ? 1 : 0;
        const double against = (outward == upward) ? law->formula[1] : -law->formula[1];
        slope = law->formula[0] - ((against + law->formula[2]) * power);
    } else {
        int at = 0;
        while ((at < (law->size - 2)) && (z >= law->knots[at + 1])) {
            at++;
        }
        const double share = (z - law->knots[at]) / (law->knots[at + 1] - law->knots[at]);
        const double *branch = (upward != 0) ? law->rising : law->falling;
        slope = branch[at] + (share * (branch[at + 1] - branch[at]));
    }
    return slope;
}
"""
"""`branch_slope` in C; as the integration, in double also where signals are float."""

OF_AXIS = """
const hysteretic_law law = {p->formula[i], p->knots[i], p->rising[i], p->falling[i], p->table_size[i]};
"""

ADVANCE = """
for (int i = 0; i < AXES; i++) {
    @OF_AXIS@
    const double mass = p->mass[i];
    const double damping = p->damping[i];
    const double stiffness = p->stiffness[i];
    const double step = p->step[i];
    const double half = 0.5 * step;
    const double sixth = step / 6.0;
    const double now = (double)in[i];
    const double slope = (HELD != 0) ? 0.0 : ((now - s->before[i]) / (double)p->steps[i]);
    double u = (HELD != 0) ? now : s->before[i];
    double y = s->y[i];
    double v = s->v[i];
    double z = s->z[i];
    for (int turn = 0; turn < p->steps[i]; turn++) {
        const double middle = u + (0.5 * slope);
        const double a1 = (((u - (damping * v)) - (stiffness * y)) - z) / mass;
        const double f1 = v * branch_slope(z, (v > 0.0) ? 1 : 0, &law);
        const double v2 = v + (half * a1);
        const double z2 = z + (half * f1);
        const double a2 = (((middle - (damping * v2)) - (stiffness * (y + (half * v)))) - z2) / mass;
        const double f2 = v2 * branch_slope(z2, (v2 > 0.0) ? 1 : 0, &law);
        const double v3 = v + (half * a2);
        const double z3 = z + (half * f2);
        const double a3 = (((middle - (damping * v3)) - (stiffness * (y + (half * v2)))) - z3) / mass;
        const double f3 = v3 * branch_slope(z3, (v3 > 0.0) ? 1 : 0, &law);
        u += slope;
        const double v4 = v + (step * a3);
        const double z4 = z + (step * f3);
        const double a4 = (((u - (damping * v4)) - (stiffness * (y + (step * v3)))) - z4) / mass;
        const double f4 = v4 * branch_slope(z4, (v4 > 0.0) ? 1 : 0, &law);
        y += sixth * ((v + (2.0 * (v2 + v3))) + v4);
        v += sixth * ((a1 + (2.0 * (a2 + a3))) + a4);
        z += sixth * ((f1 + (2.0 * (f2 + f3))) + f4);
    }
    s->y[i] = y;
    s->v[i] = v;
    s->z[i] = z;
    s->before[i] = now;
    out[i] = (real)y;
}
""".replace("@OF_AXIS@", OF_AXIS.strip())
"""`advance_oscillator` in C."""

COME_TO_REST = """
for (int i = 0; i < AXES; i++) {
    @OF_AXIS@
    const double now = (double)in[i];
    const double h = now / (double)SETTLING_STEPS;
    const int upward = (now > 0.0) ? 1 : 0;
    double z = 0.0;
    if (now != 0.0) {
        for (int turn = 0; turn < SETTLING_STEPS; turn++) {
            const double g1 = branch_slope(z, upward, &law);
            const double f1 = g1 / (p->stiffness[i] + g1);
            const double g2 = branch_slope(z + ((0.5 * h) * f1), upward, &law);
            const double f2 = g2 / (p->stiffness[i] + g2);
            const double g3 = branch_slope(z + ((0.5 * h) * f2), upward, &law);
            const double f3 = g3 / (p->stiffness[i] + g3);
            const double g4 = branch_slope(z + (h * f3), upward, &law);
            const double f4 = g4 / (p->stiffness[i] + g4);
            z += (h * ((f1 + (2.0 * (f2 + f3))) + f4)) / 6.0;
        }
    }
    s->y[i] = (now - z) / p->stiffness[i];
    s->v[i] = 0.0;
    s->z[i] = z;
    s->before[i] = now;
    out[i] = (real)s->y[i];
}
""".replace("@OF_AXIS@", OF_AXIS.strip())
"""`advance_without_inertia` in C, from rest at 0 V to one command."""


@dataclass(frozen=True)
class HystereticOscillator(Stage):
    """Base of the stages of this structure; they add the parameters of their branches and say what these are in `laws`."""

    mass: ScalarPerAxis = scalar("V s²/measurement unit", "moved mass", above=0.0)
    damping: ScalarPerAxis = scalar("V s/measurement unit", "viscous damping", lower=0.0)
    stiffness: ScalarPerAxis = scalar("V/measurement unit", "of the spring without hysteresis", above=0.0)

    @property
    def is_hysteresis(self) -> bool:
        return True

    def laws(self, axes: int) -> list[Law]:
        """Branches of the force."""
        raise NotImplementedError

    def mechanics(self, axes: int) -> Annotated[Array, "A 3"]:
        """Mass, damping and stiffness of every axis."""
        return np.ascontiguousarray(np.stack(per_axis_scalars(self, axes, "mass", "damping", "stiffness"), axis=1))

    def small_motion_stiffness(self, axes: int) -> Annotated[Array, "A"]:
        """Stiffness for small motions about rest, the force's included."""
        at_rest = [
            0.5 * sum(branch_slope(0.0, upward, law.formula, law.knots, law.rising, law.falling) for upward in (True, False))
            for law in self.laws(axes)
        ]
        stiffness: Array = self.mechanics(axes)[:, 2] + np.array(at_rest)
        return stiffness

    def steps(self, sampling: Sampling) -> list[int]:
        """Number of integration steps between two samples."""
        mass, damping, stiffness = self.mechanics(sampling.axes).T
        stiffest = np.maximum(self.small_motion_stiffness(sampling.axes), stiffness)
        with np.errstate(over="ignore", divide="ignore"):
            fastest = np.maximum(np.sqrt(stiffest / mass), damping / mass)
            counts = np.ceil(sampling.sample_time * fastest / RESOLUTION)
        if not np.all(counts <= MAX_STEPS):
            raise InputError(
                f"mass: the fastest time constant of the mechanics is {1 / np.max(fastest):.3g} s, more than {MAX_STEPS} steps of "
                f"integration per sample of {sampling.sample_time:g} s: give parameters for this sample time"
            )
        return [max(int(count), 1) for count in counts]

    def linearized(self, axes: int) -> tuple[Stage, ...]:
        mass, damping, _ = self.mechanics(axes).T
        den = np.stack([mass, damping, self.small_motion_stiffness(axes)], axis=1)
        return (TransferFunction(frozen(np.ones((axes, 1))), frozen(den)),)

    def mean_slope(self, axes: int) -> Array:
        slope: Array = 1.0 / self.small_motion_stiffness(axes)
        return slope

    def at_rest(self, signal: Array) -> Array:
        return OscillatorFilter(self, signal.shape[1]).follow(np.asarray(signal, dtype=float))

    def filter(self, sampling: Sampling) -> OscillatorFilter:
        return OscillatorFilter(self, sampling.axes, sampling)


class OscillatorFilter(Filter):
    """Streaming `HystereticOscillator`; without a clock it only settles and follows."""

    hold = "foh"

    def __init__(self, stage: HystereticOscillator, axes: int, sampling: Sampling | None = None) -> None:
        self.mechanics = stage.mechanics(axes)
        self.laws = [(law.formula, law.knots, law.rising, law.falling) for law in stage.laws(axes)]
        self.steps = stage.steps(sampling) if sampling else [1] * axes
        self.sample_time = sampling.sample_time if sampling else 0.0
        self.held = sampling is not None and sampling.hold == "zoh"
        self.state = np.zeros((axes, 6))

    @property
    def force_range(self) -> Array:
        """Least and greatest force z (A, 2), V, since the filter was settled."""
        return self.state[:, 4:].copy()

    def follow(self, signal: Array, steps: int = STATIC_STEPS) -> Array:
        """Displacement (N, A) at the equilibria of a signal (N, A), one after the other, each reached in so many `steps`."""
        output = np.empty(signal.shape)
        for axis, law in enumerate(self.laws):
            column = np.empty(len(signal))
            command = np.ascontiguousarray(signal[:, axis])
            advance_without_inertia(command, steps, self.mechanics[axis, 2], *law, self.state[axis], column)
            output[:, axis] = column
        return output

    def settle(self, value: Array) -> Array:
        self.state[:] = 0.0
        settled: Array = self.follow(np.asarray(value, dtype=float)[None], SETTLING_STEPS)[0]
        return settled

    def process(self, block: Array) -> Array:
        output = np.empty(block.shape)
        for axis, law in enumerate(self.laws):
            column = np.empty(len(block))
            command, steps = np.ascontiguousarray(block[:, axis]), self.steps[axis]
            step, state = self.sample_time / steps, self.state[axis]
            advance_oscillator(command, self.held, step, steps, self.mechanics[axis], *law, state, column)
            output[:, axis] = column
        return output

    def c_code(self) -> CCode:
        axes, knots = len(self.laws), max(law[1].size for law in self.laws)
        tables = np.zeros((3, axes, knots))
        for axis, law in enumerate(self.laws):
            for table, values in zip(tables, law[1:], strict=True):
                table[axis, : values.size] = values
        slopes = "V/measurement unit, slope of the force at the knots while the displacement"
        sizes = [law[1].size for law in self.laws]
        numbers = {
            "mass": (self.mechanics[:, 0], "V s^2/measurement unit"),
            "damping": (self.mechanics[:, 1], "V s/measurement unit"),
            "stiffness": (self.mechanics[:, 2], "V/measurement unit"),
            "step": (self.sample_time / np.array(self.steps), "s, of the integration"),
            "formula": (np.array([law[0] for law in self.laws]), "alpha, beta, gamma, exponent of the force"),
            "knots": (tables[0], "V, forces of the table"),
            "rising": (tables[1], f"{slopes} rises"),
            "falling": (tables[2], f"{slopes} falls"),
        }
        state = {"y": "measurement unit", "v": "measurement unit/s", "z": "V, force", "before": "V, command before"}
        return CCode(
            "oscillator",
            ADVANCE,
            COME_TO_REST,
            {"HELD": int(self.held), "SETTLING_STEPS": SETTLING_STEPS},
            {
                **{name: reals(value, text, wide=True) for name, (value, text) in numbers.items()},
                "table_size": integers(sizes, "knots, 0 for the formula"),
                "steps": integers(self.steps, "of the integration in a tick"),
            },
            {name: reals(np.zeros(axes), text, wide=True) for name, text in state.items()},
            (BRANCH,),
        )
