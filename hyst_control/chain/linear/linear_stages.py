# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Linear continuous-time stages, discretized exactly for the hold of the signal that enters them.

A run of neighboring linear stages and delays is one `LinearSystem` per axis (or one for all axes where a stage couples
them), and is advanced by one matrix exponential: nothing is lost between its members, and a delay that is not a whole
number of samples is exact too, because the held input is known between the samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast

import numpy as np
from scipy.linalg import block_diag

from hyst_control.base.arrays import Array, Complex
from hyst_control.base.errors import InputError
from hyst_control.chain.bounded_cache import remembered
from hyst_control.chain.linear import rational_factors
from hyst_control.chain.linear.discretization import Discretised as Discretised
from hyst_control.chain.linear.discretization import discretise as discretise
from hyst_control.chain.linear.discretization import discretise_average
from hyst_control.chain.linear.linear_filter import LinearFilter as LinearFilter
from hyst_control.chain.linear.linear_kernels import FEW
from hyst_control.chain.linear.linear_system import THROUGH
from hyst_control.chain.linear.linear_system import LinearSystem as LinearSystem
from hyst_control.chain.linear.linear_system import stacked as stacked
from hyst_control.chain.linear.linear_system import transfer_function_system as transfer_function_system
from hyst_control.chain.parameter import (
    AllAxes,
    Coordinate,
    Form,
    Parameter,
    ScalarPerAxis,
    Scattering,
    VectorPerAxis,
    all_axes,
    flag,
    scalar,
    vector,
)
from hyst_control.chain.stage import Role, Sampling, Stage, depth, per_axis, per_axis_scalar, per_axis_scalars, register, scaled

MAX_SKEW = 1e8  # Condition number of the eigenvectors up to which a state space has modes to speak of
LONGEST_DELAY = 1e6  # Longest delay in samples: what is held in memory


@dataclass(frozen=True, eq=False)
class LinearStage(Stage):
    """A stage that is a linear continuous-time system; `systems` gives one per axis, or a single one that couples the axes."""

    ROLES: ClassVar[Role] = Role.LINEAR

    def systems(self, axes: int) -> list[LinearSystem]:
        """One single-input system per axis, or one system for all axes where the stage couples them."""
        raise NotImplementedError

    def filter(self, sampling: Sampling) -> LinearFilter:
        return linear_filter([self], sampling)

    def linearized(self, axes: int) -> tuple[Stage, ...]:
        return (self,)

    def gain_at_rest(self, axes: int) -> tuple[Array, Array]:
        """Gain (A, A) and bias (A,) that all settles to."""
        systems = self.systems(axes)
        gain = np.zeros((axes, axes))
        width = axes // len(systems)
        for i, system in enumerate(systems):
            gain[i * width : (i + 1) * width, i * width : (i + 1) * width] = system.static_gain()
        return gain, np.concatenate([system.bias for system in systems])

    def at_rest(self, signal: Array) -> Array:
        gain, bias = self.gain_at_rest(signal.shape[1])
        return signal @ gain.T + bias


@register
@dataclass(frozen=True)
class Delay(Stage):
    """y(t) = u(t - tau), tau in s, exact between the samples: a chain lets the nearest linear stage carry it.

    Alone it returns what the held input was tau earlier: whole samples under `zoh`, linear in between under `foh`.
    """

    name: ClassVar[str] = "delay"
    equation: ClassVar[str] = r"y(t) = u(t - \mathrm{tau})"
    place: ClassVar[str] = "drive"
    tau: ScalarPerAxis = scalar("s", "transport delay", lower=0.0)

    def linearized(self, axes: int) -> tuple[Stage, ...]:
        return (self,)

    def filter(self, sampling: Sampling) -> LinearFilter:
        return linear_filter([self], sampling)

    def at_rest(self, signal: Array) -> Array:
        return signal


@register
@dataclass(frozen=True)
class TransferFunction(LinearStage):
    """G(s) = num(s) / den(s), descending powers of s; with `coupled` matrices of polynomials, [output][input]."""

    name: ClassVar[str] = "transfer_function"
    equation: ClassVar[str] = r"G(s) = \frac{\mathrm{num}(s)}{\mathrm{den}(s)}"
    ROLES: ClassVar[Role] = LinearStage.ROLES | Role.MECHANICS
    num: VectorPerAxis | AllAxes = vector("descending powers of s", "numerator", scatter=Scattering.POLES)
    den: VectorPerAxis | AllAxes = vector("descending powers of s", "denominator", scatter=Scattering.POLES)
    coupled: bool = flag("whether num is [output][input] of polynomials, and den likewise or one for all")

    def declarations(self) -> Mapping[str, Parameter]:
        known = super().declarations()
        if not self.coupled:
            return known
        matrix = {"num": (3,), "den": (1, 3)}
        return {**known, **{key: replace(known[key], form=Form.ALL_AXES, dimensions=due) for key, due in matrix.items()}}

    @property
    def mixes_axes(self) -> bool:
        return self.coupled

    def coordinates(self, axes: int) -> dict[tuple[str, int | None], Coordinate]:
        """Gain, frequencies, dampings and times of every axis; none where polynomials couple the axes."""
        return {
            (name, axis): coordinate
            for axis, (num, den) in enumerate(self._pairs(axes))
            for name, coordinate in rational_factors.factors(num, den).items()
        }

    def with_coordinates(self, values: Mapping[tuple[str, int | None], float], axes: int) -> TransferFunction:
        moved = [
            rational_factors.rational(num, den, {name: value for (name, of), value in values.items() if of == axis})
            for axis, (num, den) in enumerate(self._pairs(axes))
        ]
        if axes == 1:
            return replace(self, num=moved[0][0], den=moved[0][1])
        return replace(self, num=[num for num, _ in moved], den=[den for _, den in moved])

    def _pairs(self, axes: int) -> list[tuple[Array, Array]]:
        if self.coupled:
            return []
        return list(zip(per_axis(self.num, axes, 1, "num"), per_axis(self.den, axes, 1, "den"), strict=True))

    def check(self) -> None:
        axes = next((len(value) for value in cast(tuple[Any, Any], (self.num, self.den)) if depth(value) > 1), 1)
        for system in self.systems(axes):
            system.static_gain()

    def systems(self, axes: int) -> list[LinearSystem]:
        if not self.coupled:
            return [self._single(num, den) for num, den in self._pairs(axes)]
        num, den = cast(Any, self.num), cast(Any, self.den)
        common = depth(den) == 1
        if len(num) != axes or any(len(row) != axes for row in num):
            raise InputError(f"num: {len(num)} outputs by {len(num[0])} inputs for {axes} axes")
        columns = [
            [self._single(np.array(num[i][j]), np.array(den if common else den[i][j])) for i in range(axes)] for j in range(axes)
        ]
        return [
            LinearSystem(
                block_diag(*(each.A for column in columns for each in column)),
                block_diag(*(np.vstack([each.B for each in column]) for column in columns)),
                np.hstack([block_diag(*(each.C for each in column)) for column in columns]),
                np.hstack([np.vstack([each.D for each in column]) for column in columns]),
                np.zeros(axes),
            )
        ]

    @staticmethod
    def _single(num: Array, den: Array) -> LinearSystem:
        if not np.any(den):
            raise InputError("den: all zero")
        return transfer_function_system(num, den)


@dataclass(frozen=True)
class Mode:
    """A mode of a state space: one real pole, or a pair of which `pole` is the one above the real axis."""

    pole: complex  # Eigenvalue of A; of a discrete system its z
    # right, left: Right and left eigenvector (n,), left @ right = 1
    right: Complex
    left: Complex
    # frequency, damping: Hz; damping ratio, negative where the mode is unstable
    frequency: float
    damping: float
    gains: Array  # Gain at rest (p,) of every output, root mean square over the inputs

    @classmethod
    def of(cls, pole: complex, right: Complex, left: Complex, b: Array, c: Array, sample_time: float | None) -> Mode:
        """Mode of a pole with its eigenvectors."""
        rate = pole if sample_time is None else np.log(pole + 0j) / sample_time
        size = max(abs(rate), 1e-300)
        rest = -pole if sample_time is None else 1.0 - pole
        static = np.real(np.outer(c @ right, left @ b) / rest) * (1 if pole.imag == 0.0 else 2)
        return cls(pole, right, left, size / (2 * np.pi), -rate.real / size, np.sqrt(np.mean(static**2, axis=1)))

    @property
    def projection(self) -> Array:
        """Projector (n, n) of the states onto the mode."""
        return (1 if self.pole.imag == 0.0 else 2) * np.real(np.outer(self.right, self.left))

    def moved(self, frequency: float | None, damping: float | None, corner: float | None, sample_time: float | None) -> complex:
        """The pole for another frequency and damping; None: as it is. Neither changes its sign."""
        if frequency is None and damping is None and corner is None:
            return self.pole
        given = corner if frequency is None else frequency
        size = 2 * np.pi * max(self.frequency if given is None else given, 0.05 * self.frequency)
        ratio = self.damping if damping is None else damping
        if self.pole.imag:
            # Neither unstable nor split in two real poles.
            ratio = np.sign(self.damping) * min(max(abs(ratio) * np.sign(ratio * self.damping), 0.05 * abs(self.damping)), 0.999)
        rate = size * complex(-ratio, np.sqrt(max(1.0 - ratio**2, 0.0)) if self.pole.imag else 0.0)
        return rate if sample_time is None else complex(np.exp(rate * sample_time))


@register
@dataclass(frozen=True)
class StateSpace(LinearStage):
    """dx/dt = A x + B u, y = C x + D u over all axes together; with `sample_time` (s) x[k+1] = A x[k] + B u[k]."""

    name: ClassVar[str] = "state_space"
    equation: ClassVar[str] = r"\dot{x} = \mathrm{A}\, x + \mathrm{B}\, u, \quad y = \mathrm{C}\, x + \mathrm{D}\, u"
    ROLES: ClassVar[Role] = LinearStage.ROLES | Role.MIXES_AXES
    A: AllAxes = all_axes("1/s, or 1 where discrete", "state from state", 2, scatter=Scattering.POLES)
    B: AllAxes = all_axes("", "state from input", 2)
    C: AllAxes = all_axes("", "output from state", 2)
    D: AllAxes = all_axes("", "output from input", 2)
    sample_time: float | None = all_axes("s", "of a discrete system", 0, default=None, above=0.0, scatter=Scattering.NONE)

    @property
    def linear(self) -> bool:
        return not self.discrete

    @property
    def is_mechanics(self) -> bool:
        return not self.discrete

    def coordinates(self, axes: int) -> dict[tuple[str, int | None], Coordinate]:
        """Frequency and damping, or corner, of every mode, and its gain at rest to every output, root mean square over the inputs."""
        found: dict[tuple[str, int | None], Coordinate] = {}
        for i, mode in enumerate(self._modes()):
            if mode.pole.imag:
                found[f"frequency[{i}]", None] = Coordinate(mode.frequency, mode.frequency, "Hz", "A")
                found[f"damping[{i}]", None] = Coordinate(mode.damping, abs(mode.damping), "", "A")
            else:
                found[f"corner[{i}]", None] = Coordinate(mode.frequency, mode.frequency, "Hz", "A")
            for output, gain in enumerate(mode.gains):
                found[f"gain[{i}][{output}]", None] = Coordinate(float(gain), float(mode.gains.max()), "gain", "C")
        return found

    def with_coordinates(self, values: Mapping[tuple[str, int | None], float], axes: int) -> StateSpace:
        a, c = np.array(self.A, dtype=float), np.array(self.C, dtype=float)
        for i, mode in enumerate(self._modes()):
            frequency, damping, corner = (values.get((f"{name}[{i}]", None)) for name in ("frequency", "damping", "corner"))
            pole = mode.moved(frequency, damping, corner, self.sample_time)
            a = a + (1 if mode.pole.imag == 0.0 else 2) * np.real((pole - mode.pole) * np.outer(mode.right, mode.left))
            for output, gain in enumerate(mode.gains):
                moved = values.get((f"gain[{i}][{output}]", None), gain)
                if gain:
                    c[output] += (moved / gain - 1.0) * (np.array(self.C, dtype=float)[output] @ mode.projection)
        return replace(self, A=a, C=c)

    def _modes(self) -> list[Mode]:
        """The modes in rising order of frequency; none where the states have no modes of their own (a defective matrix)."""
        a, b, c = (np.array(getattr(self, part), dtype=float) for part in "ABC")
        if not len(a):
            return []
        poles, right = np.linalg.eig(a)
        if np.linalg.cond(right) > MAX_SKEW:
            return []
        left = np.linalg.inv(right)
        found = [
            Mode.of(complex(pole), right[:, i], left[i], b, c, self.sample_time) for i, pole in enumerate(poles) if pole.imag >= 0.0
        ]
        return sorted(found, key=lambda mode: mode.frequency)

    def check(self) -> None:
        a, b, c, d = (np.array(getattr(self, field), dtype=float) for field in "ABCD")
        n = len(a)
        if a.shape != (n, n) or b.shape[0] != n or c.shape[1] != n or d.shape != (c.shape[0], b.shape[1]):
            raise InputError(f"A: shapes A {a.shape}, B {b.shape}, C {c.shape}, D {d.shape} do not fit together")
        # A pole where a constant input never comes to rest: s = 0, or z = 1.
        at_rest = -a if self.sample_time is None else np.eye(n) - a
        if n and np.linalg.cond(at_rest) > 1.0 / np.finfo(float).eps:
            raise InputError("A: the system integrates (a pole at rest) and never comes to rest: remove that pole")

    @property
    def discrete(self) -> bool:
        """True where the matrices advance by one sample instead of giving the derivative."""
        return self.sample_time is not None

    def gain_at_rest(self, axes: int) -> tuple[Array, Array]:
        if not self.discrete:
            return super().gain_at_rest(axes)
        a, b, c, d = (np.array(getattr(self, part), dtype=float) for part in "ABCD")
        return d + c @ np.linalg.solve(np.eye(len(a)) - a, b), np.zeros(axes)

    def systems(self, axes: int) -> list[LinearSystem]:
        a, b, c, d = (np.array(getattr(self, field), dtype=float) for field in "ABCD")
        system = LinearSystem(a, b, c, d, np.zeros(len(c)))
        if system.D.shape != (axes, axes):
            raise InputError(f"D: {system.D.shape[0]} outputs by {system.D.shape[1]} inputs for {axes} axes")
        return [system]

    def filter(self, sampling: Sampling) -> LinearFilter:
        if self.sample_time is None:
            return super().filter(sampling)
        if abs(self.sample_time - sampling.sample_time) > 1e-9 * sampling.sample_time:
            raise InputError(
                f"sample_time: this discrete state space advances by {self.sample_time:g} s but is run at "
                f"{sampling.sample_time:g} s: run it at its own sample time or give continuous matrices"
            )
        system = self.systems(sampling.axes)[0]
        # Under zoh the sample wanted is the one at the interval's end, so the input of the interval acts at once.
        taps = np.stack([system.B, 0 * system.B, 0 * system.B])
        if sampling.hold == "foh":
            taps = np.roll(taps, 1, axis=0)
        feedthrough = np.stack([system.D, 0 * system.D])
        zero = np.zeros(sampling.axes, dtype=np.int64)
        return LinearFilter([Discretised(system.A, taps, system.C, feedthrough, system.bias)], zero)


@register
@dataclass(frozen=True)
class RateCorrection(LinearStage):
    """Ψ = (k1 dv/dt + b1) / (k2 s + b2), the lag driven by the command's rate (MHL paper Eq. 4).

    Realized as the high-pass k1 s / (k2 s + b2) of the command plus the constant b1 / b2, so no difference quotient is taken.
    """

    name: ClassVar[str] = "rate_correction"
    equation: ClassVar[str] = r"\Psi = \frac{\mathrm{k1}\, \dot{v} + \mathrm{b1}}{\mathrm{k2}\, s + \mathrm{b2}}"
    k1: ScalarPerAxis = scalar("output unit s / V", "gain of the command's rate")
    k2: ScalarPerAxis = scalar("s", "lag", above=0.0)
    b1: ScalarPerAxis = scalar("output unit", "constant", default=0.0, scatter=Scattering.ABSOLUTE)
    b2: ScalarPerAxis = scalar("", "denominator's constant", default=1.0, above=0.0)

    def with_rate_part(self, factor: Array) -> Stage | None:
        if not np.any(per_axis_scalar(self.k1, len(factor), "k1")):
            return None
        return replace(self, k1=scaled(self.k1, factor, 0, "k1"))

    def systems(self, axes: int) -> list[LinearSystem]:
        # Plain numbers: what is out of proportion becomes infinite, and is refused where the system is discretized.
        values = zip(*(each.tolist() for each in per_axis_scalars(self, axes, "k1", "k2", "b1", "b2")), strict=True)
        return [
            LinearSystem(
                np.array([[-b2 / k2]]),
                np.array([[1.0]]),
                np.array([[-(k1 / k2) * (b2 / k2)]]),
                np.array([[k1 / k2]]),
                np.array([b1 / b2]),
            )
            for k1, k2, b1, b2 in values
        ]


@register
@dataclass(frozen=True)
class CrossCoupling(LinearStage):
    """y_i = M_ii u_i + L_i(s) sum over j != i of M_ij u_j; M is `matrix`, L_i a first-order low-pass, or 1 without a `corner`."""

    name: ClassVar[str] = "cross_coupling"
    equation: ClassVar[str] = (
        r"y_i = M_{ii} u_i + \frac{1}{1 + s / (2 \pi\, \mathrm{corner}_i)} \sum_{j \neq i} M_{ij} u_j, \quad M = "
        r"\mathrm{matrix}"
    )
    ROLES: ClassVar[Role] = LinearStage.ROLES | Role.MIXES_AXES
    matrix: AllAxes = all_axes("", "share of every input in every output, [output][input]", 2)
    corner: ScalarPerAxis | None = scalar("Hz", "of the low-pass on what comes from other axes", default=None, above=0.0)

    def check(self) -> None:
        matrix = np.array(self.matrix, dtype=float)
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
            raise InputError(f"matrix: shape {matrix.shape}, give one row and one column per axis")

    def systems(self, axes: int) -> list[LinearSystem]:
        matrix = np.array(self.matrix, dtype=float)
        if len(matrix) != axes:
            raise InputError(f"matrix: {len(matrix)} rows for {axes} axes")
        if self.corner is None:
            return [LinearSystem(np.zeros((0, 0)), np.zeros((0, axes)), np.zeros((axes, 0)), matrix, np.zeros(axes))]
        w = 2 * np.pi * np.diag(per_axis_scalar(self.corner, axes, "corner"))
        direct = np.diag(np.diag(matrix))
        return [LinearSystem(-w, w @ (matrix - direct), np.eye(axes), direct, np.zeros(axes))]


def realization(system: LinearSystem) -> LinearSystem:
    """A system in the states that it runs in: few are kept in registers as they are, many act on each other only within their mode."""
    balanced = system.balanced()
    return balanced if len(balanced.A) <= FEW else balanced.by_modes()


def linear_filter(run: list[Stage], sampling: Sampling, averaged: bool = False) -> LinearFilter:
    """One filter for a run of linear stages and delays, the delays taken at its input; of delays only, a pure delay."""
    return _prepared(tuple(run), sampling, averaged).another()


@remembered
def _prepared(run: tuple[Stage, ...], sampling: Sampling, averaged: bool) -> LinearFilter:
    axes = sampling.axes
    late = np.zeros(axes)
    systems: list[LinearSystem] | None = None
    for stage in run:
        if isinstance(stage, Delay):
            late += per_axis_scalar(stage.tau, axes, "tau")
            continue
        following = cast(LinearStage, stage).systems(axes)
        if systems is None:
            systems = following
        elif len(systems) == len(following):
            systems = [one.then(other) for one, other in zip(systems, following, strict=True)]
        else:
            systems = [_coupled(systems).then(_coupled(following))]
    pure_delay = systems is None
    if systems is None:
        systems = [THROUGH] * axes
    samples = late / sampling.sample_time
    if np.any(samples > LONGEST_DELAY):
        raise InputError(
            f"tau: {late.max():g} s are {samples.max():.3g} samples of {sampling.sample_time:g} s, {LONGEST_DELAY:.0e} at most"
        )
    whole = np.floor(samples + 1e-9)
    fraction = np.maximum(samples - whole, 0.0).reshape(len(systems), -1)
    try:
        advance = discretise_average if averaged else discretise
        discretised = [advance(realization(system), fraction[s], sampling) for s, system in enumerate(systems)]
        result = LinearFilter(discretised, whole)
    except (np.linalg.LinAlgError, ValueError, OverflowError):
        names = ", ".join(stage.name for stage in run)
        raise InputError(
            f"{names}: time constants out of all proportion to the sample time {sampling.sample_time:g} s: check their units"
        ) from None
    if pure_delay or averaged:
        result.hold = sampling.hold
    result.history = np.zeros((0, axes))  # what is kept needs no room for a long delay
    return result


def _coupled(systems: list[LinearSystem]) -> LinearSystem:
    return systems[0] if len(systems) == 1 else stacked(systems)
