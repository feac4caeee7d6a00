"""Diagnosis of records against a model: the gap between measurement and simulation, and the effects that explain it.

`problem_of` turns records into a problem, `diagnose` runs all steps on it: noise, record checks, threshold, search, evidence, decision.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hyst_control.chain.stage import Array
from hyst_control.diagnose.baseline import Baseline, as_clean_command, no_model, with_baseline, with_discrepancy
from hyst_control.diagnose.clean_lines import beyond_clean
from hyst_control.diagnose.command_roughness import as_recorded, roughness_evidence, with_commands
from hyst_control.diagnose.configuration import CONFIGURATION, Configuration
from hyst_control.diagnose.distortion import distortions
from hyst_control.diagnose.evidence import Evidence, Finding, RecordEvidence, RoughnessEvidence
from hyst_control.diagnose.evidence_collection import (
    collect,
    companions,
    known_error,
    residual_evidence,
    stated_energy,
    stated_noise,
    white_noise,
)
from hyst_control.diagnose.gap_reduction import holds
from hyst_control.diagnose.hypothesis import Member, catalogue
from hyst_control.diagnose.hypothesis_fit import Linearised, Solution, fit
from hyst_control.diagnose.hypothesis_search import Found, Scored, search
from hyst_control.diagnose.null_distribution import threshold
from hyst_control.diagnose.parameter_uncertainty import pinned, scatter_of, within_own_error
from hyst_control.diagnose.passed_error import passed_error
from hyst_control.diagnose.policy import Decision, contenders, decide, detected, not_received, practical_floor
from hyst_control.diagnose.problem import Piece, Problem, check_command, check_units, split
from hyst_control.diagnose.record_checks import effect_found_by, lattice_of, lines, record_evidence
from hyst_control.effects import EFFECTS
from hyst_control.effects.effect import PLACES, RecordCheck
from hyst_control.errors import InputError
from hyst_control.model_file import Model
from hyst_control.records.record import Record

VETOES = 3
"""Explanations in turn that are dropped because they leave more than no effect does on blocks that they were not fitted to."""


@dataclass(frozen=True)
class AxisDiagnosis:
    """Diagnosis of one problem: an axis, or all axes of a model that mixes them.

    Parameters
    ----------
    axes : tuple of int
        Indices in the model.
    problem : Problem
        Records and model of these axes.
    linearised : Linearised
        The problem with the columns of its coefficients.
    found : Found
        Result of the search, with the fits of all hypotheses.
    hypotheses : tuple of Scored
        Hypotheses in the order of the evidence.
    evidence : Evidence
        Numbers that the decision is based on.
    decision : Decision
        Verdict, its reasons, and the effects that are named.
    baseline : Baseline, optional
        Clean records or stated discrepancy that were used.

    """

    axes: tuple[int, ...]
    problem: Problem
    linearised: Linearised
    found: Found
    hypotheses: tuple[Scored, ...]
    evidence: Evidence
    decision: Decision
    baseline: Baseline | None = None

    @property
    def chosen(self) -> Scored:
        """The best explanation."""
        return self.hypotheses[self.decision.chosen]

    @property
    def listed(self) -> tuple[Scored, ...]:
        """Explanations that the data cannot distinguish from the best one, best first, including it."""
        return tuple(self.hypotheses[index] for index in self.decision.listed)

    @property
    def coefficients(self) -> Array:
        """Deviations (K,) of the best explanation's coefficients from the nominal ones, in tolerances."""
        return self.chosen.solution.z * self.chosen.tolerances

    def gap(self) -> Array:
        """Compute the gap of the nominal model.

        Returns
        -------
        ndarray, shape (M, A)
            Measured minus simulated from the command as it was recorded, measurement unit.

        """
        recorded = as_recorded(self.problem)
        if recorded is not self.problem:
            return recorded.rows(recorded.measured() - recorded.simulate(recorded.model.chain.stages))
        return self.problem.rows(self.linearised.measured - self.linearised.simulate(np.zeros(self.linearised.count)))


@dataclass(frozen=True)
class Diagnosis:
    """Diagnosis of all axes together.

    Parameters
    ----------
    model : Model
        Nominal model.
    problem : Problem
        Problem of all axes.
    parts : tuple of AxisDiagnosis
        One per axis, or a single one if the model mixes the axes.
    notes : tuple of str
        Remarks on the records, one sentence each.
    seed : int
        Seed of all random numbers.
    configuration : Configuration
        Settings of the diagnosis.

    """

    model: Model
    problem: Problem
    parts: tuple[AxisDiagnosis, ...]
    notes: tuple[str, ...]
    seed: int
    configuration: Configuration = CONFIGURATION


def diagnose(
    records: Sequence[Record],
    model: Model | None,
    seed: int = 0,
    without: Sequence[str] = (),
    cache: bool = True,
    progress: Callable[[str], None] = lambda _: None,
    warm_up: float = 0.0,
    configuration: Configuration = CONFIGURATION,
    baseline: Sequence[Record] = (),
) -> Diagnosis:
    """Diagnose records against a model.

    Parameters
    ----------
    records : sequence of Record
        Records with command and measurement.
    model : Model or None
        Nominal model; None: a clean record of the same command is the prediction, and only effects behind the mechanics are tried.
    seed : int
        Seed of all random numbers.
    without : sequence of str
        Names of effects that are not tried.
    cache : bool
        True to keep the threshold of the null distribution between runs.
    progress : callable
        Called with the name of each step.
    warm_up : float
        Beginning of each record that is simulated but not counted, s; see `problem_of`.
    configuration : Configuration
        Settings of the diagnosis.
    baseline : sequence of Record
        Clean records of the same plant, or of plants of the same type.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputError
        If the records cannot be used.

    """
    model, problem, notes, beside = with_clean(records, model, warm_up, configuration, baseline, without)
    parts = []
    axis = 0
    for part, known, bare in beside:
        axes = tuple(range(axis, axis + len(part.model.axes)))
        parts.append(_axis(part, known, bare, axes, seed, without, cache, progress, configuration))
        axis += len(axes)
    notes += [note for part in parts for note in _outlier_notes(part)]
    problem = replace(problem, slowest=parts[0].problem.slowest)
    return Diagnosis(model, problem, tuple(parts), tuple(notes), seed, configuration)


def with_clean(
    records: Sequence[Record],
    model: Model | None,
    warm_up: float,
    configuration: Configuration,
    baseline: Sequence[Record],
    without: Sequence[str] = (),
) -> tuple[Model, Problem, list[str], list[tuple[Problem, Baseline | None, bool]]]:
    """Make the problems of records beside clean ones.

    Parameters
    ----------
    records, model, warm_up, configuration, baseline, without
        As in `diagnose`.

    Returns
    -------
    model : Model
        Nominal model; one whose output is 0 where there is none.
    problem : Problem
        Of all axes.
    notes : list of str
        Remarks on the records.
    parts : list of tuple
        By axis, or a single one if the model mixes the axes: its problem, its baseline, and whether there is no model.

    Raises
    ------
    InputError
        If the records cannot be used.

    """
    bare = model is None
    if model is None:
        if not baseline:
            raise InputError("diagnose: needs a model or a baseline, and has neither: give --model, --baseline or both")
        model = no_model(records[0])
    problem, notes = problem_of(records, model, warm_up, configuration)
    clean = split(_clean_problem(baseline, problem, warm_up, configuration)) if baseline else None
    parts = []
    looked_for = _is_used(RecordCheck.COMMAND_LATTICE, without) and not bare
    if looked_for and clean is not None:
        clean = [_without_roughness(part, configuration) for part in clean]
    for index, part in enumerate(split(problem)):
        if looked_for:
            part = _without_roughness(part, configuration)
            if clean is not None:
                part = as_clean_command(part, clean[index], configuration.baseline)
        beside = _beside(part, clean[index] if clean else None, configuration)
        if bare and (beside is None or not beside.carried):
            raise InputError(
                "baseline: no clean record has the new record's command, which is needed where there is no model: give --model, or a "
                "clean record of the same command"
            )
        parts.append((part, beside, bare))
    return model, problem, notes, parts


def problem_of(
    records: Sequence[Record], model: Model, warm_up: float = 0.0, configuration: Configuration = CONFIGURATION
) -> tuple[Problem, list[str]]:
    """Make one problem from records, cut into gapless pieces, and estimate its noise.

    Parameters
    ----------
    records : sequence of Record
        Records with command and measurement.
    model : Model
        Nominal model.
    warm_up : float
        Beginning of each record that is simulated but not counted, s; needed for records that do not begin at rest.
    configuration : Configuration
        Settings of the diagnosis.

    Returns
    -------
    problem : Problem
        All pieces, with the noise of each axis.
    notes : list of str
        Remarks on the records, one sentence each.

    Raises
    ------
    InputError
        If the records cannot be used.

    """
    least_rows = configuration.record.least_rows
    if not 0.0 <= warm_up < np.inf:
        raise InputError(f"warm-up: must be >= 0 s, got {warm_up!r}")
    pieces, notes, sample_times, holds = [], [], set(), set()
    for record in records:
        check_units(model, record.signal("measurement").unit, record.source)
        check_command(record)
        stretches = record.aligned(("command", "measurement"), allow_gaps=True)
        used = [stretch for stretch in stretches if len(stretch.time) >= least_rows]
        if not used:
            raise InputError(f"{record.source}: no gapless stretch of {least_rows} samples: record longer, or mend the transport")
        if len(stretches) > 1:
            notes.append(f"{record.source}: ticks are missing between {len(stretches)} stretches; only the first starts settled")
        notes += record.notes
        for i, stretch in enumerate(used):
            command, measurement = stretch.values["command"], stretch.values["measurement"]
            if measurement.shape[1] != len(model.axes) or command.shape[1] != len(model.axes):
                raise InputError(
                    f"{record.source}: has {command.shape[1]} commands and {measurement.shape[1]} measurements, the model "
                    f"{len(model.axes)} axes ({', '.join(model.axes)}): give the model of this plant"
                )
            if not np.ptp(command):
                raise InputError(f"{record.source}: the command never moves: record with an excitation")
            dead = [axis for axis, span in zip(model.axes, np.ptp(measurement, axis=0), strict=True) if not span]
            if dead:
                raise InputError(f"{record.source}: the measurement of {', '.join(dead)} never moves: check sensor and import")
            keep = None
            if i or stretch is not stretches[0]:
                # The piece does not begin at rest: its first rows fill the hysteresis' memory and do not count.
                keep = np.arange(len(command)) >= len(command) // configuration.record.memory_part
            elif warm_up:
                keep = np.arange(len(command)) >= round(warm_up / stretch.sample_time)
                if np.count_nonzero(keep) < least_rows:
                    raise InputError(
                        f"{record.source}: {warm_up:g} s of warm-up leave {np.count_nonzero(keep)} samples, {least_rows} "
                        "are due: shorten the warm-up or record longer"
                    )
            pieces.append(Piece(command, measurement, keep))
            sample_times.add(stretch.sample_time)
        holds.add(model.hold if record.hold == "zoh" and model.hold == "foh" else record.hold)
    if len({float(f"{step:.6g}") for step in sample_times}) > 1:
        raise InputError(
            f"records have different sample times ({', '.join(f'{step:g} s' for step in sorted(sample_times))}): "
            "diagnose them one by one"
        )
    if len(holds) > 1:
        raise InputError("some records hold the command (zoh), others do not (foh): diagnose them one by one")
    problem = Problem(model, tuple(pieces), sample_times.pop(), holds.pop(), np.ones(len(model.axes)))
    valid = model.valid.get("command")
    if valid:
        commands = np.concatenate([piece.command for piece in pieces])
        outside = float(np.mean((commands < valid[0] - 1e-9) | (commands > valid[1] + 1e-9)))
        if outside > 0:
            notes.append(f"{outside:.1%} of the command lies outside the {valid[0]:g} … {valid[1]:g} V that the model is valid for")
    return _with_noise(problem, _residuals(problem), configuration), notes


def _residuals(problem: Problem) -> Array:
    """Measured minus simulated (M, A) of the nominal model, measurement unit."""
    return problem.rows(problem.measured() - problem.simulate(problem.model.chain.stages))


def _with_noise(problem: Problem, residuals: Array, configuration: Configuration) -> Problem:
    """The same problem with the noise (A,) estimated from the upper end of the residuals' spectrum."""
    measured = np.concatenate([piece.measurement for piece in problem.pieces])
    stated, sigma = stated_noise(problem.model), []
    for axis in range(residuals.shape[1]):
        lattice = lattice_of(measured[:, axis], configuration.checks)
        # On a quantized measurement, stretches at rest hide the noise.
        noise = white_noise(problem, residuals, axis, configuration.noise, rests=not lattice)
        # The rounding error counts as noise too, but it follows the signal: the upper spectrum shows little of it.
        rounded = float(np.hypot(lattice / np.sqrt(12.0), stated[axis])) if lattice else 0.0
        sigma.append(max(noise, configuration.noise.least * float(np.ptp(measured[:, axis])), rounded, 1e-12))
    return replace(problem, sigma=np.array(sigma))


def _beside(problem: Problem, clean: Problem | None, configuration: Configuration) -> Baseline | None:
    """Baseline from clean records, or else from the model file's discrepancy; None without either."""
    if clean is not None:
        return with_baseline(problem, clean, configuration.baseline)
    return with_discrepancy(problem, configuration.baseline) if problem.model.discrepancy else None


def _clean_problem(baseline: Sequence[Record], problem: Problem, warm_up: float, configuration: Configuration) -> Problem:
    clean, _ = problem_of(baseline, problem.model, warm_up, configuration)
    if abs(clean.sample_time - problem.sample_time) > 1e-6 * problem.sample_time:
        raise InputError(
            f"baseline: has a sample time of {clean.sample_time:g} s, the record {problem.sample_time:g} s: record both at one rate"
        )
    return clean


def _axis(
    problem: Problem,
    baseline: Baseline | None,
    sensor_side: bool,
    axes: tuple[int, ...],
    seed: int,
    without: Sequence[str],
    cache: bool,
    progress: Callable[[str], None],
    configuration: Configuration,
) -> AxisDiagnosis:
    thresholds = configuration.policy
    prepared = prepare(problem, baseline, without, configuration, progress)
    problem, linearised, checks, findings = prepared.problem, prepared.linearised, prepared.checks, prepared.findings
    floor = prepared.floor
    members = prepared.members(sensor_side)
    progress("records without a gap")
    null = threshold(linearised, members, seed, cache=cache, configuration=configuration)
    found = search(linearised, members, null + thresholds.margin, floor, prepared.leaves, progress, configuration)
    collected = collect(found, null, floor, prepared.stated, prepared.record, checks, configuration)

    def with_residuals(evidence: Evidence) -> Evidence:
        return evidence.with_residuals(
            {
                index: residual_evidence(
                    problem,
                    collected.hypotheses[index],
                    findings,
                    checks,
                    configuration,
                    companions(linearised, collected.hypotheses[index], baseline.usual_zero, baseline.mean_zero, found.temper)
                    if baseline
                    else (),
                    distortions(linearised, collected.hypotheses[index], found.temper),
                    passed_error(linearised, collected.hypotheses[index]),
                )
                for index in contenders(evidence, thresholds)
                if evidence.hypotheses[index].residual is None
            }
        )

    evidence = with_residuals(collected.evidence)
    decision = decide(evidence, thresholds)
    for _ in range(VETOES if evidence.whitened else 0):
        best = collected.hypotheses[decision.chosen]
        if best.candidate is None or holds(linearised, best, found.none, configuration.reduction):
            break
        evidence = with_residuals(evidence.without(decision.chosen))
        decision = decide(evidence, thresholds)
    return AxisDiagnosis(axes, problem, linearised, found, collected.hypotheses, evidence, decision, baseline)


@dataclass(frozen=True)
class Prepared:
    """Problem of an axis before any effect is tried.

    Parameters
    ----------
    problem : Problem
        With its noise, and without rows that hold no measurement of their own.
    linearised : Linearised
        The problem with the columns of its coefficients.
    without : tuple of str
        Effects that are not tried.
    checks : frozenset of RecordCheck
        Checks whose effect is in the catalogue.
    record : tuple of RecordEvidence
        By axis.
    findings : tuple of Finding
        Repeated samples and lattices.
    suggested : callable
        Finds the lines in the spectrum: by the effect that they suggest their frequencies, Hz. Only a search needs them.
    stated : ndarray, shape (A,)
        Noise that the model states, rms, measurement unit.
    floor : float
        Rms that an effect must take off to be worth naming, in units of the noise.
    leaves : float
        Energy that the model itself says it leaves, in noise energies.

    """

    problem: Problem
    linearised: Linearised
    without: tuple[str, ...]
    checks: frozenset[RecordCheck]
    record: tuple[RecordEvidence, ...]
    findings: tuple[Finding, ...]
    suggested: Callable[[], Mapping[str, Sequence[float]]]
    stated: Array
    floor: float
    leaves: float

    def members(self, sensor_side: bool) -> list[Member]:
        """List the effects to try.

        Parameters
        ----------
        sensor_side : bool
            True for those behind the mechanics only.

        Returns
        -------
        list of Member

        """
        members = catalogue(self.problem, self.suggested(), self.without)
        return [one for one in members if not sensor_side or PLACES.index(one.place) > PLACES.index("mechanics")]


def prepare(
    problem: Problem,
    baseline: Baseline | None,
    without: Sequence[str],
    configuration: Configuration,
    progress: Callable[[str], None] = lambda _: None,
) -> Prepared:
    """Fit the coefficients alone, check the record, and estimate its noise: all that comes before effects are tried.

    Parameters
    ----------
    problem : Problem
        Of an axis, or of all axes of a model that mixes them.
    baseline : Baseline or None
        Clean records or stated discrepancy.
    without : sequence of str
        Names of effects that are not tried.
    configuration : Configuration
        Settings of the diagnosis.
    progress : callable
        Called with the name of each step.

    Returns
    -------
    Prepared

    Raises
    ------
    InputError
        If the model cannot be simulated on the record.

    """
    thresholds = configuration.policy
    if baseline is not None:
        problem = _with_noise(baseline.problem, _residuals(baseline.problem), configuration)
        without = [*without, *(name for name, effect in EFFECTS.items() if effect.companion is not None)]
    stated = stated_noise(problem.model)
    own = known_error(problem, stated)
    checks = frozenset(check for check in RecordCheck if _is_used(check, without))
    progress("coefficients of the model")
    scatter = within_own_error(scatter_of(problem.model), problem)
    if baseline is not None and baseline.clean is not None and problem.own_spectrum is not None:
        scatter = pinned(scatter, replace(baseline.clean, own_spectrum=problem.own_spectrum, sigma=problem.own_spectrum.noise))
    linearised = Linearised(problem, scatter)
    none = fit(linearised)
    record = record_evidence(problem, problem.rows(none.residual), configuration.checks, configuration.noise)
    if baseline is not None and baseline.clean is not None:
        record = _beside_usual(record, baseline.clean, configuration)
    findings = detected(record, checks, thresholds)
    suggested = partial(_suggested, problem, linearised, none, baseline, configuration)
    # The first noise estimate still contained spectral leakage from the gap.
    problem = _with_noise(problem, problem.rows(none.residual), configuration)
    repeated = [finding.axis for finding in findings if finding.check is RecordCheck.REPEATED_VALUES]
    problem = _without_repeats(problem, repeated)
    linearised = Linearised(problem, scatter)
    problem = _without_truncation(linearised, findings, configuration)
    linearised = linearised if problem is linearised.problem else Linearised(problem, scatter)
    if repeated:
        problem = _with_noise(problem, problem.rows(fit(linearised).residual), configuration)
        linearised = Linearised(problem, scatter)
    floor = _floor(problem, own, configuration)
    if baseline is not None:
        least = float(np.sqrt(np.mean((baseline.floor / problem.sigma) ** 2)))
        floor = max(floor, least if problem.own_spectrum is None else configuration.baseline.same_floor)
    leaves = max(stated_energy(own, problem.sigma), 1.0 + problem.own_energy)
    return Prepared(problem, linearised, tuple(without), checks, tuple(record), tuple(findings), suggested, stated, floor, leaves)


def _suggested(
    problem: Problem, linearised: Linearised, none: Solution, baseline: Baseline | None, configuration: Configuration
) -> dict[str, list[float]]:
    """Lines in the spectrum of what the coefficients leave, beyond those of the clean records."""
    found = lines(problem, linearised.unexplained(none.residual), configuration.checks)
    if baseline is None or baseline.clean is None:
        return found
    clean_rows = np.split(_residuals(baseline.clean), np.cumsum(_counts(baseline.clean))[:-1])
    return beyond_clean(found, problem.rows(none.residual), clean_rows, problem.sample_time, configuration.checks)


def _counts(problem: Problem) -> list[int]:
    """Rows that count, by record."""
    return [len(piece.counted(piece.command)) for piece in problem.pieces]


def _beside_usual(record: Sequence[RecordEvidence], clean: Problem, configuration: Configuration) -> tuple[RecordEvidence, ...]:
    """The evidence on a record with what the clean records show of the same, which is normal."""
    usual = record_evidence(clean, _residuals(clean), configuration.checks, configuration.noise)
    return tuple(
        replace(
            new,
            # Repeats that are few enough for chance are normal as well.
            usual_repeated=old.repeated
            if old.step
            else max(_repeats(piece.counted(piece.measurement)[:, axis]) for piece in clean.pieces),
            usual_step=old.step,
            usual_roughness=0.0 if old.roughness is None else old.roughness.rms,
        )
        for axis, (new, old) in enumerate(zip(record, usual, strict=True))
    )


def _repeats(values: Array) -> float:
    """Share of samples (N,) that repeat the one before."""
    return float(np.mean(np.diff(values) == 0.0))


def _without_roughness(problem: Problem, configuration: Configuration) -> Problem:
    """The same problem with smooth commands where the plant did not receive the roughness of the recorded ones."""
    found: list[RoughnessEvidence | None] = []
    for axis in range(len(problem.model.axes)):
        seen, smooth = roughness_evidence(problem, axis)
        missing = seen is not None and not_received(seen, configuration.policy)
        if missing:
            problem = with_commands(problem, axis, smooth)
        found.append(seen if missing else None)
    if not any(found):
        return problem
    problem = replace(problem, roughness=tuple(found))
    return _with_noise(problem, _residuals(problem), configuration)


def _is_used(check: RecordCheck, without: Sequence[str]) -> bool:
    effect = effect_found_by(check)
    return effect is not None and effect.name not in without


def _outlier_notes(part: AxisDiagnosis) -> list[str]:
    model, rows = part.problem.model, part.evidence.rows
    return [
        f"{model.axes[one.axis]}: {one.count} single samples ({one.count / rows:.2%}) stand out of the noise: outliers, "
        f"{one.rms:.3g} {model.units['measurement']} rms"
        for one in part.decision.outliers
    ]


def _floor(problem: Problem, stated: Array, configuration: Configuration) -> float:
    """Least rms that matters in practice, in units of the noise."""
    measured = np.concatenate([piece.measurement for piece in problem.pieces])
    steps = np.array([lattice_of(column, configuration.checks) for column in measured.T])
    return practical_floor(np.ptp(measured, axis=0), steps, stated, problem.sigma, configuration.policy)


def _without_truncation(linearised: Linearised, findings: Sequence[Finding], configuration: Configuration) -> Problem:
    """The same problem, where a converter rounded down or up with the half step added that it took off or put on.

    Only where the constant that fits best beside the coefficients is that half step: any other one is an offset.
    """
    problem = linearised.problem
    shift = np.zeros(len(problem.model.axes))
    gap = linearised.unexplained(linearised.measured - linearised.nominal)
    for finding in findings:
        if finding.check is RecordCheck.VALUE_LATTICE:
            constant = np.zeros((len(gap) // len(shift), len(shift)))
            constant[:, finding.axis] = 1.0 / problem.sigma[finding.axis]
            column = problem.whitened(constant.reshape(-1))
            steps = float(column @ gap / (column @ linearised.unexplained(column))) / finding.value
            if abs(abs(steps) - 0.5) < configuration.checks.truncation:
                shift[finding.axis] = -0.5 * np.sign(steps) * finding.value
    if not shift.any():
        return problem
    return replace(problem, pieces=tuple(replace(piece, measurement=piece.measurement + shift) for piece in problem.pieces))


def _without_repeats(problem: Problem, axes: Sequence[int]) -> Problem:
    """The same problem without the rows that repeat the row before on one of these axes: they hold no new measurement."""
    if not axes:
        return problem
    pieces = []
    for piece in problem.pieces:
        same = np.zeros(len(piece.command), bool)
        same[1:] = (np.diff(piece.measurement[:, axes], axis=0) == 0.0).any(axis=1)
        pieces.append(replace(piece, keep=~same if piece.keep is None else piece.keep & ~same))
    return replace(problem, pieces=tuple(pieces))
