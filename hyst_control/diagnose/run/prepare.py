# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""One axis before any effect is tried: its noise, its coefficients fitted alone, and what the record itself shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.configuration import Configuration, NoiseSettings
from hyst_control.diagnose.decide.policy import practical_floor
from hyst_control.diagnose.decide.record_findings import detected
from hyst_control.diagnose.evidence import Finding, RecordEvidence
from hyst_control.diagnose.model_error.baseline import Baseline
from hyst_control.diagnose.noise.white import noise_between_periods, noise_of
from hyst_control.diagnose.problem.coefficient_prior import pinned, reduced, scatter_of, within_own_error
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.record_checks.lines_in_clean import beyond_clean
from hyst_control.diagnose.record_checks.spectral_lines import in_time, lines
from hyst_control.diagnose.record_checks.summary import effect_found_by, lattice_of, record_evidence
from hyst_control.diagnose.search.candidate import Member
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.search.command_holds import command_holds
from hyst_control.diagnose.search.fit import Linearized, Solution, fit
from hyst_control.diagnose.validate.present_in_baseline import CleanRecords
from hyst_control.effects.effect import PLACES, RecordCheck
from hyst_control.identify.model_error.error_spectrum import ErrorSpectrum
from hyst_control.model_file import Model


def nominal_residuals(problem: Problem) -> Annotated[Array, "M A"]:
    """Subtract the simulation of the nominal model from the measurement."""
    return problem.rows(problem.measured() - problem.simulate(problem.model.chain.stages))


def stated_noise(model: Model) -> Annotated[Array, "A"]:
    """Noise that a model file states."""
    stated = np.atleast_1d(np.asarray(model.noise.get("sigma", 0.0), dtype=float))
    return np.broadcast_to(stated, (len(model.axes),)).copy()


def known_error(problem: Problem, stated: Annotated[Array, "A"]) -> Annotated[Array, "A"]:
    """Choose what a model is known to leave beside the whitened error: its stated noise, or its model discrepancy."""
    if problem.own_spectrum is not None:
        return np.zeros_like(stated)  # fits have it in their weights
    return stated if problem.own_error is None else np.maximum(stated, problem.own_error)


def white_noise(
    problem: Problem, residuals: Annotated[Array, "M A"], axis: int, settings: NoiseSettings, rests: bool = True
) -> float:
    """White noise of an axis in the residuals of all pieces, also by differences between periods where the commands repeat."""
    left = np.split(residuals[:, axis], problem.edges)
    commands = [piece.counted(piece.command) for piece in problem.pieces]
    if not rests:
        return noise_of(left, settings=settings)
    found = noise_of(left, [command[:, axis] for command in commands], settings)
    if not problem.is_carried:  # else the noise of the baseline record is in the residual, and nowhere in the record
        commands, left = [piece.command for piece in problem.pieces], [piece.measurement[:, axis] for piece in problem.pieces]
    elif any(piece.keep is not None and np.count_nonzero(np.diff(piece.keep)) > 2 for piece in problem.pieces):
        return found
    return min(found, noise_between_periods(left, commands, settings))


def with_noise(problem: Problem, residuals: Annotated[Array, "M A"], configuration: Configuration) -> Problem:
    """Estimate the noise from the upper end of the residuals' spectrum."""
    measured = np.concatenate([piece.readings for piece in problem.pieces])
    stated, sigma = stated_noise(problem.model), []
    for axis in range(residuals.shape[1]):
        lattice = lattice_of(measured[:, axis], configuration.checks)
        # On a quantized measurement, stretches at rest hide the noise.
        noise = white_noise(problem, residuals, axis, configuration.noise, rests=not lattice)
        # The rounding error counts as noise too, but it follows the signal: the upper spectrum shows little of it.
        rounded = float(np.hypot(lattice / np.sqrt(12.0), stated[axis])) if lattice else 0.0
        sigma.append(max(noise, configuration.noise.least * float(np.ptp(measured[:, axis])), rounded, 1e-12))
    return replace(problem, sigma=np.array(sigma))


@dataclass(frozen=True)
class Prepared:
    """Problem of an axis before any effect is tried."""

    problem: Problem  # With its noise, and without rows that hold no measurement of their own
    linearized: Linearized  # The problem with the columns of its coefficients
    without: tuple[str, ...]  # Effects that are not tried
    checks: frozenset[RecordCheck]  # Checks whose effect is in the catalogue
    record: tuple[RecordEvidence, ...]  # By axis
    findings: tuple[Finding, ...]  # Repeated samples and lattices
    # Finds the lines in the spectrum: by the effect that they suggest their frequencies, Hz. Only a search needs them
    suggested: Callable[[], Mapping[str, Sequence[float]]]
    holds: Callable[[], Sequence[tuple[int, int]]]  # Estimates holds of the command from the gap
    stated: Annotated[Array, "A"]  # Noise that the model states, rms, measurement unit
    floor: float  # Rms that an effect must take off to be worth naming, in units of the noise
    leaves: float  # Energy that the model itself says it leaves, in noise energies
    clean: CleanRecords | None  # Baseline records of other commands
    has_session: bool  # Whether the zero and the drift of a session are free in every hypothesis

    def members(self, sensor_side: bool) -> list[Member]:
        """List the effects to try."""
        members = catalogue(self.problem, self.suggested(), self.without, self.holds())
        return [
            one
            for one in members
            if not (sensor_side and PLACES.index(one.place) <= PLACES.index("mechanics"))
            and not (self.has_session and one.is_of_session)
        ]


def prepare(
    problem: Problem,
    baseline: Baseline | None,
    without: Sequence[str],
    configuration: Configuration,
    progress: Callable[[str], None] = lambda _: None,
) -> Prepared:
    """Fit the coefficients alone, check the record, and estimate its noise: all that comes before effects are tried."""
    thresholds = configuration.policy
    if baseline is not None:
        problem = with_noise(baseline.problem, nominal_residuals(baseline.problem), configuration)
    stated = stated_noise(problem.model)
    own = known_error(problem, stated)
    checks = frozenset(check for check in RecordCheck if is_used(check, without))
    progress("coefficients of the model")
    scatter = within_own_error(scatter_of(problem.model), problem)
    rows = None if baseline is None else clean_rows(baseline, problem)
    clean = None if rows is None else CleanRecords(rows)
    if clean is not None:
        scatter = pinned(scatter, clean.columns)
        problem = replace(problem, independent=clean.independent)
    elif isinstance(problem.own_spectrum, ErrorSpectrum) and not problem.is_carried:
        problem = replace(problem, independent=configuration.baseline.stated_independent)
    linearized = Linearized(problem, scatter)
    if (fewer := reduced(scatter, linearized.columns)) is not scatter:
        scatter = fewer
        linearized = Linearized(problem, scatter)
    none = fit(linearized)
    record: Sequence[RecordEvidence] = record_evidence(
        problem, problem.rows(none.residual), configuration.checks, configuration.noise
    )
    if baseline is not None and baseline.clean is not None:
        record = _beside_usual(record, baseline.clean, configuration)
    elif steps := problem.model.discrepancy.get("step"):
        record = [replace(seen, usual_step=float(step)) for seen, step in zip(record, steps, strict=True)]
    findings = detected(record, checks, thresholds)
    suggested = partial(_suggested, problem, linearized, none, baseline, configuration)
    holds = partial(command_holds, linearized)
    # The first noise estimate still contained spectral leakage from the gap.
    problem = replace(with_noise(problem, problem.rows(none.residual), configuration), steps=_steps(problem, findings))
    repeated = [finding.axis for finding in findings if finding.check is RecordCheck.REPEATED_VALUES]
    problem = _without_repeats(problem, repeated, configuration.record.min_rows)
    linearized = Linearized(problem, scatter)
    problem = without_truncation(linearized, findings, configuration)
    linearized = linearized if problem is linearized.problem else Linearized(problem, scatter)
    if repeated:
        problem = with_noise(problem, problem.rows(fit(linearized).residual), configuration)
        linearized = Linearized(problem, scatter)
    floor = _floor(problem, own, configuration)
    if baseline is not None:
        least = float(np.sqrt(np.mean((baseline.floor / problem.sigma) ** 2)))
        floor = max(floor, least if problem.own_spectrum is None else configuration.baseline.same_floor)
    leaves = max(float(np.mean((own / problem.sigma) ** 2)), 1.0 + problem.own_energy)
    return Prepared(
        problem,
        linearized,
        tuple(without),
        checks,
        tuple(record),
        tuple(findings),
        suggested,
        holds,
        stated,
        floor,
        leaves,
        clean,
        baseline is not None,
    )


def clean_rows(baseline: Baseline, problem: Problem) -> Problem | None:
    """The baseline records' rows on which the model discrepancy was measured, with its spectrum."""
    if baseline.error_rows is None or not isinstance(problem.own_spectrum, ErrorSpectrum):
        return None
    return replace(baseline.error_rows, own_spectrum=problem.own_spectrum, sigma=problem.own_spectrum.noise)


def _steps(problem: Problem, findings: Sequence[Finding]) -> tuple[float, ...]:
    """Steps of the value grids that were found, by axis, measurement unit; 0 where there is none."""
    found = {one.axis: one.value for one in findings if one.check is RecordCheck.VALUE_LATTICE}
    return tuple(found.get(axis, 0.0) for axis in range(len(problem.model.axes)))


def _suggested(
    problem: Problem, linearized: Linearized, none: Solution, baseline: Baseline | None, configuration: Configuration
) -> dict[str, list[float]]:
    """Lines in the spectrum of what the coefficients leave, beyond those of the baseline records."""
    found = lines(problem, linearized.unexplained(none.residual), configuration.checks)
    if baseline is None or baseline.clean is None:
        return found
    clean, new = (
        [in_time(piece, part) for piece, part in zip(of.pieces, np.split(rows, of.edges), strict=True)]
        for of, rows in ((baseline.clean, nominal_residuals(baseline.clean)), (problem, problem.rows(none.residual)))
    )
    return beyond_clean(found, np.concatenate(new), clean, problem.sample_time, configuration.checks)


def _beside_usual(record: Sequence[RecordEvidence], clean: Problem, configuration: Configuration) -> tuple[RecordEvidence, ...]:
    """The evidence on a record with what the baseline records show of the same, which is normal."""
    usual = record_evidence(clean, nominal_residuals(clean), configuration.checks, configuration.noise)
    return tuple(
        replace(
            new,
            # Repeats that are few enough for chance are normal as well.
            usual_repeated=old.repeated
            if old.step
            else max(float(np.mean(np.diff(piece.counted(piece.readings)[:, axis]) == 0.0)) for piece in clean.pieces),
            usual_step=old.step,
            usual_roughness=0.0 if old.roughness is None else old.roughness.rms,
            usual_stuck=old.stuck,
        )
        for axis, (new, old) in enumerate(zip(record, usual, strict=True))
    )


def is_used(check: RecordCheck, without: Sequence[str]) -> bool:
    """Tell whether the effect that a check finds is in the catalogue."""
    effect = effect_found_by(check)
    return effect is not None and effect.name not in without


def _floor(problem: Problem, stated: Array, configuration: Configuration) -> float:
    """Least rms that matters in practice, in units of the noise."""
    measured = np.concatenate([piece.readings for piece in problem.pieces])
    steps = np.array([lattice_of(column, configuration.checks) for column in measured.T])
    # Whitened vectors are measured by own error and noise together.
    unit = problem.sigma if problem.own_spectrum is None else problem.own_spectrum.rms(problem.sigma)
    return practical_floor(np.ptp(measured, axis=0), steps, stated, unit, configuration.policy)


def without_truncation(linearized: Linearized, findings: Sequence[Finding], configuration: Configuration) -> Problem:
    """Take back the half step by which a converter rounded down or up.

    Only where the constant that fits best beside the coefficients is that half step: any other one is an offset.
    """
    problem = linearized.problem
    shift = np.zeros(len(problem.model.axes))
    gap = linearized.unexplained(linearized.measured - linearized.nominal)
    for finding in findings:
        if finding.check is RecordCheck.VALUE_LATTICE:
            constant = np.zeros((len(gap) // len(shift), len(shift)))
            constant[:, finding.axis] = 1.0 / problem.sigma[finding.axis]
            column = problem.whitened(constant.reshape(-1))
            steps = float(column @ gap / (column @ linearized.unexplained(column))) / finding.value
            if abs(abs(steps) - 0.5) < configuration.checks.truncation:
                shift[finding.axis] = -0.5 * np.sign(steps) * finding.value
    if not shift.any():
        return problem
    return replace(problem, pieces=tuple(replace(piece, measurement=piece.measurement + shift) for piece in problem.pieces))


def _without_repeats(problem: Problem, axes: Sequence[int], min_rows: int) -> Problem:
    """The same problem without rows that repeat the row before on one of these axes, but where too few would be left."""
    if not axes:
        return problem
    pieces = []
    for piece in problem.pieces:
        same = np.zeros(len(piece.command), bool)
        same[1:] = (np.diff(piece.measurement[:, axes], axis=0) == 0.0).any(axis=1)
        keep = piece.mask & ~same
        pieces.append(replace(piece, keep=keep) if np.count_nonzero(keep) >= min_rows else piece)
    return replace(problem, pieces=tuple(pieces))
