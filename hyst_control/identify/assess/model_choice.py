# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Choice between model families by their error on rows that were not fitted, with a table of what was tried."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from hyst_control.base import progress
from hyst_control.base.errors import InputError
from hyst_control.identify.data.fit import Fit, TriedRow

AS_GOOD = 0.01
"""The model with fewest parameters is taken of those whose error exceeds the least one by no more than this share."""
POOR = 0.5  # Held-out NRMSE, % of the range, above which the families of the second choice are tried as well
USELESS = "its simulation of the whole records explains less than a constant and a gain"
"""Why a family that does well on held-out rows is passed over."""


def best_family(
    families: Sequence[str],
    identify: Callable[[str], Fit],
    further: Callable[[Fit], Sequence[str]] = lambda fit: (),
    explains: Callable[[Fit], bool] = lambda fit: True,
) -> Fit:
    """Identify every family and take the plainest of those that do best on held-out rows.

    Where none of them does well, the first one that is named for the best one, and has not been tried, is tried, until one does.
    """
    rows: list[TriedRow] = []
    fits: dict[str, Fit] = {}
    useful: set[str] = set()
    errors: list[InputError] = []

    def attempt(family: str) -> None:
        progress.step(f"try {family}")
        begin = time.perf_counter()
        try:
            fits[family] = identify(family)
        except InputError as error:
            errors.append(error)
            rows.append(_row(family, None, time.perf_counter() - begin, str(error)))
        else:
            of_use = explains(fits[family])
            useful.update([family] if of_use else [])
            rows.append(_row(family, fits[family], time.perf_counter() - begin, "" if of_use else USELESS))

    def scored() -> dict[str, float]:
        """Held-out errors by family, of those whose simulation is of use; of all where none is."""
        errors = {row["family"]: row["held_out_nrmse"] for row in rows if row["held_out_nrmse"] is not None}
        return {name: error for name, error in errors.items() if name in useful} or errors

    for family in families:
        attempt(family)
    if not fits:
        raise errors[0]

    def best() -> str:
        scores = scored()
        return min(scores, key=lambda name: scores[name])

    def is_poor() -> bool:
        return not useful or scored()[best()] > POOR

    while is_poor() and (due := [name for name in further(fits[best()]) if name not in {row["family"] for row in rows}]):
        attempt(due[0])
    scores = scored()
    limit = (1.0 + AS_GOOD) * min(scores.values())
    counts = {row["family"]: row["parameters"] for row in rows}
    chosen = min(
        (family for family, score in scores.items() if score <= limit), key=lambda family: (counts[family], scores[family])
    )
    for row in rows:
        row["chosen"] = row["family"] == chosen
    fit = fits[chosen]
    return replace(fit, report={**fit.report, "tried": rows})


def _row(family: str, fit: Fit | None, seconds: float, refused: str) -> TriedRow:
    return {
        "family": family,
        "structure": _structure(fit) if fit else "",
        "parameters": len(fit.report["parameters"]) if fit else 0,
        "held_out_nrmse": max(fit.report.get("held_out_nrmse", ()), default=None) if fit else None,
        "seconds": seconds,
        "chosen": False,
        "refused": refused,
        "structures": fit.report.get("structures", []) if fit else [],
    }


def _structure(fit: Fit) -> str:
    states = fit.report.get("states")
    return "; ".join(fit.report.get("structure", [])) or (f"{states} states" if states else "")


def choice_lines(rows: Sequence[TriedRow]) -> list[str]:
    """The table of what was tried, as text."""
    width = max(len(row["family"]) for row in rows)
    lines = [f"  {'family':{width + 2}}  parameters  held-out NRMSE  seconds  structure"]
    for row in rows:
        mark = "*" if row["chosen"] else " "
        error = "-" if row["held_out_nrmse"] is None else f"{row['held_out_nrmse']:.3f} %"
        words = row["refused"] or row["structure"] or "no dynamics"
        lines.append(f"  {mark} {row['family']:{width}}  {row['parameters']:10d}  {error:>14}  {row['seconds']:7.1f}  {words}")
    return lines
