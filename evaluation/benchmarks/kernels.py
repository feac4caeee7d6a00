# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Speed of the chain's compiled kernels beside the same loops in C (gcc -O3)."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluation.benchmarks import limits
from hyst_control.base.arrays import Array
from hyst_control.chain import Sampling
from hyst_control.chain.hysteresis.madelung import Madelung, madelung_branches
from hyst_control.chain.hysteresis.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, dynamic_prandtl_ishlinskii
from hyst_control.chain.linear.linear_kernels import advance_single
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.reporting.tables import Limit, Table

ROWS = 200_000
REPEATS = 9


@dataclass(frozen=True)
class Pair:
    """A kernel of this package and the same loop in C."""

    case: str  # Name of the kernel in the table
    own: Callable[[], Array]  # Runs this package's kernel over `ROWS` samples and returns its output
    other: Callable[[], Array]  # Runs the C loop over the same samples


def run(table: Table) -> None:
    """Add rates of every kernel and of its C counterpart, the best of several runs that alternate, so that a drift of speed meets both."""
    library = limits.compiled("kernels.c", "-O3")
    for pair in (prandtl_ishlinskii(library), linear(library), madelung(library)):
        if not np.allclose(pair.own(), pair.other(), rtol=1e-9, atol=1e-12):
            raise AssertionError(f"{pair.case}: the two kernels do not compute the same")
        times: tuple[list[float], list[float]] = ([], [])
        for _ in range(REPEATS):
            for seconds, call in zip(times, (pair.own, pair.other), strict=True):
                begin = time.perf_counter()
                call()
                seconds.append(time.perf_counter() - begin)
        own, other = (ROWS / min(seconds) for seconds in times)
        limit = Limit(other, "the same loop in C")
        table.add("kernels", pair.case, "hyst", "kernel_rate", "samples/s", own, n=REPEATS, limit=limit)
        table.add("kernels", pair.case, "c", "kernel_rate", "samples/s", other, n=REPEATS)


def prandtl_ishlinskii(library: ctypes.CDLL) -> Pair:
    """Set up HAMPI's modified Prandtl-Ishlinskii model with ten operators on one axis."""
    stage = ModifiedPrandtlIshlinskii(
        np.linspace(0.5, 49.0, 10), np.linspace(0.5, 0.1, 10), m1=7.7e-7, m2=2.5e-7, k=-6.4e-4, b=0.025
    )
    running = stage.filter(Sampling(5e-5, 1))
    command = np.ascontiguousarray(25.0 * (1.0 - np.cos(0.01 * np.arange(ROWS)))).reshape(-1, 1)
    output = np.empty_like(command)
    operators = running.thresholds, running.release, running.weights, *running.coefficients
    arrays = command, running.previous, running.rate_factor, *operators

    def own() -> Array:
        running.settle(command[0])
        dynamic_prandtl_ishlinskii(*arrays, None, running.center, running.state, output)
        return output.copy()

    def other() -> Array:
        running.settle(command[0])
        _call(library.dynamic_prandtl_ishlinskii, ROWS, 1, 10, *arrays, running.state, output)
        return output.copy()

    return Pair("modified_prandtl_ishlinskii", own, other)


def linear(library: ctypes.CDLL) -> Pair:
    """Set up HAMPI's third-order G(s) (HAMPI paper Eq. 1)."""
    running = TransferFunction([-340.5, 4.249e6, 3.461e7], [1.0, 8610.0, 5.989e7, 4.751e8]).filter(Sampling(5e-5, 1))
    block = np.ascontiguousarray(np.sin(0.01 * np.arange(ROWS))).reshape(-1, 1)
    output = np.empty_like(block)
    system = running.a, running.b, running.c, running.d, running.bias
    arrays = (*system, running.whole, running.state, running.scratch, running.history)

    def own() -> Array:
        running.settle(block[0])
        advance_single(block, running.a, running.reach, running.b, running.late, *arrays[2:], 0, output)
        return output.copy()

    def other() -> Array:
        running.settle(block[0])
        _call(library.advance_single, ROWS, 1, running.a.shape[1], len(running.history), block, *arrays, 0, output)
        return output.copy()

    return Pair("transfer_function", own, other)


def madelung(library: ctypes.CDLL) -> Pair:
    """Set up a Madelung hysteresis with the MHL paper's quintic curves (Table 1, scaled to close)."""
    up = np.array([-0.4624, 1.788, -2.398, 2.037, 2.228])
    down = np.array([0.9457, -3.005, 3.248, -2.083, 4.104])
    stage = Madelung(up * 3.2 / up.sum(), down * 3.2 / down.sum(), input_scale=1.0, output_scale=1.0)
    running = stage.filter(Sampling(1e-4, 1))
    k = np.arange(ROWS)
    source = 0.5 - 0.45 * np.cos(0.01 * k) * np.cos(0.00037 * k)
    output = np.empty(ROWS)
    rising, falling = running.rising[0], running.falling[0]
    stack, depth, last = np.zeros((4096, 2)), running.stack_depth[0], running.last[0]

    def start() -> None:
        running.settle(np.zeros(1))
        stack[:2] = running.stack[0][:2]

    def own() -> Array:
        start()
        curves = (*rising, *falling, running.full[0], running.end_slope[0])
        madelung_branches(source, False, curves, (stack, depth, last), output, 0)
        return output.copy()

    def other() -> Array:
        start()
        curves = (rising[1], falling[1], running.full[0], running.end_slope[0])
        _call(library.madelung_branches, ROWS, 5, source, *curves, stack, depth, last, output)
        return output.copy()

    return Pair("madelung", own, other)


def _call(function: Any, *arguments: NDArray[Any] | int | float) -> None:
    """Call a C function with arrays, whole numbers and real numbers."""
    kinds: dict[type, Any] = {int: ctypes.c_long, float: ctypes.c_double, np.float64: ctypes.c_double}
    function(*(ctypes.c_void_p(one.ctypes.data) if isinstance(one, np.ndarray) else kinds[type(one)](one) for one in arguments))
