# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Thread in which a device's driver runs: its calls go there one after another, and one that hangs keeps nothing else waiting."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any


class Call:
    """One call of a driver: a `function` without arguments."""

    def __init__(self, function: Callable[[], Any]) -> None:
        self._function: Callable[[], Any] | None = function
        self._running = threading.Lock()  # wakes its waiter in half the time that an Event takes
        self._running.acquire()
        self.result: Any = None
        self.error: BaseException | None = None  # What the driver raised
        self.seconds = 0.0  # Time that it took, s

    def ended(self, within: float = 0.0) -> bool:
        """True once the call has ended; waits `within` s for that."""
        over = self._running.acquire(timeout=within)
        if over:
            self._running.release()
        return over

    def cancel(self) -> None:
        """Do not run it, unless it has begun."""
        self._function = None

    def run(self) -> None:
        """Run it, in the driver's thread."""
        begin, function = time.monotonic(), self._function
        try:
            if function is not None:
                self.result = function()
        except BaseException as error:  # a driver may raise anything; here even SystemExit would end nothing but its own thread
            self.error = error
        self.seconds = time.monotonic() - begin
        self._running.release()


class DriverThread:
    """Thread of one connection with a device, from the first call to `end`; it keeps no process from ending."""

    def __init__(self) -> None:
        self._calls: SimpleQueue[Call | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, daemon=True, name="driver")
        self._began: float | None = None  # s, of the call that runs
        self._ending = False

    def call(self, function: Callable[[], Any]) -> Call:
        """Have a `function` called after those before it."""
        if self._thread.ident is None:
            self._thread.start()
        call = Call(function)
        self._calls.put(call)
        return call

    def end(self, function: Callable[[], Any]) -> None:
        """Have a last `function` called, once, unless there was no call at all."""
        if self._thread.ident is not None and not self._ending:
            self._ending = True
            self.call(function)
            self._calls.put(None)

    def ended(self, within: float = 0.0) -> bool:
        """True when the last call has ended, or there was none at all; waits `within` s for that."""
        if self._thread.is_alive():
            self._thread.join(within)
        return not self._thread.is_alive()

    def answers(self) -> None:
        """Note that the driver has answered in the midst of a call."""
        self._began = time.monotonic()

    @property
    def silent_for(self) -> float:
        """Time for which the present call has been running, s; 0 when there is none."""
        began = self._began
        return 0.0 if began is None else time.monotonic() - began

    def _run(self) -> None:
        while (call := self._calls.get()) is not None:
            self._began = time.monotonic()
            call.run()
            self._began = None
