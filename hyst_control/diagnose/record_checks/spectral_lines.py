# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of a residual, in its spectrum over time and over the command: they suggest where the fits of an effect begin."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from scipy.ndimage import median_filter

from hyst_control.base.arrays import Array, Mask
from hyst_control.base.signals import convolved, periodogram
from hyst_control.chain.stage import Sampling
from hyst_control.diagnose.configuration import CONFIGURATION, CheckSettings
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.record_checks.summary import effect_found_by
from hyst_control.effects.effect import Effect, Line, RecordCheck


def lines(
    problem: Problem, unexplained: Annotated[Array, "M"], settings: CheckSettings = CONFIGURATION.checks
) -> dict[str, list[float]]:
    """Frequencies at which the residual's spectrum has a narrow line."""
    mains_effect, line_effect = effect_found_by(RecordCheck.MAINS_LINE), effect_found_by(RecordCheck.SPECTRAL_LINE)
    of_mains, others = [], []
    rows = problem.rows(unexplained)
    index = int(np.argmax(problem.counts))
    piece = problem.pieces[index]
    longest, longest_rows = piece.counted(piece.command), np.split(rows, problem.edges)[index]
    rate = 1.0 / problem.sample_time
    spectra = periodogram(in_time(piece, piece.driving), rate, linear=True)[1].T
    placed = in_time(piece, longest_rows)
    count = len(placed)
    for axis in range(rows.shape[1]):
        frequency, power = periodogram(placed[:, axis], rate)
        width = rate / count
        ratio = power / np.maximum(background(power, settings.background_bins), 1e-300)
        mains = _mains(mains_effect, problem)
        for fundamental in mains:
            near = np.abs(frequency - fundamental) < max(settings.mains_width, settings.mains_bins * width)
            near |= np.abs(frequency - 2.0 * fundamental) < max(settings.mains_width, settings.mains_bins * width)
            reach = max(settings.mains_width, settings.harmonic_bins * width)
            if covers_command(problem, [fundamental], reach, orders=1, settings=settings):
                continue
            if near.any() and ratio[near].max(initial=0.0) > settings.mains_ratio:
                of_mains.append(fundamental)
        sure = ratio > settings.line_ratio
        # In a band that is driven evenly, as by a sweep, a line is none of the command's; where the command has lines, it may be.
        sure &= frequency > settings.lowest_line_bins * width
        for driven in spectra:
            of_command = driven > settings.driven_share * driven.max()
            of_command &= driven > settings.driven_ratio * background(driven, settings.background_bins)
            sure &= ~np.convolve(of_command, np.ones(3), "same").astype(bool)
            sure &= ~_harmonics(frequency, driven, settings)
        for fundamental in mains:
            for harmonic in settings.mains_harmonics:
                reach = max(settings.mains_width, settings.mains_harmonic_bins * width)
                sure &= np.abs(frequency - harmonic * fundamental) > reach
        if sure.any():
            top = int(np.argmax(np.where(sure, power, 0.0)))
            others.append(_peak(frequency, power, top))
    apart = settings.same_line_bins / (count * problem.sample_time)
    suggested = ((mains_effect, of_mains), (line_effect, others))
    found = {effect.name: _distinct(values, apart) for effect, values in suggested if effect is not None}
    lattice_effect = effect_found_by(RecordCheck.COMMAND_LATTICE)
    if lattice_effect is not None:
        steps = [
            command_lattice(longest[:, axis], longest_rows[:, axis], _response(problem, axis, settings.lattice_response), settings)
            for axis in range(rows.shape[1])
        ]
        found[lattice_effect.name] = [step for of_axis in steps for step in of_axis]
    return found


def in_time(piece: Piece, rows: Annotated[Array, "N A"]) -> Annotated[Array, "M A"]:
    """Rows that count, at their times, straight lines between them: moved together, a line would have another frequency."""
    known = np.flatnonzero(piece.mask)
    return np.stack([np.interp(np.arange(known[0], known[-1] + 1), known, column) for column in rows.T], axis=1)


def command_lattice(
    command: Annotated[Array, "N"],
    unexplained: Annotated[Array, "N"],
    response: Annotated[Array, "K"],
    settings: CheckSettings = CONFIGURATION.checks,
) -> list[float]:
    """Steps of a value grid that the command may have been rounded to.

    The error of rounding is periodic over the command: what the residual holds of it, by a filter matched to the plant's response, has
    as a function of the command a line at one over the step. Differences in time take off what is slow, as most other gaps are.
    """
    low, span = float(command.min()), float(np.ptp(command))
    bins, padded = settings.lattice_bins, 4
    if not (span > 0.0 and np.any(response)):
        return []
    later = np.append(np.diff(unexplained), 0.0)
    matched = convolved(later, np.diff(response, prepend=0.0)[::-1])[len(response) - 1 :][: len(command)]
    place = np.rint((command - low) / span * (bins - 1)).astype(np.int64)
    sums = np.bincount(place, weights=matched, minlength=bins)
    counts = np.bincount(place, minlength=bins)
    window = np.ones(bins // 16)
    smooth = np.convolve(sums, window, "same") / np.maximum(np.convolve(counts, window, "same"), 1.0)
    power = np.abs(np.fft.rfft(sums - smooth * counts, padded * bins)) ** 2
    ratio = power / np.maximum(background(power, padded * settings.background_bins), 1e-300)
    cycles = np.arange(len(power)) / padded
    ratio[(cycles < settings.lattice_least) | (cycles > 0.2 * bins)] = 0.0
    found: list[float] = []
    for top in np.argsort(ratio)[::-1][: 4 * padded * settings.lattice_steps]:
        if ratio[top] > settings.lattice_ratio and all(abs(cycles[top] - other) > 1.0 for other in found):
            found.append(_peak(cycles, power, int(top)))
    found = found[: settings.lattice_steps]
    # The error of a coarse lattice is no sine over the command, and of its line the second harmonic may stand out alone.
    halves = [0.5 * one for one in found if 0.5 * one >= settings.lattice_least]
    found += [half for half in halves if all(abs(half - other) > 1.0 for other in found)]
    return [span / one for one in found]


def background(power: Annotated[Array, "N"], reach: int) -> Annotated[Array, "N"]:
    """Mean power around every bin of a spectrum, from the median, which no line moves."""
    padded = np.pad(power, reach, mode="reflect") if len(power) > reach + 1 else np.pad(power, reach, mode="edge")
    return np.asarray(median_filter(padded, 2 * reach + 1)[reach : reach + len(power)] / np.log(2.0), dtype=np.float64)


def _response(problem: Problem, axis: int, count: int) -> Array:
    """Change of the nominal measurement 1, 2, … `count` samples after the command of an axis has gone up by a quarter of its span."""
    commands = np.concatenate([piece.command for piece in problem.pieces])
    lower, upper = commands.min(axis=0), commands.max(axis=0)
    running = problem.model.chain.filter(Sampling(problem.sample_time, len(lower), problem.hold))
    first = running.settle(0.75 * lower + 0.25 * upper)[axis]
    raised = 0.75 * lower + 0.25 * upper
    raised[axis] += 0.25 * (upper - lower)[axis]
    return np.diff(running.process(np.repeat(raised[None], count, axis=0))[:, axis], prepend=first)


def _mains(effect: Effect | None, problem: Problem) -> tuple[float, ...]:
    """Frequencies (Hz) of the mains: where fits of the effect begin."""
    if effect is None:
        return ()
    return next(parameter.starts for parameter in effect.parameters(problem.surroundings) if parameter.unit == "Hz")


def _harmonics(frequency: Array, driven: Array, settings: CheckSettings) -> Mask:
    """Frequencies (N,) that are near a harmonic of a command whose power is near those of one fundamental."""
    fundamental = _peak(frequency, driven, int(np.argmax(driven * frequency**2)))  # of the rate: a mean that wanders is none
    order = np.round(frequency / fundamental)
    possible, bins = order >= 1, settings.harmonic_bins
    if fundamental < settings.fundamental_bins * frequency[1]:
        # Hardly resolved: everything would be near a harmonic, so that only the first ones count, which any nonlinearity has.
        possible &= order <= settings.first_harmonics
        bins = min(bins, 0.25 * fundamental / frequency[1])
    above = driven[frequency > 0.5 * fundamental].sum()
    for width in settings.harmonic_widths:
        reach = max(bins * frequency[1], width * fundamental)
        near = possible & (np.abs(frequency - order * fundamental) < reach)
        if driven[near].sum() > settings.harmonic_power * above:
            return np.asarray(near, dtype=bool)
    return np.zeros(len(frequency), bool)


def takes_up_command(problem: Problem, frequency: float, line: Line) -> bool:
    """Tell whether a line swells so much that it would take up what an effect does to a command of one frequency."""
    if line.swells == 1:
        return False
    duration = problem.sample_time * max(len(piece.command) for piece in problem.pieces)
    # A Legendre polynomial of degree n has n zeros: n / 2 periods.
    return covers_command(problem, [harmonic * frequency for harmonic in line.harmonics], 0.5 * line.swells / duration)


def covers_command(
    problem: Problem,
    fundamentals: Sequence[float],
    reach: float,
    orders: int | None = None,
    settings: CheckSettings = CONFIGURATION.checks,
) -> bool:
    """True where a line that swells may be what follows a command of one frequency, whose amplitude may change."""
    piece = problem.pieces[int(np.argmax(problem.counts))]
    frequency, spectra = periodogram(piece.driving, 1.0 / problem.sample_time, linear=True)
    for driven in spectra.T:
        peak = _peak(frequency, driven, int(np.argmax(driven)))
        if driven[np.abs(frequency - peak) <= reach].sum() < settings.harmonic_power * driven.sum():
            continue
        harmonics = peak * np.arange(1, (settings.first_harmonics if orders is None else orders) + 1)
        if any(np.min(np.abs(harmonics - one)) <= reach for one in fundamentals):
            return True
    return False


def _peak(frequency: Array, power: Array, top: int) -> float:
    around = slice(max(top - 1, 0), top + 2)
    return float(np.sum(frequency[around] * power[around]) / np.sum(power[around]))


def _distinct(values: Sequence[float], width: float) -> list[float]:
    kept: list[float] = []
    for value in values:
        if all(abs(value - other) > width for other in kept):
            kept.append(value)
    return kept
