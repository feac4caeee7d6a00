# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records beside each other: axes exchanged, signs turned, other scales, other plants."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import permutations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.averaged_spectra import FEWEST_LINES, LONGEST_SEGMENT, SEGMENTS, SHORTEST_SEGMENT, Spectra
from hyst_control.records.validity.findings import Finding, Trial, times
from hyst_control.records.validity.rows import MAX_PAIRED

PAIRED = 0.3  # Mean share by which another pairing of commands and measurements explains more

DIFFERENCES = ((1.3, 0.35), (3.0, 0.5), (np.inf, 0.9))
"""Ratio of two records' command ranges, and the median relative difference of their responses that says two plants up to it.

A hysteresis' gain grows with amplitude, fivefold from the smallest on. Records of one plant: 0.26, 0.4 and 0.57 at most.
"""

SCALE = 20.0  # Ratio of one record's response to another's
OPPOSED = -0.5  # Cosine between two records' responses


def exchanged_axes(likeness: Array, name: str, axes: Sequence[str]) -> list[Finding]:
    """Axes that are better matched in another order; likeness (A, A) of what is expected of one axis and what is measured on another."""
    count = len(axes)
    best = max(permutations(range(count)), key=lambda order: sum(likeness[order[k], k] for k in range(count)))
    moved = [k for k in range(count) if best[k] != k]
    gained = sum(float(likeness[best[k], k] - likeness[k, k]) for k in moved) / max(len(moved), 1)
    return [Finding("swapped_axes", name, axes[k], gained, PAIRED) for k in moved] if gained > PAIRED else []


def findings_between(
    trials: tuple[Trial, Trial], numbers: tuple[int, int], known: dict[tuple[int, int], Spectra]
) -> Iterator[Finding]:
    """Findings about two sound records beside each other; known: spectra by the record's number and the length of a segment."""
    one, other = trials
    name = f"{one.name} and {other.name}"
    if one.axes != other.axes:
        counts = len(one.axes), len(other.axes)
        yield Finding("different_plants", name, "", float(counts[1]), float(counts[0]), f"({counts[0]} and {counts[1]} axes)")
        return
    duration = min(len(trial.command) * trial.sample_time for trial in (one, other)) / SEGMENTS
    lengths = [int(round(duration / trial.sample_time)) for trial in (one, other)]
    if min(lengths) < SHORTEST_SEGMENT or max(lengths) > LONGEST_SEGMENT:
        return
    for trial, key in zip(trials, zip(numbers, lengths, strict=True), strict=True):
        if key not in known:
            known[key] = Spectra.of(trial.command, trial.measurement, key[1])
    spectra = [known[key] for key in zip(numbers, lengths, strict=True)]
    exchanged = _exchanged_axes_between(spectra, name, one.axes)
    if exchanged:
        yield from exchanged
        return
    for index, axis in enumerate(one.axes):
        spans = [float(np.ptp(trial.command[:, index])) for trial in (one, other)]
        if min(spans) <= 0:
            continue
        limit = next(difference for ratio, difference in DIFFERENCES if max(spans) <= ratio * min(spans))
        responses = [each.response(index) for each in spectra]
        count = min(len(response) for response, _ in responses)
        shared = responses[0][1][:count] & responses[1][1][:count]
        if shared.sum() < FEWEST_LINES:
            continue
        first, second = (response[:count][shared] for response, _ in responses)
        largest = np.maximum(np.abs(first), np.abs(second))
        cosine = float(np.median((first * second.conj()).real / np.maximum(np.abs(first) * np.abs(second), 1e-300)))
        difference = float(np.median(np.abs(first - second) / np.maximum(largest, 1e-300)))
        ratio = float(np.median(np.abs(first) / np.maximum(np.abs(second), 1e-300)))
        if cosine < OPPOSED:
            yield Finding("sign_turned", name, axis, cosine, OPPOSED, f"(correlation {cosine:.2g})")
        elif not 1.0 / SCALE < ratio < SCALE:
            yield Finding("scaled_measurement", name, axis, ratio, SCALE if ratio > 1 else 1.0 / SCALE, times(ratio))
        elif difference > limit:
            yield Finding("different_plants", name, axis, difference, limit, f"(by {100 * difference:.0f} %)")


def _exchanged_axes_between(spectra: Sequence[Spectra], name: str, axes: Sequence[str]) -> list[Finding]:
    """Axes of one record that respond to all commands as others of another record do."""
    if not 2 <= len(axes) <= MAX_PAIRED:
        return []
    count = min(len(each.power) for each in spectra)
    shared = np.ones(count, bool)
    for each in spectra:
        for index in range(len(axes)):
            shared &= each.response(index)[1][:count] & each.independent[:count]
    if shared.sum() < FEWEST_LINES:
        return []
    first, second = (each.transfer[:count][shared] for each in spectra)
    sizes = [np.sqrt(np.sum(np.abs(each) ** 2, axis=(0, 1))) for each in (first, second)]
    likeness = np.einsum("fab,fac->bc", first.conj(), second).real / np.maximum(np.outer(*sizes), 1e-300)
    return exchanged_axes(np.abs(likeness), name, axes)
