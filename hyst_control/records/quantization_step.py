# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Step of the value grid that a signal's values lie on, and the weight of a rounded sample."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Mask
from hyst_control.records.stream.row_store import blocks, empty_rows

LEVELS = 4  # Fewest levels of a lattice
CROWDING = 0.7  # Most levels of a lattice, per sample
SPREAD = 1.5  # Distances of neighboring levels, in smallest ones, up to which they are one step
OFF = 0.02  # Distance from the lattice, in steps, up to which a level lies on it
SHARE = 0.99  # Share of the levels that must lie on the lattice
LONGEST = 2**20  # Samples among which repetitions are looked for: those of longer records in so many at a time

REPEATED = 0.4
"""Share of repeated commands that find the reading of the time before, from which such readings count once (half a loop is on the
virgin curve the first time)."""


def quantization_step(
    values: Annotated[Array, "N"],
    *,
    fewest: float = LEVELS,
    crowding: float = CROWDING,
    spread: float = SPREAD,
    off: float = OFF,
    share: float = SHARE,
) -> float:
    """Step of the value grid that all values lie on."""
    levels = np.unique(values)
    if len(levels) < fewest or len(levels) > crowding * len(values):
        return 0.0
    steps = np.diff(levels)
    step = float(np.median(steps[steps <= spread * steps.min()]))
    if step <= 0 or step < 1e-9 * np.ptp(levels):
        return 0.0
    step = float(np.ptp(levels) / np.rint(np.ptp(levels) / step))
    distance = np.abs((levels - levels[0]) / step - np.rint((levels - levels[0]) / step))
    return step if np.mean(distance < off) > share else 0.0


def rounding_weights(command: Annotated[Array, "N"], values: Annotated[Array, "N"]) -> Array | None:
    """Weights of rounded samples by what they tell."""
    # A run of equal readings says once that the signal was within half a step, not as often as it is long; and where a repeated command
    # finds the readings of the time before, without noise that would make them differ, they say nothing new. Where the noise is larger
    # than the step there are no long runs and few such repetitions, and every sample counts as it is.
    if not quantization_step(values[:LONGEST]):
        return None
    weight = empty_rows(len(values))
    for begin in range(0, len(values), LONGEST):
        part = slice(begin, begin + LONGEST)
        change = np.flatnonzero(np.diff(values[part])) + 1
        lengths = np.diff(np.concatenate([[0], change, [len(values[part])]]))
        weight[part] = np.repeat(1.0 / lengths, lengths)
        weight[part][_repeated(command[part], values[part])] = 0.0
    mean = weight.mean()
    for part in blocks(len(weight)):
        weight[part] /= mean
    return weight


def _repeated(command: Array, values: Array) -> Mask:
    """Samples (N,) at which the last three commands and the reading are those of an earlier sample; none where readings scatter."""
    coarse = np.rint(command / max(1e-6 * np.ptp(command), 1e-300))
    moves = np.stack([np.roll(coarse, 2), np.roll(coarse, 1), coarse], axis=1)
    _, known = np.unique(moves, axis=0, return_inverse=True)
    _, first = np.unique(np.stack([known.ravel(), values], axis=1), axis=0, return_index=True)
    again = np.ones(len(values), dtype=bool)
    again[first] = False
    moving = (coarse != moves[:, 1]) & (np.arange(len(values)) > 1)
    found: Mask = again & moving
    repetitions = np.count_nonzero(moving) - len(np.unique(known.ravel()[moving]))
    if not repetitions or np.count_nonzero(found) < REPEATED * repetitions:
        found[:] = False
    return found
