"""Ctrl-C in a process of nodes: one handler for the whole run, which can delay or ignore an interrupt.

It is set before `rclpy.init`, whose own handler then calls it. A handler set later would replace rclpy's.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_count = 0
"""Number of interrupts since `listen`."""
_only_counting = False
"""True while interrupts are only counted."""


def listen() -> None:
    """Start handling the interrupts of this process: each raises KeyboardInterrupt in the main thread."""
    global _count, _only_counting
    _count, _only_counting = 0, False
    signal.signal(signal.SIGINT, _on_interrupt)


def received() -> bool:
    """True after an interrupt, also one that a library has suppressed."""
    return _count > 0


def ignore() -> None:
    """Ignore interrupts from now on, because the process is ending."""
    global _only_counting
    _only_counting = True


@contextmanager
def ignored() -> Iterator[None]:
    """Ignore interrupts within the context.

    rclpy receives a Ctrl-C first, in a thread of its own. Python's interrupt of the same signal, or a second one, would arrive while
    nodes are being closed and a bag is being finished.
    """
    global _only_counting
    if threading.current_thread() is not threading.main_thread():  # Python interrupts the main thread only
        yield
        return
    before, _only_counting = _only_counting, True
    try:
        yield
    finally:
        _only_counting = before


@contextmanager
def delayed() -> Iterator[None]:
    """Delay an interrupt until the context ends, so that nothing is lost half done."""
    before = _count
    with ignored():
        yield
    if _count > before and not _only_counting and threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt


def _on_interrupt(number: int, frame: FrameType | None) -> None:
    global _count
    _count += 1
    if not _only_counting:
        raise KeyboardInterrupt
