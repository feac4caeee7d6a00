# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Replay of the software blocks that a bag recorded: what they say they did, from what they were given. Exact, whatever the loop does."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.diagnose.configuration import CONFIGURATION, ReplaySettings
from hyst_control.records.actuator_following import APPLIED
from hyst_control.records.record import Record


@dataclass(frozen=True)
class Block:
    """Software block, and the rms (V) by which it departs from what it should have done."""

    name: str
    rms: float
    text: str

    @property
    def faithful(self) -> bool:
        """True when the block's output is exactly as it should be."""
        return self.rms == 0.0


def replay(record: Record, settings: ReplaySettings = CONFIGURATION.replay) -> list[Block]:
    """Replay the sum and limits (command = feedforward + feedback within limits), the PI law, and the transport of the ticks."""
    return [block for block in (_sum(record, settings), _feedback(record, settings), _transport(record)) if block is not None]


def _sum(record: Record, settings: ReplaySettings) -> Block | None:
    if not {"command", "feedforward", "feedback"} <= set(record.signals):
        return None
    try:
        sent = record.aligned(("feedforward", "feedback", "command"), allow_gaps=True)[0]
    except InputError as error:
        return Block("feedforward", 0.0, f"not replayed: {error}")
    command, wanted = sent.command, sent.signal("feedforward").values + sent.signal("feedback").values
    span = max(float(np.ptp(command)), 1e-9)
    step = float(np.max(np.abs(np.diff(command, axis=0)), initial=0.0))
    limited = (command <= command.min(axis=0) + settings.tolerance * span) | (
        command >= command.max(axis=0) - settings.tolerance * span
    )
    limited[1:] |= np.abs(np.abs(np.diff(command, axis=0)) - step) < settings.tolerance * span
    wrong = (command - wanted)[~limited]
    rms = float(np.sqrt(np.mean(wrong**2))) if wrong.size else 0.0
    faithful = rms < settings.tolerance * span
    return Block(
        "command sum",
        0.0 if faithful else rms,
        "command = feedforward + feedback, as it should"
        if faithful
        else f"command departs from feedforward + feedback by {rms:.3g} V rms where no limit acts",
    )


def _feedback(record: Record, settings: ReplaySettings) -> Block | None:
    if not {"reference", "feedback", "measurement"} <= set(record.signals):
        return None
    try:
        stretch = record.aligned(("reference", "feedback", "measurement"), allow_gaps=True)[0]
    except InputError as error:
        return Block("feedback", 0.0, f"not replayed: {error}")
    feedback = stretch.signal("feedback").values
    span = float(np.ptp(feedback))
    if span == 0.0:
        return Block("feedback", 0.0, "feedback was off")
    tracking = stretch.signal("reference").values - stretch.measurement
    worst = 0.0
    for axis in range(feedback.shape[1]):
        # v[k] - v[k-1] = kp (e[k] - e[k-1]) + ki T e[k]; ticks at a limit, where the integral is led back, stand out and are left out.
        design = np.stack([np.diff(tracking[:, axis]), tracking[1:, axis]], axis=1)
        moved = np.diff(feedback[:, axis])
        keep = np.ones(len(moved), bool)
        for _ in range(3):
            law = np.linalg.lstsq(design[keep], moved[keep], rcond=None)[0]
            left = np.abs(moved - design @ law)
            keep = left <= max(settings.outlying * float(np.median(left)), settings.tolerance * span)
        worst = max(worst, float(np.sqrt(np.mean(left[keep] ** 2))))
    faithful = worst < settings.law_tolerance * span
    return Block(
        "feedback",
        0.0 if faithful else worst,
        "feedback is a PI of the recorded error, as it should"
        if faithful
        else f"feedback departs from a PI of the recorded error by {worst:.3g} V rms a tick",
    )


def _transport(record: Record) -> Block | None:
    sent = replace(record, signals={topic: each for topic, each in record.signals.items() if topic != APPLIED})
    try:
        stretches = sent.aligned(allow_gaps=True)
        step = record.sample_time
    except InputError:
        return None
    signal = record.signal("measurement")
    ticks = np.rint((signal.time[-1] - signal.time[0]) / step) + 1
    kept = sum(len(stretch.time) for stretch in stretches)
    lost = max(int(ticks) - kept, 0)
    text = "every tick is there" if not lost else f"{lost} of {int(ticks)} ticks are missing"
    if signal.timing == "receive":
        text += "; the sample times are those of reception, with its jitter"
    return Block("transport", 0.0, text)
