# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of records before anything is fitted to them: is this a measurement of that command, and are these records of one plant.

A record is called reversed, exchanged or shifted only where a causal model of moderate order (`reference_model`) explains the reversed,
exchanged or shifted record clearly better, on rows that were held out; and unrelated to its command only where neither such a model nor
the coherence finds more in the command than in the command of another time. Records are compared by their frequency responses.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.records.averaged_spectra import Spectra
from hyst_control.records.validity import facts
from hyst_control.records.validity.beside_model import model_findings, refutes
from hyst_control.records.validity.causality import direction_findings
from hyst_control.records.validity.findings import NOTES, Finding, Trial
from hyst_control.records.validity.reference_model import Reference, linear_reference
from hyst_control.records.validity.rows import MAX_PAIRED, CondensedRows
from hyst_control.records.validity.sensor import dead_sensor, is_modeled, moves_less_than_a_step
from hyst_control.records.validity.two_records import exchanged_axes, findings_between

SHORTEST_RECORD = 1024  # Samples below which no model is fitted: a record must be longer than a plant rings


def examined(trials: Sequence[Trial]) -> tuple[list[Finding], list[Finding]]:
    """Everything that shows records to be no measurement of their commands, or of several plants, and notes on those used all the same."""
    # trials: of finite numbers; those of fewer than `SHORTEST_RECORD` samples are looked at for dead sensors only
    found: list[Finding] = []
    sound: list[Trial] = []
    for trial in trials:
        own = _of_trial(trial)
        found += own
        if all(each.name in NOTES for each in own) and len(trial.command) >= SHORTEST_RECORD:
            sound.append(trial)
    spectra: dict[tuple[int, int], Spectra] = {}
    for one, other in combinations(range(len(sound)), 2):
        found += findings_between((sound[one], sound[other]), (one, other), spectra)
    return [each for each in found if each.name not in NOTES], [each for each in found if each.name in NOTES]


def refuse_invalid(trials: Sequence[Trial]) -> list[Finding]:
    """Check `trials`; raise `InputError` with the first finding and the number of further ones, if there is any, else return notes."""
    found, notes = examined(trials)
    if found:
        raise InputError(found[0].text() + (f" (and {len(found) - 1} more findings)" if len(found) > 1 else ""))
    return notes


def _of_trial(trial: Trial) -> list[Finding]:
    moving = [index for index in range(len(trial.axes)) if np.ptp(trial.command[:, index]) > 0]
    dead = {
        index: finding for index in moving if not is_modeled(trial, index) and (finding := dead_sensor(trial, index)) is not None
    }
    if len(trial.command) < SHORTEST_RECORD or not moving:
        return list(dead.values())
    left = CondensedRows.of(trial)
    dead = {index: finding for index, finding in dead.items() if not moves_less_than_a_step(trial, left, index)}
    if not dead and (found := _pairing(trial, left, moving)):
        return found
    found = [finding for index in moving for finding in _of_axis(trial, left, index, dead.get(index))]
    if any(finding.name not in NOTES for finding in found):
        return found
    if sum(finding.name == "copied_command" for finding in found) == len(moving):
        return found  # checks of rate and time shift need a lag in the measurement
    # A lead that grows evenly is that of the clock: no rows are lost.
    clock = any(finding.name == "clock_difference" for finding in found)
    return [*found, *(each for each in model_findings(trial, moving) if not (clock and each.name == "lost_rows"))]


def _of_axis(trial: Trial, left: CondensedRows, index: int, dead: Finding | None) -> list[Finding]:
    """Findings on an axis that moves: the first reason to refuse it, and notes."""
    found = [each for each in direction_findings(trial, left, index) if not refutes(trial, index, each.name)]
    if dead is not None and not any(each.name == "swapped_signals" for each in found):
        return [dead]
    return [*found, *_facts(trial, index)]


def _facts(trial: Trial, index: int) -> Iterator[Finding]:
    command, measured, axis = trial.command[:, index], trial.measurement[:, index], trial.axes[index]
    if rails := facts.every_rail(command, measured):
        each = " and ".join(f"at {value:.4g} {trial.unit} in {100 * share:.2g} % of the samples" for value, share in rails)
        yield Finding("at_range_end", trial.name, axis, max(share for _, share in rails), 0.0, each)
    if (held := facts.held_samples(command)) > 1:
        rate = 1.0 / (held * trial.sample_time)
        yield Finding("held_command", trial.name, axis, held, 1.0, f"for {held} samples each, as if logged at {rate:.4g} Hz")
    if (gain := facts.copied_gain(command, measured)) is not None:
        yield Finding("copied_command", trial.name, axis, gain, 0.0, f"({gain:.4g} times the command)")
    if gaps := facts.simultaneous_gaps(command, measured):
        yield Finding("lost_rows", trial.name, axis, gaps, 0.0, f"(command and measurement jump together in {gaps} places)")
    if (count := facts.outliers(command, measured)) > 0:
        yield Finding("single_outliers", trial.name, axis, count, 0.0, f"({count} of {len(measured)})")
    if (stands := facts.longest_stand(command, measured)) is not None:
        begin, count = stands
        detail = f"on {measured[begin]:.4g} {trial.unit} for {count} samples from {begin * trial.sample_time:.4g} s on"
        yield Finding("stuck_measurement", trial.name, axis, count, 0.0, detail)
    yield from implausible_range(trial.name, axis, command, measured, trial.unit)


def implausible_range(record: str, axis: str, command: Array, measured: Array, unit: str) -> Iterator[Finding]:
    """Finding on ranges of a command in V and a measurement (N,) that no stage has."""
    if (odd := facts.implausible(command, measured, unit)) is not None:
        what, smaller = odd
        yield Finding("implausible_range", record, axis, 0.0, 0.0, f"({what})", f"check the unit: is it in {smaller}?")


def _pairing(trial: Trial, left: CondensedRows, moving: Sequence[int]) -> list[Finding]:
    """Axes whose measurements follow each other's commands; of up to four that move, more are not paired."""
    if not 2 <= len(moving) <= MAX_PAIRED:
        return []
    likeness = np.array(
        [[_made_of(linear_reference(left.command[:, [one]], left.measurement[:, other])) for other in moving] for one in moving]
    )
    return exchanged_axes(likeness, trial.name, [trial.axes[index] for index in moving])


def _made_of(fit: Reference) -> float:
    """Share of a measurement's power that its command makes, of what neither a straight line nor ringing from before explains."""
    return 1.0 - min(fit.unexplained / max(min(fit.without_command, 1.0), 1e-300), 1.0)
