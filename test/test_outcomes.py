"""Many independent jobs: on processes of this computer and on Dask, with jobs that fail and workers that are killed."""

from __future__ import annotations

import os
import queue
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import Future
from contextlib import contextmanager, suppress

import pytest

from hyst_control.base import cluster
from hyst_control.base.parallel import Workers, outcomes

BEGIN = """
import os, signal, sys, time
from pathlib import Path
from hyst_control.base.errors import InputError
from hyst_control.base.parallel import Workers, outcomes

def job(value):
    kind, number, folder = value
    with open(Path(folder) / f"{number}", "a") as file:
        file.write("x")
    if kind == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == "refused":
        raise InputError(f"{number} cannot be read")
    if kind == "once" and os.path.getsize(Path(folder) / f"{number}") == 1:
        raise OSError("the file server is away")
    if kind == "slow":
        time.sleep(0.05)
    return number * number

def shown(found):
    return sorted((outcome.job[1], outcome.result, outcome.reason) for outcome in found)
"""


def run(folder, body, *words):
    script = folder / "script.py"
    script.write_text(textwrap.dedent(BEGIN) + textwrap.dedent(body))
    ended = subprocess.run([sys.executable, str(script), str(folder), *words], capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


MIXED = """
if __name__ == "__main__":
    folder, cluster = sys.argv[1], (sys.argv[2] if len(sys.argv) > 2 else None)
    kinds = {3: "killed", 5: "refused", 6: "once"}
    jobs = [(kinds.get(i, "good"), i, folder) for i in range(20)]
    print(shown(outcomes(job, jobs, Workers(2, cluster))))
"""


@pytest.mark.parametrize("cluster", [[], ["local"]])
def test_a_job_costs_at_most_itself(tmp_path, cluster):
    if cluster:
        pytest.importorskip("distributed")
    found = eval(run(tmp_path, MIXED, *cluster))
    assert [number for number, _, _ in found] == list(range(20))
    failed = {number: reason for number, result, reason in found if result is None}
    assert set(failed) == {3, 5}
    assert "killed" in failed[3] and failed[5] == "5 cannot be read"
    assert all(result == number * number for number, result, _ in found if number not in failed)
    tried = (tmp_path / "5").read_text()
    # Once more, and again without counting where its worker was killed beside it, or the one that was to compute it.
    assert tried in ("xx", "xxx") or (cluster and tried.startswith("xx")), "what fails is tried once more"
    done_once = [number for number in range(20) if number not in (3, 5, 6)]
    if not cluster:  # a cluster computes what a killed worker still held once more
        assert all(len((tmp_path / str(number)).read_text()) <= 3 for number in done_once)


class Blaming:
    """A cluster that gives its worker two jobs at a time, and blames both where one of them kills it, as Dask does."""

    cluster = "tcp://nowhere"

    def __init__(self, killer):
        self.killer, self.due = killer, queue.Queue()
        threading.Thread(target=self.compute, daemon=True).start()

    @contextmanager
    def open(self):
        yield self, lambda: 1
        self.due.put(None)

    def submit(self, function, work, job):
        future = Future()
        self.due.put((future, work, job))
        return future

    def compute(self):
        while (first := self.due.get()) is not None:
            held = [first]
            with suppress(queue.Empty):
                held += [self.due.get(timeout=0.2)]
            dead = any(job == self.killer for _, _, job in held)
            for future, work, job in held:
                if dead:
                    future.set_exception(KilledWorker())
                else:
                    future.set_result(work(job))


class KilledWorker(Exception):
    """Named as Dask's."""


@pytest.mark.parametrize("killer", [0, 3])
def test_a_job_is_taken_for_a_killer_only_where_it_was_alone(killer):
    found = list(outcomes(lambda number: number * number, range(6), Blaming(killer)))
    assert sorted(outcome.job for outcome in found) == list(range(6))
    assert [(outcome.job, "killed" in outcome.reason) for outcome in found if outcome.result is None] == [(killer, True)]


def test_jobs_are_drawn_as_they_are_needed(tmp_path):
    body = """
    if __name__ == "__main__":
        drawn = []
        def jobs():
            for i in range(200):
                drawn.append(i)
                yield "good", i, sys.argv[1]
        most = 0
        for done, _ in enumerate(outcomes(job, jobs(), Workers(2))):
            most = max(most, len(drawn) - done)
        print(most)
    """
    assert int(run(tmp_path, body)) <= 8


def free_port():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


@pytest.fixture
def dask_processes():
    """Start a scheduler and workers as processes of their own; all are ended with the test."""
    pytest.importorskip("distributed")
    running = []

    def start(*words):
        process = subprocess.Popen(
            [sys.executable, "-m", "distributed.cli." + words[0], *words[1:]],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        running.append(process)
        return process

    yield start
    for process in running:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def test_a_scheduler_that_is_lost_is_looked_for_again(tmp_path, dask_processes):
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"

    def cluster():
        scheduler = dask_processes("dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard", "--no-jupyter")
        worker = dask_processes(
            "dask_worker", address, "--host", "127.0.0.1", "--nthreads", "1", "--nworkers", "2", "--no-dashboard"
        )
        return scheduler, worker

    first = cluster()
    body = """
    if __name__ == "__main__":
        jobs = [("slow", i, sys.argv[1]) for i in range(200)]
        found = []
        for outcome in outcomes(job, jobs, Workers(None, sys.argv[2])):
            found.append(outcome)
        print(shown(found))
    """
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent(BEGIN) + textwrap.dedent(body))
    study = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path), address], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while not (tmp_path / "20").exists():  # a fifth of the work is under way
        assert study.poll() is None and time.monotonic() < deadline, (
            study.stderr.read() if study.poll() is not None else "no job began"
        )
        time.sleep(0.02)
    for process in first:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    cluster()
    out, err = study.communicate(timeout=120)
    assert study.returncode == 0, err
    found = eval(out)
    assert [number for number, _, _ in found] == list(range(200))
    assert all(result == number * number for number, result, _ in found)
    twice = [number for number in range(200) if len((tmp_path / str(number)).read_text()) > 1]
    assert len(twice) <= 12, "done again is only what was under way"


def test_workers_that_join_later_are_counted(dask_processes, monkeypatch):
    """Under a batch system they come when they have waited for their turn: what is handed out ahead has to grow with them."""
    monkeypatch.setattr(cluster, "LOOK_AGAIN", 0.05)
    address = f"tcp://127.0.0.1:{(port := free_port())}"
    dask_processes("dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard", "--no-jupyter")
    with Workers(None, address).open() as (_, slots):
        assert slots() == 1  # none yet
        dask_processes("dask_worker", address, "--host", "127.0.0.1", "--nthreads", "3", "--nworkers", "1", "--no-dashboard")
        deadline = time.monotonic() + 60
        while slots() != 3:
            assert time.monotonic() < deadline, "the worker was not counted"
            time.sleep(0.05)
