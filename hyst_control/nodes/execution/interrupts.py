# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C and SIGTERM in a process of nodes: one handler for the whole run, which can delay or ignore an interrupt.

rclpy's own handler is not installed: it would shut the context down at once, and with it the publishers that bring the actuator to its
safe value. While an executor waits no Python code runs in the main thread; so a thread hears of every signal and ends the waiting.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from hyst_control.base.parallel import WaitingThread
from hyst_control.processes.environment import LIFELINE

SIGNALS = (signal.SIGINT, signal.SIGTERM)

_count = 0  # Number of interrupts since `listen`
_only_counting = False  # True while interrupts are only counted
_receiver: Callable[[], None] | None = None  # Called by the thread for an interrupt, within `delivered`
_graceful = False  # True while the first interrupt is left to the receiver
_listening = False
_sockets: tuple[socket.socket, socket.socket] | None = None


def listen() -> None:
    """Start handling the interrupts of this process: each raises KeyboardInterrupt in the main thread."""
    global _count, _only_counting, _receiver, _graceful, _listening, _sockets
    _count, _only_counting, _receiver, _graceful = 0, False, None, False
    for number in SIGNALS:
        signal.signal(number, _on_interrupt)
    if _sockets is None:
        _sockets = socket.socketpair()
        for end in _sockets:
            end.set_inheritable(False)
        _sockets[1].setblocking(False)
        WaitingThread(target=_wait, args=(_sockets[0],), daemon=True, name="interrupts").start()
        os.register_at_fork(after_in_child=_not_in_child)
    _listening = True
    signal.set_wakeup_fd(_sockets[1].fileno(), warn_on_full_buffer=False)


def end_with_parent() -> None:
    """End as by SIGTERM when the process that started this one has ended, if that is one of this package."""
    number = os.environ.pop(LIFELINE, "")
    if number:
        WaitingThread(target=_wait_for_parent, args=(int(number),), daemon=True, name="lifeline").start()


def _wait_for_parent(lifeline: int) -> None:
    try:
        os.read(lifeline, 1)  # nothing is ever written
    except OSError:
        return
    os.kill(os.getpid(), signal.SIGTERM)


def _wait(own: socket.socket) -> None:
    """Tell the receiver of every interrupt; runs in a thread."""
    while numbers := own.recv(64):
        receiver = _receiver
        if receiver is not None and any(number in numbers for number in SIGNALS):
            receiver()


def _not_in_child() -> None:
    """A forked worker is no node: its signals are its own."""
    global _listening
    if _listening:
        _listening = False
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def delivered(receiver: Callable[[], None], graceful: bool) -> Iterator[None]:
    """Call a function for every interrupt within the context, from a thread of its own."""
    # graceful: the first interrupt is left to it, so that no callback is cut in two; otherwise, and for a second one,
    # KeyboardInterrupt is raised in the main thread as well
    global _receiver, _graceful
    _receiver, _graceful = receiver, graceful
    try:
        yield
    finally:
        _receiver, _graceful = None, False


def received() -> bool:
    """True after an interrupt, also one that a library has suppressed."""
    return _count > 0


def ignore() -> None:
    """Ignore interrupts from now on, because the process is ending."""
    global _only_counting
    _only_counting = True


@contextmanager
def ignored() -> Iterator[None]:
    """Ignore interrupts within the context, such as a second one while nodes are being closed and a bag is being finished."""
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
    if (
        _count > before
        and not (_only_counting or _graceful and _count < 2)
        and threading.current_thread() is threading.main_thread()
    ):
        raise KeyboardInterrupt


def _on_interrupt(number: int, frame: FrameType | None) -> None:
    global _count
    _count += 1
    if not (_only_counting or _graceful and _count < 2):
        raise KeyboardInterrupt
