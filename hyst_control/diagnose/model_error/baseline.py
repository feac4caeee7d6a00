# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Baseline of a diagnosis: records of the healthy plant, on which a model's residual is its model discrepancy and not a gap.

If one has the same command as the new record, up to a time shift, the model's error on it is carried over sample by sample:

    predicted new record = E_out( y_clean + [ M_E(u_new) - M(u_clean) ] ) + zero(t)

E_out are the sensor's effects, which act on the plant's whole output; M is the model, and M_E the model with the effects of the
drive. Without a model, the baseline record alone is the prediction, and only effects behind the mechanics can be found. If no baseline
record has the same command, the error is predicted from features of the command, or its size and its correlation alone are known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Annotated, Any

import numpy as np

from hyst_control.base.arrays import Array, Mask
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain
from hyst_control.chain.memoryless import Gain
from hyst_control.diagnose.configuration import BaselineSettings
from hyst_control.diagnose.model_error.other_commands import (
    learned_mean,
    lowest_frequency,
    on_new_ground,
    own_error_spectrum,
    predicted_error,
    simulated_rows,
)
from hyst_control.diagnose.model_error.plant_response import lacking_response
from hyst_control.diagnose.model_error.same_command import Match, matching, period_differences, repeating_rows
from hyst_control.diagnose.model_error.unknown_initial_memory import has_whole_loop, initial_memory, is_new_ground, wiped_out
from hyst_control.diagnose.model_error.unknown_initial_motion import without_initial_motion
from hyst_control.diagnose.noise.denoised_error import white_noise, without_noise
from hyst_control.diagnose.noise.white import noise_between_periods
from hyst_control.diagnose.problem.per_record_stages import CarriedError, LackingResponse, SessionZero
from hyst_control.diagnose.problem.problem import Piece, Problem, check_unit
from hyst_control.identify.model_error.error_spectrum import ErrorSpectrum
from hyst_control.identify.model_error.learned_discrepancy import LearnedDiscrepancy, discrepancy_of, session_zeros
from hyst_control.identify.model_error.stated_spectrum import StatedSpectrum, spectrum_on_new_records
from hyst_control.model_file import Model, simulate
from hyst_control.records.correlation import correlation_length
from hyst_control.records.record import Record
from hyst_control.records.repeated_periods import is_same
from hyst_control.records.session_zero import SHAPES, usual_zero, without_zero


@dataclass(frozen=True)
class Baseline:
    """Baseline of one problem: its model extended by the model discrepancy, and the size of that error."""

    problem: Problem  # The new records; their model has stages for the known error and the session's zero
    carried: bool  # True when the model's error is carried over sample by sample
    # Rms difference between baseline records of the same command, or between periods of one, measurement unit; rms of the model's
    # error if no baseline record has that command; 0 if there is only one baseline record and its command has no period
    repeatability: Annotated[Array, "A"]
    # Departure from the clean sessions' mean up to which a session is usual, measurement unit: what the baseline records predict for
    # the next one, and a share of the range at most, which is all that is known beside a single one
    usual_zero: Annotated[Array, "A 3"]
    floor: Annotated[Array, "A"]  # Rms that an effect must remove from the residual to be named at all, measurement unit
    clean: Problem | None  # The baseline records; None if the model file's discrepancy is used instead
    error: Annotated[Array, "A"]  # Rms of the model discrepancy on the baseline records without their zeros, measurement unit
    # What predicts this error on other commands; None where that is not known, or of axes that the model mixes
    learned: LearnedDiscrepancy | None = None
    # The baseline records with the rows on which the error was measured: those that say nothing of the time before the record, where
    # the new records have no others. None where the error is carried over, or a model file states it
    error_rows: Problem | None = None

    @property
    def is_of_other_commands(self) -> bool:
        """True where baseline records tell the model discrepancy on other commands only."""
        return self.clean is not None and not self.carried

    def error_energy(self, command: Annotated[Array, "N A"], sample_time: float) -> float:
        """Predict the energy of the model discrepancy on a command."""
        if self.learned is None:
            return float(np.sum(self.error**2))
        design, _ = without_zero(self.learned.features.rows(np.ascontiguousarray(command[:, 0]), sample_time))
        spread = np.column_stack([self.learned.mean, self.learned.factor])
        return float(np.mean(np.sum((design @ spread) ** 2, axis=1)) + self.learned.rest**2)


def no_model(record: Record) -> Model:
    """Make a placeholder for a missing model: its output is 0, so that the baseline record alone is the prediction."""
    units = {"command": record.command_unit, "measurement": record.unit}
    return Model("no model", record.axes, units, record.sample_time, Chain((Gain(0.0),)), record.hold)


def error_on(records: Sequence[Record], model: Model) -> Annotated[Array, "A"]:
    """Measure what a model leaves on baseline records, their zeros and drifts included."""
    found = []
    for record in records:
        check_unit(model, record, "measurement")
        for stretch in record.aligned(allow_gaps=True):
            command, measurement = stretch.command, stretch.measurement
            if command.shape[1] != len(model.axes) or measurement.shape[1] != len(model.axes):
                raise InputError(
                    f"{record.source}: has {measurement.shape[1]} axes, the model {len(model.axes)}: give records of it"
                )
            found.append(measurement - simulate(model, command, record.sample_time, record.hold))
    return np.asarray(np.sqrt(np.mean(np.concatenate(found) ** 2, axis=0)), dtype=np.float64)


def with_baseline(problem: Problem, clean: Problem, settings: BaselineSettings) -> Baseline:
    """Make the baseline of a problem from baseline records."""
    matches = [matching(piece.command, clean.pieces, settings.same_command, settings.overlap) for piece in problem.pieces]
    if not all(matches) and any(np.ptp(simulated_rows(clean, i, piece)) > 0 for i, piece in enumerate(clean.pieces)):
        # The model error on a similar command is partly the same.
        matches = [
            matching(piece.command, clean.pieces, settings.similar_command, settings.similar_overlap) for piece in problem.pieces
        ]
    spans = np.max([np.ptp(piece.measurement, axis=0) for piece in problem.pieces], axis=0)
    if all(matches):
        return _carried(problem, clean, matches, spans, settings)
    # A record that begins anywhere fills the memory first: what the model leaves there is no error of it.
    known = _from_wiped_memory(clean, problem)
    errors = [(piece.measurement - simulated_rows(clean, i, piece))[piece.first :] for i, piece in enumerate(clean.pieces)]
    left = [rows[later.first - piece.first :] for rows, later, piece in zip(errors, known.pieces, clean.pieces, strict=True)]
    stated = discrepancy_of([piece.command for piece in clean.pieces], left, clean.sample_time) | session_zeros(errors)
    return replace(_beside_own_error(problem, stated, clean, settings, left, errors), error_rows=known)


def with_discrepancy(problem: Problem, settings: BaselineSettings, by_spectrum: bool = False) -> Baseline:
    """Make the baseline of a problem from the discrepancy that its model file states, instead of from baseline records."""
    found = _beside_own_error(problem, problem.model.discrepancy, None, settings)
    if not by_spectrum:
        return found
    error, with_learned = found.repeatability, found.learned is not None
    spectrum = _stated_spectrum(problem, problem.model.discrepancy["spectrum"], error, with_learned, settings)
    return replace(found, problem=replace(found.problem, own_spectrum=spectrum), floor=np.zeros_like(found.floor))


def _beside_own_error(
    problem: Problem,
    stated: Mapping[str, Any],
    clean: Problem | None,
    settings: BaselineSettings,
    errors: Sequence[Array] = (),
    everything: Sequence[Array] = (),
) -> Baseline:
    """Make the baseline of a model whose model discrepancy is known from other commands, in the form that a model file has it."""
    # errors: those of the baseline records, each (N, A), from which its spectrum is read; a model file states none. everything: the
    # same with the rows before, in which the time before the record shows
    error = np.asarray(stated["rms"], dtype=float)
    zeros = stated.get("zero")
    mean = np.asarray(stated.get("zero_mean", np.zeros((len(error), len(SHAPES)))), dtype=float)
    usual = np.full(mean.shape, np.nan) if zeros is None else np.asarray(zeros, dtype=float) - np.abs(mean)
    # Without a stated correlation that of a sine at the slowest excited frequency is assumed.
    seconds = float(stated.get("correlation", 1.0 / (np.pi * lowest_frequency(problem))))
    learned = [LearnedDiscrepancy.from_document(one) for one in stated.get("learned", ()) if one is not None]
    predicted = initial_memory(problem, settings.memory_share)
    rest = settings.unseen * error
    known = learned[0] if len(learned) == len(error) == 1 else None  # axes that the model mixes have no features of their own
    if known is not None:
        predicted = (*predicted, *predicted_error(problem, known))
        rest, seconds = settings.unseen * np.array([known.rest]), known.correlation
    spans = np.max([np.ptp(piece.measurement, axis=0) for piece in problem.pieces], axis=0)
    noise = np.broadcast_to(np.atleast_1d(np.asarray(problem.model.noise.get("sigma", 0.0), dtype=float)), error.shape)
    model = problem.model.with_stages((*problem.model.chain.stages, *predicted, _zero(problem, spans, mean, settings)))
    excess = np.sqrt(np.maximum(error**2 - noise**2, 0.0))
    usual = np.fmin(usual, np.array(settings.usual_share) * spans[:, None])
    length = max(seconds / problem.sample_time, 1.0)
    spectrum = None
    floor = settings.other_command * excess
    if clean is not None:
        left = [without_zero(rows)[0] for rows in errors]
        if known is not None:
            left = [
                rows - without_zero(learned_mean(known, piece, len(rows), clean.sample_time))[0]
                for rows, piece in zip(left, clean.pieces, strict=True)
            ]
        spectrum = own_error_spectrum(left, everything, clean, max(problem.counts))
        spectrum = on_new_ground(spectrum, problem, clean, error, settings)
        floor = np.zeros_like(excess)
    beside = replace(problem, model=model, beside_error=True, own_error=rest, own_correlation=length, own_spectrum=spectrum)
    return Baseline(beside, False, error, usual, floor, clean, excess, known)


def _stated_spectrum(
    problem: Problem, documents: Sequence[Any], error: Array, with_learned: bool, settings: BaselineSettings
) -> ErrorSpectrum:
    """The model discrepancy's spectrum on new records as the model's file states it, raised where their commands drive the model more."""
    stated = [StatedSpectrum.from_document(one) for one in documents]
    outputs = [without_zero(piece.counted(simulated_rows(problem, i, piece)))[0] for i, piece in enumerate(problem.pieces)]
    relative = settings.unseen * error / np.maximum([one.output_rms for one in stated], 1e-300)
    found = spectrum_on_new_records(stated, outputs, problem.sample_time, lowest_frequency(problem), relative, with_learned)
    return replace(found, power=settings.unseen**2 * found.power)


def _carried(
    problem: Problem, clean: Problem, matches: Sequence[Sequence[Match]], spans: Array, settings: BaselineSettings
) -> Baseline:
    given = clean
    problem, clean = _as_the_plant_answers(problem, clean, matches)
    pieces: list[Piece] = []
    series: list[Array] = []
    differences: list[Array] = []
    run_to_run: list[Array] = []
    zeros: list[Array] = []
    lefts: list[Array] = []
    noises: list[Array] = []
    unlike: list[Array] = []
    for piece, found in zip(problem.pieces, matches, strict=True):
        filled = [max(piece.first, match.clean.first - match.shift) for match in found]
        begin, end = max(*(match.begin for match in found), *filled), min(match.end for match in found)
        # Rows of a warm-up do not count, but they wipe the memory out all the same.
        wiped = max(
            wiped_out(piece.command[:end]), *(wiped_out(match.clean.command[: end + match.shift]) - match.shift for match in found)
        )
        kept = np.zeros(len(piece.command), dtype=bool)
        kept[begin:end] = True
        kept &= ~_fills_memory(piece.command, begin, end, wiped, settings)
        begin = int(np.argmax(kept))
        whole = kept.all() and piece.keep is None
        pieces.append(replace(piece, keep=None if whole else kept & piece.mask))
        errors, clean_errors, given_errors = [], [], []
        for match in found:
            matched = np.clip(np.arange(len(piece.command)) + match.shift, 0, len(match.clean.command) - 1)
            index = next(i for i, one in enumerate(clean.pieces) if one is match.clean)
            clean_errors.append(match.clean.measurement - simulated_rows(clean, index, match.clean))
            errors.append(clean_errors[-1][matched])
            given_errors.append((match.clean.measurement - simulated_rows(given, index, match.clean))[matched])
        mean = np.mean(errors, axis=0)
        repeating = [noise_between_periods([column], [piece.command]) for column in mean.T]
        # What the new record has too is no noise of the clean one, however rough.
        differing = white_noise((piece.measurement - simulated_rows(problem, len(series), piece) - mean)[kept]) / np.sqrt(2.0)
        quiet, still = without_noise(mean, np.fmin(repeating, differing))
        series.append(quiet)
        # How near the model came that was made without this record tells how well the plant repeats; the filter was fitted to it.
        lefts.append(without_zero(np.mean(given_errors, axis=0)[kept])[0])
        noises.append(still)
        if apart := max(_apart(piece.command, match, settings) for match in found):
            unlike.append(min(settings.error_slope * apart, 1.0) * without_zero(quiet[kept])[0])
        apart_by = [without_zero((error - errors[0])[kept])[0] for error in errors[1:]]
        differences += apart_by
        run_to_run += [rows / np.sqrt(2.0) for rows in apart_by]
        zeros.append(usual_zero(np.array([without_zero((error - series[-1])[begin:end])[1] for error in errors])))
        if len(errors) == 1:
            clean_piece, shift = found[0].clean, found[0].shift
            rows = repeating_rows(clean_piece.command, begin + shift, end + shift, settings)
            successive, about_mean = period_differences(clean_piece.command[rows], clean_errors[0][rows], rows.start, settings)
            differences += successive
            run_to_run += about_mean
    repeatability = np.sqrt(np.mean(np.concatenate(differences) ** 2, axis=0)) if differences else np.zeros(len(spans))
    usual = np.fmin(np.max(zeros, axis=0), np.array(settings.usual_share) * spans[:, None])
    # Both records of a difference have noise, and the mean of n clean ones a part of it; what is carried has what is left of it.
    both = float(np.sqrt(1.0 + 1.0 / min(len(found) for found in matches)))
    alone = repeatability / both
    noise = np.hypot(alone, np.max([one.std(axis=0) for one in noises], axis=0)) if differences else alone
    kept_rows = replace(problem, pieces=tuple(pieces))
    memory = initial_memory(kept_rows, settings.memory_share)
    stages = (*problem.model.chain.stages, CarriedError(tuple(series), noise=tuple(noises)), *memory)
    zero = _zero(replace(problem, model=problem.model.with_stages(stages)), spans, np.zeros((len(spans), len(SHAPES))), settings)
    floor, motions = settings.same_floor * repeatability, []
    if (
        not differences
    ):  # one record tells little of the next one: what the model leaves on it differs from session to session at most
        motions = [without_zero(piece.counted(piece.measurement))[0] for piece in pieces]
        usual_size = settings.usual_repeatability * np.sqrt(np.mean(np.concatenate(motions) ** 2, axis=0))
        floor = np.minimum(usual_size, np.sqrt(np.mean(np.concatenate(lefts) ** 2, axis=0)))
    own_error = alone if differences else floor
    spectra = [
        ErrorSpectrum.of(errors, problem.sample_time, max(kept_rows.counts), lowest_frequency(problem), factor)
        for errors, factor in ((run_to_run, both**2), (unlike, 1.0))
        if errors
    ]
    if unlike:
        spread = np.sqrt(np.mean(np.concatenate(unlike) ** 2, axis=0))
        own_error, floor = np.hypot(own_error, spread), np.hypot(floor, settings.same_floor * spread)
    model = replace(problem.model.with_stages((*stages, zero)), tolerance={}, uncertainty={}, noise={"sigma": noise.tolist()})
    beside = replace(
        problem,
        model=model,
        pieces=tuple(pieces),
        beside_error=True,
        own_error=own_error,
        own_correlation=max((correlation_length(rows) for rows in differences or motions), default=1.0),
        own_spectrum=reduce(ErrorSpectrum.with_further, spectra) if spectra else None,
    )
    error = np.sqrt(np.mean(np.concatenate([without_zero(rows)[0] for rows in series]) ** 2, axis=0))
    return Baseline(beside, True, repeatability, usual, floor, clean, error)


def _as_the_plant_answers(problem: Problem, clean: Problem, matches: Sequence[Sequence[Match]]) -> tuple[Problem, Problem]:
    """Both problems with what the model's linear dynamics lack on the matching baseline records."""
    used = {next(i for i, one in enumerate(clean.pieces) if one is match.clean) for found in matches for match in found}
    outputs = {index: simulated_rows(clean, index, clean.pieces[index]) for index in used}
    still = without_initial_motion(clean)  # what goes on from before is no answer to the command
    errors = {index: still.pieces[index].measurement - output for index, output in outputs.items()}
    counted = [[clean.pieces[index].counted(rows[index]) for index in used] for rows in (outputs, errors)]
    taps = lacking_response(*counted)
    if not taps.any():
        return problem, clean
    lacking = LackingResponse(taps)
    problem = replace(problem, model=problem.model.with_stages((*problem.model.chain.stages, lacking)))
    return problem, replace(clean, model=clean.model.with_stages((*clean.model.chain.stages, lacking)))


def _apart(command: Array, match: Match, settings: BaselineSettings) -> float:
    """Distance of a command from a baseline record's, in rms of its motion; 0 where both are the same."""
    own, other = command[match.begin : match.end], match.clean.command[match.begin + match.shift : match.end + match.shift]
    if is_same(own, other, settings.same_command):
        return 0.0
    return float(np.sqrt(np.mean((own - other) ** 2) / np.mean((own - own.mean(axis=0)) ** 2)))


def _fills_memory(command: Array, begin: int, end: int, wiped: int, settings: BaselineSettings) -> Mask:
    """Rows (N,) that are left out for what they hold of the time before the record, of which nothing is left from row `wiped` on."""
    most = settings.memory_rows * len(command)
    if wiped - begin <= most:
        return np.asarray(np.arange(len(command)) < wiped)
    nothing, new_ground = np.zeros((2, len(command)), dtype=bool)
    if command.shape[1] == 1:
        new_ground[begin:end] = is_new_ground(command[begin:end, 0])
    return new_ground if np.count_nonzero(new_ground) <= most else nothing


def _from_wiped_memory(clean: Problem, problem: Problem) -> Problem:
    """The baseline records from the row on at which their command has wiped out the time before, where new records count from there too."""
    # Until then a record shows a memory that may be many times the model discrepancy: a new one that fills it while it counts does too.
    if any(wiped_out(piece.command) > piece.first for piece in problem.pieces):
        return clean
    pieces = []
    for piece in clean.pieces:
        known = wiped_out(piece.command)
        if known > piece.first and has_whole_loop(piece.command, known):
            piece = replace(piece, keep=piece.mask & (np.arange(len(piece.command)) >= known))
        pieces.append(piece)
    return replace(clean, pieces=tuple(pieces))


def _zero(problem: Problem, spans: Array, mean: Array, settings: BaselineSettings) -> SessionZero:
    """Zero of every record, free by as much as it lies off, about the baseline sessions' mean (A, 3), or about 0 where that is nearer."""
    durations = np.array([len(piece.command) for piece in problem.pieces]) * problem.sample_time
    gaps = [piece.measurement - simulated_rows(problem, i, piece) for i, piece in enumerate(problem.pieces)]
    zeros = np.array([without_zero(rows)[1] for rows in gaps])
    known = np.where(np.abs(zeros - mean) < np.abs(zeros), mean, 0.0)
    scale = np.array(settings.zero_share) * spans[:, None]
    scale[:, 0] = np.maximum(scale[:, 0], np.max(np.abs(zeros - known)[:, :, 0], axis=0))
    return SessionZero.usual(scale, durations, known)
