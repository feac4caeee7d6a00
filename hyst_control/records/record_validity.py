# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of records before anything is fitted to them: is this a measurement of that command, and are these records of one plant.

A fit to a shuffled command, to a sensor that was not plugged in, or to the records of two plants ends without an error and means nothing.
A record is called reversed, exchanged or shifted only where a causal model of moderate order (`reference_model`) explains the reversed,
exchanged or shifted record clearly better, on rows that were held out; and unrelated to its command only where neither such a model nor
the coherence finds more in the command than in the command of another time. Records are compared by their frequency responses.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations
from pathlib import Path

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.yaml_files import read_yaml
from hyst_control.records.averaged_spectra import FEWEST_LINES, LONGEST_SEGMENT, SEGMENTS, SHORTEST_SEGMENT, Spectra, segment_length
from hyst_control.records.record_against_model import LONGEST as LONGEST_SIMULATED
from hyst_control.records.record_against_model import MIN_SHIFT, Simulation, best_order, meant, time_shift
from hyst_control.records.record_facts import copied_gain, held_samples, implausible, interpolated, rails, simultaneous_gaps
from hyst_control.records.reference_model import (
    Reference,
    condensed,
    continued,
    hysteretic_reference,
    independent_sines,
    linear_reference,
    reference,
    shift_curve,
    surely_better,
)

SHORTEST_RECORD = 1024
"""Samples below which no model is fitted: a record must be longer than a plant rings."""

LONGEST_RECORD = 2**20
"""Samples, from the beginning, by whose coherence a record is judged."""

SOUND = 1e-4
"""Share of a measurement's power that a causal model leaves of a record which is not asked further."""

CLEAR, CLEAR_LEAD, CLEAR_EXCHANGE = 2.0, 4.0, 1.5
"""Ratio of the powers that a model leaves of a record, and of the record read backwards, shifted, and exchanged, from which it is that.

Of sound records of many sines the ratios stay below 1; a model is never its machine, so a verdict needs more than that. Where the
measurement is not the cleaner of the two, noise alone makes an exchange look better, up to `CLEAR_LEAD`.
"""

ANOTHER_TIME = 0.382
"""Share of a record from which its commands of another time are taken."""
OTHER_TIMES, LINEAR_FOLLOWS = (0.236, ANOTHER_TIME, 0.618), 0.5
"""Other times with which a linear model is compared, and the share of the least of theirs that its own command's leaves at most."""

FOLLOWS = 0.2
"""Ratio of what the command leaves to what the command of another time does, up to which an incoherent measurement follows it."""

MIN_SINES, MANY_SINES = 9.0, 70.0
"""Sines in a command from which a record tells one causal model from another, since with fewer the poles of a model fit any phases; and
from which there are more than coefficients, so that a model may leave a good part of the power."""

FAR_LESS = 0.05
"""Ratio of what an arrangement of few sines leaves to what it leaves at another time."""

HALF = 0.5
"""Share of a measurement's power that initial states alone must leave of a sound record, and that an arrangement may leave at most."""

EXPLAINED = 0.3
"""Share of a measurement's power that is coherent with the commands, from which it follows them."""

FITS = 0.03
"""Share of a measurement's power that a model of the record read backwards or exchanged leaves at most."""

MODELED = 0.02
"""Share of a measurement's power that a model leaves up to which standing still is the machine's, not the sensor's."""

SATURATION_MATTERS = 1e-3
"""Share of a measurement's power that a model leaves from which it is asked whether the command stops acting."""

CLIPPED_SHARES = (0.5, 0.6, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95)
"""Shares of the command's range at which that is tried."""

OUTER, MIN_OUTER, SPREAD, FLAT = 0.9, 20, 0.015, 0.35
"""Share of the range beyond which the measurement's slope is looked at, rows there and how far they spread, and the share of the whole
slope that is flat."""

LATE = 10.0
"""Ratio of the powers that a model leaves without and with a delay from which the delay is reported."""

SMALL_LEAD, MAX_SMALL_LEAD = 2, 8
"""Rows of a lead that is always tried, and up to which it is doubled."""

SECTIONS, MAX_SECTION, MIN_SECTIONS, MIN_SECTION_SINES = 8, 8192, 3, 3.0
"""Sections of a record in which a lead is sought that grows, the rows of one, how many must show it, and by how many sines each."""

MAX_PAIRED = 4
"""Axes up to which every order is tried, and commands up to which an axis may be driven by all of them."""

PAIRED = 0.3
"""Mean share by which another pairing of commands and measurements explains more."""

DIFFERENCES = ((1.3, 0.35), (3.0, 0.5), (np.inf, 0.9))
"""Ratio of two records' command ranges, and the median relative difference of their responses that says two plants up to it.

A hysteresis' gain grows with amplitude, fivefold from the smallest on. Records of one plant: 0.26, 0.4 and 0.57 at most.
"""

EMPTY = 0.01
"""Power relative to the mean below which a frequency is not excited."""

FROZEN = 0.3
"""Share of the command's range that passes while the measurement stands still."""

LONG_STILL = 0.05
"""Share of a record for which a measurement must keep one value to stand still."""

SCALE = 20.0
"""Ratio of one record's response to another's."""

OPPOSED = -0.5
"""Cosine between two records' responses."""

MAINS = (50.0, 60.0)


@dataclass(frozen=True)
class Trial:
    """A gapless stretch of a record.

    command (N, A) in V and measurement (N, A), sample_time in s, the axes' names, unit of the measurement; simulated (N, A): what a model
    makes of the command; simulate: the model, at any command and sample time; modes: the frequencies of its modes, Hz; delay: its own, s.
    """

    name: str
    command: Array
    measurement: Array
    sample_time: float
    axes: tuple[str, ...]
    simulated: Array | None = None
    unit: str = "um"
    simulate: Simulation | None = None
    modes: tuple[float, ...] = ()
    delay: float = 0.0


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a record.

    name: `NAMES`; record: its trial's name (two of them joined by " and "); axis: name, "" for all; value: what was found; limit: the
    value that it may have; detail: the value in words.
    """

    name: str
    record: str
    axis: str
    value: float
    limit: float
    detail: str = ""
    remedy: str = ""

    def text(self) -> str:
        """As one line for a person: what, where, remedy."""
        what, remedy = NAMES[self.name]
        where = f"{self.record}: {self.axis}" if self.axis else self.record
        detail = self.detail or f"({self.value:.3g}, limit {self.limit:.3g})"
        return f"{where}: {what} {detail}: {self.remedy or remedy}"

    def document(self) -> dict[str, str | float]:
        """As plain JSON types."""
        return {"name": self.name, "record": self.record, "axis": self.axis, "value": self.value, "limit": self.limit}


NAMES: dict[str, list[str]] = read_yaml(Path(__file__).with_name("findings.yaml"))
"""Text of each finding, and the remedy."""

NOTES = (
    "late_measurement",
    "lost_rows",
    "at_range_end",
    "clipped_command",
    "copied_command",
    "held_command",
    "implausible_range",
    "slow_sampling",
)
"""Findings with which a record is used all the same."""


def check_records(trials: Sequence[Trial]) -> list[Finding]:
    """Everything that shows records to be no measurement of their commands, or of several plants."""
    # trials: stretches of records, of finite numbers; those of fewer than `SHORTEST_RECORD` samples are looked at for dead sensors
    # only
    return examined(trials)[0]


def examined(trials: Sequence[Trial]) -> tuple[list[Finding], list[Finding]]:
    """Findings for which records are refused, as in `check_records`, and notes on those that are used all the same."""
    found: list[Finding] = []
    sound: list[Trial] = []
    for trial in trials:
        own = _of_trial(trial)
        found += own
        if all(each.name in NOTES for each in own) and len(trial.command) >= SHORTEST_RECORD:
            sound.append(trial)
    spectra: dict[tuple[int, int], Spectra] = {}
    for one, other in combinations(range(len(sound)), 2):
        found += _between((sound[one], sound[other]), (one, other), spectra)
    return [each for each in found if each.name not in NOTES], [each for each in found if each.name in NOTES]


def refuse_invalid(trials: Sequence[Trial]) -> list[Finding]:
    """Check `trials`; raise `InputError` with the first finding and the number of further ones, if there is any, else return notes."""
    found, notes = examined(trials)
    if found:
        raise InputError(found[0].text() + (f" (and {len(found) - 1} more findings)" if len(found) > 1 else ""))
    return notes


def _of_trial(trial: Trial) -> list[Finding]:
    moving = [index for index in range(len(trial.axes)) if np.ptp(trial.command[:, index]) > 0]
    dead = {index: finding for index in moving if not _modeled(trial, index) and (finding := _dead(trial, index)) is not None}
    if len(trial.command) < SHORTEST_RECORD or not moving:
        return list(dead.values())
    left = _Condensed.of(trial)
    if not dead and (found := _pairing(trial, left, moving)):
        return found
    found = [finding for index in moving for finding in _of_axis(trial, left, index, dead.get(index))]
    return found if any(finding.name not in NOTES for finding in found) else [*found, *_against_the_model(trial, moving)]


def _of_axis(trial: Trial, left: _Condensed, index: int, dead: Finding | None) -> list[Finding]:
    """Findings on an axis that moves: the first reason to refuse it, and notes."""
    found = _direction(trial, left, index)
    if dead is not None and not any(each.name == "swapped_signals" for each in found):
        return [dead]
    return [*found, *_facts(trial, index)]


def _facts(trial: Trial, index: int) -> Iterator[Finding]:
    command, measured, axis = trial.command[:, index], trial.measurement[:, index], trial.axes[index]
    if (rail := rails(command, measured)) is not None:
        detail = f"at {rail[0]:.4g} {trial.unit} in {100 * rail[1]:.2g} % of the samples"
        yield Finding("at_range_end", trial.name, axis, rail[1], 0.0, detail)
    if (held := held_samples(command)) > 1:
        rate = 1.0 / (held * trial.sample_time)
        yield Finding("held_command", trial.name, axis, held, 1.0, f"for {held} samples each, as if logged at {rate:.4g} Hz")
    if (gain := copied_gain(command, measured)) is not None:
        yield Finding("copied_command", trial.name, axis, gain, 0.0, f"({gain:.4g} times the command)")
    if gaps := simultaneous_gaps(command, measured):
        yield Finding("lost_rows", trial.name, axis, gaps, 0.0, f"(command and measurement jump together in {gaps} places)")
    if (odd := implausible(command, measured, trial.unit)) is not None:
        what, smaller = odd
        yield Finding("implausible_range", trial.name, axis, 0.0, 0.0, f"({what})", f"check the unit: is it in {smaller}?")


@dataclass(frozen=True)
class _Condensed:
    """The rows of a trial that models are fitted to, of `together` samples each."""

    command: Array
    measurement: Array
    simulated: Array | None
    together: int

    @classmethod
    def of(cls, trial: Trial) -> _Condensed:
        """Rows of a trial; a command that was logged too rarely is interpolated."""
        command = np.column_stack([interpolated(values) for values in trial.command.T])
        width = len(trial.axes)
        both = trial.measurement if trial.simulated is None else np.hstack([trial.measurement, trial.simulated])
        rows, measured, together = condensed(command, both)
        return cls(rows, measured[:, :width], None if trial.simulated is None else measured[:, width:], together)

    def fastest(self, trial: Trial) -> _Condensed:
        """As many rows of the trial as they are, where its commands move fastest."""
        count = len(self.command)
        power = np.concatenate([[0.0], np.cumsum(np.sum(np.diff(trial.command, axis=0) ** 2, axis=1))])
        begin = int(np.argmax(power[count - 1 :] - power[: len(power) - count + 1]))
        rows = slice(begin, begin + count)
        return _Condensed(trial.command[rows], trial.measurement[rows], None, 1)

    def inputs(self, index: int) -> Array:
        """Commands that may drive an axis."""
        return self.command if self.command.shape[1] <= MAX_PAIRED else self.command[:, [index]]


def _direction(trial: Trial, left: _Condensed, index: int) -> list[Finding]:
    """Findings on whether an axis follows its commands, and on the direction of time."""
    command, measured = left.inputs(index), left.measurement[:, index]
    ahead = reference(command, measured)
    if left.simulated is not None and _misfit(left.simulated[:, index], measured) < min(max(2.0 * ahead.unexplained, SOUND), HALF):
        return []
    # A lead of a few samples shows where the command is fastest, in rows that nothing was averaged to.
    fast = left if left.together == 1 else left.fastest(trial)
    quick = ahead if fast is left else reference(fast.inputs(index), fast.measurement[:, index])
    if all(each.unexplained < SOUND and each.without_command > HALF for each in (ahead, quick)):
        return []
    notes: list[Finding] = []
    whole = held_samples(trial.command[:, index]) == 1 and rails(trial.command[:, index], trial.measurement[:, index]) is None
    if whole and not (_in_no_order(trial.command[:, index]) and _coherent(trial, index) < EXPLAINED):
        informative = independent_sines(left.command[:, index]) >= MIN_SINES
        if informative and (shifts := _growing_lead(trial, index)):
            return shifts
        delayed, own, lead, shifts = _shifted(trial, left, index, ahead)
        if ahead.without_command > HALF:  # what drifts needs no command, whatever its delay
            ahead = delayed
        share, found = _alternative(trial, left, index, own)
        if fast is not left and not shifts and (tried := _shifted(trial, fast, index, quick))[3]:
            _, own, lead, shifts = tried
            if not any(each.name == "swapped_signals" for each in found):
                share, found = _alternative(trial, fast, index, own)
        if any(each.name not in NOTES for each in shifts):
            # An inverse, and time that runs backwards, are explained by a lead of a few samples, too.
            instead = _cleaner(trial, index) if any(each.name == "swapped_signals" for each in found) else share < lead
            return found if found and instead else shifts
        if found:
            return found
        notes = [*shifts, *_clipped(trial, index, command, measured, ahead)]
    return [*_incoherence(trial, index, ahead, command, measured), *notes]


def _clipped(trial: Trial, index: int, command: Array, measured: Array, ahead: Reference) -> Iterator[Finding]:
    """A level of the command beyond which it has no effect."""
    own = index if command.shape[1] > 1 else 0
    values = command[:, own]
    lower, span = float(values.min()), float(np.ptp(values))
    if ahead.unexplained < SATURATION_MATTERS:
        return
    slope = _slope(values, measured)
    tried = {}
    for upper in (True, False):
        outer = values > lower + OUTER * span if upper else values < lower + (1.0 - OUTER) * span
        if (
            outer.sum() < MIN_OUTER
            or np.std(values[outer]) < SPREAD * span
            or abs(_slope(values[outer], measured[outer])) > FLAT * abs(slope)
        ):
            continue
        for share in CLIPPED_SHARES:
            level = lower + (share if upper else 1.0 - share) * span
            changed = command.copy()
            changed[:, own] = np.minimum(values, level) if upper else np.maximum(values, level)
            tried[level] = continued(changed, measured, ahead)
    if not tried:
        return
    level = min(tried, key=lambda each: tried[each].unexplained)
    if surely_better(tried[level], ahead, CLEAR_LEAD):
        side = "above" if level > lower + 0.5 * span else "below"
        yield Finding("clipped_command", trial.name, trial.axes[index], level, 0.0, f"{side} about {level:.3g} V")


def _slope(command: Array, measured: Array) -> float:
    about = command - command.mean()
    return float(about @ measured) / max(float(about @ about), 1e-300)


def _alternative(trial: Trial, left: _Condensed, index: int, ahead: Reference) -> tuple[float, list[Finding]]:
    """The record read backwards or exchanged, where a model explains that clearly better, and what that leaves."""
    command, measured = left.inputs(index), left.measurement[:, index]
    sines = independent_sines(left.command[:, index])
    ways = [("reversed_time", command[::-1], measured[::-1], CLEAR)]
    if ahead.unexplained > SATURATION_MATTERS:
        other = _Condensed.of(replace(trial, command=np.ascontiguousarray(trial.command[::-1])))
        opposite, beside = other.inputs(index), other.measurement[:, index]
        # Either of the two may be the one that was turned around.
        ways += [("reversed_command", opposite, beside, CLEAR), ("reversed_command", opposite[::-1], beside[::-1], CLEAR)]
    if ahead.unexplained > SATURATION_MATTERS or sines >= MIN_SINES:  # of slow motion the inverse of play operators is such, too
        both = left.measurement if _independent(left.command) else measured[:, None]
        limit = CLEAR_EXCHANGE if _cleaner(trial, index) else CLEAR_LEAD
        ways.append(("swapped_signals", both, left.command[:, index], limit))
    clear: list[tuple[float, str, float]] = []
    for name, inputs, wanted, limit in ways:
        fit = hysteretic_reference(inputs, wanted)
        if fit.unexplained > (HALF if sines > MANY_SINES else FITS) or not surely_better(fit, ahead, limit):
            continue
        if _of_this_time(fit, inputs, wanted, FAR_LESS if sines < MIN_SINES else HALF):
            clear.append((fit.unexplained, name, limit))
    if not clear:
        return np.inf, []
    share, name, limit = min(clear)
    return share, [Finding(name, trial.name, trial.axes[index], ahead.unexplained / max(share, 1e-300), limit)]


def _of_this_time(fit: Reference, inputs: Array, wanted: Array, share: float) -> bool:
    """True where an arrangement leaves less than a share of what its inputs (N, A) of other times do; not of a drift, or of a few sines."""
    shift = int(OTHER_TIMES[0] * len(wanted))
    others = (inputs[shift:], wanted[:-shift]), (inputs[:-shift], wanted[shift:])
    return fit.unexplained < share * min(hysteretic_reference(*other).unexplained for other in others)


def _independent(command: Array) -> bool:
    """True of few commands (N, A) that differ: of axes that are driven alike, several measurements together tell the command of the one."""
    count = command.shape[1]
    return 1 < count <= MAX_PAIRED and bool(np.all(np.ptp(command, axis=0) > 0) and np.linalg.cond(np.corrcoef(command.T)) < 1e3)


def _of_another_time(rows: Array, shift: float = ANOTHER_TIME) -> Array:
    """Rows (N, A) of another time of a record, by no simple fraction of it: it may be periodic."""
    return np.roll(rows, int(shift * len(rows)), axis=0)


def _time(seconds: float) -> str:
    return f"{1e3 * seconds:.3g} ms" if seconds < 10.0 else f"{seconds:.3g} s"


def _shifted(trial: Trial, rows: _Condensed, index: int, own: Reference) -> tuple[Reference, Reference, float, list[Finding]]:
    """The model of the rows with its delay, and begun with a lead's poles; what a lead leaves, what is told of either."""
    command, measured = rows.inputs(index), rows.measurement[:, index]
    reach, informative = len(measured) // 8, independent_sines(rows.command[:, index]) >= MIN_SINES
    curves = [shift_curve(command, measured, poles, reach) for poles in (own.poles, own.poles[:0])]

    def finding(name: str, shift: int, text: str) -> list[Finding]:
        seconds = rows.together * trial.sample_time * shift
        remedy = f"{text} --shift {-seconds:.3g}"
        return [Finding(name, trial.name, trial.axes[index], abs(seconds), 0.0, f"by {_time(abs(seconds))}", remedy)]

    delays = {int(np.argmin(curve[reach:])) for curve in curves if curve[reach:].min() < 0.5 * curve[reach]}
    later = {each: _continued_at(each, command, measured, own) for each in delays}
    best = min(later, key=lambda each: later[each].unexplained, default=0)
    inside = SMALL_LEAD < best < reach - SMALL_LEAD  # a periodic command is explained by every period of delay
    if informative and inside and surely_better(later[best], own, LATE):
        return later[best], later[best], np.inf, finding("late_measurement", best, "if the machine has no such delay, pass")
    own = delayed = min([own, *later.values()], key=lambda fit: fit.unexplained)
    if not informative:
        return delayed, own, np.inf, []
    early = {-SMALL_LEAD} | {
        int(np.argmin(curve[:reach])) - reach for curve in curves if curve[:reach].min() < 0.5 * curve[reach:].min()
    }
    leads = {each: _continued_at(each, command, measured, own) for each in early}
    shift = -2 * SMALL_LEAD
    while shift >= -MAX_SMALL_LEAD and leads[shift // 2].unexplained < 0.5 * own.unexplained:
        leads[shift] = _continued_at(shift, command, measured, leads[shift // 2])
        shift *= 2
    best = min(leads, key=lambda each: leads[each].unexplained)
    if leads[best].unexplained < own.unexplained:
        own = min(own, continued(command, measured, leads[best]), key=lambda fit: fit.unexplained)
    if leads[best].unexplained < HALF and surely_better(leads[best], own, CLEAR_LEAD):
        return (
            delayed,
            own,
            leads[best].unexplained,
            finding("early_measurement", best, "check that both recordings start together, or pass"),
        )
    return delayed, own, np.inf, []


def _growing_lead(trial: Trial, index: int) -> list[Finding]:
    """A lead that is not the same everywhere in a record, as where rows of the measurement were lost and closed up."""
    command, measured = trial.command, trial.measurement[:, index]
    if command.shape[1] > MAX_PAIRED:
        command = command[:, [index]]
    count = min(len(measured) // SECTIONS, MAX_SECTION)
    reach, static = count // 8, np.zeros(0, complex)
    intervals = []
    for begin in np.linspace(0, len(measured) - count, SECTIONS).astype(int):
        rows = slice(begin, begin + count)
        if independent_sines(trial.command[rows, index]) < MIN_SECTION_SINES:
            continue
        curve = shift_curve(command[rows], measured[rows], static, reach)
        if curve.min() < MODELED:
            possible = np.flatnonzero(curve <= 1.25 * max(curve.min(), 0.01 * SOUND)) - reach
            if np.ptp(possible) <= reach // 8:
                intervals.append((int(possible[0]), int(possible[-1])))
    if len(intervals) < MIN_SECTIONS or np.any(np.diff(np.mean(intervals, axis=1)) >= 0.0):
        return []
    earliest = intervals[-1][1]
    if earliest >= -SMALL_LEAD or intervals[0][0] - earliest <= SMALL_LEAD:
        return []
    lead = -earliest * trial.sample_time
    detail = f"(the measurement leads the command by a time that grows to {_time(lead)})"
    return [Finding("lost_rows", trial.name, trial.axes[index], lead, 0.0, detail)]


def _continued_at(shift: int, command: Array, measured: Array, begun: Reference) -> Reference:
    """A model of a measurement that is taken `shift` rows later."""
    end = len(measured) - abs(shift)
    return continued(command[max(-shift, 0) :][:end], measured[max(shift, 0) :][:end], begun)


def _incoherence(trial: Trial, index: int, ahead: Reference, command: Array, measured: Array) -> list[Finding]:
    """An axis that follows its commands no more than those of another time."""
    explained = _coherent(trial, index)
    if explained >= EXPLAINED:
        return []
    others = [hysteretic_reference(_of_another_time(command, shift), measured).unexplained for shift in OTHER_TIMES]
    if ahead.unexplained < FOLLOWS * min(others):
        return []
    # A machine whose memory is as long as the record: play operators of any slow command then explain it between held-out blocks, and
    # only linear models show whose command it was.
    own = linear_reference(command, measured)
    commands = (_of_another_time(command, shift) for shift in OTHER_TIMES)
    # A hum is explained by any command once a pole stands at its frequency: the other times begin with the same poles, too.
    fits = (fit for other in commands for fit in (linear_reference(other, measured), continued(other, measured, own)))
    if own.unexplained < LINEAR_FOLLOWS * min(fit.unexplained for fit in fits):
        return []
    return [Finding(_kind_of_incoherence(trial, index), trial.name, trial.axes[index], explained, EXPLAINED)]


def _coherent(trial: Trial, index: int) -> float:
    """Share of an axis' power that is coherent with the commands."""
    rows = slice(0, LONGEST_RECORD)
    length = segment_length(len(trial.command[rows]))
    return float(Spectra.of(trial.command[rows], trial.measurement[rows], length).explained[index])


def _modeled(trial: Trial, index: int) -> bool:
    """Whether a model explains an axis but for a few percent of its power: a compensator's output may stand still."""
    return trial.simulated is not None and _misfit(trial.simulated[:, index], trial.measurement[:, index]) < MODELED


def _misfit(expected: Array, measured: Array) -> float:
    """Share of a measurement's power (N,) that is not what was expected, but for a constant."""
    return float(np.var(measured - expected)) / max(float(np.var(measured)), 1e-300)


def _dead(trial: Trial, index: int) -> Finding | None:
    """A sensor that keeps one value, or two neighboring ones, or stands still while the command moves."""
    values = trial.measurement[:, index]
    few = len(np.unique(values[:LONGEST_RECORD])) <= 2 and len(np.unique(trial.command[:LONGEST_RECORD, index])) > 2
    passed = 1.0 if few else _frozen(trial, index)
    if passed <= FROZEN or (not few and rails(trial.command[:, index], values) is not None):
        return None
    return Finding("dead_sensor", trial.name, trial.axes[index], passed, FROZEN)


def _cleaner(trial: Trial, index: int) -> bool:
    """True where the measurement has less noise than the command."""
    return _roughness(trial.measurement[:LONGEST_RECORD, index]) < _roughness(trial.command[:LONGEST_RECORD, index])


def _pairing(trial: Trial, left: _Condensed, moving: Sequence[int]) -> list[Finding]:
    """Axes whose measurements follow each other's commands; of up to four that move, more are not paired."""
    if not 2 <= len(moving) <= MAX_PAIRED:
        return []
    likeness = np.array(
        [
            [1.0 - min(linear_reference(left.command[:, [one]], left.measurement[:, other]).unexplained, 1.0) for other in moving]
            for one in moving
        ]
    )
    return exchanged_axes(likeness, trial.name, [trial.axes[index] for index in moving])


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


def exchanged_axes(likeness: Array, name: str, axes: Sequence[str]) -> list[Finding]:
    """Axes that are better matched in another order; likeness (A, A) of what is expected of one axis and what is measured on another."""
    count = len(axes)
    best = max(permutations(range(count)), key=lambda order: sum(likeness[order[k], k] for k in range(count)))
    moved = [k for k in range(count) if best[k] != k]
    gained = sum(float(likeness[best[k], k] - likeness[k, k]) for k in moved) / max(len(moved), 1)
    return [Finding("swapped_axes", name, axes[k], gained, PAIRED) for k in moved] if gained > PAIRED else []


def _against_the_model(trial: Trial, moving: Sequence[int]) -> list[Finding]:
    """What a model explains clearly better than the record as it is; notes on what it tells besides."""
    if trial.simulated is None or not moving:
        return []
    expected, measured = trial.simulated[:LONGEST_SIMULATED], trial.measurement[:LONGEST_SIMULATED]
    moved = [index for index in moving if np.ptp(expected[:, index]) > 0 and np.ptp(measured[:, index]) > 0]
    nyquist = 0.5 / trial.sample_time
    aliased = [mode for mode in trial.modes if mode > nyquist]
    notes = []
    if aliased:
        detail = f"(Nyquist frequency {nyquist:.4g} Hz, mode at {aliased[0]:.4g} Hz)"
        notes = [Finding("slow_sampling", trial.name, "", nyquist, aliased[0], detail)]
    if moved and (order := best_order(expected[:, moved], measured[:, moved])) is not None:
        return [
            Finding("swapped_axes", trial.name, trial.axes[moved[k]], 1.0, PAIRED, "in the model")
            for k, other in enumerate(order)
            if other != k
        ]
    if (
        trial.simulate is not None
        and (found := meant(trial.command, trial.measurement, trial.sample_time, trial.simulate)) is not None
    ):
        return [_meant(trial, *found)]
    return [finding for index in moved for finding in _axis_against_the_model(trial, index)] + notes


def _meant(trial: Trial, name: str, factor: float) -> Finding:
    if name == "wrong_rate":
        detail = (
            f": a sample rate of {factor / trial.sample_time:.4g} Hz instead of {1.0 / trial.sample_time:.4g} Hz fits the model"
        )
        return Finding(name, trial.name, "", factor, 1.0, detail)
    if name == "scaled_command":
        return Finding(name, trial.name, "", factor, 1.0, f"(scaled by {factor:g} it fits)")
    return Finding(name, trial.name, "", 1.0, 1.0, "(so the model fits)")


def _axis_against_the_model(trial: Trial, index: int) -> Iterator[Finding]:
    assert trial.simulated is not None
    axis, step = trial.axes[index], trial.sample_time
    expected, measured = trial.simulated[:LONGEST_SIMULATED, index], trial.measurement[:LONGEST_SIMULATED, index]
    shift = time_shift(expected, measured)
    ratio, correlation = float(np.ptp(measured) / np.ptp(expected)), float(np.corrcoef(expected, measured)[0, 1])
    if -shift * step > trial.delay + MIN_SHIFT * step and correlation > OPPOSED:
        remedy = f"check that both recordings start together, or pass --shift {-shift * step:.3g}"
        yield Finding(
            "early_measurement", trial.name, axis, -shift * step, 0.0, f"by {_time(-shift * step)} beside the model", remedy
        )
    elif shift > 0:
        remedy = f"if the machine has no such delay, pass --shift {-shift * step:.3g}"
        yield Finding("late_measurement", trial.name, axis, shift * step, 0.0, f"by {_time(shift * step)} beside the model", remedy)
    elif correlation < OPPOSED:
        yield Finding("sign_turned", trial.name, axis, correlation, OPPOSED)
    if not 1.0 / SCALE < ratio < SCALE:
        yield Finding("scaled_measurement", trial.name, axis, ratio, SCALE if ratio > 1 else 1.0 / SCALE)


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
    return exchanged_axes(np.abs(likeness), name, axes)


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
