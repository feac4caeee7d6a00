"""Low-passes of an amplifier or a sensor: equal first-order ones in a row, or one of second order with a damping of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.c_code import CCode, reals
from hyst_control.chain.linear import LinearStage, LinearSystem, linear_filter
from hyst_control.chain.parameter import Array, ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import Filter, Sampling, Stage, frozen, per_axis_scalar, per_axis_scalars
from hyst_control.effects.effect import Parameter, Surroundings, Values
from hyst_control.errors import InputError


@dataclass(frozen=True)
class Lowpass(LinearStage):
    """1 / (1 + s / (2π cutoff))^order; cutoff Hz, infinite: none on that axis. Exact: it merges with its linear neighbors.

    Of order 2 it is ω² / (s² + 2 damping ω s + ω²) with ω = 2π cutoff: damping 1 is two equal low-passes, 0.707 a Butterworth filter.
    """

    unit_gain: ClassVar[bool] = True
    cutoff: ScalarPerAxis = scalar("Hz", "of every low-pass", above=0.0, infinite=True)
    order: ScalarPerAxis = scalar("", "number of low-passes", default=1, lower=1.0, whole=True, scatter=Scattering.NONE)
    damping: ScalarPerAxis = scalar("", "of a low-pass of order 2", default=1.0, above=0.0, scatter=Scattering.NONE)

    def check(self) -> None:
        axes = max(len(value) if isinstance(value, tuple) else 1 for value in (self.order, self.damping))
        order, damping = per_axis_scalars(self, axes, "order", "damping")
        if np.any((order != 2.0) & (damping != 1.0)):
            raise InputError("damping: belongs to a low-pass of order 2: leave it out, or give order 2")

    def systems(self, axes: int) -> list[LinearSystem]:
        return [
            lowpass_system(cutoff, int(order), damping)
            for cutoff, order, damping in zip(*per_axis_scalars(self, axes, "cutoff", "order", "damping"), strict=True)
        ]


@dataclass(frozen=True)
class AtSamples(Stage):
    """The values of a linear stage's output at the ends of the intervals, handed on as if held; part of a started chain only."""

    base: LinearStage

    def filter(self, sampling: Sampling) -> Filter:
        running = linear_filter([self.base], sampling)
        running.hold = sampling.hold
        return running


@dataclass(frozen=True)
class Rebuilt(Stage):
    """The held signal that a first-order low-pass turns into one with the given values at the samples; started chains only.

    z_k = (u_k - e u_{k-1}) / (1 - e) with e = exp(-2π cutoff · sample time), per axis.
    """

    cutoff: ScalarPerAxis

    def filter(self, sampling: Sampling) -> Filter:
        cutoff = per_axis_scalar(self.cutoff, sampling.axes, "cutoff")
        return RebuiltFilter(np.exp(-2 * np.pi * cutoff * sampling.sample_time), sampling.hold)


class RebuiltFilter(Filter):
    """Streaming `Rebuilt`; keep: e (A,)."""

    def __init__(self, keep: Array, hold: str) -> None:
        self.hold = hold
        self.keep, self.last = keep, np.zeros(len(keep))

    def settle(self, value: Array) -> Array:
        self.last = np.array(value, dtype=float)
        return self.last.copy()

    def process(self, block: Array) -> Array:
        before = np.concatenate([self.last[None], block])[: len(block)]
        self.last = block[-1].copy() if len(block) else self.last
        # In this order a signal at rest stays what it is to the last bit.
        rebuilt: Array = block + self.keep / (1.0 - self.keep) * (block - before)
        return rebuilt

    def c_code(self) -> CCode:
        return CCode(
            "rebuilt",
            """
for (int i = 0; i < AXES; i++) {
    out[i] = in[i] + (p->lead[i] * (in[i] - s->last[i]));
    s->last[i] = in[i];
}
""",
            "for (int i = 0; i < AXES; i++) {\n    s->last[i] = in[i];\n    out[i] = in[i];\n}",
            constants={"lead": reals(self.keep / (1.0 - self.keep), "share of a change that is added")},
            state={"last": reals(self.last, "signal unit, input before")},
        )


def lowpass_system(cutoff: float, order: int, damping: float = 1.0) -> LinearSystem:
    """`order` first-order low-passes at `cutoff` Hz in a row, or one of second order with another damping."""
    if np.isinf(cutoff):
        return LinearSystem(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)), np.zeros(1))
    rate = 2 * np.pi * cutoff
    if order == 2 and damping != 1.0:
        a = rate * np.array([[0.0, 1.0], [-1.0, -2.0 * damping]])
        return LinearSystem(a, rate * np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)), np.zeros(1))
    a = rate * (np.eye(order, k=-1) - np.eye(order))
    return LinearSystem(a, rate * np.eye(order, 1), np.eye(order)[-1:], np.zeros((1, 1)), np.zeros(1))


def lowpass_parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Cutoff, order, and the damping of one of second order, as a record shows them.

    The cutoff goes from what the record is just long enough to show up to what its sampling hardly does; beside clean records from a
    tenth of the lowest excited frequency.

    Parameters
    ----------
    around
        Record that the sizes are judged by.
    """
    nyquist = 0.5 / around.sample_time
    if around.slowest is not None:
        starts = tuple(np.geomspace(0.3 * around.slowest, nyquist, 6).tolist())
        lower = 0.1 * around.slowest
    else:
        starts = tuple(share * nyquist for share in (0.03, 0.2, 0.7))
        lower = min(3.0 / around.duration, 0.01 * nyquist)
    return (
        Parameter("cutoff", "Hz", np.inf, starts, lower, nyquist, 1.5, logarithmic=True),
        Parameter("order", "", 1.0, (1.0, 2.0), 1.0, 2.0, 1.0),
        Parameter("damping", "", 1.0, (0.9,), 0.4, 1.6, 0.3, told=False),
    )


def lowpass_variants(around: Surroundings) -> tuple[Values, ...]:
    """First order, and second order with any damping.

    Parameters
    ----------
    around
        Record that the sizes are judged by.
    """
    return {"order": 1.0, "damping": 1.0}, {"order": 2.0}


def lowpass_values(values: Values) -> Values:
    """Values of a low-pass whose order is 1 on some axes: they have no damping of their own there.

    Parameters
    ----------
    values
        Of the parameters, by name.
    """
    order = np.array(values.get("order", 1.0), dtype=float)
    damping = np.where(order == 2.0, np.array(values.get("damping", 1.0), dtype=float), 1.0)
    return {"cutoff": values["cutoff"], "order": frozen(order), "damping": frozen(damping)}
