# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of the figures of `hyst bench`: the same work on this machine, in the same run, by bare C, the memory, or the system alone."""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
import time
from functools import cache
from pathlib import Path

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.control.feedback.pi import constants_of
from hyst_control.export.compiled import c_compiler
from hyst_control.export.controller import Controller
from hyst_control.reporting.tables import Limit

FREE = (
    "-fassociative-math",
    "-freciprocal-math",
    "-ffinite-math-only",
    "-fno-signed-zeros",
    "-fno-trapping-math",
    "-fno-math-errno",
)
"""Flags of -ffast-math one by one: the flag itself adds start code by which the whole process takes subnormal numbers for 0."""
FAST = ("-O3", "-march=native", *FREE)
REPEATS, ROUNDS = 30, 20_000
SECONDS = 3.0
"""Time for which the bare timer runs."""


def wakes(rate: float, seconds: float, priority: int = 0) -> tuple[Array, float, bool]:
    """Times (s) at which a bare timer wakes, its share of a core, and whether it runs under SCHED_FIFO, where the system allows it."""
    awake, realtime = np.empty(round(rate * seconds)), ctypes.c_int()
    load = _library().timer(1.0 / rate, len(awake), priority, awake, ctypes.byref(realtime))
    return awake, load, bool(realtime.value)


@cache
def timer(rate: float, priority: int = 0) -> dict[str, Limit]:
    """Load and percentiles of the period of a bare timer, by quantity."""
    awake, load, realtime = wakes(rate, SECONDS, priority)
    of = f"bare timerfd{f', SCHED_FIFO {priority}' if realtime else ''}"
    periods = {f"period_p{part:g}": np.percentile(1e6 * np.diff(awake), part) for part in (50.0, 99.0, 99.9)}
    return {name: Limit(float(value), of) for name, value in {"cpu": 100.0 * load, **periods}.items()}


@cache
def ring(processes: int) -> Limit:
    """Rounds per second of processes that wake each other in turn."""
    return Limit(1.0 / _library().ring(processes, ROUNDS), f"{processes} processes that wake each other by eventfd")


def reading(table: Array) -> Limit:
    """Seconds of one pass over an array or a mapped file, the best of three."""
    spent = []
    for _ in range(3):
        begin = time.perf_counter()
        np.add.reduce(table, axis=None)
        spent.append(time.perf_counter() - begin)
    return Limit(min(spent), "one pass over the data")


def copying(folder: Path) -> tuple[Limit, Limit]:
    """Seconds of writing the bytes of a folder's files to a file, and of reading that, the best of three."""
    content, copy, spent = b"".join(file.read_bytes() for file in folder.iterdir()), folder / "copy", []
    for _ in range(3):
        clocks = [time.perf_counter()]
        for work in (lambda: copy.write_bytes(content), copy.read_bytes):
            work()
            clocks.append(time.perf_counter())
        spent.append(np.diff(clocks))
    written, read = np.min(spent, axis=0)
    return Limit(float(written), "the same bytes to a file"), Limit(float(read), "the same bytes from a file")


def hampi_step(controller: Controller, rows: Array) -> tuple[Limit, Array]:
    """Microseconds of a step of HAMPI's settled feedforward and PI feedback in C for it alone, the best of several, and its commands."""
    linear, inverse = controller.c_code().parts[0].parts[:2]
    a, b, c, d = (linear.constants[name].value for name in "abcd")
    plays = [inverse.constants[name].value for name in ("thresholds", "release", "weights", "w0", "m1", "m2", "k", "b")]
    rate = [inverse.constants[name].value for name in ("gain", "rate_factor", "most")]
    memory = [linear.state["x"].value, rows[0, 0], *(inverse.state[name].value for name in ("operators", "previous", "command"))]
    parts = [a, b[0, 1], c, d[0, 0], *plays, *rate, constants_of(controller.pi)[:6], *memory, np.zeros(2)]
    start, command, spent = np.concatenate([np.ravel(part) for part in parts]), np.empty(len(rows)), []
    reference, measurement = np.ascontiguousarray(rows[:, :2].T)
    library = _library(a.shape[1], plays[0].shape[1], inverse.sizes["ITERATIONS"])
    for _ in range(REPEATS):
        begin = time.thread_time()
        library.loop(len(rows), controller.ahead, reference, measurement, start.copy(), command)
        spent.append(time.thread_time() - begin)
    return Limit(1e6 * min(spent) / len(rows), "C written for this case alone"), command


def compiled(source: str, *flags: str) -> ctypes.CDLL:
    """A library from a C file beside this one."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "library.so"
        subprocess.run([c_compiler(), *flags, "-shared", "-fPIC", "-o", target, Path(__file__).with_name(source)], check=True)
        return ctypes.CDLL(str(target))


@cache
def _library(order: int = 1, plays: int = 1, turns: int = 1) -> ctypes.CDLL:
    """The compiled `limits.c`, for the sizes of a controller."""
    library = compiled("limits.c", *FAST, f"-DORDER={order}", f"-DPLAYS={plays}", f"-DTURNS={turns}")
    array = np.ctypeslib.ndpointer(np.float64, flags="C")
    library.ring.restype = library.timer.restype = ctypes.c_double
    library.timer.argtypes = [ctypes.c_double, ctypes.c_int, ctypes.c_int, array, ctypes.c_void_p]
    library.loop.argtypes = [ctypes.c_int, ctypes.c_int, array, array, array, array]
    return library
