# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Watchdog that ends a process which the middleware keeps from ending.

The standard library has no equivalent. `faulthandler.dump_traceback_later(exit=True)` does not need the interpreter's lock either, but
ends the process with status 1 and a traceback, not with the node's own status (0 after an interrupt, 2 on bad input). A
`threading.Timer` and a handler of `signal.signal` need the lock, and the default action of SIGALRM ends the process by a signal.
"""

from __future__ import annotations

import ctypes
import sys

PATIENCE = 5.0  # s; ending normally takes a few milliseconds

_SIGEV_THREAD, _CLOCK_MONOTONIC = 2, 1


class _Notification(ctypes.Structure):
    """`struct sigevent` of Linux: a thread calls `function(value)`."""

    _fields_ = (
        ("value", ctypes.c_long),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("reserved", ctypes.c_char * 32),
    )


class _Duration(ctypes.Structure):
    """`struct itimerspec`: interval and first time, each in s and ns."""

    _fields_ = (("interval", ctypes.c_long * 2), ("first", ctypes.c_long * 2))


def exit_within(status: int, seconds: float = PATIENCE) -> None:
    """End the process if it is still running after a time, whatever it is waiting for.

    Fast DDS 2.14 can deadlock while it destroys a participant and learns that another one leaves, as when one Ctrl-C ends all nodes:
    `DomainParticipant::set_listener` waits for a callback of the discovery, which waits for it. The call holds the interpreter's
    lock, so no Python code can end it; a timer of the C library calls `_exit`.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    library = ctypes.CDLL(None, use_errno=True)
    notification = _Notification(value=status, notify=_SIGEV_THREAD, function=ctypes.cast(library._exit, ctypes.c_void_p))
    timer = ctypes.c_void_p()
    if library.timer_create(_CLOCK_MONOTONIC, ctypes.byref(notification), ctypes.byref(timer)) == 0:
        whole = int(seconds)
        first = (ctypes.c_long * 2)(whole, int((seconds - whole) * 1e9))
        library.timer_settime(timer, 0, ctypes.byref(_Duration(first=first)), None)
