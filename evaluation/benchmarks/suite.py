# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst bench`: speed of kernels, bags and the running loop on this machine, and what intervals hold, as a result table."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from evaluation.benchmarks import bags, coverage, exported, kernels, long_records, loops, round_trips, workflows
from hyst_control.base import progress
from hyst_control.base.errors import InputError
from hyst_control.reporting.tables import Table

GROUPS: dict[str, Callable[[Table], None]] = {
    "kernels": kernels.run,
    "exported": exported.run,
    "bags": bags.run,
    "loops": loops.run,
    "coverage": coverage.run,
    "round_trips": round_trips.run,
    "workflows": workflows.run,
}
"""Groups that are run where none is named."""

NAMED_ONLY: dict[str, Callable[[Table], None]] = {"dashboard": loops.dashboard}
"""Groups that are run only when they are asked for, the dashboard as a part of loops."""

LONG_RUNS = {"lockstep": loops.soak_lockstep, "wall-clock": loops.soak_wall_clock}
"""Long runs by name, which are run only when they are asked for."""


def run(
    only: str | None = None, seconds: float = loops.SECONDS, soak: float | None = None, minutes: Sequence[float] | None = None
) -> Table:
    """Run all groups of benchmarks, or one of them."""
    table = Table("bench")
    for name, value in (("seconds", seconds), ("soak", soak), *(("minutes", length) for length in minutes or ())):
        if value is not None and not 0 < value < 1e6:
            raise InputError(f"{name}: must be > 0 and < 1e6, got {value!r}")
    if only in LONG_RUNS:
        LONG_RUNS[only](table, **({} if soak is None else {"minutes": soak}))
    elif soak is not None:
        raise InputError("soak: goes with --only lockstep or wall-clock")
    elif minutes is not None:
        long_records.run(table, minutes)
    else:
        for name in GROUPS if only is None else (only,):
            progress.step(name.replace("_", " "))
            options = {"seconds": seconds} if name in ("loops", "dashboard") else {}
            (GROUPS | NAMED_ONLY)[name](table, **options)
    return table
