"""Records cut at their rests: one experiment after the other in a bag is the same as a bag for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyst_control.chain.stage import Array
from hyst_control.identify.dataset import Dataset
from hyst_control.identify.gram import Window
from hyst_control.identify.simulation_error import surviving_turns
from hyst_control.identify.windows import turning_points, whole_records

REST_TIME = 0.02
"""A command that holds still for this long (s) rests."""
STRETCH, SETTLE = 0.06, 0.015
"""Length (s) of the stretches that minor loops are cut into, and of what comes before each for its transients."""
MINOR = 0.5
"""A motion over less than this share of the drive is of minor loops."""
TAIL_TIME = 0.1
"""How much (s) of the rest after a motion still belongs to it: long enough for what it left to settle."""


def experiments(datasets: Sequence[Dataset], axis: int) -> list[Window]:
    """The motions of one axis, each a window and a group of its own; a record in which nothing rests stays whole.

    Rows in which the axis rests while others move say nothing of it and are left out, and so are those of the first rise, which
    is not on the major loop (`first_rise`). A motion remembers those before it. Minor loops are cut into short stretches, each
    with an offset of its own: where they lie, and how they drift, is more than Madelung's rules can tell.
    """
    found: list[Window] = []
    windows = whole_records(datasets, axis)
    top = max(float(window.command.max()) for window in windows)
    for window in windows:
        pieces = motions(window.command, window.sample_time)
        window = replace(window, skip=max(window.skip, first_rise(window.command, top)))
        if len(pieces) < 2 or window.memory is not None:
            found += [replace(window, group=len(found))] * bool(pieces)
            continue
        tail = int(TAIL_TIME / window.sample_time)
        for begin, still, end in pieces:
            first, end = max(begin - 1, 0), min(end, still + tail)
            minor = np.ptp(window.command[first:end]) < MINOR * top and still - begin > 2
            for part, counts in stretches(first, end, window.sample_time) if minor else [(first, first)]:
                stop = min(counts + int(STRETCH / window.sample_time), end) if minor else end
                if max(window.skip, counts) < stop:
                    found.append(replace(window, command=window.command[part:stop], measurement=window.measurement[part:stop],
                                         skip=max(window.skip, counts) - part, group=len(found),
                                         memory=remembered(window.command, part), weight=None))
    return found


def stretches(first: int, end: int, sample_time: float) -> list[tuple[int, int]]:
    """(beginning, first row that counts) of the stretches that rows first…end are cut into, each with its settling before it."""
    length, settle = int(STRETCH / sample_time), int(SETTLE / sample_time)
    begins = np.linspace(first, end, max(round((end - first) / length), 1) + 1).astype(int)[:-1]
    return [(max(int(begin) - settle, first), int(begin)) for begin in begins]


def first_rise(command: Array, top: float) -> int:
    """The rows of a command (N,) before it first comes to the top of the major loop; 0 where it never does.

    Until then it may be on a virgin curve, which the curves of the major loop do not describe.
    """
    reached = np.flatnonzero(command >= 0.99 * top)
    return int(reached[0]) if len(reached) else 0


def remembered(command: Array, row: int) -> Array | None:
    """The turning points before `row` of a command (N,) from rest at 0 V that still matter there; None at the start."""
    if row == 0:
        return None
    earlier = np.concatenate([[0.0], command[turning_points(command[:row + 1])], command[row:row + 1]])
    return earlier[surviving_turns(earlier)][:-1]


def motions(command: Array, sample_time: float) -> list[tuple[int, int, int]]:
    """(first, last moving row + 1, end) of the motions of a command (N,): each with the rest that follows it."""
    span = float(np.ptp(command))
    moving = np.flatnonzero(np.abs(np.diff(command)) > 1e-9 * span) + 1
    if span == 0 or not len(moving):
        return []
    breaks = np.flatnonzero(np.diff(moving) > REST_TIME / sample_time)
    begins = moving[np.concatenate([[0], breaks + 1])]
    ends = moving[np.concatenate([breaks, [len(moving) - 1]])] + 1
    following = np.append(begins[1:], len(command))
    return [(int(b), int(m), int(e)) for b, m, e in zip(begins, ends, following, strict=True)]
