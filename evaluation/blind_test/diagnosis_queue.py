"""Diagnoses of all blind tests in one queue, one process per core or on a cluster, until a given time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from hyst_control.parallel import Workers, map_spawned, outcomes

Job = tuple[Callable[[Any], str], tuple[Any, ...]]
"""Function that makes a report, and what it takes; it returns the name of the case."""


def interleaved(*lists: Sequence[Job]) -> list[Job]:
    """Mix lists evenly, so that a run that is stopped has done the same part of each."""
    placed = [((index + 0.5) / len(jobs), job) for jobs in lists for index, job in enumerate(jobs)]
    return [job for _, job in sorted(placed, key=lambda each: each[0])]


def work(
    jobs: Sequence[Job], until: float | None = None, note: Callable[[str], None] = print, workers: Workers | None = None
) -> None:
    """Do diagnoses, one process per core or on the workers given."""
    # workers: where they are done; those of a cluster must see the folder of the run under the same path. None: one process per
    # core
    begin = time.monotonic()
    due = [(job, until) for job in jobs]
    for done, name in enumerate(map_spawned(_in_time, due) if workers is None else _names(due, workers, note), 1):
        if name and (done % 20 == 0 or done == len(jobs)):
            spent = time.monotonic() - begin
            note(f"{done} of {len(jobs)} diagnosed ({name}), {spent:.0f} s, {spent / done * (len(jobs) - done):.0f} s to go")


def _names(due: Sequence[tuple[Job, float | None]], workers: Workers, note: Callable[[str], None]) -> Iterator[str]:
    """Names of the cases as they are diagnosed; one that fails costs itself, and the next call does it again."""
    for outcome in outcomes(_in_time, due, workers):
        if outcome.result is None:
            note(f"a case was not diagnosed: {outcome.reason}")
        yield outcome.result or ""


def _in_time(due: tuple[Job, float | None]) -> str:
    """The name of the case that was diagnosed, "" after the time."""
    (diagnose, arguments), until = due
    return "" if until is not None and time.time() > until else diagnose(arguments)
