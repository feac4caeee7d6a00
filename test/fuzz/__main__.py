"""`make fuzz`: many random inputs to everything that reads files or messages. An argument says how many (default 100000)."""

from __future__ import annotations

import faulthandler
import resource
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from targets import TARGETS

HANG = 60.0
"""s that one input may take; it is interrupted then, and the process ended where it does not take notice."""

GROWTH = 500 * 2**20
"""Bytes by which a target's inputs may make the process grow."""


class Hang(BaseException):
    """An input that took too long; no `Exception`, which a reader may catch."""


def main() -> None:
    """Run all targets, each with its share of the inputs; the first failure ends it with the input that failed."""
    total = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    for name, (inputs, reader, share) in TARGETS.items():
        begin, size = time.monotonic(), _largest()
        seen = run(inputs, reader, round(total * share))
        grown = _largest() - size
        print(f"{name}: {seen} inputs, {time.monotonic() - begin:.0f} s, {grown / 2**20:.0f} MiB, none failed", flush=True)
        if grown > GROWTH:
            raise SystemExit(f"{name}: grew by more than {GROWTH / 2**20:.0f} MiB")


def _largest() -> int:
    """Largest size of the process so far, in bytes."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def run(inputs: Any, reader: Callable[[Any], None], count: int) -> int:
    """How many inputs were read; the first failure is raised with the smallest input that shows it."""
    seen = [0]

    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
        phases=(Phase.generate, Phase.shrink),
    )
    @given(inputs)
    def read(value):
        seen[0] += 1
        signal.setitimer(signal.ITIMER_REAL, HANG, 1.0)  # again, where an exception is swallowed
        faulthandler.dump_traceback_later(2 * HANG, exit=True)
        try:
            reader(value)
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            faulthandler.cancel_dump_traceback_later()

    def hang(*_: Any) -> None:
        raise Hang(f"longer than {HANG:g} s")

    before = signal.signal(signal.SIGALRM, hang)
    try:
        read()
    finally:
        signal.signal(signal.SIGALRM, before)
    return seen[0]


if __name__ == "__main__":
    main()
