# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Values of a measurement that stand still while the plant moves: repeated samples, stretches on one value, passages through a level."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.configuration import CONFIGURATION, CheckSettings

STANDS = 4.0  # Noise rms within which a measurement stands on one level
PASSED = 10.0  # Times as far as these the simulation must pass it meanwhile
STANDING = 1.0 / 3.0
"""Least share of all passages through the level: where a hum cancels the motion now and then, most pass."""
MAX_LEVELS = 1e6  # Levels up to which a range is resolved: beyond, the noise is that of a simulation without any


def repeated_samples(
    values: Annotated[Array, "N"], step: float, sigma: float, settings: CheckSettings = CONFIGURATION.checks
) -> tuple[float, int]:
    """Share of samples that repeat the one before exactly, beyond what a value grid explains."""
    if step > 0:
        # On a lattice neighbors coincide by chance: only where the signal moves by several steps a sample does a repeat say much.
        smooth = np.convolve(values, np.ones(settings.repeat_smoothing) / settings.repeat_smoothing, "same")
        moving = np.abs(np.gradient(smooth)) > settings.repeat_motion * step
        # Before a step nothing moves yet, though the smoothed signal does.
        moving = np.convolve(moving, np.ones(settings.repeat_reach), "same") == settings.repeat_reach
    else:
        moving = np.ones(len(values), bool)
    moved = np.diff(values, prepend=np.nan)
    count = int(moving.sum())
    if count < settings.repeat_samples:
        return 0.0, count
    share = float(np.mean(moved[moving] == 0.0))
    if step > 0:  # by chance a sample repeats the one before as often as it is one step above, or one below
        share -= 0.5 * float(np.mean(np.abs(np.abs(moved[moving]) - step) < 0.01 * step))
        return max(share, 0.0), count
    if share < settings.repeat_chance * _chance(values, settings.repeat_window):
        return 0.0, count  # numbers of few digits coincide now and then
    if sigma < 1e-12 * max(np.ptp(values), 1e-300):
        return 0.0, count  # a noise-free record at rest repeats itself
    return share, count


def _chance(values: Array, window: int) -> float:
    """Share of neighbors that coincide by chance in numbers that are rounded to the smallest step that occurs."""
    steps = np.abs(np.diff(values))
    if not steps.any():
        return 1.0
    around = np.sqrt(np.convolve(steps**2, np.ones(window) / window, "same"))
    # A stretch without a step does not tell how fast the signal moves, as many of them are held samples; those around do.
    told = np.flatnonzero(np.convolve(steps > 0.0, np.ones(window), "same") > 0.5)
    around = np.interp(np.arange(len(steps)), told, around[told])
    return float(np.mean(np.minimum(steps[steps > 0].min() / np.maximum(around, 1e-300), 1.0)))


def stuck_stretches(pieces: Sequence[tuple[Array, Array]], step: float, sigma: float) -> int:
    """Count stretches that stand on one and the same value while the command moves."""
    if step > 0 or sigma < 1e-12 * max((float(np.ptp(values)) for _, values in pieces), default=0.0):
        return 0
    stretches: Counter[float] = Counter()
    repeats: Counter[float] = Counter()
    for command, values in pieces:
        same = np.diff(values) == 0.0
        edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if np.ptp(command[begin : end + 1]) > 0.0:
                stretches[float(values[begin])] += 1
                repeats[float(values[begin])] += int(end - begin)
    if not repeats:
        return 0
    value, count = repeats.most_common(1)[0]
    return stretches[value] if 2 * count > repeats.total() else 0


def level_crossings(pieces: Sequence[tuple[Array, Array]], step: float, sigma: float) -> int:
    """Count passages through one level on which the measurement stands but for its noise, while the simulation moves on."""
    reach = STANDS * sigma
    values = np.concatenate([measured for _, measured in pieces])
    lowest, span = float(values.min()), float(np.ptp(values))
    if step > sigma or not PASSED * reach < span < MAX_LEVELS * reach:
        return 0
    moved = np.concatenate([np.abs(np.diff(simulated, prepend=simulated[:1])) for simulated, _ in pieces])
    bins = ((values - lowest) / reach).astype(np.int64)
    travel = np.bincount(bins, moved)
    first = int(np.argmax(travel))
    others = np.where(np.abs(np.arange(len(travel)) - first) > PASSED, travel, 0.0)
    counts = [_passages(pieces, float(np.median(values[bins == one])), reach) for one in (first, int(np.argmax(others)))]
    return max(counts[0] - counts[1], 0)


def _passages(pieces: Sequence[tuple[Array, Array]], level: float, reach: float) -> int:
    """Stretches within `reach` of a level, entered on one side and left on the other, over which the simulation moves much further."""
    found, crossed = 0, 0
    for simulated, measured in pieces:
        beside = measured[np.abs(measured - level) > reach] > level
        crossed += int(np.count_nonzero(np.diff(beside.astype(int))))
        on_it = np.abs(measured - level) <= reach
        edges = np.flatnonzero(np.diff(np.concatenate([[False], on_it, [False]]).astype(int)))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if begin == 0 or end == len(measured):
                continue
            stands = measured[begin:end]
            if np.count_nonzero(np.diff(stands) == 0.0) > len(stands) // 2 and float(np.median(stands)) != level:
                continue  # samples that were held, each stretch at a value of its own
            before, after = measured[begin - 1] - level, measured[end] - level
            # Before a step both rest: what stands there lets go with the simulation, not after it has passed.
            moved = (simulated[[(begin + end) // 2, end - 1]] - simulated[begin]) * np.sign(after)
            found += bool(before * after < 0.0 and moved[0] > 0.5 * PASSED * reach and moved[1] > 2.0 * PASSED * reach)
    return found if found >= STANDING * crossed else 0
