"""Real-time priority and processor core of the process."""

from __future__ import annotations

import os

ANY_CORE = -1
"""No core in particular."""


def set_scheduler(priority: int, cpu: int) -> str:
    """Request a real-time priority and a processor core for this process.

    Parameters
    ----------
    priority : int
        Priority under SCHED_FIFO, 1 to 99; 0 keeps the scheduler.
    cpu : int
        Core to which the process is pinned; `ANY_CORE` for any.

    Returns
    -------
    str
        Reason why the system refuses it; "" when it does not.
    """
    try:
        if cpu != ANY_CORE:
            os.sched_setaffinity(0, {cpu})
        if priority:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        return error.strerror or str(error)
    return ""
