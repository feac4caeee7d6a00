# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Progress of a long command, on one line of the terminal; redirected, the parts of the work, a line each.

The elapsed time moves while a step takes long: a timer's signal draws the line again every second. It is no thread, because the process
may fork meanwhile, and a forked child has no timer.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_bar: Any = None  # tqdm's, None while nothing is shown
_within = ""
_lines = False  # True when the standard error is no terminal, and parts are printed as lines


@contextmanager
def shown(wanted: bool = True) -> Iterator[None]:
    """Show the steps on the standard error while the context lasts: all on a terminal, otherwise the counted parts."""
    global _bar, _lines
    if not wanted or not sys.stderr.isatty():
        _lines = wanted
        try:
            yield
        finally:
            _lines = False
        return
    from tqdm import tqdm

    tqdm.monitor_interval = 0  # no monitor thread: the process may fork meanwhile
    _bar = bar = tqdm(bar_format="{elapsed} {desc}", leave=False, file=sys.stderr)
    try:
        yield
    finally:
        end()
        bar.close()


def end() -> None:
    """Remove the line for good: before a command prints its result."""
    global _bar
    if _bar is not None:
        _disarm()
        _bar.close()
        _bar = None


def _arm() -> None:
    """Draw the line again every second, unless something else uses the timer, this is no main thread, or Windows has no such timer."""
    if not hasattr(signal, "SIGALRM"):
        return
    free = signal.getsignal(signal.SIGALRM) is signal.SIG_DFL and threading.current_thread() is threading.main_thread()
    if free and signal.getitimer(signal.ITIMER_REAL)[0] == 0.0:
        signal.signal(signal.SIGALRM, _tick)
        signal.setitimer(signal.ITIMER_REAL, 1.0, 1.0)


def _disarm() -> None:
    if hasattr(signal, "SIGALRM") and signal.getsignal(signal.SIGALRM) is _tick:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)


def _tick(number: int, frame: FrameType | None) -> None:
    if _bar is not None:
        _bar.refresh()


def step(text: str) -> None:
    """Show the next step."""
    if _bar is not None:
        _arm()
        _bar.set_description_str(": ".join(filter(None, [_within, text])), refresh=False)
        _bar.update()
        _bar.refresh()


@contextmanager
def steps(total: int) -> Iterator[Callable[[str], None]]:
    """Provide a `step` for work of several counted parts; the steps within one are shown behind it: "3/8 identify HAMPI: read"."""
    global _within
    count = 0

    def part(text: str) -> None:
        global _within
        nonlocal count
        count += 1
        _within = f"{count}/{total} {text}"
        if _lines:
            print(_within, file=sys.stderr, flush=True)
        step("")

    try:
        yield part
    finally:
        _within = ""
