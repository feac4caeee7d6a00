# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Worker processes for computations, started here only.

Workers compute serially inside, end with their parent, also when that
is killed, and end at once when the work is canceled (an error, Ctrl-C). A worker that is killed ends the work in a `WorkerLost`; of
many independent jobs (`outcomes`) it costs one.
"""

from __future__ import annotations

import ctypes
import gc
import io
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeAlias, TypeVar, cast

from hyst_control.base.cluster import cluster_executor
from hyst_control.base.errors import InputError, WorkerLost

PARENT_DEATH_SIGNAL = 1  # of prctl(2)
JOBS_PER_WORKER = 100
"""Number of jobs after which a worker of `map_spawned` is replaced, so that memory leaks of libraries do not accumulate."""

Job = TypeVar("Job")
Result = TypeVar("Result")

LOST_WORKER = "a worker process was killed, possibly for lack of memory: free memory and run the command again"

_Answer: TypeAlias = tuple[object, Exception | None, str]

_serial = False
_team: _Team | None = None  # Processes of `forked`


class WaitingThread(threading.Thread):
    """Thread that waits for a file all its life and holds no lock, so that a fork may leave it behind."""


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compute_serially() -> None:
    """Let `map_forked` and `map_spawned` compute in this process from now on: others like it keep all cores busy."""
    global _serial
    _serial = True


@contextmanager
def executor(workers: int, serial: bool = True) -> Iterator[Executor]:
    """Provide fresh worker processes for independent pieces of a computation."""
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin_worker, (serial,))
    try:
        yield pool
    except BaseException as error:
        # A broken pool ends its workers itself, but not one that is being started meanwhile, for which it would then wait.
        for worker in set(multiprocessing.active_children()) - others:
            worker.kill()
        # Work that is given to a pool in the moment in which it breaks meets a pipe that is closed already.
        if isinstance(error, BrokenProcessPool) or (isinstance(error, OSError) and _is_broken(pool)):
            raise WorkerLost(LOST_WORKER) from None
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def _is_broken(pool: ProcessPoolExecutor) -> bool:
    try:
        pool.submit(int)
    except BrokenProcessPool:
        return True
    except (OSError, RuntimeError):
        pass
    return False


def map_forked(work: Callable[[int], Result], count: int) -> Iterator[Result]:
    """Compute work(0), work(1), ... in order, by forking on all cores where that is safe: no arguments are copied or pickled."""
    workers = min(cores(), count)
    if not _may_fork(workers):
        yield from map(work, range(count))
        return
    with closing(_Team((work,), workers)) as team:
        yield from team.map(work, [(index,) for index in range(count)])


@contextmanager
def forked(known: Sequence[object]) -> Iterator[None]:
    """Let `map_known` compute in processes that are forked now, where that is safe; they have `known` already, as it is now."""
    global _team
    if _team is not None or not _may_fork(cores()):
        yield
        return
    with closing(_Team(known, cores())) as _team:
        try:
            yield
        finally:
            _team = None


def known_workers() -> int:
    """Number of jobs that `map_known` computes at a time."""
    return len(_team.lines) if _team else 1


def map_known(work: Callable[..., Result], jobs: Sequence[tuple[Any, ...]]) -> list[Result]:
    """Compute work(*job) for all jobs, in the processes of `forked`, to which only what they do not have is sent."""
    global _team
    if _team is None or len(jobs) < 2:
        return [work(*job) for job in jobs]
    team, _team = _team, None
    found = list(team.map(work, jobs))
    _team = team  # not after an error: what others still compute would be taken for answers to the next jobs
    return found


class Beside(Generic[Result]):
    """Result of a computation that goes on in another process."""

    def __init__(self, work: Callable[[], Result], line: _Line | None = None) -> None:
        self._line, self._answer = line, None if line else _answer(work)
        if line:
            line.send((work, ()))

    def is_known(self) -> bool:
        """True when the computation has ended."""
        return self._line is None or self._answer is not None or self._line.pipe.poll()

    def result(self) -> Result:
        """Wait for the result, or raise the error that the computation has ended in."""
        if self._answer is None:
            assert self._line is not None
            self._answer = self._line.receive()
        return cast(Result, _result_of(self._answer))


@contextmanager
def beside(work: Callable[[], Result]) -> Iterator[Beside[Result]]:
    """Compute work() in a process that is forked now while this one goes on; where that is not safe, before it goes on."""
    if not _may_fork(cores()):
        yield Beside(work)
        return
    with closing(_Team((work,), 1)) as team:
        yield Beside(work, *team.lines)


def in_thread(work: Callable[[], Result]) -> Callable[[], Result]:
    """Compute work(), which lets go of the interpreter, in a thread that ends with it; what is returned waits for the result."""
    pool = ThreadPoolExecutor(1)
    result = pool.submit(work).result
    pool.shutdown(wait=False)
    return result


def _may_fork(workers: int) -> bool:
    """Check that several processes may be forked: none is computing beside this one, and no thread holds a lock."""
    others = [thread for thread in threading.enumerate() if not isinstance(thread, WaitingThread)]
    alone = _serial or workers < 2 or len(others) > 1 or multiprocessing.current_process().daemon
    return not alone and "fork" in multiprocessing.get_all_start_methods()


class _Team:
    """Forked processes that compute, a job at a time, for the one that started them."""

    def __init__(self, known: Sequence[object], count: int) -> None:
        self._workers: dict[_Line, BaseProcess] = {}
        context = multiprocessing.get_context("fork")
        for _ in range(count):
            here, there = context.Pipe()
            worker = context.Process(target=_serve, args=(_Line(there, known),), daemon=True)
            worker.start()
            there.close()  # so that the line ends with the worker
            self._workers[_Line(here, known)] = worker

    @property
    def lines(self) -> list[_Line]:
        """Connections to the processes."""
        return list(self._workers)

    def map(self, work: Callable[..., Result], jobs: Sequence[tuple[Any, ...]]) -> Iterator[Result]:
        """Results of work(*job), in order."""
        waiting, idle = deque(enumerate(jobs)), self.lines
        under_way: dict[_Line, int] = {}
        done: dict[int, Any] = {}
        for index in range(len(jobs)):
            while index not in done:
                while idle and waiting:
                    line, (number, job) = idle.pop(), waiting.popleft()
                    line.send((work, job))
                    under_way[line] = number
                ready = connection.wait([line.pipe for line in under_way])
                for line in [line for line in under_way if line.pipe in ready]:
                    done[under_way.pop(line)] = _result_of(line.receive())
                    idle.append(line)
            yield done.pop(index)

    def close(self) -> None:
        """End the processes, whatever they do, and without a word."""
        for line, worker in self._workers.items():
            worker.kill()
            line.pipe.close()
        for worker in self._workers.values():
            worker.join()


class _Line:
    """A connection between processes, through which objects that both know go as numbers."""

    def __init__(self, pipe: connection.Connection, known: Sequence[object]) -> None:
        self.pipe, self._known = pipe, known
        self._numbers = {id(one): number for number, one in enumerate(known)}

    def send(self, message: object) -> None:
        """Send an object."""
        file = io.BytesIO()
        pickler = pickle.Pickler(file, pickle.HIGHEST_PROTOCOL)
        pickler.persistent_id = lambda one: self._numbers.get(id(one))  # type: ignore[method-assign]
        pickler.dump(message)
        try:
            self.pipe.send_bytes(file.getbuffer())
        except OSError:
            raise WorkerLost(LOST_WORKER) from None

    def receive(self) -> Any:
        """Receive an object."""
        try:
            unpickler = pickle.Unpickler(io.BytesIO(self.pipe.recv_bytes()))
        except (OSError, EOFError):
            raise WorkerLost(LOST_WORKER) from None
        unpickler.persistent_load = self._known.__getitem__  # type: ignore[method-assign]
        return unpickler.load()


def _serve(line: _Line) -> None:
    """Compute what is sent, as a worker of a team."""
    global _team
    _team = None
    _begin_worker(True)
    while True:
        line.send(_answer(*line.receive()))


def _answer(work: Callable[..., object], job: Sequence[Any] = ()) -> _Answer:
    """The result of a job, or the error that it ends in and where."""
    try:
        return work(*job), None, ""
    except Exception as error:
        return None, error, traceback.format_exc()


def _result_of(answer: _Answer) -> object:
    result, error, trace = answer
    if error is not None:
        raise error from RuntimeError(f"in a worker process:\n{trace}")
    return result


def map_spawned(work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[Result]:
    """Compute work(job) in order, on all cores, in fresh processes: for jobs of seconds to minutes."""
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


@dataclass(frozen=True)
class Workers:
    """Place where many independent jobs are computed."""

    count: int | None = None  # Processes of this computer; None: one a core
    # Address of a Dask scheduler, path of its scheduler file, or "local"; None: processes of this computer, without Dask
    cluster: str | None = None

    def __post_init__(self) -> None:
        if self.count is not None and self.count < 1:
            raise InputError(f"--workers: must be at least 1, got {self.count}")
        if self.count is not None and self.cluster not in (None, "local"):
            raise InputError("--workers: a cluster that is running has its own number of workers: leave it out")

    @contextmanager
    def open(self) -> Iterator[tuple[Executor, Callable[[], int]]]:
        """Provide the executor, and a function that returns the number of jobs that it computes at the same time."""
        count = self.count or cores()
        if self.cluster is not None:
            with cluster_executor(self.cluster, count) as opened:
                yield opened
            return
        with executor(count) as pool:
            yield pool, lambda: count


@dataclass(frozen=True)
class Outcome(Generic[Job, Result]):
    """End of a job."""

    job: Job  # The job
    result: Result | None  # Its result; None where it failed
    reason: str = ""  # Why it failed; "" where it did not


ATTEMPTS = 2  # Times that a job is tried
AHEAD = 3
"""Jobs submitted for every one that can be computed at a time: what waits keeps the workers busy, and memory flat."""
REOPENED = 5
"""Times in a row that workers are started or a scheduler is looked for again, without a job done in between."""


def outcomes(work: Callable[[Job], Result], jobs: Iterable[Job], workers: Workers) -> Iterator[Outcome[Job, Result]]:
    """Compute work(job) for many jobs, in the order in which they end; each costs at most itself.

    A job that fails is tried once more. Where a worker is killed, nobody knows by which of the jobs under way: they are computed
    one at a time until the guilty one is found, on a cluster when the others are done. Where a cluster's scheduler is lost, it is
    looked for again.
    """
    source = iter(jobs)
    again: deque[tuple[Job, int]] = deque()
    suspects: deque[tuple[Job, int]] = deque()
    fruitless = 0
    while True:
        under_way: dict[Future[Result], tuple[Job, int]] = {}
        try:
            with workers.open() as (pool, slots):
                for outcome in _drive(pool, slots, work, source, again, suspects, under_way):
                    fruitless = 0
                    yield outcome
                return
        except (WorkerLost, _PoolLost, InputError) as error:
            if isinstance(error, InputError) and not (fruitless or under_way):
                raise
            fruitless += 1
            if fruitless > REOPENED:
                raise WorkerLost(f"workers were lost {fruitless} times in a row ({error}): look after them and run again") from None
            alone = len(under_way) == 1 and workers.cluster is None
            for job, attempt in under_way.values():
                if alone and attempt + 1 >= ATTEMPTS:
                    fruitless = 0
                    yield Outcome(job, None, KILLED)
                else:
                    (suspects if workers.cluster is None else again).append((job, attempt + alone))


class _PoolLost(Exception):
    """The workers as a whole are gone."""


def _drive(
    pool: Executor,
    slots: Callable[[], int],
    work: Callable[[Job], Result],
    source: Iterator[Job],
    again: deque[tuple[Job, int]],
    suspects: deque[tuple[Job, int]],
    under_way: dict[Future[Result], tuple[Job, int]],
) -> Iterator[Outcome[Job, Result]]:
    """Outcomes until nothing is left to do; what is under way stays in `under_way` when the pool is lost."""
    alone = False
    while True:
        if not under_way:
            alone = bool(suspects)
        while len(under_way) < (1 if alone else AHEAD * slots()):
            waiting = suspects if alone else again
            try:
                due = waiting.popleft() if waiting else (next(source), 0)
            except StopIteration:
                break
            try:
                under_way[pool.submit(_serially, work, due[0])] = due
            except (BrokenProcessPool, RuntimeError):
                waiting.appendleft(due)
                raise _PoolLost("no work can be given to it") from None
        if not under_way:
            return
        for future in wait(under_way, return_when=FIRST_COMPLETED).done:
            job, attempt = under_way[future]
            error = CancelledError() if future.cancelled() else future.exception()
            if isinstance(error, (BrokenProcessPool, CancelledError)) or type(error).__name__ in LOST:
                raise _PoolLost(str(error) or type(error).__name__)
            del under_way[future]
            if error is None:
                yield Outcome(job, future.result())
            elif not isinstance(error, Exception):
                raise error
            elif type(error).__name__ == "KilledWorker":
                if alone:  # a cluster blames every job that a killed worker had, the waiting ones too
                    yield Outcome(job, None, KILLED)
                else:
                    suspects.append((job, attempt))
            elif attempt + 1 < ATTEMPTS:
                again.append((job, attempt + 1))
            else:
                yield Outcome(job, None, str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}")


KILLED = "its worker was killed, possibly for lack of memory"
LOST = {"CommClosedError", "FutureCancelledError", "TimeoutError"}
"""Names of a cluster's errors that say that the scheduler is gone, not that a job has failed."""


def _serially(work: Callable[[Job], Result], job: Job) -> Result:
    """Compute a job in a worker that others started: it computes serially inside."""
    compute_serially()
    return work(job)


def _begin_worker(serial: bool) -> None:
    """Set up the signals of a worker: SIGTERM ends it without a message, Ctrl-C is its parent's, and it ends with its parent."""
    global _serial
    _serial = serial
    # What a fork inherits as garbage is its parent's to collect: the objects of a library whose threads are not here must not be touched.
    gc.freeze()
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PARENT_DEATH_SIGNAL, signal.SIGKILL)
    parent = multiprocessing.parent_process()
    if parent is not None and os.getppid() != parent.pid:
        os._exit(1)  # killed before the line above
