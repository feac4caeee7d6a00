# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Segmentation of records into the papers' experiments: the step, the quasi-static loops and the loops at a given rate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Integers
from hyst_control.identify.data.reversal_points import turning_points
from hyst_control.records.record import Record
from hyst_control.records.stream.row_store import blocks

REST_TIME = 5e-3  # A command that holds still for this long (s) rests


@dataclass(frozen=True)
class Stretch:
    """Rows of a record between two rests."""

    record: int  # Index of the record
    # begin, end: First row, and the row behind the last one
    begin: int
    end: int
    kind: str  # "step" or "motion"
    frequency: float  # Main frequency of a motion, Hz
    amplitude: float  # Height of the step or motion, V


def stretches_between_rests(data: Record, record: int, axis: int) -> list[Stretch]:
    """Find the motions of one axis of a record, each with the rest that follows it.

    Motions that join without a rest are cut where their frequency changes: at returns to the lowest command.
    """
    command = data.command[:, axis]
    span = float(np.ptp(command))
    if span == 0:
        return []
    edges = moving_stretches(command, 1e-6 * span, int(max(REST_TIME / data.sample_time, 2)))
    found: list[Stretch] = []
    for index, (begin, stop) in enumerate(edges):
        end = edges[index + 1][0] if index + 1 < len(edges) else len(command)
        jump = command[min(stop + 1, len(command) - 1)] - command[begin]
        if stop - begin <= 2:
            found.append(Stretch(record, begin, end, "step", 0.0, float(jump)))
            continue
        found += [
            Stretch(record, begin + left, begin + right, "motion", frequency, amplitude)
            for left, right, frequency, amplitude in _motions(command[begin : stop + 1], data.sample_time)
        ]
    return found


def moving_stretches(command: Array, least: float, rest: int) -> list[tuple[int, int]]:
    """(first, last + 1) of the stretches of motion that are separated by at least `rest` samples that change by `least` or less."""
    begins: list[int] = []
    ends: list[int] = []
    for indices in _moving(command, least):
        if not begins:
            begins.append(int(indices[0]))
        breaks = np.flatnonzero(np.diff(indices) > rest)
        ends += (indices[breaks] + 1).tolist()
        begins += indices[breaks + 1].tolist()
        last = int(indices[-1])
    return list(zip(begins, [*ends, last + 1], strict=True)) if begins else []


def _moving(command: Array, least: float) -> Iterator[Integers]:
    """Samples (n,) behind which a command changes by more than `least`, block by block; each block begins with the last one's last."""
    last: list[Integers] = []
    for part in blocks(len(command)):
        found = np.flatnonzero(np.abs(np.diff(command[part.start : part.stop + 1])) > least) + part.start
        if len(found):
            joined = np.concatenate([*last, found])
            last = [joined[-1:]]
            yield joined


def resting_stretches(command: Annotated[Array, "N"], least: int) -> list[tuple[int, int]]:
    """Find the stretches over which a command holds still."""
    found, last = [], -1
    for indices in _moving(command, 1e-6 * float(np.ptp(command))):
        edges = np.concatenate([[last], indices])
        long = np.flatnonzero(np.diff(edges) >= least)
        found += list(zip((edges[long] + 1).tolist(), (edges[long + 1] + 1).tolist(), strict=True))
        last = int(indices[-1])
    if len(command) - 1 - last >= least:
        found.append((last + 1, len(command)))
    return found


def _motions(command: Array, sample_time: float) -> list[tuple[int, int, float, float]]:
    """Cut a motion into runs of equal period and peak-to-peak amplitude, from its turning points."""
    turns = np.append(turning_points(command), len(command) - 1)
    half_periods = np.diff(turns)
    swings = np.abs(np.diff(command[turns]))
    large = swings > 0.02 * max(np.ptp(command), 1e-300)
    runs: list[tuple[int, int, float, float]] = []
    start = 0
    for i in range(1, len(half_periods) + 1):
        same = (
            i < len(half_periods)
            and large[i] == large[start]
            and (
                abs(half_periods[i] - half_periods[start]) <= max(2, 0.1 * half_periods[start])
                and abs(swings[i] - swings[start]) <= 0.1 * swings[start]
            )
        )
        if not same:
            if large[start]:
                period = 2.0 * float(np.mean(half_periods[start:i])) * sample_time
                runs.append((int(turns[start]), int(turns[i]), 1.0 / period, float(swings[start])))
            start = i
    return runs


def select_stretches(records: Sequence[Record], axis: int, kind: str, frequency: float | None = None) -> list[Stretch]:
    """Select stretches for a role; of the motions those of the largest amplitude, as in the papers."""
    everything = [stretch for number, data in enumerate(records) for stretch in stretches_between_rests(data, number, axis)]
    if kind == "step":
        steps = [stretch for stretch in everything if stretch.kind == "step" and stretch.amplitude > 0]
        return steps[:1]
    motions = [stretch for stretch in everything if stretch.kind == "motion"]
    if kind == "quasi_static":
        motions = [stretch for stretch in motions if stretch.frequency <= 5.0]
    elif motions:
        assert frequency is not None
        nearest = min(abs(np.log(stretch.frequency / frequency)) for stretch in motions)
        motions = [stretch for stretch in motions if abs(np.log(stretch.frequency / frequency)) <= nearest + 0.05]
        if nearest > 0.4:
            return []
    largest = max((stretch.amplitude for stretch in motions), default=0.0)
    return [stretch for stretch in motions if stretch.amplitude >= 0.9 * largest]
