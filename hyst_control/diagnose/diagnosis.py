"""A whole diagnosis: records and a model in, what the gap is and what explains it out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hyst_control.chain.stage import Array
from hyst_control.diagnose.decision import Decision, Thresholds, decide, energy, thresholds
from hyst_control.diagnose.flicker_estimation import Flicker, flicker
from hyst_control.diagnose.hypothesis import catalogue
from hyst_control.diagnose.hypothesis_fit import Linearised, fit
from hyst_control.diagnose.hypothesis_search import Found, search
from hyst_control.diagnose.noise_floor import noise_of
from hyst_control.diagnose.null_distribution import threshold
from hyst_control.diagnose.parameter_uncertainty import scatter_of
from hyst_control.diagnose.problem import Piece, Problem, check_units, split
from hyst_control.diagnose.record_checks import (
    FEW_OUTLIERS,
    MANY_OUTLIERS,
    Finding,
    excess_noise,
    findings,
    lattice_of,
    lines,
    outliers,
)
from hyst_control.errors import InputError
from hyst_control.model_file import Model
from hyst_control.records.record import Record

LEAST_ROWS = 200
HIDDEN = 0.3
"""Share of 1/f noise at the top of the spectrum beyond which it hides the white noise."""

OUTWEIGHS = 0.7
"""Share of excess noise (rms) from which outliers are what it is."""

LEAST_NOISE = 2e-5
"""Share of the range below which noise is not believed: numbers are rounded, and models discretised."""


@dataclass(frozen=True)
class AxisDiagnosis:
    """The diagnosis of one problem: an axis, or all axes of a model that mixes them.

    axes: indices in the model. floor: practical size (rms, in units of the noise). null: the simulated null's threshold (nats).
    notes: sentences on what was met that no effect of the catalogue is.
    """

    axes: tuple[int, ...]
    problem: Problem
    linearised: Linearised
    found: Found
    decision: Decision
    findings: tuple[Finding, ...]
    flicker: Flicker | None
    null: float
    floor: float
    notes: tuple[str, ...] = ()

    def gap(self) -> Array:
        """Measured minus simulated (M, A) by the model as it is given, in the measurement's unit."""
        return self.problem.rows(self.linearised.measured - self.linearised.simulate(np.zeros(self.linearised.count)))


@dataclass(frozen=True)
class Diagnosis:
    """All axes together, with the whole problem they were split from and sentences on the records."""

    model: Model
    problem: Problem
    parts: tuple[AxisDiagnosis, ...]
    notes: tuple[str, ...]
    seed: int


def diagnose(
    records: Sequence[Record],
    model: Model,
    seed: int = 0,
    without: Sequence[str] = (),
    cache: bool = True,
    limits: Thresholds | None = None,
    progress: Callable[[str], None] = lambda _: None,
    warm_up: float = 0.0,
) -> Diagnosis:
    """Diagnose records against a model.

    without: effects left out of the catalogue; cache: keep the null's threshold between runs; warm_up: as in `problem_of`.
    Raises `InputError` when the records cannot be used.
    """
    limits = limits or thresholds()
    problem, notes = problem_of(records, model, warm_up)
    parts = []
    axis = 0
    for part in split(problem):
        count = len(part.model.axes)
        parts.append(_axis(part, tuple(range(axis, axis + count)), seed, without, cache, limits, progress))
        axis += count
    notes += [note for part in parts for note in part.notes]
    return Diagnosis(model, problem, tuple(parts), tuple(notes), seed)


def problem_of(records: Sequence[Record], model: Model, warm_up: float = 0.0) -> tuple[Problem, list[str]]:
    """The records as pieces of one problem, and sentences on what was met in them.

    warm_up: s at the beginning of each record that bring the simulation into the plant's state and do not count, for records
    that do not begin at rest.
    """
    if not 0.0 <= warm_up < np.inf:
        raise InputError(f"warm-up: {warm_up!r} s, 0 or more is due")
    pieces, notes, sample_times, holds = [], [], set(), set()
    for record in records:
        check_units(model, record.signal("measurement").unit, record.source)
        stretches = record.aligned(("command", "measurement"), allow_gaps=True)
        used = [stretch for stretch in stretches if len(stretch.time) >= LEAST_ROWS]
        if not used:
            raise InputError(f"{record.source}: no gapless stretch of {LEAST_ROWS} samples: record longer, or mend the transport")
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
            keep = None
            if i or stretch is not stretches[0]:
                keep = np.arange(len(command)) >= len(command) // 3  # the memory of the hysteresis has to fill first
            elif warm_up:
                keep = np.arange(len(command)) >= round(warm_up / stretch.sample_time)
                if np.count_nonzero(keep) < LEAST_ROWS:
                    raise InputError(
                        f"{record.source}: {warm_up:g} s of warm-up leave {np.count_nonzero(keep)} samples, {LEAST_ROWS} "
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
    return _with_noise(problem, problem.rows(problem.measured() - problem.simulate(model.chain.stages))), notes


def _with_noise(problem: Problem, residuals: Array) -> Problem:
    """The same problem with the noise (A,) that the residuals' upper spectrum has."""
    measured = np.concatenate([piece.measurement for piece in problem.pieces])
    stated, sigma = stated_noise(problem.model), []
    for axis in range(residuals.shape[1]):
        lattice = lattice_of(measured[:, axis])
        noise = _white(problem, residuals, axis, rests=not lattice)  # at rest a lattice hides the noise
        # Rounding adds to the noise; it follows the signal, so that the upper spectrum shows little of it.
        rounded = float(np.hypot(lattice / np.sqrt(12.0), stated[axis])) if lattice else 0.0
        sigma.append(max(noise, LEAST_NOISE * float(np.ptp(measured[:, axis])), rounded, 1e-12))
    return replace(problem, sigma=np.array(sigma))


def _axis(
    problem: Problem,
    axes: tuple[int, ...],
    seed: int,
    without: Sequence[str],
    cache: bool,
    limits: Thresholds,
    progress: Callable[[str], None],
) -> AxisDiagnosis:
    model = problem.model
    stated = stated_noise(model)
    progress("coefficients of the model")
    scatter = scatter_of(model)
    linearised = Linearised(problem, scatter)
    none = fit(linearised)
    strange: list[str] = []
    looked = [finding for finding in findings(problem, problem.rows(none.residual)) if finding.name not in without]
    suggested = lines(problem, linearised.unexplained(none.residual))
    # The first estimate of the noise still had the gap's own leakage in it.
    problem = _with_noise(problem, problem.rows(none.residual))
    problem = _without_repeats(problem, looked)
    linearised = Linearised(problem, scatter)
    if any(finding.name == "held_samples" for finding in looked):
        problem = _with_noise(problem, problem.rows(fit(linearised).residual))
        linearised = Linearised(problem, scatter)
    members = catalogue(problem, suggested, without)
    progress("records without a gap")
    null = threshold(linearised, members, seed, cache=cache)
    floor = practical_floor(problem, stated, limits)
    leaves = max(float(np.mean((stated / problem.sigma) ** 2)), 1.0)
    lattice = np.zeros(len(axes))
    for finding in looked:
        if finding.name == "quantization":
            lattice[finding.axis] = finding.values["step"]
    found = search(linearised, members, null + limits.margin, floor, leaves, progress=progress)
    decision = decide(found, null, floor, limits, leaves, lattice)
    noise = _flicker(problem, found, decision, null + limits.margin, floor) if "flicker_noise" not in without else None
    if noise is not None and _outweighs(noise, found, decision):
        decision = replace(decide(replace(found, singles=(), combinations=()), null, floor, limits, leaves, lattice), remainder=0.0)
        if decision.verdict == "unknown":
            decision = replace(decision, verdict="no_gap")
    if "sensor_noise" not in without:
        left = problem.rows(decision.chosen.solution.residual)
        for axis in range(len(axes)):
            if noise is not None and noise.top > HIDDEN:
                continue
            white = noise.white if noise is not None else _white(problem, left, axis)
            # What falls with frequency levels off at the top, which looks white.
            more = excess_noise(white / 1.5 if noise is not None else white, float(stated[axis]), looked, axis, len(left))
            count, rms = outliers(left[:, axis])
            if more is not None and FEW_OUTLIERS <= count <= MANY_OUTLIERS * len(left) and rms > OUTWEIGHS * more.rms:
                strange.append(
                    f"{model.axes[axis]}: {count} single samples ({count / len(left):.2%}) stand out of the noise: outliers, "
                    f"{rms:.3g} {model.units['measurement']} rms"
                )
                decision = _left_unknown(decision, found, (rms / problem.sigma[axis]) ** 2 / len(axes), limits)
            elif more is not None:
                looked.append(more)
    return AxisDiagnosis(axes, problem, linearised, found, decision, tuple(looked), noise, null, floor, tuple(strange))


def _left_unknown(decision: Decision, found: Found, energy_left: float, limits: Thresholds) -> Decision:
    """The decision when so much energy (in units of the noise's) is known to be left that no effect of the catalogue is."""
    before = max(energy(found.none, len(found.linearised.measured)) - 1.0, 1e-12)
    remainder = float(np.clip(energy_left / before, decision.remainder, 1.0))
    return replace(decision, remainder=remainder, verdict="unknown" if remainder > limits.unknown else decision.verdict)


def stated_noise(model: Model) -> Array:
    """Rms (A,) of the noise that a model file states, 0 where it does not."""
    return np.broadcast_to(np.atleast_1d(np.asarray(model.noise.get("sigma", 0.0), dtype=float)), len(model.axes)).copy()


def practical_floor(problem: Problem, stated: Array, limits: Thresholds) -> float:
    """The rms (in units of the noise) that an effect must take off to be worth naming.

    A model's stated noise that exceeds the measured one says how far the model itself was off when it was identified. The
    rounding of a converter follows the signal: a share of it is no effect.
    """
    measured = np.concatenate([piece.measurement for piece in problem.pieces])
    size = limits.practical_floor * np.ptp(measured, axis=0) / problem.sigma
    excess = np.sqrt(np.maximum((stated / problem.sigma) ** 2 - 1.0, 0.0))
    rounding = np.array([lattice_of(column) for column in measured.T]) / np.sqrt(12.0) / problem.sigma
    return float(np.sqrt(np.mean(size**2 + (limits.discrepancy * excess) ** 2 + (limits.rounding * rounding) ** 2)))


def _without_repeats(problem: Problem, found: Sequence[Finding]) -> Problem:
    """Rows that only repeat the one before say nothing of the plant."""
    axes = [finding.axis for finding in found if finding.name == "held_samples"]
    if not axes:
        return problem
    pieces = []
    for piece in problem.pieces:
        same = np.zeros(len(piece.command), bool)
        same[1:] = (np.diff(piece.measurement[:, axes], axis=0) == 0.0).any(axis=1)
        pieces.append(replace(piece, keep=~same if piece.keep is None else piece.keep & ~same))
    return replace(problem, pieces=tuple(pieces))


def _white(problem: Problem, residuals: Array, axis: int, rests: bool = True) -> float:
    """Rms of an axis' noise from the residuals (rows, A) of all pieces; rests: whether stretches at rest count."""
    edges = np.cumsum([0, *(len(piece.counted(piece.measurement)) for piece in problem.pieces)])
    return noise_of(
        [residuals[a:b, axis] for a, b in zip(edges[:-1], edges[1:], strict=True)],
        [piece.counted(piece.command)[:, axis] for piece in problem.pieces] if rests else None,
    )


def _flicker(problem: Problem, found: Found, decision: Decision, threshold: float, floor: float) -> Flicker | None:
    """1/f noise in what the coefficients leave, if it explains more than the chosen effect, or in what that leaves; measurement unit."""
    if len(problem.model.axes) > 1 or any(piece.keep is not None for piece in problem.pieces):
        return None
    command = np.concatenate([piece.command[:, 0] for piece in problem.pieces])
    for solution in (found.none.solution, decision.chosen.solution):
        seen = flicker(solution.residual, command)
        if seen.plausible and seen.gain > threshold + 5.0 and seen.rms > max(floor, 0.1):
            if solution is found.none.solution and not _outweighs(seen, found, decision):
                continue
            scale = float(problem.sigma[0])
            return replace(seen, rms=seen.rms * scale, ci90=(seen.ci90[0] * scale, seen.ci90[1] * scale), white=seen.white * scale)
    return None


def _outweighs(noise: Flicker, found: Found, decision: Decision) -> bool:
    """Whether 1/f noise explains more than the chosen effect does."""
    best = found.temper * (found.none.solution.misfit - decision.chosen.solution.misfit)
    return decision.chosen.candidate is None or noise.gain > best
