# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""One axis of the modified Hammerstein-like model as a parameter vector, and the options of its fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated, Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain import Parallel, Stage
from hyst_control.chain.linear.linear_stages import Delay, RateCorrection
from hyst_control.identify.assess.assembly import AxisFit
from hyst_control.identify.data.fit import Number
from hyst_control.identify.families.options import TRUTH, methods_option, option
from hyst_control.identify.families.shared_options import nuisance_option, structure_option
from hyst_control.identify.mhl.madelung import CurveOptions, range_notes, turned_by
from hyst_control.identify.mhl.madelung_curves import Curves, Ends
from hyst_control.identify.solve.simulation_error import Parametrization
from hyst_control.identify.solve.stable_dynamics import Structure
from hyst_control.records.record import Record

MOST = 0.95  # Of the mean slope: from it on the passes of the whole inverse may not converge
K2_UNIT = 1e-3  # Unit (s) of k2 in the parameter vector, which holds its logarithm


@dataclass(frozen=True)
class MhlOptions(CurveOptions):
    """Options of a fit of the modified Hammerstein-like model."""

    method: str = methods_option("joint", "paper")
    nuisance: str = nuisance_option("linear")
    structure: Structure | None = structure_option()
    cross_coupling: bool = option(True, TRUTH, "look for cross-coupling between several axes", methods=("joint",))


@dataclass(frozen=True)
class Axis:
    """Model of one axis as a parameter vector (P,): curves, rate part (k1 relative to the slope, log k2), dynamics with delay."""

    curves: Curves  # Form of the curves
    structure: Structure  # Factors of G(s)
    ends: Ends  # Commands at the ends of the curves
    output_scale: float  # Scale of the output (measurement unit)
    sign: float  # Sign of the response, 1 or -1
    sample_time: float  # Sample time, s

    @property
    def size(self) -> int:
        """Number of parameters."""
        return self.curves.size + 2 + self.structure.size

    def split(self, vector: Annotated[Array, "P"]) -> tuple[Array, Array, Array]:
        """Split a parameter vector by part."""
        n = self.curves.size
        return vector[:n], vector[n : n + 2], vector[n + 2 :]

    def rate(self, vector: Annotated[Array, "P"]) -> tuple[float, float]:
        """Parameters of the rate correction."""
        share, log_k2 = self.split(vector)[1]
        k2 = K2_UNIT * self.structure.pace * float(np.exp(log_k2))
        return float(share) * self.output_scale / self.ends.length * k2, k2

    def stages(self, vector: Annotated[Array, "P"], b1: float = 0.0) -> list[Stage]:
        """Construct the chain: delay, hysteresis and rate correction in parallel, G(s)."""
        curves, _, dynamics = self.split(vector)
        k1, k2 = self.rate(vector)
        linear = _dynamics_stages(self.structure, dynamics.tobytes())
        core = _curve_stage(self.curves, curves.tobytes(), self.ends, self.output_scale)
        hysteresis = Parallel(((core,), (RateCorrection(k1=k1, k2=k2, b1=b1),)))
        delays = [stage for stage in linear if isinstance(stage, Delay)]
        return [*delays, hysteresis, *(stage for stage in linear if not isinstance(stage, Delay))]

    def limit(self, vector: Annotated[Array, "P"]) -> Annotated[Array, "P"]:
        """Move a parameter vector into the range that data can resolve."""
        curves, rate, dynamics = self.split(vector)
        most = MOST * abs(self.curves.full(curves))
        rate = np.clip(rate, [-5.0, np.log(0.02)], [most, np.log(200.0)])
        return np.concatenate([curves, rate, self.structure.limit(dynamics, self.sample_time)])

    def parametrization(self) -> Parametrization:
        """Chains, constraints and bounds of the search."""
        curves, rhs = self.curves.constraints()
        lhs = np.zeros((len(curves), self.size))
        lhs[:, : self.curves.size] = curves
        return Parametrization(self.stages, lhs, rhs, self.limit)


# A neighboring vector differs in one parameter: most stages of its chain have been constructed and checked before.
@lru_cache(256)
def _curve_stage(curves: Curves, vector: bytes, ends: Ends, output_scale: float) -> Stage:
    return curves.stage(np.frombuffer(vector), ends, output_scale)


@lru_cache(256)
def _dynamics_stages(structure: Structure, vector: bytes) -> tuple[Stage, ...]:
    return tuple(structure.stages(np.frombuffer(vector)))


@dataclass(frozen=True)
class Found:
    """Parameters of one axis."""

    axis: Axis  # Model of the axis
    vector: Annotated[Array, "P"]  # Parameters (P,)
    covariance: Annotated[Array, "P P"]  # Their covariance (P, P)
    offset: float  # Zero of the sensor (measurement unit)
    held_out: float  # Mean square error on the rows held out
    steps: dict[str, dict[str, Any]] = field(default_factory=dict)  # Results of the paper's sequence

    def axis_fit(self, records: Sequence[Record], index: int) -> AxisFit:
        """The fit as every family hands it over."""
        axis, unit = self.axis, records[0].unit

        def numbers(vector: Array) -> list[Number]:
            curves, _, dynamics = axis.split(vector)
            k1, k2 = axis.rate(vector)
            full = Number("output_scale", axis.output_scale * axis.curves.full(curves), unit)
            rate = [Number("k1", k1, f"{unit} s/V"), Number("k2", k2, "s")]
            zero = Number("b1", self.offset, unit, estimated=False)
            return [*axis.curves.numbers(curves), full, *rate, *axis.structure.numbers(dynamics), zero]

        return AxisFit(
            lambda vector: [*axis.stages(vector, self.offset), *turned_by(axis.sign)],
            self.vector,
            self.covariance,
            numbers,
            self.held_out,
            tolerance=axis.curves.tolerance(axis.split(self.vector)[0], self.covariance),
            structure=axis.structure.describe(),
            notes=lambda _: range_notes(records, index, axis.ends),
            steps=self.steps,
        )
