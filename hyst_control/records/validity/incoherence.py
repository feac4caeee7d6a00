# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""An axis whose measurement follows its commands no more than those of another time."""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.averaged_spectra import Spectra, segment_length
from hyst_control.records.session_zero import without_zero
from hyst_control.records.validity.findings import Finding, Trial
from hyst_control.records.validity.reference_model import Reference, continued, hysteretic_reference, linear_reference

LONGEST_RECORD = 2**20  # Samples, from the beginning, by whose coherence a record is judged
OTHER_TIMES = (0.236, 0.382, 0.618)
"""Shares of a record from which its commands of another time are taken, none of them a simple fraction: it may be periodic."""
LINEAR_FOLLOWS = 0.5  # Share that a linear model of the command leaves at most, of the least that those of other times leave

FOLLOWS = 0.2
"""Ratio of what the command leaves to what the command of another time does, up to which an incoherent measurement follows it."""

EXPLAINED = 0.3  # Share of a measurement's power that is coherent with the commands, from which it follows them
WHITE = 0.2  # Correlation of neighbors up to which a remainder is white noise
EMPTY = 0.01  # Power relative to the mean below which a frequency is not excited

MAINS = (50.0, 60.0)


def incoherence_findings(trial: Trial, index: int, ahead: Reference, command: Array, measured: Array) -> list[Finding]:
    """An axis that follows its commands no more than those of another time."""
    explained = coherent_share(trial, index)
    if explained >= EXPLAINED:
        return []
    commands = [np.roll(command, int(shift * len(command)), axis=0) for shift in OTHER_TIMES]
    others = [hysteretic_reference(other, measured) for other in commands]
    if ahead.unexplained < FOLLOWS * min(fit.unexplained for fit in others):
        return []
    # White noise is left by every command alike: what else is left tells them apart.
    explains = ahead.unexplained < FOLLOWS * ahead.without_command
    if explains and ahead.left_beyond_noise < FOLLOWS * min(fit.left_beyond_noise for fit in others):
        return []
    # A machine whose memory is as long as the record: play operators of any slow command then explain it between held-out blocks, and
    # only linear models show whose command it was.
    own = linear_reference(command, measured)
    # Slow dynamics make the same of a smooth command and of one of another time. What leaves nothing but white noise is the whole answer.
    if abs(next_sample_correlation(measured - own.predicted)) < WHITE and own.unexplained < FOLLOWS * own.without_command:
        return []
    # A hum is explained by any command once a pole stands at its frequency: the other times begin with the same poles, too.
    fits = (fit for other in commands for fit in (linear_reference(other, measured), continued(other, measured, own)))
    if own.unexplained < LINEAR_FOLLOWS * min(fit.unexplained for fit in fits):
        return []
    detail = f"(the command explains {100.0 * explained:.2g} % of its power, at least {100.0 * EXPLAINED:.0f} % expected)"
    return [Finding(_kind_of_incoherence(trial, index), trial.name, trial.axes[index], explained, EXPLAINED, detail)]


def coherent_share(trial: Trial, index: int) -> float:
    """Share of an axis' power that is coherent with the commands, as it is or without a drift, which may be larger than all motion."""
    command, measurement = trial.command[:LONGEST_RECORD], trial.measurement[:LONGEST_RECORD]
    length = segment_length(len(command))
    return max(float(Spectra.of(command, rows, length).explained[index]) for rows in (measurement, without_zero(measurement)[0]))


def _kind_of_incoherence(trial: Trial, index: int) -> str:
    """Name of the finding on an axis that its command does not explain."""
    command, values = trial.command[:, index], trial.measurement[:, index]
    smooth = next_sample_correlation(values)
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
    if in_no_order(command):
        return "shuffled_command"
    return "unplugged_sensor" if float(power[:4].sum()) > 0.5 * float(power.sum()) else "unrelated_measurement"


def in_no_order(values: Array) -> bool:
    """True where a signal's power is the same at all frequencies, as that of noise and of shuffled samples is."""
    # Of what was built to drive a stage many frequencies are empty; of noise's about one in a hundred have a hundredth of the mean.
    power = np.abs(np.fft.rfft(values - values.mean()))[1:] ** 2
    return bool(np.mean(power < EMPTY * power.mean()) < 3.0 * EMPTY)


def next_sample_correlation(values: Array) -> float:
    """Correlation of neighboring values (N,): 0 of white noise."""
    centered = values - values.mean()
    power = float(centered @ centered)
    return float(centered[1:] @ centered[:-1]) / power if power else 0.0
