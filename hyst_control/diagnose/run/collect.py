# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Collection of the evidence from fits and records; measures, and decides nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from scipy.fft import dct

from hyst_control.base.arrays import Array
from hyst_control.diagnose.configuration import Configuration
from hyst_control.diagnose.evidence import (
    CompanionEvidence,
    Evidence,
    Finding,
    FlickerEvidence,
    HumpEvidence,
    HypothesisEvidence,
    ResidualEvidence,
)
from hyst_control.diagnose.noise.flicker import flicker
from hyst_control.diagnose.noise.narrowband import random_vibration
from hyst_control.diagnose.problem.per_record_stages import SessionZero
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.record_checks.summary import outliers
from hyst_control.diagnose.run.prepare import Prepared, known_error, white_noise
from hyst_control.diagnose.search.beam_search import FittedHypothesis, Found, strain, weighed
from hyst_control.diagnose.search.fit import Linearized
from hyst_control.diagnose.validate.predictability import predictable_share
from hyst_control.diagnose.validate.unexplained_residual import leftover
from hyst_control.effects import EFFECTS, ending_as, shares_elsewhere
from hyst_control.effects.effect import RecordCheck
from hyst_control.identify.model_error.error_spectrum import ErrorSpectrum

NORMAL_KURTOSIS = 3.0  # Mean fourth power of a normal variable over the square of its mean square


def collect(found: Found, null: float, prepared: Prepared, configuration: Configuration) -> Evidence:
    """Collect the evidence of a search, without residuals."""
    problem = found.linearized.problem
    rows = len(found.linearized.measured) // len(problem.model.axes)
    lower, upper = configuration.noise.band
    return Evidence(
        tuple(_hypothesis(found, scored, configuration.policy.many_tolerances) for scored in found.hypotheses),
        found.temper,
        found.linearized.count,
        null,
        prepared.floor,
        prepared.leaves,
        tuple(float(value) for value in problem.sigma),
        tuple(float(value) for value in prepared.stated),
        rows,
        0.5 * (upper - lower) * rows,
        prepared.record,
        prepared.checks,
        problem.weight,
        problem.beside_error and problem.own_error is None,
        problem.own_spectrum is not None,
        frozenset(name for name, effect in EFFECTS.items() if effect.repeats_values),
        frozenset(name for name, effect in EFFECTS.items() if effect.line is not None),
        problem.is_carried,
        ending_as(),
        shares_elsewhere(),
        _moved(found, prepared.stated),
        float(np.mean((found.linearized.measured - found.linearized.nominal) ** 2)),
    )


def _moved(found: Found, stated: Annotated[Array, "A"]) -> float:
    """Rms by which the coefficients of "no effect" move the simulation, beyond the model discrepancy, as a share of the range."""
    problem = found.linearized.problem
    z = found.none.solution.z
    # A change of the mean that the sensor offset compensates is no change of the simulation.
    own = z - _session_part(found.linearized) @ z
    rows = problem.rows(found.linearized.columns @ own)
    known = known_error(problem, stated) if problem.own_spectrum is None else problem.own_spectrum.rms(problem.sigma)
    span = np.ptp(np.concatenate([piece.measurement for piece in problem.pieces]), axis=0)
    energy = np.mean(rows**2, axis=0) - known**2
    return float(np.sqrt(np.max(np.maximum(energy, 0.0) / span**2)))


def _session_part(linearized: Linearized) -> Annotated[Array, "K K"]:
    """Project all coefficients onto the session effects: a matrix, whose rows of other coefficients are 0."""
    of_session, columns = linearized.scatter.companions > 0.0, linearized.columns
    found = np.zeros((columns.shape[1], columns.shape[1]))
    found[of_session] = np.linalg.lstsq(columns[:, of_session], columns, rcond=None)[0]
    return found


def residual_evidence(
    problem: Problem,
    scored: FittedHypothesis,
    findings: Sequence[Finding],
    checks: frozenset[RecordCheck],
    configuration: Configuration,
    beside: tuple[CompanionEvidence, ...],
) -> ResidualEvidence:
    """Measure what a hypothesis leaves."""
    steps = np.zeros(len(problem.model.axes))
    for finding in findings:
        if finding.check is RecordCheck.VALUE_LATTICE:
            steps[finding.axis] = finding.value
    rows = problem.rows(scored.solution.residual)
    counted = [outliers(rows[:, axis], configuration.checks, steps[axis]) for axis in range(len(problem.model.axes))]
    # A spectrum is looked at of one axis, and where no rows are missing in between.
    seen = checks if len(problem.model.axes) == 1 and not any(map(_has_holes, problem.pieces)) else frozenset[RecordCheck]()
    return ResidualEvidence(
        float(np.mean(leftover(problem, scored, steps) ** 2)),
        tuple(
            # What is left has all of its white noise in it: the upper spectrum of a short record says more by chance.
            min(white_noise(problem, rows, axis, configuration.noise), float(np.sqrt(np.mean(rows[:, axis] ** 2))))
            for axis in range(len(problem.model.axes))
        ),
        tuple(count for count, _ in counted),
        tuple(rms for _, rms in counted),
        _flicker(problem, scored, configuration) if RecordCheck.FALLING_SPECTRUM in seen else None,
        _predictable(problem, rows, configuration.baseline.blocks) if problem.beside_error else 1.0,
        beside,
        _hump(problem, scored, configuration) if RecordCheck.SPECTRAL_HUMP in seen else None,
    )


def companions(
    linearized: Linearized, scored: FittedHypothesis, usual: Annotated[Array, "A 3"], temper: float
) -> tuple[CompanionEvidence, ...]:
    """Sensor offset and drift under a hypothesis, including the part that its coefficients contribute."""
    count = len(scored.solution.z)
    along = _session_part(linearized)[:, :count]
    values = along @ scored.solution.z
    variances = np.diag(along @ scored.solution.covariance[:count, :count] @ along.T) / temper
    effects = {effect.companion.degree: effect for effect in EFFECTS.values() if effect.companion is not None}
    found = []
    for coefficient, z, variance in zip(linearized.scatter.coefficients, values, variances, strict=False):
        if coefficient.field != SessionZero.FIELD or coefficient.index[-1] not in effects:
            continue
        _, axis, degree = coefficient.index
        companion = effects[degree].companion
        assert companion is not None
        size = linearized.scatter.size(coefficient)
        departure = size * float(z)
        found.append(
            CompanionEvidence(
                effects[degree].name,
                companion.parameter,
                axis,
                companion.factor * departure,
                abs(companion.factor) * size * float(np.sqrt(variance)),
                abs(companion.factor) * float(usual[axis, degree]),
                abs(departure) / float(np.sqrt(2.0 * degree + 1.0)),
            )
        )
    return tuple(found)


def _predictable(problem: Problem, rows: Array, blocks: int) -> float:
    """Share of the remainder (M, A) that follows the command."""
    commands = [piece.counted(piece.command) for piece in problem.pieces]
    return predictable_share(commands, np.split(rows, problem.edges), blocks)


def _hypothesis(found: Found, scored: FittedHypothesis, believed: float) -> HypothesisEvidence:
    solution, problem = scored.solution, found.linearized.problem
    size = len(solution.residual)
    energy = float(solution.residual @ solution.residual) / size
    farthest = float(np.max(np.abs(solution.z), initial=0.0)) * scored.tolerances
    taken_up = float("inf")
    if not scored.inflated:
        columns, scatter = found.linearized.columns, found.linearized.scatter
        far = np.where(scatter.companions > 0.0, 0.0, solution.z) * max(1.0 - believed / max(farthest, 1e-300), 0.0)
        taken_up = float(np.mean((solution.residual + columns @ far) ** 2)) - energy
    return HypothesisEvidence(
        scored.names,
        scored.inflated,
        scored.score,
        weighed(problem, scored),
        energy,
        strain(solution),
        farthest=farthest,
        at_bound=scored.candidate is not None and scored.candidate.is_at_bound(solution.x),
        taken_up=taken_up,
        reduction=_reduction(problem, found.none.solution.residual, solution.residual),
        axes=() if scored.candidate is None or len(problem.model.axes) == 1 else tuple(m.axis for m in scored.candidate.members),
    )


def _reduction(problem: Problem, before: Annotated[Array, "M"], after: Annotated[Array, "M"]) -> float | None:
    """Mean reduction of the energy per bin: of all bins, or if that is more of those that a hypothesis changes; None without a spectrum.

    A slow effect changes few bins, and in the mean of all of them it would be too small to matter. It counts as no more than the mean
    square of its change.
    """
    if not isinstance(problem.own_spectrum, ErrorSpectrum) or not np.any(change := before - after):
        return None
    bins = np.concatenate([dct(rows, norm="ortho", axis=0).reshape(-1) for rows in problem.by_piece(change)]) ** 2
    narrower = len(bins) * float(np.mean(bins**2) / np.sum(bins) ** 2) * len(bins) / NORMAL_KURTOSIS
    unit = problem.own_spectrum.rms(problem.sigma)
    size, everywhere = float(np.mean((problem.rows(change) / unit) ** 2)), float(np.mean(before**2) - np.mean(after**2))
    return max(everywhere, min(narrower * everywhere, size))


def _has_holes(piece: Piece) -> bool:
    """True where the rows that count are not one stretch: a warm-up is none that is missed."""
    return int(np.count_nonzero(np.diff(np.pad(piece.mask, 1).astype(int)))) > 2


def _flicker(problem: Problem, scored: FittedHypothesis, configuration: Configuration) -> FlickerEvidence | None:
    """1/f noise in what a hypothesis leaves, if anything."""
    if not np.any(scored.solution.residual):
        return None
    command = np.concatenate([piece.counted(piece.command)[:, 0] for piece in problem.pieces])
    seen = flicker(problem.in_noise(scored.solution.residual), command, configuration.flicker)
    if problem.own_spectrum is not None:  # the own error may fall with frequency too
        return seen if float(np.mean(scored.solution.residual**2)) > 1.0 else None
    return replace(seen, gain=problem.weight * seen.gain)


def _hump(problem: Problem, scored: FittedHypothesis, configuration: Configuration) -> HumpEvidence | None:
    """A vibration whose phase wanders in what a hypothesis leaves."""
    driving = np.concatenate([piece.driving for piece in problem.pieces])
    measured = np.concatenate([piece.counted(piece.measurement)[:, 0] for piece in problem.pieces])
    residual, in_noise = scored.solution.residual, problem.in_noise(scored.solution.residual)
    simulated = measured - in_noise * float(problem.sigma[0])
    seen = random_vibration(residual, in_noise, driving, simulated, problem.sample_time, configuration.hump)
    return None if seen is None else replace(seen, gain=problem.weight * seen.gain, misfit=problem.weight * seen.misfit)
