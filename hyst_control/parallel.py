"""Independent pieces of one computation on all cores, by forking: nothing needs to be copied or pickled on the way in."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

PARENT_DEATH_SIGNAL = 1  # of prctl(2)

_work: Callable[[int], Any] | None = None


def forked(work: Callable[[int], Any], count: int) -> Iterator[Any]:
    """work(0), work(1), … in order; in this process where there is one core, or threads that a fork would leave behind."""
    global _work
    workers = min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 1, count)
    alone = workers < 2 or threading.active_count() > 1 or multiprocessing.current_process().daemon
    if alone or "fork" not in multiprocessing.get_all_start_methods():
        yield from map(work, range(count))
        return
    _work = work
    with multiprocessing.get_context("fork").Pool(workers, _quietly) as pool:
        yield from pool.imap(_call, range(count))
        pool.close()  # its workers end by themselves, also one that has only begun
        pool.join()


def _quietly() -> None:
    """A worker ends when it is told to, without the word that the command line has for the user; Ctrl-C is its parent's to answer.

    It ends with its parent, also when that is killed: nobody else would tell it that there is nothing more to do.
    """
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PARENT_DEATH_SIGNAL, signal.SIGKILL)


def _call(index: int) -> Any:
    return _work(index)  # type: ignore[misc]
