# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Facts about a record that need no model: rails of a converter, a held or copied command, lost rows, implausible ranges."""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.outliers import ROUNDED, outlying
from hyst_control.records.stream.row_store import blocks

LONGEST = 2**20  # Samples, from the beginning, that are looked at
MIN_RAIL = 0.005  # Share of the samples at the extreme value from which it is the end of a range
MOVES_ON = 0.01  # Share of its range by which a command goes on while the measurement stands at the end of its range
MIN_HELD, MAX_HELD = 2, 64  # Samples over which a command that was logged too rarely is held
REGULAR = 0.98  # Share of a held command's changes that lie on one grid
MIN_CHANGES = 100
COPY = 1e-4
"""Share of a copy's power that is not proportional to the command, at most; of that, another sample of the command leaves `EXACT` times."""
EXACT = 1.5
MIN_GAPS = 5  # Simultaneous jumps of command and measurement that are gaps
ALONE = 6  # Rows on both sides of a gap in which a smooth command has no other jump
JUMP = 8.0  # Size of a jump relative to the median second difference of its neighborhood
ALIKE = 4.0  # Ratio of the two jumps, each in its signal's range: a mode answers fast motion with a few times the share
MIN_OUTLIERS, MOST_OUTLIERS = 3, 0.01
"""Fewest outliers that are reported, and the share of the samples from which they count as something else."""
MIN_STAND, MOVES_FAR = 10, 0.05
"""Samples on which a measurement stands still, and the share of its range by which the command moves meanwhile."""
FAR_LONGER = 10.0  # Ratio of the longest run of one reading and the next one, from which a sensor that scatters is frozen
SCATTERS, ROUNDING = 0.6, 1e-6
"""Share of the third differences that turn from one sample to the next, of noise 0.77, and their median size as a share of the range."""
LARGEST_RANGE = {"V": 5e3, "um": 5e3, "mrad": 1e3}
"""Ranges of command (V) and measurement from which they are implausible for a piezo stage."""
LARGEST_GAIN = {"um": 3e3, "mrad": 1e3}
"""um or mrad per V from which a gain is implausible: a thousand times that of the stages at hand."""
SMALLER_UNIT = {"V": "mV", "um": "nm", "mrad": "urad"}


def rails(command: Array, measured: Array) -> tuple[float, float] | None:
    """The rail at which a measurement (N,) stands most often, and its share of the samples; None where there is none."""
    return max(every_rail(command, measured), key=lambda rail: rail[1], default=None)


def every_rail(command: Array, measured: Array) -> list[tuple[float, float]]:
    """Values at which a measurement (N,) stands again and again while the command goes on beyond, and their shares of the samples."""
    command, measured = command[:LONGEST], measured[:LONGEST]
    span = float(np.ptp(command))
    found = []
    for extreme, sign in ((float(measured.max()), 1.0), (float(measured.min()), -1.0)):
        at = measured == extreme
        share = float(at.mean())
        if not MIN_RAIL <= share < 0.5 or span == 0.0:
            continue
        edges = np.flatnonzero(np.diff(np.concatenate([[0], at.astype(np.int8), [0]])))
        begins, ends = edges[::2], edges[1::2]
        direction = np.sign(np.corrcoef(command, measured)[0, 1]) * sign
        beyond = [
            float(np.max(direction * (command[begin:end] - command[begin])))
            for begin, end in zip(begins, ends, strict=True)
            if end - begin >= 3
        ]
        if sum(step > MOVES_ON * span for step in beyond) >= min(2, len(beyond)) and beyond and max(beyond) > MOVES_ON * span:
            found.append((extreme, share))
    return found


def outliers(command: Array, measured: Array) -> int:
    """Samples of a measurement (N,) that stand alone; 0 where they are so many that they are no outliers."""
    count = int(np.count_nonzero(outlying(measured[:LONGEST, None], command[:LONGEST, None])))
    return count if MIN_OUTLIERS <= count < MOST_OUTLIERS * len(measured) else 0


def longest_stand(command: Array, measured: Array) -> tuple[int, int] | None:
    """First sample and length of the stretch on which a measurement (N,) repeats one value while the command moves far."""
    # Coarse steps of a sensor, and backlash, repeat values as well: here the measurement jumps before or behind.
    measured = measured[:LONGEST]
    steps = np.abs(np.diff(measured))
    edges = np.flatnonzero(np.diff(measured)) + 1
    begins, ends = np.append(0, edges), np.append(edges, len(measured))
    longest = int(np.argmax(ends - begins))
    begin, count = int(begins[longest]), int(ends[longest] - begins[longest])
    if count < MIN_STAND:
        return None
    others = np.delete(ends - begins, longest)
    if count > FAR_LONGER * max(others, default=count) and _freezes(command, measured, slice(begin, begin + count)):
        return begin, count
    if not 0 < begin < len(measured) - count:
        return None
    jump = max(steps[begin - 1], steps[begin + count - 1])
    usual = max(np.quantile(steps, 0.99), ROUNDED * np.min(steps[steps > 0.0]))
    moved = float(np.median(np.abs(np.diff(command[begin : begin + count])))) * count / max(float(np.ptp(command)), 1e-300)
    return (begin, count) if jump > usual and moved > MOVES_FAR else None


def _freezes(command: Array, measured: Array, still: slice) -> bool:
    """True where the command moves far over rows in which a measurement (N,) keeps a value within its range, and its others scatter."""
    span, value = float(np.ptp(measured)), measured[still.start]
    moved = command[still.start : still.stop - (still.stop - still.start) // 10]  # at the end a step is only about to follow
    if not np.min(measured) < value < np.max(measured) or np.ptp(moved) <= MOVES_FAR * np.ptp(command):
        return False
    # Third differences of noise turn from sample to sample, those of motion do not.
    rough = np.diff(np.delete(measured, still), 3)
    turning = np.mean(rough[1:] * rough[:-1] < 0.0) if len(rough) > MIN_STAND else 0.0
    return bool(turning > SCATTERS and np.median(np.abs(rough)) > ROUNDING * span)


def held_samples(command: Array) -> int:
    """Samples over which a smooth command (N,) is held, 1 where it is not: what was logged at a lower rate than the measurement."""
    changes = np.flatnonzero(np.diff(command[:LONGEST])) + 1
    if len(changes) < MIN_CHANGES:
        return 1
    gaps = np.diff(changes)
    held = int(np.bincount(np.minimum(gaps, MAX_HELD + 1)).argmax())
    if not MIN_HELD <= held <= MAX_HELD:
        return 1
    phase = int(np.bincount(changes % held).argmax())
    if np.mean(changes % held == phase) < REGULAR:
        return 1
    levels = command[phase:LONGEST:held]
    # A staircase of random levels is not held too long: its levels are no samples of a smooth command.
    smooth = np.median(np.abs(np.diff(levels, 2))) < np.median(np.abs(np.diff(levels)))
    return held if smooth else 1


def interpolated(command: Array) -> Array:
    """A command (N,) whose held samples are joined by straight lines; any other as it is."""
    held = held_samples(command)
    if held == 1:
        return command
    changes = np.flatnonzero(np.diff(command)) + 1
    phase = int(np.bincount(changes % held).argmax())
    rows = np.arange(phase, len(command), held)
    return np.asarray(np.interp(np.arange(len(command)), rows, command[rows]), dtype=np.float64)


def copied_gain(command: Array, measured: Array) -> float | None:
    """Factor of a measurement (N,) that is the command times a factor, of the same sample, and nothing else; None where it is not."""
    command, measured = command[1:LONGEST], measured[1:LONGEST]

    def left(values: Array, wanted: Array) -> tuple[float, float]:
        u, y = values - values.mean(), wanted - wanted.mean()
        power = float(u @ u)
        gain = float(u @ y) / power if power else 0.0
        return float(np.sum((y - gain * u) ** 2)) / max(float(y @ y), 1e-300), gain

    same, gain = left(command, measured)
    before, after = left(command[:-1], measured[1:])[0], left(command[1:], measured[:-1])[0]
    return gain if same < COPY and before > EXACT * same and after > EXACT * same else None


def simultaneous_gaps(command: Array, measured: Array) -> int:
    """Rows between which a smooth command and its measurement (N,) jump together, as where rows of both were lost and closed up."""
    # A plant answers a step of its command in a later sample, and a step begins and ends with another slope.
    jumps, sizes = [], []
    for values in (command[:LONGEST], measured[:LONGEST]):
        steps = np.diff(values)
        # Beside a gap both slopes are those of the motion: the step between them is several of it.
        around = 0.25 * (steps[:-4] + steps[1:-3] + steps[3:-1] + steps[4:])
        own = steps[2:-2] - around
        # Block by block: of a long record the eight rows around every row would be the largest that a fit holds in memory.
        parts = blocks(max(len(own) - 12, 0))
        rough = np.concatenate([np.zeros(0), *(_median_around(np.abs(own[part.start : part.stop + 12])) for part in parts)])
        rows = np.zeros(len(own), bool)
        rows[6 : len(own) - 6] = np.abs(own[6 : len(own) - 6]) > JUMP * rough + 1e-6 * np.ptp(values)
        rows &= own * around > 0.5 * around**2
        jumps.append(rows)
        sizes.append(np.abs(own) / max(float(np.ptp(values)), 1e-300))
    # A command that jumps in neighboring rows is rough there: a plant without dynamics follows each of its jumps.
    near = np.convolve(jumps[0], np.ones(2 * ALONE + 1, dtype=int), mode="same")
    both = jumps[0] & jumps[1] & (near == 1)
    # Both lost the same rows of one motion; a converter's steps that a controller passes on to the command have other sizes there.
    both &= (sizes[0] < ALIKE * sizes[1]) & (sizes[1] < ALIKE * sizes[0])
    chance = float(jumps[0].mean() * jumps[1].mean() * len(both))
    count = int(both.sum())
    return count if count >= max(MIN_GAPS, 5.0 * chance) else 0


def _median_around(sizes: Array) -> Array:
    """Upper median (N - 12,) of eight of the 13 sizes (N,) around every row: those next to it, where a gap shows, are left out."""
    near = np.stack([sizes[shift : len(sizes) - 12 + shift] for shift in (0, 1, 2, 4, 8, 10, 11, 12)])
    near.sort(axis=0)
    return np.asarray(near[4], dtype=np.float64)


def implausible(command: Array, measured: Array, unit: str) -> tuple[str, str] | None:
    """Finding on the ranges of a command and a measurement (N,) that no stage has, and the unit that may be meant."""
    spans = {"V": float(np.ptp(command)), unit: float(np.ptp(measured))}
    for symbol, what in (("V", "command"), (unit, "measurement")):
        if spans[symbol] > LARGEST_RANGE.get(symbol, np.inf):
            return f"the {what} spans {spans[symbol]:.4g} {symbol}", SMALLER_UNIT[symbol]
    if spans["V"] > 0 and spans[unit] / spans["V"] > LARGEST_GAIN.get(unit, np.inf):
        return f"the gain is {spans[unit] / spans['V']:.4g} {unit}/V", SMALLER_UNIT[unit]
    return None
