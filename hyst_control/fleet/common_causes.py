# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Common causes of changes: a driver, a firmware, a run that units which changed share.

Two tests, with the false discovery rate of each kept within a bound (Benjamini and Hochberg 1995): of the units that share a value of
one of the manifest's columns, more changed than a draw from the whole fleet would have (hypergeometric distribution); in one run, more
changes began than runs drawn at random would have (binomial distribution, all runs tried).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from scipy.stats import binom, false_discovery_control, hypergeom

FALSE_SHARE = 0.01  # False discovery rate of each test
MIN_UNITS = 3  # Units that must have changed together
FIRST_RUN = "first run"  # In place of a column, where changes began in one run


@dataclass(frozen=True)
class CommonCause:
    """Something that units which changed have in common."""

    quantity: str  # What changed
    column: str  # Of the manifest; `FIRST_RUN` where the changes began together
    value: str  # Of the column; the run
    changed: Sequence[str]  # Units with it that changed
    of: int  # Units with it; for a run, all that changed
    probability: float  # Adjusted p-value: the false discovery rate at which it would just be named


def find_common_causes(
    changed: Mapping[str, Mapping[str, float]], columns: Mapping[str, Mapping[str, str]], units: int, runs: int
) -> list[CommonCause]:
    """Find what units that changed have in common."""
    shared: list[CommonCause] = []
    together: list[CommonCause] = []
    for quantity, begins in changed.items():
        for column, values in columns.items():
            for value in sorted(set(values.values())):
                having = {unit for unit, its in values.items() if its == value}
                hit = sorted(having & set(begins))
                if len(hit) >= MIN_UNITS and len(having) < units:
                    chance = float(hypergeom.sf(len(hit) - 1, units, len(begins), len(having)))
                    shared.append(CommonCause(quantity, column, value, hit, len(having), chance))
        for run in sorted(set(begins.values())):
            hit = sorted(unit for unit, begin in begins.items() if begin == run)
            if len(hit) >= MIN_UNITS and runs > 1:
                chance = min(1.0, runs * float(binom.sf(len(hit) - 1, len(begins), 1.0 / runs)))
                together.append(CommonCause(quantity, FIRST_RUN, f"{run:.15g}", hit, len(begins), chance))
    return sorted(_kept(shared) + _kept(together), key=lambda cause: cause.probability)


def shared_columns(rows: Sequence[Mapping[str, object]], names: Sequence[str]) -> dict[str, dict[str, str]]:
    """Columns of the manifest whose value belongs to the unit, and groups units."""
    found: dict[str, dict[str, str]] = {}
    for name in names:
        values: dict[str, set[str]] = {}
        for row in rows:
            values.setdefault(str(row["unit"]), set()).add(str(row.get(name) or ""))
        own = {unit: next(iter(its)) for unit, its in values.items() if len(its) == 1 and "" not in its}
        if len(own) == len(values) and 1 < len(set(own.values())) < len(own):
            found[name] = own
    return found


def _kept(causes: Sequence[CommonCause]) -> list[CommonCause]:
    if not causes:
        return []
    adjusted = false_discovery_control([cause.probability for cause in causes])
    known = zip(causes, adjusted, strict=True)
    return [replace(cause, probability=float(probability)) for cause, probability in known if probability <= FALSE_SHARE]
