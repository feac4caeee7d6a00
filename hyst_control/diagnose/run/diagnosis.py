# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of records against a model: the gap between measurement and simulation, and the effects that explain it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.parallel import forked
from hyst_control.diagnose.configuration import CONFIGURATION, Configuration
from hyst_control.diagnose.decide.record_findings import not_received
from hyst_control.diagnose.evidence import Evidence, RoughnessEvidence
from hyst_control.diagnose.model_error.baseline import Baseline, no_model, with_baseline, with_discrepancy
from hyst_control.diagnose.model_error.between_periods import by_periods, gain_over_time
from hyst_control.diagnose.model_error.same_command import as_clean_command
from hyst_control.diagnose.model_error.unknown_initial_motion import beside_clean, with_initial_motion, without_first_rows
from hyst_control.diagnose.problem.coefficient_prior import idle_tolerances
from hyst_control.diagnose.problem.problem import Piece, Problem, check_unit, split
from hyst_control.diagnose.record_checks.command_roughness import as_recorded, roughness_evidence, with_commands
from hyst_control.diagnose.record_checks.spectral_lines import lines
from hyst_control.diagnose.record_checks.summary import effect_found_by
from hyst_control.diagnose.run.collect import collect
from hyst_control.diagnose.run.prepare import is_used, nominal_residuals, prepare, with_noise
from hyst_control.diagnose.run.settle import ContenderTests, settled
from hyst_control.diagnose.search.beam_search import FittedHypothesis, Found, search
from hyst_control.diagnose.search.fit import Linearized
from hyst_control.diagnose.search.null_distribution import threshold
from hyst_control.diagnose.verdict import Decision, Verdict
from hyst_control.effects import EFFECTS
from hyst_control.effects.effect import RecordCheck
from hyst_control.effects.gain_drift import EFFECT as GAIN_DRIFT
from hyst_control.model_file import Model
from hyst_control.records.record import Record

OUTSIDE = 5e-4  # Share of a command outside the model's range from which a note says it
RULES, LIKELIHOOD, BY_REGIME = "rules", "likelihood", "by_regime"  # Cores that weigh hypotheses; the better one of each regime


@dataclass(frozen=True)
class AxisDiagnosis:
    """Diagnosis of one problem: an axis, or all axes of a model that mixes them."""

    axes: tuple[int, ...]  # Indices in the model
    problem: Problem  # Records and model of these axes
    linearized: Linearized  # The problem with the columns of its coefficients
    found: Found  # Result of the search, with the fits of all hypotheses
    evidence: Evidence  # Numbers that the decision is based on
    decision: Decision  # Verdict, its reasons, and the effects that are named
    baseline: Baseline | None = None  # Baseline records or stated discrepancy that were used
    tests: ContenderTests | None = None  # What contenders leave; None by likelihood
    structure: Mapping[str, float] = field(default_factory=dict)  # Of an unknown gap, by the likelihood core: see `structure`

    @property
    def hypotheses(self) -> tuple[FittedHypothesis, ...]:
        """Hypotheses in the order of the evidence."""
        return self.found.hypotheses

    @property
    def chosen(self) -> FittedHypothesis:
        """The best explanation."""
        return self.hypotheses[self.decision.chosen]

    @property
    def listed(self) -> tuple[FittedHypothesis, ...]:
        """Explanations that the data cannot distinguish from the best one, best first, including it."""
        return tuple(self.hypotheses[index] for index in self.decision.listed)

    @property
    def coefficients(self) -> Array:
        """Deviations (K,) of the best explanation's coefficients from the nominal ones, in tolerances."""
        return self.chosen.solution.z * self.chosen.tolerances

    def gap(self) -> Annotated[Array, "M A"]:
        """Compute the gap of the nominal model."""
        recorded = as_recorded(self.problem)
        if recorded is not self.problem:
            return recorded.rows(recorded.measured() - recorded.simulate(recorded.model.chain.stages))
        return self.problem.rows(self.linearized.measured - self.linearized.simulate(np.zeros(self.linearized.count)))


@dataclass(frozen=True)
class Diagnosis:
    """Diagnosis of all axes together."""

    model: Model  # Nominal model
    problem: Problem  # Problem of all axes
    parts: tuple[AxisDiagnosis, ...]  # One per axis, or a single one if the model mixes the axes
    notes: tuple[str, ...]  # Remarks on the records, one sentence each
    seed: int  # Seed of all random numbers
    configuration: Configuration = CONFIGURATION  # Settings of the diagnosis


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
    core: str = BY_REGIME,
) -> Diagnosis:
    """Diagnose records against a model."""
    # core: which of the two cores weighs the hypotheses; by regime: the likelihood beside baseline records of other commands
    # model: nominal model; None: a baseline record of the same command is the prediction, and only effects behind the mechanics are
    # tried
    model, problem, notes, beside = with_clean(records, model, warm_up, configuration, baseline, without)
    parts: list[AxisDiagnosis] = []
    for part, known, bare in beside:
        begin = sum(len(one.axes) for one in parts)
        axes = tuple(range(begin, begin + len(part.model.axes)))
        # Only one effect by itself would be taken from a second look.
        singles = replace(configuration, search=replace(configuration.search, depth_with_own_error=1))
        again = partial(_axis, sensor_side=bare, axes=axes, seed=seed, cache=cache, progress=progress, configuration=singles)
        if core == LIKELIHOOD or (core == BY_REGIME and known is not None and known.is_of_other_commands):
            first = _by_likelihood(part, known, bare, axes, without, progress, configuration)
            if core == BY_REGIME and first.decision.verdict is Verdict.NO_GAP:  # an octave has too many bins to show one line
                second = again(part, known, without=sorted((set(EFFECTS) - _line_effects()) | set(without)))
                first = second if _is_one_of(second, _line_effects()) else first
            parts.append(first)
            continue
        first = _axis(part, known, bare, axes, seed, without, cache, progress, configuration)
        if _may_hide_a_line(first, configuration):
            by_spectrum = with_discrepancy(part, configuration.baseline, by_spectrum=True)
            # A diagnosis of lines alone is quick, and where it is not sure of one, that of all effects is not either.
            for others in (set(EFFECTS) - _line_effects(), set[str]()):
                second = again(part, by_spectrum, without=sorted(others | set(without)))
                if not _is_one_of(second, _line_effects()):
                    break
            else:
                first = second
        elif _states_spectrum(first) and _is_one_of(first, _session_effects()):
            # The stated correlation is that of the error's fastest part, which hardly allows slow errors.
            by_spectrum = with_discrepancy(part, configuration.baseline, by_spectrum=True)
            second = again(part, by_spectrum, without=sorted((set(EFFECTS) - _session_effects()) | set(without)))
            if second.decision.verdict in (Verdict.NO_GAP, Verdict.EFFECT) and not second.chosen.names:
                first = second
        parts.append(_between_periods(first, without, singles, again))
    notes += [note for part in parts for note in _outlier_notes(part)]
    problem = replace(problem, beside_error=parts[0].problem.beside_error)
    return Diagnosis(model, problem, tuple(parts), tuple(notes), seed, configuration)


def with_clean(
    records: Sequence[Record],
    model: Model | None,
    warm_up: float,
    configuration: Configuration,
    baseline: Sequence[Record],
    without: Sequence[str] = (),
) -> tuple[Model, Problem, list[str], list[tuple[Problem, Baseline | None, bool]]]:
    """Make the problems of records beside baseline ones."""
    bare = model is None
    if model is None:
        if not baseline:
            raise InputError("needs a model or a baseline, and has neither: give --model, --baseline or both")
        model = no_model(records[0])
    problem, notes = problem_of(records, model, warm_up, configuration)
    clean = split(_clean_problem(baseline, problem, warm_up, configuration)) if baseline else None
    parts = []
    looked_for = is_used(RecordCheck.COMMAND_LATTICE, without) and not bare
    if looked_for and clean is not None:
        clean = [_without_roughness(part, configuration) for part in clean]
    for index, part in enumerate(split(problem)):
        if looked_for:
            part = _without_roughness(part, configuration)
            if clean is not None:
                part = as_clean_command(part, clean[index], configuration.baseline)
        known = part
        if clean is None:
            part = with_initial_motion(without_first_rows(part))
        else:
            part, clean[index] = beside_clean(part, clean[index], configuration.baseline)
        if part is not known:
            notes.append(
                f"{', '.join(part.model.axes)}: a record does not begin at rest: its first rows are skipped, "
                "or the initial state of the dynamics is estimated"
            )
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
    """Make one problem from records, cut into gapless pieces, and estimate its noise."""
    min_rows = configuration.record.min_rows
    if not 0.0 <= warm_up < np.inf:
        raise InputError(f"warm-up: must be >= 0 s, got {warm_up!r}")
    pieces, notes, sample_times, holds = [], [], set(), set()
    for record in records:
        for signal in ("measurement", "command"):
            check_unit(model, record, signal)
        record.check_axes()
        stretches = (replace(record, start="settled") if record.start == "auto" else record).aligned(allow_gaps=True)
        used = [stretch for stretch in stretches if len(stretch) >= min_rows]
        if not used:
            raise InputError(f"{record.source}: no gapless stretch of {min_rows} samples: record longer, or mend the transport")
        if len(stretches) > 1:
            notes.append(f"{record.source}: ticks are missing between {len(stretches)} stretches; only the first starts settled")
        notes += record.notes
        for stretch in used:
            command, measurement = stretch.command, stretch.measurement
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
            if stretch.start != "settled":
                # The piece does not begin at rest: its first rows fill the hysteresis' memory and do not count.
                keep = np.arange(len(command)) >= len(command) // configuration.record.memory_part
            elif warm_up:
                keep = np.arange(len(command)) >= round(warm_up / record.sample_time)
                if np.count_nonzero(keep) < min_rows:
                    raise InputError(
                        f"{record.source}: {warm_up:g} s of warm-up leave {np.count_nonzero(keep)} samples, {min_rows} "
                        "are due: shorten the warm-up or record longer"
                    )
            pieces.append(Piece(command, measurement, keep))
        sample_times.add(record.sample_time)
        holds.add(record.hold if record.states_hold else model.hold)
    if len({float(f"{step:.6g}") for step in sample_times}) > 1:
        raise InputError(
            f"records have different sample times ({', '.join(f'{step:g} s' for step in sorted(sample_times))}): "
            "diagnose them one by one"
        )
    if len(holds) > 1:
        raise InputError("some records hold the command (zoh), others do not (foh): diagnose them one by one")
    problem = Problem(model, tuple(pieces), sample_times.pop(), holds.pop(), np.ones(len(model.axes)))
    if beyond := outside_valid(model, np.concatenate([piece.command for piece in problem.pieces])):
        notes.append(beyond)
    if not model.uncertainty and (idle := idle_tolerances(model)):
        notes.append(f"tolerance of {', '.join(idle)}: no parameter of the model's chain scatters by this name; see the model file")
    return with_noise(problem, nominal_residuals(problem), configuration), notes


def outside_valid(model: Model, command: Annotated[Array, "N A"]) -> str:
    """Phrase on the part of a command that lies outside the range that the model is valid for; empty where hardly any does."""
    valid = np.array(model.valid.get("command", (-np.inf, np.inf)), dtype=float).reshape(-1, 2)  # of all axes, or of each
    outside = float(np.mean((command < valid[:, 0] - 1e-9) | (command > valid[:, 1] + 1e-9)))
    ranges = ", ".join(f"{lower:g} … {upper:g}" for lower, upper in valid)
    return f"{outside:.1%} of the command lies outside the {ranges} V that the model is valid for" if outside >= OUTSIDE else ""


def _beside(problem: Problem, clean: Problem | None, configuration: Configuration) -> Baseline | None:
    """Baseline from baseline records, or else from the model file's discrepancy; None without either."""
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


def _by_likelihood(
    problem: Problem,
    baseline: Baseline | None,
    sensor_side: bool,
    axes: tuple[int, ...],
    without: Sequence[str],
    progress: Callable[[str], None],
    configuration: Configuration,
) -> AxisDiagnosis:
    from hyst_control.diagnose.likelihood.core import by_likelihood  # only here, it takes long to load

    found, evidence, decision, baseline, asked = by_likelihood(problem, baseline, sensor_side, without, progress, configuration)
    here = found.linearized
    return AxisDiagnosis(axes, here.problem, here, found, evidence, decision, baseline, structure=asked)


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
    problem, linearized = prepared.problem, prepared.linearized
    members = prepared.members(sensor_side)
    progress("records without a gap")
    null = threshold(linearized, members, seed, cache=cache, configuration=configuration)
    known = [linearized, problem, linearized.scatter, linearized.scatter.model, configuration, *EFFECTS.values(), *members]
    with forked(known):  # effects hold functions, which cannot be sent
        found = search(linearized, members, null + thresholds.margin, prepared.floor, prepared.leaves, progress, configuration)
        evidence = collect(found, null, prepared, configuration)
        tests = ContenderTests(prepared, found, baseline, configuration)
        evidence, decision = settled(evidence, tests, thresholds)
    return AxisDiagnosis(axes, problem, linearized, found, evidence, decision, baseline, tests)


def _may_hide_a_line(found: AxisDiagnosis, configuration: Configuration) -> bool:
    """True where a line stands out of what the model leaves, though it is no gap beside the stated error, which has no frequency."""
    if found.decision.verdict is not Verdict.NO_GAP or not _states_spectrum(found):
        return False
    left = found.linearized.unexplained(found.found.none.solution.residual)
    return any(lines(found.problem, left, configuration.checks).get(name) for name in _line_effects())


def _states_spectrum(found: AxisDiagnosis) -> bool:
    """True where the model's error is known from its file alone, with its spectrum."""
    baseline = found.baseline
    return baseline is not None and baseline.clean is None and "spectrum" in found.problem.model.discrepancy


def _between_periods(
    found: AxisDiagnosis, without: Sequence[str], configuration: Configuration, diagnosed: Callable[..., AxisDiagnosis]
) -> AxisDiagnosis:
    """The diagnosis, or that of what periods of the command differ by, where the stated error hides a gain that drifts."""
    baseline, evidence, drift = found.baseline, found.evidence, GAIN_DRIFT.name
    if found.decision.verdict is not Verdict.NO_GAP or baseline is None or baseline.clean is not None or drift in without:
        return found
    beside = by_periods(baseline, found.problem)
    least = evidence.null + configuration.policy.margin
    if beside is None or gain_over_time(beside, found.linearized, found.found.none.solution) < least:
        return found
    second = diagnosed(beside.problem, beside, without=sorted(set(EFFECTS) - {drift}))
    return second if _is_one_of(second, {drift}) else found


def _is_one_of(found: AxisDiagnosis, effects: Collection[str]) -> bool:
    """True where such effects are the sure explanation. Of lines alone a spectrum from other records tells enough."""
    names = found.chosen.names
    return found.decision.verdict is Verdict.EFFECT and bool(names) and set(names) <= set(effects)


def _session_effects() -> frozenset[str]:
    return frozenset(name for name, effect in EFFECTS.items() if effect.companion is not None)


def _line_effects() -> frozenset[str]:
    effects = (effect_found_by(RecordCheck.MAINS_LINE), effect_found_by(RecordCheck.SPECTRAL_LINE))
    return frozenset(effect.name for effect in effects if effect is not None)


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
    return with_noise(problem, nominal_residuals(problem), configuration)


def _outlier_notes(part: AxisDiagnosis) -> list[str]:
    model, rows = part.problem.model, part.evidence.rows
    return [
        f"{model.axes[axis]}: in {part.evidence.record[axis].stuck} stretches the measurement stays on one and the same value while the "
        "command moves: a dead band of the sensor, or the end of its range"
        for axis in part.decision.stands
    ] + [
        f"{model.axes[one.axis]}: {one.count} single samples ({one.count / rows:.2%}) stand out of the noise: outliers, "
        f"{one.rms:.3g} {model.units['measurement']} rms"
        for one in part.decision.outliers
    ]
