"""Ctrl-C in a process of nodes: one handler from beginning to end, which lets it wait or pass where that is asked for.

It is set before `rclpy.init`, whose own handler then calls it. One that was set later would take rclpy's out of the chain.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_count = 0
"""Interrupts heard since `listen`."""
_held = False
"""True while an interrupt is only counted."""


def listen() -> None:
    """Answer the interrupts of this process from now on: each raises KeyboardInterrupt in the main thread."""
    global _count, _held
    _count, _held = 0, False
    signal.signal(signal.SIGINT, _on_interrupt)


def heard() -> bool:
    """True once an interrupt has come, also one that a library has swallowed."""
    return _count > 0


def ignore() -> None:
    """Let interrupts pass without effect from now on: the process ends."""
    global _held
    _held = True


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Let interrupts pass without effect meanwhile.

    rclpy hears a Ctrl-C first, in a thread of its own: Python's own interrupt of the same signal, or a second one, would come while the
    nodes are being closed and a bag is finished.
    """
    global _held
    if threading.current_thread() is not threading.main_thread():  # where Python interrupts nobody
        yield
        return
    before, _held = _held, True
    try:
        yield
    finally:
        _held = before


@contextmanager
def undivided() -> Iterator[None]:
    """Let an interrupt wait until the block has ended: what is half done would be lost."""
    before = _count
    with uninterrupted():
        yield
    if _count > before and not _held and threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt


def _on_interrupt(number: int, frame: FrameType | None) -> None:
    global _count
    _count += 1
    if not _held:
        raise KeyboardInterrupt
