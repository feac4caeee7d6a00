"""Diagnoses of all blind tests in one queue, one process per core, until a given time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from hyst_control.parallel import map_spawned

Job = tuple[Callable[[Any], str], tuple[Any, ...]]
"""Function that makes a report, and what it takes; it returns the name of the case."""


def interleaved(*lists: Sequence[Job]) -> list[Job]:
    """Mix lists evenly, so that a run that is stopped has done the same part of each.

    Parameters
    ----------
    *lists
        Lists of diagnoses.

    Returns
    -------
    list[Job]
        All of them, each list's in its order.
    """
    placed = [((index + 0.5) / len(jobs), job) for jobs in lists for index, job in enumerate(jobs)]
    return [job for _, job in sorted(placed, key=lambda each: each[0])]


def work(jobs: Sequence[Job], until: float | None = None, note: Callable[[str], None] = print) -> None:
    """Do diagnoses, one process per core.

    Parameters
    ----------
    jobs
        The diagnoses.
    until
        Time of the clock at which no further one begins, s; None: all are done.
    note
        Called with every line of progress.
    """
    begin = time.monotonic()
    for done, name in enumerate(map_spawned(_in_time, [(job, until) for job in jobs]), 1):
        if name and (done % 20 == 0 or done == len(jobs)):
            spent = time.monotonic() - begin
            note(f"{done} of {len(jobs)} diagnosed ({name}), {spent:.0f} s, {spent / done * (len(jobs) - done):.0f} s to go")


def _in_time(due: tuple[Job, float | None]) -> str:
    """The name of the case that was diagnosed, "" after the time."""
    (diagnose, arguments), until = due
    return "" if until is not None and time.time() > until else diagnose(arguments)
