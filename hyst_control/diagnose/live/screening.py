# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Screening of records: proves that a diagnosis would find no gap, without trying any effect.

Where the coefficients alone leave no more than the practical floor, or what the model leaves on clean records, and are strained by
less than the margin of a claim, no effect can be named, however well a search turns out. What remains are the checks of the record,
the zero of its session and 1/f noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.configuration import CONFIGURATION, Configuration
from hyst_control.diagnose.decide.policy import decide
from hyst_control.diagnose.model_error.baseline import Baseline
from hyst_control.diagnose.run.collect import collect, companions, residual_evidence
from hyst_control.diagnose.run.diagnosis import with_clean
from hyst_control.diagnose.run.prepare import Prepared, prepare
from hyst_control.diagnose.search.beam_search import FittedHypothesis, Found, inflated, settled
from hyst_control.diagnose.search.fit import Linearized, fit
from hyst_control.diagnose.search.null_distribution import threshold
from hyst_control.diagnose.verdict import Verdict
from hyst_control.model_file import Model
from hyst_control.records.record import Record

CLEARLY = 2.0  # Energy that the first fit leaves, in those that are no gap, from which it is not gone on with


@dataclass(frozen=True)
class Screening:
    """Gap of records, and whether it is proved to be none."""

    no_gap: bool  # True where a diagnosis would say "no_gap"; where False it may say anything
    # gap_rms, floor_rms: As in the gap report, measurement unit
    gap_rms: float
    gap_nrmse: float  # As in the gap report, % of the range
    floor_rms: float
    # What the coefficients leave within their tolerances, rms over all axes, measurement unit
    left_rms: float
    unit: str  # Measurement unit


def screen(
    records: Sequence[Record],
    model: Model | None,
    baseline: Sequence[Record] = (),
    verdict: bool = True,
    configuration: Configuration = CONFIGURATION,
) -> Screening:
    """Screen records."""
    nominal, _, _, parts = with_clean(records, model, 0.0, configuration, baseline)
    energies, floors, relative, left, clear = [], [], [], [], verdict
    for problem, beside, sensor_side in parts:
        prepared = prepare(problem, beside, (), configuration)
        linearized = prepared.linearized
        gap = prepared.problem.rows(linearized.measured - linearized.simulate(np.zeros(linearized.count)))
        measured = prepared.problem.rows(linearized.measured)
        energies += list(np.mean(gap**2, axis=0))
        floors += list(np.asarray(prepared.problem.sigma) ** 2)
        relative += list(100.0 * np.sqrt(np.mean(gap**2, axis=0)) / np.maximum(np.ptp(measured, axis=0), 1e-300))
        first = fit(linearized)
        left += list(np.mean(prepared.problem.rows(first.residual) ** 2, axis=0))
        near = _energy(first.residual) <= CLEARLY * _no_gap_energy(prepared)
        clear = clear and near and _is_clear(prepared, beside, sensor_side, configuration)
    return Screening(
        clear,
        float(np.sqrt(np.mean(energies))),
        float(np.mean(relative)),
        float(np.sqrt(np.mean(floors))),
        float(np.sqrt(np.mean(left))),
        nominal.units["measurement"],
    )


def _energy(residual: Array) -> float:
    return float(residual @ residual) / len(residual)


def _no_gap_energy(prepared: Prepared) -> float:
    """Energy up to which nothing is named, in noise energies: beside baseline records that of the model discrepancy."""
    weighted = prepared.problem.weight != 1.0
    return max(prepared.floor**2, prepared.leaves if weighted else 0.0)


def _is_clear(prepared: Prepared, beside: Baseline | None, sensor_side: bool, configuration: Configuration) -> bool:
    """True where no search could find anything to name."""
    policy, linearized = configuration.policy, prepared.linearized
    none = FittedHypothesis(None, settled(linearized), 0.0)
    if _energy(none.solution.residual) > _no_gap_energy(prepared):
        return False  # an effect might take off enough to be named
    if 0.5 * float(none.solution.z @ none.solution.z) > policy.margin:
        return False  # an effect might relieve the coefficients
    if _coefficients_may_claim(linearized, none, configuration):
        return False
    found = Found(linearized, none, none, (), (), 1.0)
    zero = () if beside is None else companions(linearized, none, beside.usual_zero, 1.0)
    left = residual_evidence(prepared.problem, none, prepared.findings, prepared.checks, configuration, zero)

    def passes(null: float) -> bool:
        evidence = collect(found, null, prepared, configuration)
        evidence = evidence.with_residuals(dict.fromkeys(range(len(found.hypotheses)), left))
        return decide(evidence, policy).verdict is Verdict.NO_GAP

    # The null is asked for only where it matters, as of 1/f noise: it is the dearest part.
    return passes(0.0) or (
        passes(np.inf) and passes(threshold(linearized, prepared.members(sensor_side), configuration=configuration))
    )


def _coefficients_may_claim(linearized: Linearized, none: FittedHypothesis, configuration: Configuration) -> bool:
    """True where coefficients beyond their tolerances might explain more than the margin; beside a weight only their strain counts."""
    if linearized.problem.weight != 1.0:
        return False
    factor = configuration.search.inflation
    wide = settled(inflated(linearized, factor), none.solution.z / factor)
    return none.solution.misfit - wide.misfit > configuration.policy.margin
