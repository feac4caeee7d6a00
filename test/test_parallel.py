# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Pieces of a computation on all cores, as the command line runs them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

BEGIN = """
import os, signal, sys, time
from hyst_control.base.errors import WorkerLost
from hyst_control.base.parallel import beside, executor, forked, map_forked, map_known, map_spawned
os.sched_getaffinity = lambda process: {0, 1}
signal.signal(signal.SIGINT, signal.default_int_handler)  # also where the tests run in the background

def killed_at_three(i):
    if i == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return i * i

def inside(i):
    return [list(each(os.getpid)) for each in (lambda f: map_forked(lambda _: f(), 3), lambda f: map_spawned(pid, range(3)))], os.getpid()

def pid(_):
    return os.getpid()

def slow(i):
    os.write(1, f"{os.getpid()}\\n".encode())
    time.sleep(1000)
"""

WORDLESS = """
signal.signal(signal.SIGTERM, signal.default_int_handler)
for _ in range(5):
    assert list(map_forked(lambda i: i * i, 7)) == [i * i for i in range(7)]
"""

KILLED = """
if __name__ == "__main__":
    found = []
    try:
        for value in {each}(killed_at_three, range(8) if {each} is map_spawned else 8):
            found.append(value)
    except WorkerLost as error:
        assert "killed" in str(error)
        print(found == [0, 1, 4][:len(found)])
"""

SERIAL = """
if __name__ == "__main__":
    for each in (map_forked(inside, 2), map_spawned(inside, range(2))):
        for lists, worker in each:
            assert lists == [[worker] * 3] * 2 and worker != os.getpid()
    print(list(map_spawned(pid, range(1))) == [os.getpid()])
"""

KNOWN = """
class Held:
    __reduce__ = None  # cannot be sent

held = Held()

def squared(one, i):
    return one if i == 2 else i * i, os.getpid()

def failing(one, i):
    if i == 0:
        raise ValueError("at 0")
    time.sleep(0.3)
    return one, os.getpid()

before = list(range(3))
with forked([held, before]):
    for _ in range(2):
        found = map_known(squared, [(held, i) for i in range(8)])
        assert [value for value, _ in found] == [held if i == 2 else i * i for i in range(8)]
        assert len({worker for _, worker in found} - {os.getpid()}) == 2
    before.append(3)
    assert map_known(len, [(before,)] * 2) == [3, 3]  # as they were when they were forked
    assert map_known(squared, [(held, 1)]) == [(1, os.getpid())]
    try:
        map_known(failing, [(held, 0), (held, 1), (held, 2)])
    except ValueError as error:
        print(error, "in failing" in str(error.__cause__))
    assert map_known(squared, [(held, i) for i in (1, 3)]) == [(1, os.getpid()), (9, os.getpid())]
assert map_known(squared, [(held, i) for i in (1, 3)]) == [(1, os.getpid()), (9, os.getpid())]
"""

BESIDE = """
with beside(lambda: (os.getpid(), time.sleep(0.2))) as one, beside(lambda: 1 / 0) as other:
    began = one.is_known()
    assert one.result()[0] != os.getpid() and one.is_known() and one.result() == one.result() and not began
    for _ in range(2):
        try:
            other.result()
        except ZeroDivisionError as error:
            print("lambda" in str(error.__cause__))
try:
    with beside(lambda: os.kill(os.getpid(), signal.SIGKILL)) as lost:
        lost.result()
except WorkerLost:
    print("lost")
begun = time.monotonic()
with beside(lambda: time.sleep(1000)):
    pass
assert time.monotonic() - begun < 100
"""

KILLED_AT_START = """
from concurrent.futures import wait
from multiprocessing.context import SpawnProcess
begun, futures, start = [], [], SpawnProcess.start

def start_and_kill_the_first(process):
    start(process)
    begun.append(process)
    if len(begun) == 2:
        begun[0].kill()
        wait(futures, timeout=5.0)  # until the pool knows

if __name__ == "__main__":
    SpawnProcess.start = start_and_kill_the_first
    try:
        with executor(2) as pool:
            futures.append(pool.submit(slow, 0))
            futures.append(pool.submit(slow, 1))
            futures[1].result()
    except WorkerLost as error:
        print("killed" in str(error))
"""

ENDLESS = """
if __name__ == "__main__":
    list({each}(slow, range(2) if {each} is map_spawned else 2))
"""


def run(program: str, folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "program.py").write_text(BEGIN + program)
    return subprocess.run([sys.executable, folder / "program.py"], capture_output=True, text=True, timeout=120, check=False)


def test_workers_end_without_a_word_where_the_command_line_catches_the_signal(tmp_path):
    """The command line turns the signal that ends a process into an interrupt: workers that end by it would print tracebacks."""
    done = run(WORDLESS, tmp_path)
    assert done.returncode == 0 and done.stderr == ""


@pytest.mark.parametrize("each", ["map_forked", "map_spawned"])
def test_a_killed_worker_ends_the_work_in_one_error(tmp_path, each):
    """A pool that starts another worker in its place would wait for the lost result without end."""
    done = run(KILLED.format(each=each), tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "True\n", "")


def test_workers_hold_what_they_know_and_answer_in_order(tmp_path):
    """After an error the rest is computed in the process itself: nothing waits for answers to jobs that were given up."""
    done = run(KNOWN, tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "at 0 True\n", "")


def test_a_computation_beside_gives_its_result_its_error_or_its_end(tmp_path):
    done = run(BESIDE, tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "True\nTrue\nlost\n", "")


def test_a_worker_killed_while_another_one_starts_ends_the_work_too(tmp_path):
    """The pool has ended its workers by then, and would wait for the one that it did not know.

    Its own thread may say that its table of workers grew while it read it (CPython 3.11 does); the work has ended in one error by then.
    """
    done = run(KILLED_AT_START, tmp_path)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (0, "True")
    assert not done.stderr or done.stderr.endswith("RuntimeError: dictionary changed size during iteration\n")


def test_workers_are_serial_inside(tmp_path):
    done = run(SERIAL, tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "True\n", "")


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGKILL])
@pytest.mark.parametrize("each", ["map_forked", "map_spawned"])
def test_workers_end_with_their_parent(tmp_path, each, ending):
    """Ctrl-C, or its death: both workers are busy for as long as the test would wait."""
    (tmp_path / "program.py").write_text(BEGIN + ENDLESS.format(each=each))
    begun = subprocess.Popen(
        [sys.executable, tmp_path / "program.py"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    assert begun.stdout is not None
    assert len({int(begun.stdout.readline()) for _ in range(2)}) == 2
    begun.send_signal(ending)
    _, told = begun.communicate(timeout=120)  # the pipes close when the last worker has ended
    assert begun.returncode == -ending and told.count("Traceback") == (ending == signal.SIGINT)


BREAKING = """
with executor(2) as pool:
    lost = [pool.submit(os.getpid).result(), pool.submit(killed_at_three, 3)]
    lost[1].exception()
    raise OSError("handle is closed")
"""
INTACT = """
with executor(2) as pool:
    pool.submit(os.getpid).result()
    raise OSError("the disk is full")
"""


@pytest.mark.parametrize(
    ("program", "told"), [(BREAKING, "WorkerLost: a worker process was killed"), (INTACT, "OSError: the disk is full")]
)
def test_a_pipe_that_a_lost_worker_leaves_closed_is_told_as_that(tmp_path, program, told):
    """A race within the pool: work that is given to it in the moment in which it breaks."""
    indented = program.replace("\n", "\n    ")
    done = run(f"if __name__ == '__main__':{indented}\n", tmp_path)
    assert done.returncode == 1 and told in done.stderr.splitlines()[-1]


def workers_of(process: int) -> Iterator[int]:
    """Processes that compute for a process, without those that only clean up after it."""
    try:
        children = Path(f"/proc/{process}/task/{process}/children").read_text().split()
        for child in map(int, children):
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                yield child
    except OSError:
        return


def test_a_command_whose_worker_is_killed_ends_with_one_line(tmp_path):
    """As the kernel kills where memory runs out: with SIGKILL, from outside."""
    if len(os.sched_getaffinity(0)) < 2:
        pytest.skip("one core: the command starts no workers")
    main = "import sys; from hyst_control.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", main, "cases", "make", "--seed", "7", "--count", "40"]
    chosen = ["--plants", "pea_published", "--output", str(tmp_path / "out")]
    begun = subprocess.Popen([*command, *chosen], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 120.0
    while not (found := list(workers_of(begun.pid))):
        assert begun.poll() is None and time.monotonic() < until
        time.sleep(0.01)
    os.kill(found[0], signal.SIGKILL)
    _, told = begun.communicate(timeout=120)
    assert begun.returncode == 2, told
    assert told.startswith("hyst cases: a worker process was killed") and told.count("\n") == 1


GARBAGE = """
import gc, os
from hyst_control.base.parallel import map_forked
os.sched_getaffinity = lambda process: {0, 1}
parent = os.getpid()

class Held:
    def __del__(self):
        if os.getpid() != parent:
            os.abort()  # as a library does that finds none of its threads

one = Held()
one.itself = one
gc.disable()
del one
print(list(map_forked(lambda i: (gc.collect(), i)[1], 4)))
"""


def test_a_worker_leaves_its_parents_garbage_alone():
    """Objects of a library that are destroyed in a fork, without the library's threads, end the worker by a segmentation fault."""
    result = subprocess.run([sys.executable, "-c", GARBAGE], capture_output=True, text=True, timeout=60)
    assert result.stdout.strip() == "[0, 1, 2, 3]", result.stderr
