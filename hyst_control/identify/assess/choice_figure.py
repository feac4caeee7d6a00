# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Drawing of a model choice: error on held-out rows over the number of parameters, for what was tried."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hyst_control.base.errors import InputError

if TYPE_CHECKING:
    from hyst_control.reporting.signal_figures import Line, Panel


def choice_panels(report: Mapping[str, Any]) -> list[Panel]:
    """Families and structures of G(s) that a fit report has, or the orders of a linear model; small dots are what was not chosen."""
    # Here, not above: the families are looked for in every module of this folder, and few runs draw.
    from hyst_control.reporting.signal_figures import Panel

    title = "NRMSE on held-out rows [% of range]"
    if "tried" in report:
        return [Panel("parameters", title, tuple(_of_families(report["tried"])), "y")]
    if "structures" in report:
        names = dict.fromkeys(row["axis"] for row in report["structures"])
        of_axes = {name: [row for row in report["structures"] if row["axis"] == name] for name in names}
        return [Panel("parameters", title, tuple(_of_structures(rows, "")), "y") for rows in of_axes.values()]
    orders = [row for row in report.get("orders", ()) if row["held_out"] is not None]
    if not orders:
        raise InputError(
            f"family {report['family']}: chose among nothing: identify without a family, or with hampi, hapi or linear"
        )
    states = np.array([row["states"] for row in orders], dtype=float)
    lines = [
        _points(name, states, [100.0 * row[key] for row in orders])
        for name, key in (("held-out rows", "held_out"), ("fitted rows", "fitted"))
    ]
    return [Panel("states", "rms error [% of rms measurement]", tuple(lines), "y")]


def _of_families(rows: Sequence[Mapping[str, Any]]) -> Iterator[Line]:
    for row in rows:
        if row["held_out_nrmse"] is not None:
            name = f"{row['family']}, {row['seconds']:.1f} s" + (" (chosen)" if row["chosen"] else "")
            yield _points(name, [row["parameters"]], [row["held_out_nrmse"]], "x" if row["chosen"] else "o")
            yield from list(_of_structures(row["structures"], f"{row['family']}: "))[:1]


def _of_structures(rows: Sequence[Mapping[str, Any]], before: str) -> Iterator[Line]:
    """Those that were not chosen, and the chosen one."""
    for chosen in (False, True):
        found = [row for row in rows if row["chosen"] is chosen and row["held_out_nrmse"] is not None]
        name = "chosen: " + ", ".join(row["structure"] for row in found) if chosen else f"{before}structures of G(s)"
        if found:
            yield _points(
                name, [row["parameters"] for row in found], [row["held_out_nrmse"] for row in found], "x" if chosen else "."
            )


def _points(name: str, x: Any, y: Any, marker: str = "o") -> Line:
    from hyst_control.reporting.signal_figures import Line

    return Line(name, np.asarray(x, dtype=float), np.asarray(y, dtype=float), True, marker)
