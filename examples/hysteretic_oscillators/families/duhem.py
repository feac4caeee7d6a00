# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identification of Duhem hysteresis of Bouc and Wen's form in front of creep operators and dynamics G(s).

    y = G(s) C(s) [slope u + z],    dz/du = alpha (1 + growth u) - (beta sgn(u̇ z) + gamma) |z|^exponent,    C(0) = G(0) = 1

The search is over the simulation error of the whole chain. Creep operators and factors of G(s) are added one by one as long as the
held-out error falls: creep is a choice of the data, not of the family.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.parallel import map_forked
from hyst_control.chain import Stage
from hyst_control.chain.hysteresis.creep_operators import CreepOperators
from hyst_control.chain.linear.linear_stages import Delay
from hyst_control.chain.parameter import declared
from hyst_control.identify.assess.assembly import AxisFit
from hyst_control.identify.data.fit import Number
from hyst_control.identify.data.fit_windows import response_sign, short_stretches, whole_records
from hyst_control.identify.families.estimator import Estimator, register
from hyst_control.identify.families.options import TRUTH, Options, option
from hyst_control.identify.families.shared_options import nuisance_option, structure_option
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.identify.solve.simulation_error import Parametrization, Solution, minimize_simulation_error
from hyst_control.identify.solve.stable_dynamics import Structure
from hyst_control.records.record import Record
from hysteretic_oscillators.stages.duhem import Duhem

NAMES = tuple(declared(Duhem))
"""Parameters of the hysteresis."""
STARTS = ((-0.2, 2.0), (-0.4, 6.0), (0.1, 2.0))
"""Starts of the search: alpha relative to the mean slope, and beta relative to the drive."""
MEMORY_SHARE = 0.2
"""Share of the stroke by which the memory is measured in the parameter vector."""
SELECTION_ROWS, STRETCH, SETTLE = 60_000, 0.2, 0.02
"""Rows that choose between structures; length (s) of their stretches, and of their beginning that does not count."""
WORTHWHILE = 0.03
"""A factor is kept when it lowers the held-out mean square error by more than this share."""
PER_DECADE = 2
"""Creep operators per decade of time constants."""


@dataclass(frozen=True)
class DuhemOptions(Options):
    """Options of a fit of Duhem hysteresis."""

    nuisance: str = nuisance_option("linear")
    structure: Structure | None = structure_option()
    creep: bool | None = option(None, TRUTH, "creep operators, where they are not to be chosen on held-out data")


@dataclass(frozen=True)
class Axis:
    """Model of one axis as a parameter vector (P,) of order one: hysteresis (6), shares of the creep operators, dynamics with delay."""

    slope: float  # Mean slope, with the response's sign (measurement unit / V)
    drive: float  # Range of the command, V
    times: tuple[float, ...]  # Time constants (K,) of the creep operators, s
    structure: Structure  # Factors of G(s)
    sample_time: float  # Sample time, s

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(NAMES) + len(self.times) + self.structure.size

    def split(self, vector: Array) -> tuple[Array, Array, Array]:
        """Split a parameter vector into hysteresis (6,), shares (K,) and dynamics."""
        behind = len(NAMES) + len(self.times)
        return vector[: len(NAMES)], vector[len(NAMES) : behind], vector[behind:]

    def hysteresis(self, vector: Array) -> dict[str, float]:
        """Parameters of the stage by name."""
        slope, alpha, beta, gamma, log_exponent, growth = (float(value) for value in vector[: len(NAMES)])
        exponent = float(np.exp(log_exponent))
        memory = MEMORY_SHARE * abs(self.slope) * self.drive
        pace = 1.0 / (self.drive * memory ** (exponent - 1.0))
        return {
            "slope": slope * self.slope,
            "alpha": alpha * self.slope,
            "beta": beta * pace,
            "gamma": gamma * pace,
            "exponent": exponent,
            "growth": growth / self.drive,
        }

    def stages(self, vector: Array) -> list[Stage]:
        """The chain: delay, hysteresis, creep operators, G(s)."""
        _, shares, dynamics = self.split(vector)
        linear = self.structure.stages(dynamics)
        creep = [CreepOperators(self.times, shares)] if self.times else []
        delays = [stage for stage in linear if isinstance(stage, Delay)]
        return [*delays, Duhem(**self.hysteresis(vector)), *creep, *(stage for stage in linear if not isinstance(stage, Delay))]

    def limit(self, vector: Array) -> Array:
        """Move a parameter vector into the range in which the memory saturates and data can resolve the dynamics."""
        core, shares, dynamics = self.split(vector)
        slope, alpha, beta, gamma, log_exponent, growth = core
        beta = float(np.clip(beta, 1e-3, 100.0))
        bounded = [
            slope,
            alpha,
            beta,
            np.clip(gamma, -beta, beta),
            np.clip(log_exponent, np.log(0.6), np.log(5.0)),
            np.clip(growth, -2, 2),
        ]
        return np.concatenate([bounded, np.clip(shares, -0.2, 0.2), self.structure.limit(dynamics, self.sample_time)])

    def parametrization(self) -> Parametrization:
        """Chains and bounds of the search."""
        return Parametrization(self.stages, limit=self.limit)


@register
class DuhemHysteresis(Estimator[DuhemOptions]):
    """Duhem hysteresis, creep operators and dynamics."""

    name = "duhem"
    sentence = (
        "Duhem hysteresis of Bouc and Wen's form, asymmetric and saturating, in front of creep operators and dynamics G(s), which are "
        "added as long as the held-out error falls"
    )
    second_choice = True
    Options = DuhemOptions

    def fit_axis(self, records: Sequence[Record], index: int, options: DuhemOptions) -> AxisFit:
        axis, solution, held_out = searched(whole_records(records, index, weighted=False), options)
        unit = records[0].unit
        words = axis.structure.describe() + (f", {len(axis.times)} creep operators" if axis.times else "")
        return AxisFit(
            axis.stages,
            solution.parameters,
            solution.covariance,
            lambda vector: numbers(axis, vector, unit),
            held_out,
            structure=words,
        )


def searched(windows: Sequence[Window], options: DuhemOptions) -> tuple[Axis, Solution, float]:
    """The model of one axis, its solution on all rows, and the mean square error on rows held out."""
    moving = [window for window in windows if np.ptp(window.command)]
    slope = max(float(np.ptp(window.measurement)) / float(np.ptp(window.command)) for window in moving)
    drive = max(float(np.ptp(window.command)) for window in moving)
    sample_time = min(window.sample_time for window in windows)
    plain = Axis(response_sign(windows) * slope, drive, (), Structure(), sample_time)
    few = short_stretches(windows, SELECTION_ROWS, STRETCH, SETTLE)
    starts = [np.array([1.0, alpha, beta, 0.0, 0.1, 0.0]) for alpha, beta in STARTS]
    trials = map_forked(
        lambda i: minimize_simulation_error(few, plain.parametrization(), starts[i], nuisance=options.nuisance, passes=5),
        len(starts),
    )
    best = min(trials, key=lambda solution: solution.fitted)
    axis, chosen = grown(few, plain, best, options)
    final = minimize_simulation_error(
        windows, axis.parametrization(), chosen.parameters, nuisance=options.nuisance, passes=12, tolerance=1e-6, everything=True
    )
    return axis, final, chosen.held_out


def creep_times(windows: Sequence[Window]) -> tuple[float, ...]:
    """Time constants of the creep operators, s: a grid from a few samples to a third of the longest of the records in `windows`."""
    shortest = 5.0 * min(window.sample_time for window in windows)
    longest = max(len(window.command) * window.sample_time / window.share for window in windows) / 3.0
    count = max(int(PER_DECADE * np.log10(max(longest / shortest, 1.0))) + 1, 1)
    return tuple((shortest * 10.0 ** (np.arange(count) / PER_DECADE)).tolist())


def grown(windows: Sequence[Window], axis: Axis, best: Solution, options: DuhemOptions) -> tuple[Axis, Solution]:
    """Add creep operators and factors of G(s) as long as the held-out error falls."""
    creep = creep_times(windows)
    if options.structure is not None or options.creep:
        axis, best = extended(windows, axis, best, [(creep if options.creep else (), options.structure or Structure())], options)
    while True:
        trials = []
        if options.structure is None:
            trials += [(axis.times, structure) for structure in axis.structure.extensions() if not structure.slow_pair]
        if options.creep is None and not axis.times:
            trials.append((creep, axis.structure))
        if not trials:
            return axis, best
        following = extended(windows, axis, best, trials, options)
        if not following[1].held_out < (1.0 - WORTHWHILE) * best.held_out:
            return axis, best
        axis, best = following


def extended(
    windows: Sequence[Window],
    axis: Axis,
    best: Solution,
    trials: Sequence[tuple[tuple[float, ...], Structure]],
    options: DuhemOptions,
) -> tuple[Axis, Solution]:
    """Fit richer models from the parameters of the poorer one, on all cores, and return the one with the least held-out error."""
    core, shares, dynamics = axis.split(best.parameters)
    frequencies = [f for f in (200.0, 1000.0, 4000.0) if f < 0.4 / axis.sample_time] or [0.2 / axis.sample_time]
    begin = []
    for times, structure in trials:
        richer = replace(axis, times=times, structure=structure)
        delayed = shares if len(times) == len(shares) else np.zeros(len(times))
        for frequency in frequencies if structure.modes > axis.structure.modes else frequencies[:1]:
            begin.append((richer, np.concatenate([core, delayed, structure.grow(axis.structure, dynamics, frequency)])))

    def fitted(index: int) -> Solution:
        richer, start = begin[index]
        return minimize_simulation_error(windows, richer.parametrization(), start, nuisance=options.nuisance, passes=12)

    solutions = list(map_forked(fitted, len(begin)))
    least = min(range(len(begin)), key=lambda index: solutions[index].held_out)
    return begin[least][0], solutions[least]


def numbers(axis: Axis, vector: Array, unit: str) -> list[Number]:
    """Numbers of one axis as a report lists them."""
    _, shares, dynamics = axis.split(vector)
    units = {name: known.unit.replace("output unit", unit).replace(" / V", "/V") for name, known in declared(Duhem).items()}
    core = [Number(name, value, units[name]) for name, value in axis.hysteresis(vector).items()]
    return [*core, *(Number(f"shares[{i}]", share) for i, share in enumerate(shares)), *axis.structure.numbers(dynamics)]
