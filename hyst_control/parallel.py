"""Worker processes for computations, started here only.

Workers compute serially inside, end with their parent, also when that
is killed, and end at once when the work is canceled (an error, Ctrl-C). A worker that is killed ends the work in a `WorkerLost`.
"""

from __future__ import annotations

import ctypes
import gc
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Literal, TypeVar, cast

from hyst_control.errors import WorkerLost

PARENT_DEATH_SIGNAL = 1  # of prctl(2)
JOBS_PER_WORKER = 100
"""Number of jobs after which a worker of `mapped` is replaced, so that memory leaks of libraries do not accumulate."""

Job = TypeVar("Job")
Result = TypeVar("Result")

_serial = False
_work: Callable[[int], object] | None = None


class WaitingThread(threading.Thread):
    """Thread that waits for a file all its life and holds no lock, so that a fork may leave it behind."""


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def executor(workers: int, start: Literal["spawn", "fork"] = "spawn", serial: bool = True) -> Iterator[Executor]:
    """Provide worker processes for independent pieces of a computation.

    Parameters
    ----------
    workers
        Number of processes.
    start
        "spawn" for fresh interpreters, or "fork" for copies of this process, which begin at once and share its memory.
    serial
        Compute serially in `forked` and `mapped` within a worker.

    Yields
    ------
    Executor
        Executor, which is shut down at the end of the context.

    Raises
    ------
    WorkerLost
        A worker was killed before its work was done.
    """
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context(start), _begin_worker, (serial,))
    try:
        yield pool
    except BaseException as error:
        # A broken pool ends its workers itself, but not one that is being started meanwhile, for which it would then wait.
        for worker in set(multiprocessing.active_children()) - others:
            worker.kill()
        if isinstance(error, BrokenProcessPool):
            raise WorkerLost(
                "a worker process was killed, possibly for lack of memory: free memory and run the command again"
            ) from None
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def forked(work: Callable[[int], Result], count: int) -> Iterator[Result]:
    """Compute work(0), work(1), ... in order, on all cores by forking: no arguments are copied or pickled.

    Computed in this process where there is one core, in a worker, or beside threads that a fork would leave behind.

    Parameters
    ----------
    work
        Any function, also a closure over large arrays; its results are pickled.
    count
        Number of pieces.

    Yields
    ------
    Result
        Results in order.

    Raises
    ------
    WorkerLost
        A worker was killed before its work was done.
    """
    global _work
    workers = min(cores(), count)
    others = [thread for thread in threading.enumerate() if not isinstance(thread, WaitingThread)]
    alone = _serial or workers < 2 or len(others) > 1 or multiprocessing.current_process().daemon
    if alone or "fork" not in multiprocessing.get_all_start_methods():
        yield from map(work, range(count))
        return
    _work = work
    with executor(workers, "fork") as pool:
        waiting = deque(pool.submit(_call, index) for index in range(count))
        while waiting:
            yield cast(Result, waiting.popleft().result())


def mapped(work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
    """Compute work(job) in order, on all cores, in fresh processes: for jobs of seconds to minutes.

    Parameters
    ----------
    work
        A function of a module, which can be pickled.
    jobs
        Its arguments, pickled one by one.

    Yields
    ------
    Result
        Results in order.

    Raises
    ------
    WorkerLost
        A worker was killed before its work was done; the results before have been returned.
    """
    workers = min(cores(), len(jobs))
    if _serial or workers < 2:
        yield from map(work, jobs)
        return
    batch = workers * JOBS_PER_WORKER
    for begin in range(0, len(jobs), batch):
        with executor(workers) as pool:
            waiting = deque(pool.submit(work, job) for job in jobs[begin : begin + batch])
            while waiting:
                yield waiting.popleft().result()


def _begin_worker(serial: bool) -> None:
    """Set up the signals of a worker: SIGTERM ends it without a message, Ctrl-C is handled by its parent.

    It ends with its parent, also when that is killed, since no other process would end it.
    """
    global _serial
    _serial = serial
    # What a fork inherits as garbage is its parent's to collect: the objects of a library whose threads are not here must not be touched.
    gc.freeze()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PARENT_DEATH_SIGNAL, signal.SIGKILL)


def _call(index: int) -> object:
    assert _work is not None
    return _work(index)
