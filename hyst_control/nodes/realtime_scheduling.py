"""Real-time priority and processor core of the process."""

from __future__ import annotations

import os


def set_scheduler(priority: int, cpu: int) -> str:
    """Ask the system for a priority and a core; the reason why it refuses them, "" when it does not.

    Parameters
    ----------
    priority : int
        Of SCHED_FIFO, 1 to 99; 0 leaves the scheduler as it is.
    cpu : int
        Number of the core that the process is pinned to; -1 leaves it free.
    """
    try:
        if cpu >= 0:
            os.sched_setaffinity(0, {cpu})
        if priority:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        return error.strerror or str(error)
    return ""
