# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`make fuzz`: many random inputs to everything that reads files or messages. An argument says how many (default 100000).

A part of them is guided: of what came in, that is changed further which reached lines of the package that others did not reach.
"""

from __future__ import annotations

import faulthandler
import resource
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings, target
from targets import TARGETS

import hyst_control

HANG = 60.0
"""s that one input may take; it is interrupted then, and the process ended where it does not take notice."""

GROWTH = 500 * 2**20
"""Bytes by which a target's inputs may make the process grow."""


GUIDED = 0.2
"""Share of the inputs whose lines are followed, which takes several times as long."""
PACKAGE = str(Path(hyst_control.__file__).parent)


class Reached:
    """Lines of the package that an input reaches, and how many inputs before reached each."""

    def __init__(self) -> None:
        self.before: Counter[tuple[CodeType, int]] = Counter()
        self.lines: set[tuple[CodeType, int]] = set()

    def read(self, reader: Callable[[Any], None], value: Any) -> float:
        """Let a reader read; the lines that it reached, the seldom ones counting most."""
        self.lines = set()
        sys.settrace(self._follow)
        try:
            reader(value)
        finally:
            sys.settrace(None)
            self.before.update(self.lines)
        return sum(1.0 / self.before[line] for line in self.lines) + 1e-3 * len(self.lines)

    def _follow(self, frame: FrameType, event: str, _: Any) -> Callable[..., Any] | None:
        if event == "call" and not frame.f_code.co_filename.startswith(PACKAGE):
            return None
        self.lines.add((frame.f_code, frame.f_lineno))
        return self._follow


class Hang(BaseException):
    """An input that took too long; no `Exception`, which a reader may catch."""


def main() -> None:
    """Run all targets, each with its share of the inputs; the first failure ends it with the input that failed."""
    total = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    for name, (inputs, reader, share) in TARGETS.items():
        begin, size = time.monotonic(), _largest()
        guided = round(total * share * GUIDED)
        seen, reached = run(inputs, reader, round(total * share) - guided), Reached()
        seen += run(inputs, reader, guided, reached)
        grown = _largest() - size
        print(
            f"{name}: {seen} inputs, {time.monotonic() - begin:.0f} s, {grown / 2**20:.0f} MiB, {len(reached.before)} lines, none failed",
            flush=True,
        )
        if grown > GROWTH:
            raise SystemExit(f"{name}: grew by more than {GROWTH / 2**20:.0f} MiB")


def _largest() -> int:
    """Largest size of the process so far, in bytes."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def run(inputs: Any, reader: Callable[[Any], None], count: int, reached: Reached | None = None) -> int:
    """How many inputs were read, guided by the lines `reached`; the first failure is raised with the smallest input that shows it."""
    seen = [0]

    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
        phases=(Phase.generate, Phase.target, Phase.shrink),
    )
    @given(inputs)
    def read(value):
        seen[0] += 1
        signal.setitimer(signal.ITIMER_REAL, HANG, 1.0)  # again, where an exception is swallowed
        faulthandler.dump_traceback_later(2 * HANG, exit=True)
        try:
            if reached is None:
                reader(value)
            else:
                target(reached.read(reader, value))
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
