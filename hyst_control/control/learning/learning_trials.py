# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Trials of learning offline: on a plant that can be run, or from records of trials; and their table."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.control.feedback.loop import Compensator, Plant
from hyst_control.control.feedback.pi import RunningPI
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.control.learning.feedback_error_learning import FeedbackErrorLearning
from hyst_control.control.learning.iterative_learning import MAX_ROWS, IterativeLearning, RunningIterativeLearning
from hyst_control.control.learning.learning_loop import run_learning_loop
from hyst_control.model_file import Model
from hyst_control.records.record import Record
from hyst_control.reporting.tables import Table

KINDS = ("mhl_inverse", "hampi", "none")  # Compensators of `best_compensator`, the best first
LEARNED = "learned"
TOPICS = ("reference", "feedback", "measurement")


def run_trials(
    reference: Array, compensator: Compensator | None, controller: RunningPI, plant: Plant, description: IterativeLearning
) -> tuple[RunningIterativeLearning, dict[str, Array]]:
    """Learn one period (N, A) of a reference on a plant; the learner and the signals of all trials."""
    periods = description.trials * (description.settling + description.averaged)
    if periods * len(reference) > MAX_ROWS:
        raise InputError(
            f"trials: {description.trials} of {description.trial_rows} samples are too many to keep, "
            f"{MAX_ROWS // description.trial_rows} are possible: take fewer, or fewer periods in each"
        )
    learner = description.start()
    return learner, run_learning_loop(np.tile(reference, (periods, 1)), compensator, controller, plant, learner)


def learn_from_records(records: Sequence[Record], description: IterativeLearning) -> tuple[RunningIterativeLearning, float]:
    """Learn from records of trials, one record per trial, in order.

    Every record begins at a tick where a period begins, and its last whole periods count. The feedforward of the second trial must
    contain the correction that was learned from the first, and so on; the correction of the first trial is its topic `learned`,
    zero where it has none.
    """
    learner, rows, low, high = description.start(), description.trial_rows, np.inf, -np.inf
    for index, record in enumerate(records):
        held = [LEARNED] if index == 0 and LEARNED in record.signals else []
        [data] = record.aligned([*TOPICS, *held])
        period, axes = description.filter.period, description.filter.axes
        reference, feedback, measurement = (data.signal(topic).values for topic in TOPICS)
        if len(reference) < rows or reference.shape[1] != axes:
            raise InputError(
                f"{record.source}: {len(reference)} samples of {reference.shape[1]} axes: a trial needs "
                f"{rows // period} periods, {rows} samples, of {axes} axes"
            )
        begin = (len(reference) // period) * period - rows
        piece = slice(begin, begin + rows)
        if held:
            learner = description.start(data.signal(LEARNED).values[begin + rows - period : begin + rows])
        learner.learned(index * rows, np.zeros((rows, axes)))
        learner.observe(index * rows, reference[piece], measurement[piece], feedback[piece])
        low, high = min(low, float(reference.min())), max(high, float(reference.max()))
    return learner, high - low


def trial_table(learner: RunningIterativeLearning, span: float, subject: str) -> Table:
    """Table of trials: error, its repeating part and the noise in that part; the reason why learning ended is a note."""
    table = Table("learn")
    for index, trial in enumerate(learner.history):
        for quantity, value in (("nrmse", trial.error), ("nrmse_repeating", trial.repeating), ("nrmse_noise", trial.noise)):
            table.add("learning from trial to trial", f"trial {index}", subject, quantity, "%", 100.0 * value / span)
    trials = f"{len(learner.history)} trial{'s' * (len(learner.history) != 1)}"
    table.notes.append(f"Stopped after {trials}: {learner.stopped}." if learner.stopped else f"{trials}; learning goes on.")
    return table


def feedback_error_table(
    reference: Array,
    compensator: Compensator | None,
    controller: RunningPI,
    plant: Plant,
    description: FeedbackErrorLearning,
    duration: float,
    subject: str,
    axes: Sequence[str],
) -> Table:
    """Feedback-error learning on a plant: NRMSE in percent of the range at its beginning and end, and what it learned."""
    learner = description.start(len(axes))
    count = max(int(np.ceil(duration / description.sample_time / len(reference))), 3)
    signals = run_learning_loop(np.tile(reference, (count, 1)), compensator, controller, plant, learner)
    error = (signals["reference"] - signals["measurement"]).reshape(count, len(reference), len(axes))
    tenth = max(count // 10, 1)
    table = Table("learn")
    for case, part in (("first tenth", error[1 : 1 + tenth]), ("last tenth", error[-tenth:])):
        value = 100.0 * np.sqrt(np.mean(part**2)) / np.ptp(reference, axis=0).max()
        table.add("feedback-error learning", case, subject, "nrmse", "%", float(value))
    for axis, gain, lag in zip(axes, learner.gain, learner.lag, strict=True):
        table.add("feedback-error learning", f"axis {axis}", subject, "gain", "", gain)
        table.add("feedback-error learning", f"axis {axis}", subject, "lag", "s", lag)
    return table


def best_compensator(model: Model, sample_time: float, limits: tuple[float, float]) -> tuple[str, Compensator]:
    """Kind and compensator that suit a model best: the first of `KINDS` that can be built."""
    for kind in KINDS[:-1]:
        with suppress(InputError):
            return kind, build_compensator(model, kind, sample_time=sample_time, limits=limits)
    return KINDS[-1], build_compensator(model, KINDS[-1], sample_time=sample_time, limits=limits)
