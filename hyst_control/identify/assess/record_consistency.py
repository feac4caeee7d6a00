# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Consistency of records under their common model, by which records of two plants are separated.

What a model makes of a command holds the plant's hysteresis and dynamics; what is left of the way from there to the measurement is a
frequency response near 1. A lack of the model's structure shows in all records alike where they drive alike. Records of two plants pull
the common model to either side: their responses differ from each other, though the plants may have one gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.identify.assess.fit_report import residual
from hyst_control.model_file import Model
from hyst_control.records.averaged_spectra import LONGEST_SEGMENT, SEGMENTS, SHORTEST_SEGMENT, Spectra
from hyst_control.records.record import Record
from hyst_control.records.validity.checks import SHORTEST_RECORD

LIKE = 1.3
"""Ratio of two records' ranges up to which they are compared: what a model lacks of a hysteresis changes with the amplitude."""
FEWEST_LINES = 3  # Frequencies of an octave at which both responses are known
DISAGREEMENT = 0.1  # Difference of two responses, as a share, from which records are said to disagree


@dataclass(frozen=True)
class Disagreement:
    """Two records whose responses relative to their common model differ.

    records: names of both; axis: name; frequency: center of the octave where they differ most, Hz; difference: of the responses, as a
    share of the model's.
    """

    records: tuple[str, str]
    axis: str
    frequency: float
    difference: float

    def text(self) -> str:
        """As one line: what, where, and what to do."""
        return (
            f"{self.records[0]} and {self.records[1]}: {self.axis}: they differ by {100 * self.difference:.0f} % around "
            f"{self.frequency:.3g} Hz under one model: if they are of two plants or settings, identify each by itself"
        )


def disagreements(model: Model, records: Sequence[Record], errors: Sequence[Array] | None = None) -> list[Disagreement]:
    """Compare all records of like range in pairs, by what their common model leaves: (N, A) of the last N rows of each, where known.

    One per pair and axis that differs by more than `DISAGREEMENT`, in the octave where it does so most.
    """
    found: list[Disagreement] = []
    if len(records) < 2:
        return found
    errors = [residual(model, data) for data in records] if errors is None else errors
    for (one, of_one), (other, of_other) in combinations(zip(records, errors, strict=True), 2):
        if one.axes != other.axes or one.sample_time != other.sample_time:
            continue
        length = min(len(of_one), len(of_other)) // SEGMENTS
        if not SHORTEST_SEGMENT <= length or min(len(of_one), len(of_other)) < SHORTEST_RECORD:
            continue
        length = min(length, LONGEST_SEGMENT)
        spectra = []
        for data, error in ((one, of_one), (other, of_other)):
            measured = data.measurement[-len(error) :]
            spectra.append(Spectra.of(measured - error, measured, length))
        for axis, name in enumerate(one.axes):
            spans = float(one.span[axis]), float(other.span[axis])
            if min(spans) > 0 and max(spans) <= LIKE * min(spans):
                difference, frequency = _largest_difference(spectra[0], spectra[1], axis, 1.0 / (length * one.sample_time))
                if difference > DISAGREEMENT:
                    found.append(Disagreement((one.name, other.name), name, frequency, difference))
    return found


def _largest_difference(one: Spectra, other: Spectra, axis: int, width: float) -> tuple[float, float]:
    """Difference of two responses in the octave where it is largest, and that octave's center in Hz; bins are `width` Hz wide."""
    (first, known), (second, also_known) = one.response(axis), other.response(axis)
    shared = known & also_known
    shared[:2] = False  # the mean, which leaks
    worst, at = 0.0, 0.0
    begin = 2
    while begin < len(shared):
        octave = slice(begin, 2 * begin)
        used = shared[octave]
        if used.sum() >= FEWEST_LINES:
            difference = float(np.median(np.abs(first[octave][used] - second[octave][used])))
            if difference > worst:
                worst, at = difference, np.sqrt(2.0) * begin * width
        begin *= 2
    return worst, float(at)
