# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Check that an axis follows its commands, in the direction of time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.validity.clipping import clipping_findings
from hyst_control.records.validity.facts import held_samples, rails
from hyst_control.records.validity.findings import NOTES, Finding, Trial, figures
from hyst_control.records.validity.incoherence import (
    EXPLAINED,
    LONGEST_RECORD,
    OTHER_TIMES,
    coherent_share,
    in_no_order,
    incoherence_findings,
)
from hyst_control.records.validity.reference_model import (
    Reference,
    hysteretic_reference,
    independent_sines,
    reference,
    surely_better,
)
from hyst_control.records.validity.rows import (
    CLEAR,
    CLEAR_EXCHANGE,
    CLEAR_LEAD,
    HALF,
    MANY_SINES,
    MAX_PAIRED,
    MIN_SINES,
    SATURATION_MATTERS,
    SOUND,
    CondensedRows,
)
from hyst_control.records.validity.sensor import unexpected_share
from hyst_control.records.validity.time_shift import clock_difference, growing_lead, time_shifts

FAR_LESS = 0.05  # Ratio of what an arrangement of few sines leaves to what it leaves at another time

SWITCHED = 8
"""Levels up to which a command is switched, such as a binary sequence: no sensor has so few, and play operators cut the noise off them."""

EXACT = 1e-6  # Unexplained share of a measurement's power up to which a record is checked no further: in 1e-4 a lead may hide

FITS = 0.03  # Share of a measurement's power that a model of the record read backwards or exchanged leaves at most


def direction_findings(trial: Trial, left: CondensedRows, index: int) -> list[Finding]:
    """Findings on whether an axis follows its commands, and on the direction of time."""
    command, measured = left.inputs(index), left.measurement[:, index]
    ahead = reference(command, measured)
    if left.simulated is not None and unexpected_share(left.simulated[:, index], measured) < min(
        max(2.0 * ahead.unexplained, SOUND), HALF
    ):
        return []
    # A lead of a few samples shows where the command is fastest, in rows that nothing was averaged to.
    fast = left if left.together == 1 else left.fastest(trial)
    quick = ahead if fast is left else reference(fast.inputs(index), fast.measurement[:, index])
    if all(each.unexplained < EXACT and each.without_command > HALF for each in (ahead, quick)):
        return []
    notes: list[Finding] = []
    whole = held_samples(trial.command[:, index]) == 1
    whole &= _is_switched(trial.measurement[:, index]) or rails(trial.command[:, index], trial.measurement[:, index]) is None
    if whole and not (in_no_order(trial.command[:, index]) and coherent_share(trial, index) < EXPLAINED):
        informative = independent_sines(left.command[:, index]) >= MIN_SINES
        if shifts := clock_difference(trial, index) or (growing_lead(trial, index) if informative else []):
            # Of an exchanged record the lead of the inverse varies with what is excited when. Of one with lost rows a model of the
            # record taken so much later leaves as little as the exchange does.
            causal = [ahead, *(_without_lead(trial, left, index, each.value) for each in shifts if each.name == "lost_rows")]
            found = _alternative(trial, left, index, min(causal, key=lambda fit: fit.unexplained))[1]
            return found if any(each.name == "swapped_signals" for each in found) else shifts
        delayed, own, lead, shifts = time_shifts(trial, left, index, ahead)
        if fast is not left and quick.unexplained < SOUND:
            # The rows that show a lead best follow their command: of averaged rows a model of few states is not that exact.
            shifts = [each for each in shifts if each.name == "late_measurement"]
        if ahead.without_command > HALF:  # what drifts needs no command, whatever its delay
            ahead = delayed
        share, found = _alternative(trial, left, index, own)
        if fast is not left and not shifts and (tried := time_shifts(trial, fast, index, quick))[3]:
            _, own, lead, shifts = tried
            if not any(each.name == "swapped_signals" for each in found):
                share, found = _alternative(trial, fast, index, own)
        if any(each.name not in NOTES for each in shifts):
            # An inverse, and time that runs backwards, are explained by a lead of a few samples, too.
            instead = _cleaner(trial, index) if any(each.name == "swapped_signals" for each in found) else share < lead
            return found if found and instead else shifts
        if found:
            return found
        notes = [*shifts, *clipping_findings(trial, index, command, measured, ahead)]
    return [*incoherence_findings(trial, index, ahead, command, measured), *notes]


def _without_lead(trial: Trial, rows: CondensedRows, index: int, lead: float) -> Reference:
    """The model of an axis whose measurement is taken later by a lead, s, so that it leads nowhere."""
    late = int(np.ceil(lead / (rows.together * trial.sample_time))) + 1
    return reference(rows.inputs(index)[late:], rows.measurement[:-late, index])


def _alternative(trial: Trial, left: CondensedRows, index: int, ahead: Reference) -> tuple[float, list[Finding]]:
    """The record read backwards or exchanged, where a model explains that clearly better, and what that leaves."""
    command, measured = left.inputs(index), left.measurement[:, index]
    sines = independent_sines(left.command[:, index])
    ways = [("reversed_time", command[::-1], measured[::-1], CLEAR)]
    if ahead.unexplained > SATURATION_MATTERS:
        other = CondensedRows.of(replace(trial, command=np.ascontiguousarray(trial.command[::-1])))
        opposite, beside = other.inputs(index), other.measurement[:, index]
        # Either of the two may be the one that was turned around.
        ways += [("reversed_command", opposite, beside, CLEAR), ("reversed_command", opposite[::-1], beside[::-1], CLEAR)]
    possible = not _is_switched(trial.command[:, index])
    # Of slow motion the inverse of play operators is such, too.
    cleaner = _cleaner(trial, index)
    # In a closed loop the command follows the measurement, too: what a model explains of the rougher signal is no inverse.
    possible = possible and (cleaner or ahead.unexplained > FITS)
    if possible and (ahead.unexplained > SATURATION_MATTERS or sines >= MIN_SINES):
        both = left.measurement if _independent(left.command) else measured[:, None]
        limit = CLEAR_EXCHANGE if cleaner else CLEAR_LEAD
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
    ratio = ahead.unexplained / max(share, 1e-300)
    way = "exchanged" if name == "swapped_signals" else "read backwards"
    detail = f"({way}, a causal model leaves {figures(ratio)} times less of the power)"
    return share, [Finding(name, trial.name, trial.axes[index], ratio, limit, detail)]


def _of_this_time(fit: Reference, inputs: Array, wanted: Array, share: float) -> bool:
    """True where an arrangement leaves less than a share of what its inputs (N, A) of other times do; not of a drift, or of a few sines."""
    shift = int(OTHER_TIMES[0] * len(wanted))
    others = (inputs[shift:], wanted[:-shift]), (inputs[:-shift], wanted[shift:])
    return fit.unexplained < share * min(hysteretic_reference(*other).unexplained for other in others)


def _independent(command: Array) -> bool:
    """True of few commands (N, A) that differ: of axes that are driven alike, several measurements together tell the command of the one."""
    count = command.shape[1]
    return 1 < count <= MAX_PAIRED and bool(np.all(np.ptp(command, axis=0) > 0) and np.linalg.cond(np.corrcoef(command.T)) < 1e3)


def _is_switched(values: Array) -> bool:
    """True of a signal (N,) of few levels, which its motion does not reach as the ends of a range."""
    return len(np.unique(values[:LONGEST_RECORD])) <= SWITCHED


def _cleaner(trial: Trial, index: int) -> bool:
    """True where the measurement has less noise than the command."""
    return _roughness(trial.measurement[:LONGEST_RECORD, index]) < _roughness(trial.command[:LONGEST_RECORD, index])


def _roughness(values: Array) -> float:
    """Median size of the third difference relative to the range: noise has much of it, motion little."""
    return float(np.median(np.abs(np.diff(values, 3)))) / max(float(np.ptp(values)), 1e-300)
