# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of records before anything is fitted to them: is this a measurement of that command, and are these records of one plant.

A fit to a shuffled command, to a sensor that was not plugged in, or to the records of two plants ends without an error and means nothing.
What tells such records apart needs no model: how much of the measurement any linear system could make of the commands (the multiple
coherence of all commands with each axis), which of the two comes first (a plant lags, whatever it is), how the axes pair up, and whether
two records show one frequency response. Every limit lies between what sound records show, those of every plant and measurement at hand,
and what records show that were spoilt.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.records.averaged_spectra import (
    FEWEST_LINES,
    LONGEST_SEGMENT,
    SEGMENTS,
    SHORTEST_SEGMENT,
    Spectra,
    segment_length,
)

SHORTEST_RECORD = 1024
"""Samples below which no spectrum is judged: a segment must be longer than a plant rings."""

KNOWN = 0.7
"""Share of a measurement's power, about its mean, that a model's simulation explains: from it on nothing further is asked."""

LONGEST_LAGGED = 2**20
"""Samples over which a late copy is looked for."""

EXPLAINED = 0.3
"""Share of a measurement's power that some linear system makes of the commands. Sound records: 0.46 and more, shuffled ones 0.1 at most."""

REVERSED = 0.15
"""By how much the command read backwards explains more. Of sound records it explains less, by 0.05 and more."""


LEAD = 1.5
"""deg by which a measurement leads, on the mean. Sound records lag, by 0 deg at least."""

CLEAR_PHASE = 0.2
"""rad, standard deviation of the phase that belongs to a gain, from which it tells which way time runs."""

CLEAR_VOTE = 0.1
"""Difference of the two agreements from which they are believed."""


MAX_PAIRED = 4
"""Axes up to which every order is tried."""

CLEAR_LEAD = 3.0
"""deg by which a measurement leads that a model explains which does not."""

PAIRED = 0.3
"""Mean share by which another pairing of commands and measurements explains more."""

DIFFERENCES = ((1.3, 0.35), (3.0, 0.5), (np.inf, 0.9))
"""Ratio of two records' command ranges, and the median relative difference of their responses that says two plants up to it.

A hysteresis' gain grows with amplitude, fivefold from the smallest on. Records of one plant: 0.26, 0.4 and 0.57 at most.
"""

EMPTY = 0.01
"""Power relative to the mean below which a frequency is not excited."""

LATER = 0.1
"""By how much more of a measurement's power is explained when what was expected of it comes late."""

FROZEN = 0.3
"""Share of the command's range that passes while the measurement stands still."""

LONG_STILL = 0.05
"""Share of a record for which a measurement must keep one value to stand still."""

SCALE = 20.0
"""Ratio of the measured range to the model's, or of one record's response to another's."""

OPPOSED = -0.5
"""Correlation with the model's simulation, or cosine between two records' responses."""

MAINS = (50.0, 60.0)


@dataclass(frozen=True)
class Trial:
    """A gapless stretch of a record.

    command (N, A) in V and measurement (N, A), sample_time in s, the axes' names; simulated (N, A): what a model makes of the command.
    """

    name: str
    command: Array
    measurement: Array
    sample_time: float
    axes: tuple[str, ...]
    simulated: Array | None = None


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a record.

    name: `NAMES`; record: its trial's name (two of them joined by " and "); axis: name, "" for all; value: what was found; limit: the
    value that it may have.
    """

    name: str
    record: str
    axis: str
    value: float
    limit: float

    def text(self) -> str:
        """As one line for a person: what, where, remedy."""
        what, remedy = NAMES[self.name]
        where = f"{self.record}: {self.axis}" if self.axis else self.record
        return f"{where}: {what} ({self.value:.3g}, limit {self.limit:.3g}): {remedy}"

    def document(self) -> dict[str, str | float]:
        """As plain JSON types."""
        return {"name": self.name, "record": self.record, "axis": self.axis, "value": self.value, "limit": self.limit}


NAMES = {
    "dead_sensor": ("the measurement stands still while the command moves", "check the sensor and its cable"),
    "noise_alone": (
        "the measurement is noise that no command explains",
        "check that the stage is driven and the sensor looks at it",
    ),
    "unplugged_sensor": ("the measurement drifts or hums and follows no command", "plug the sensor in"),
    "shuffled_command": (
        "the command's samples are in no order that the measurement knows",
        "check the columns and how they were sorted",
    ),
    "unrelated_measurement": ("no part of the measurement follows the command", "check that both are of one run and one stage"),
    "reversed_command": ("the command explains the measurement when it is read backwards", "turn the command's time around"),
    "reversed_time": ("the measurement leads the command: time runs backwards", "turn the record's time around"),
    "swapped_signals": ("the measurement leads the command and is the cleaner of the two", "swap command and measurement"),
    "swapped_axes": ("the axes follow each other's commands", "swap the columns of the axes"),
    "scaled_measurement": (
        "the measured range is another than the model's or another record's",
        "check the unit of the measurement",
    ),
    "sign_turned": ("the measurement moves against the model, or against another record", "check the sign of command and sensor"),
    "different_plants": ("the records respond as different plants do", "give the records of one plant at a time"),
}
"""Text of each finding, and the remedy."""


def check_records(trials: Sequence[Trial]) -> list[Finding]:
    """Everything that shows records to be no measurement of their commands, or of several plants."""
    # trials: stretches of records, of finite numbers; those of fewer than `SHORTEST_RECORD` samples are looked at for dead sensors
    # only
    found: list[Finding] = []
    sound: list[Trial] = []
    for trial in trials:
        own = _of_trial(trial)
        found += own
        if not own and len(trial.command) >= SHORTEST_RECORD:
            sound.append(trial)
    spectra: dict[tuple[int, int], Spectra] = {}
    for one, other in combinations(range(len(sound)), 2):
        found += _between((sound[one], sound[other]), (one, other), spectra)
    return found


def refuse_invalid(trials: Sequence[Trial]) -> None:
    """Check `trials` and raise `InputError` with the first finding and the number of further ones, if there is any."""
    found = check_records(trials)
    if found:
        raise InputError(found[0].text() + (f" (and {len(found) - 1} more findings)" if len(found) > 1 else ""))


def _of_trial(trial: Trial) -> list[Finding]:
    moving = [index for index in range(len(trial.axes)) if np.ptp(trial.command[:, index]) > 0]
    frozen = {index: passed for index in moving if (passed := _frozen(trial, index)) > FROZEN}
    if len(trial.command) < SHORTEST_RECORD:
        return [_dead(trial, index, passed) for index, passed in frozen.items()]
    if _known(trial, moving):
        return _against_a_lagging_model(trial, moving)
    spectra = Spectra.of(trial.command, trial.measurement, segment_length(len(trial.command)))
    found = [] if frozen else _pairing(trial, spectra, moving)
    if found:
        return found
    backwards: Array | None = None
    leading: list[tuple[int, float]] = []
    for index in moving:
        axis, explained = trial.axes[index], float(spectra.explained[index])
        if explained + REVERSED < 1.0:
            if backwards is None:
                backwards = Spectra.of(trial.command[::-1], trial.measurement, segment_length(len(trial.command))).explained
            if backwards[index] > max(explained, EXPLAINED) + REVERSED:
                found.append(Finding("reversed_command", trial.name, axis, float(backwards[index]), explained + REVERSED))
                continue
        if _comes_late(trial, index):
            continue
        lead = -spectra.lag(index) if explained >= EXPLAINED else 0.0
        if index in frozen and lead <= LEAD:
            found.append(_dead(trial, index, frozen[index]))
            continue
        if explained < EXPLAINED:
            found.append(Finding(_kind_of_incoherence(trial, index), trial.name, axis, explained, EXPLAINED))
        elif lead > LEAD:
            leading.append((index, lead))
    if leading:
        name = "swapped_signals" if _exchanged(trial, spectra, [index for index, _ in leading]) else "reversed_time"
        found += [Finding(name, trial.name, trial.axes[index], lead, LEAD) for index, lead in leading]
    return found or list(_against_the_model(trial, moving))


def _known(trial: Trial, moving: Sequence[int]) -> bool:
    """True where a model explains every axis that moves; one of a compensator may lead its command."""
    if trial.simulated is None or not moving:
        return False
    measured, error = trial.measurement[:, moving], (trial.measurement - trial.simulated)[:, moving]
    return bool(np.all(np.var(error, axis=0) < (1.0 - KNOWN) * np.var(measured, axis=0)))


def _against_a_lagging_model(trial: Trial, moving: Sequence[int]) -> list[Finding]:
    """Axes that lead their command though the model that explains them does not: their time runs backwards."""
    assert trial.simulated is not None  # it explains the axes
    length = segment_length(len(trial.command))
    measured = Spectra.of(trial.command, trial.measurement, length)
    leads = {index: -measured.lag(index) for index in moving}
    if max(leads.values()) <= CLEAR_LEAD:
        return []
    modelled = Spectra.of(trial.command, trial.simulated, length)
    return [
        Finding("reversed_time", trial.name, trial.axes[index], lead, CLEAR_LEAD)
        for index, lead in leads.items()
        if lead > CLEAR_LEAD and modelled.lag(index) > -LEAD
    ]


def _comes_late(trial: Trial, index: int) -> bool:
    """True where an axis is what was expected of it, by the model or else by its command, but clearly later.

    A lag of a good part of a period is what a diagnosis is to find: it leaves little coherence where a record is short, turns a sine's
    sign, and looks like a lead where it is nearly a period.
    """
    expected = (trial.command if trial.simulated is None else trial.simulated)[:LONGEST_LAGGED, index]
    one, other = (values - values.mean() for values in (expected, trial.measurement[:LONGEST_LAGGED, index]))
    size = float(np.sqrt(np.sum(one**2) * np.sum(other**2)))
    if size == 0.0:
        return False
    late = correlate(other, one, mode="full", method="fft")[len(one) - 1 : len(one) - 1 + max(len(one) // 2, 1)] / size
    lag = int(np.argmax(late))
    if -float(late[: lag + 1].min()) > late[lag]:
        return False  # its sign is turned
    return bool(late[lag] ** 2 > KNOWN and late[lag] ** 2 > max(float(late[0]), 0.0) ** 2 + LATER)


def _dead(trial: Trial, index: int, passed: float) -> Finding:
    return Finding("dead_sensor", trial.name, trial.axes[index], passed, FROZEN)


def _frozen(trial: Trial, index: int) -> float:
    """Largest share of the command's range that passes while the measurement keeps one value for long."""
    command, values = trial.command[:, index], trial.measurement[:, index]
    edges = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0) + 1, [len(values)]])
    lengths = np.diff(edges)
    passed = [0.0]
    for run in np.flatnonzero(lengths >= max(LONG_STILL * len(values), 3)):
        end = edges[run + 1] - lengths[run] // 10  # a step at its end is only about to be followed
        passed.append(float(np.ptp(command[edges[run] : max(end, edges[run] + 2)])))
    return max(passed) / float(np.ptp(command))


def _kind_of_incoherence(trial: Trial, index: int) -> str:
    """Name of the finding on an axis that its command does not explain."""
    command, values = trial.command[:, index], trial.measurement[:, index]
    smooth = _next_sample_correlation(values)
    centered = (values - values.mean()) * np.hanning(len(values))
    power = np.abs(np.fft.rfft(centered)) ** 2
    power[0] = 0.0
    width = 1.0 / (len(values) * trial.sample_time)
    frequency = np.arange(len(power)) * width
    hum = sum(float(power[np.abs(frequency - mains) < max(1.0, 2.5 * width)].sum()) for mains in MAINS)
    if hum > 0.5 * float(power.sum()):
        return "unplugged_sensor"
    if abs(smooth) < 0.3:
        return "noise_alone"
    if _in_no_order(command):
        return "shuffled_command"
    return "unplugged_sensor" if float(power[:4].sum()) > 0.5 * float(power.sum()) else "unrelated_measurement"


def _exchanged(trial: Trial, spectra: Spectra, leading: Sequence[int]) -> bool:
    """True where axes lead because command and measurement are exchanged; else time runs backwards.

    By Bode's relation the phase of a plant without surplus zeros follows from its gain, and so does its inverse's; where time runs
    backwards it has the other sign. Of coupled axes this holds for the determinant of the responses. Where the gain hardly changes, it
    is the measurement that has noise.
    """
    votes = 0.0
    for response, known in spectra.determinant(leading):
        lines = np.flatnonzero(known)
        phase = _phase_of_gain(lines, np.abs(response[lines]), len(response)) if len(lines) >= FEWEST_LINES else np.zeros(1)
        if float(np.std(phase)) > CLEAR_PHASE:
            forwards, backwards = (_agreement(np.angle(response[lines]) - sign * phase, lines, len(response)) for sign in (1, -1))
            votes += forwards - backwards
    if abs(votes) > CLEAR_VOTE:
        return votes > 0
    return all(_roughness(trial.measurement[:, index]) < _roughness(trial.command[:, index]) for index in leading)


def _phase_of_gain(lines: NDArray[np.intp], gains: Array, count: int) -> Array:
    """Phase (L,) at `lines` of the minimum-phase system of these gains (L,), constant beyond them, of `count` frequencies in all."""
    cepstrum = np.fft.irfft(np.interp(np.arange(count), lines, np.log(np.maximum(gains, 1e-300))))
    cepstrum[1 : count - 1] *= 2.0
    cepstrum[count:] = 0.0
    return np.asarray(np.fft.rfft(cepstrum).imag[lines], dtype=np.float64)


def _agreement(phase: Array, lines: NDArray[np.intp], count: int) -> float:
    """Likeness of phases (L,) to those of a delay, or a lead, of some samples: 1 where they are the same."""
    turned = np.zeros(count, complex)
    turned[lines] = np.exp(1j * phase)
    turns = np.fft.fft(turned, 4 * count)
    return float(np.max(np.abs(turns[np.r_[-64:65]]))) / len(lines)


def _pairing(trial: Trial, spectra: Spectra, moving: Sequence[int]) -> list[Finding]:
    """Axes whose measurements follow each other's commands; of up to four that move, more are not paired."""
    if not 2 <= len(moving) <= MAX_PAIRED:
        return []
    return _exchanged_axes(spectra.shares[np.ix_(moving, moving)], trial.name, [trial.axes[index] for index in moving])


def _exchanged_axes(likeness: Array, name: str, axes: Sequence[str]) -> list[Finding]:
    """Axes that are better matched in another order; likeness (A, A) of what is expected of one axis and what is measured on another."""
    count = len(axes)
    best = max(permutations(range(count)), key=lambda order: sum(likeness[order[k], k] for k in range(count)))
    moved = [k for k in range(count) if best[k] != k]
    gained = sum(float(likeness[best[k], k] - likeness[k, k]) for k in moved) / max(len(moved), 1)
    return [Finding("swapped_axes", name, axes[k], gained, PAIRED) for k in moved] if gained > PAIRED else []


def _against_the_model(trial: Trial, moving: Sequence[int]) -> Iterator[Finding]:
    if trial.simulated is None:
        return
    expressive = [index for index in moving if np.ptp(trial.simulated[:, index]) > 0 and np.ptp(trial.measurement[:, index]) > 0]
    if 2 <= len(expressive) <= MAX_PAIRED:
        both = np.hstack([trial.simulated[:, expressive], trial.measurement[:, expressive]])
        likeness = np.asarray(np.corrcoef(both, rowvar=False))[: len(expressive), len(expressive) :]
        exchanged = _exchanged_axes(np.abs(likeness), trial.name, [trial.axes[index] for index in expressive])
        if exchanged:
            yield from exchanged
            return
    for index in moving:
        expected, measured = trial.simulated[:, index], trial.measurement[:, index]
        if np.ptp(expected) == 0 or np.ptp(measured) == 0 or _comes_late(trial, index):
            continue
        ratio = float(np.ptp(measured) / np.ptp(expected))
        if not 1.0 / SCALE < ratio < SCALE:
            yield Finding("scaled_measurement", trial.name, trial.axes[index], ratio, SCALE if ratio > 1 else 1.0 / SCALE)
        correlation = float(np.corrcoef(expected, measured)[0, 1])
        if correlation < OPPOSED:
            yield Finding("sign_turned", trial.name, trial.axes[index], correlation, OPPOSED)


def _between(trials: tuple[Trial, Trial], numbers: tuple[int, int], known: dict[tuple[int, int], Spectra]) -> Iterator[Finding]:
    """Findings about two sound records beside each other; known: spectra by the record's number and the length of a segment."""
    one, other = trials
    name = f"{one.name} and {other.name}"
    if one.axes != other.axes:
        yield Finding("different_plants", name, "", float(len(other.axes)), float(len(one.axes)))
        return
    duration = min(len(trial.command) * trial.sample_time for trial in (one, other)) / SEGMENTS
    lengths = [int(round(duration / trial.sample_time)) for trial in (one, other)]
    if min(lengths) < SHORTEST_SEGMENT or max(lengths) > LONGEST_SEGMENT:
        return
    for trial, key in zip(trials, zip(numbers, lengths, strict=True), strict=True):
        if key not in known:
            known[key] = Spectra.of(trial.command, trial.measurement, key[1])
    spectra = [known[key] for key in zip(numbers, lengths, strict=True)]
    exchanged = _exchanged_axes_between(spectra, name, one.axes)
    if exchanged:
        yield from exchanged
        return
    for index, axis in enumerate(one.axes):
        spans = [float(np.ptp(trial.command[:, index])) for trial in (one, other)]
        if min(spans) <= 0:
            continue
        limit = next(difference for ratio, difference in DIFFERENCES if max(spans) <= ratio * min(spans))
        responses = [each.response(index) for each in spectra]
        count = min(len(response) for response, _ in responses)
        shared = responses[0][1][:count] & responses[1][1][:count]
        if shared.sum() < FEWEST_LINES:
            continue
        first, second = (response[:count][shared] for response, _ in responses)
        largest = np.maximum(np.abs(first), np.abs(second))
        cosine = float(np.median((first * second.conj()).real / np.maximum(np.abs(first) * np.abs(second), 1e-300)))
        difference = float(np.median(np.abs(first - second) / np.maximum(largest, 1e-300)))
        ratio = float(np.median(np.abs(first) / np.maximum(np.abs(second), 1e-300)))
        if cosine < OPPOSED:
            yield Finding("sign_turned", name, axis, cosine, OPPOSED)
        elif not 1.0 / SCALE < ratio < SCALE:
            yield Finding("scaled_measurement", name, axis, ratio, SCALE if ratio > 1 else 1.0 / SCALE)
        elif difference > limit:
            yield Finding("different_plants", name, axis, difference, limit)


def _exchanged_axes_between(spectra: Sequence[Spectra], name: str, axes: Sequence[str]) -> list[Finding]:
    """Axes of one record that respond to all commands as others of another record do."""
    if not 2 <= len(axes) <= MAX_PAIRED:
        return []
    count = min(len(each.power) for each in spectra)
    shared = np.ones(count, bool)
    for each in spectra:
        for index in range(len(axes)):
            shared &= each.response(index)[1][:count] & each.independent[:count]
    if shared.sum() < FEWEST_LINES:
        return []
    first, second = (each.transfer[:count][shared] for each in spectra)
    sizes = [np.sqrt(np.sum(np.abs(each) ** 2, axis=(0, 1))) for each in (first, second)]
    likeness = np.einsum("fab,fac->bc", first.conj(), second).real / np.maximum(np.outer(*sizes), 1e-300)
    return _exchanged_axes(np.abs(likeness), name, axes)


def _in_no_order(values: Array) -> bool:
    """True where a signal's power is the same at all frequencies, as that of noise and of shuffled samples is.

    Of what was built to drive a stage many frequencies are empty; of noise's about one in a hundred have a hundredth of the mean.
    """
    power = np.abs(np.fft.rfft(values - values.mean()))[1:] ** 2
    return bool(np.mean(power < EMPTY * power.mean()) < 3.0 * EMPTY)


def _next_sample_correlation(values: Array) -> float:
    centered = values - values.mean()
    power = float(centered @ centered)
    return float(centered[1:] @ centered[:-1]) / power if power else 0.0


def _roughness(values: Array) -> float:
    """Median size of the third difference relative to the range: noise has much of it, motion little."""
    return float(np.median(np.abs(np.diff(values, 3)))) / max(float(np.ptp(values)), 1e-300)
