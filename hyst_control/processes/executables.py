# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Executables: `executables:NAME` is the function that runs the node NAME of `NODES`, `executables:hyst` the command line.

Loading takes a second or more, in which a Ctrl-C would print a traceback of whatever is being loaded. Until node or command listens for
interrupts itself, one ends the process at once, as it does a program in C.
"""

from __future__ import annotations

import importlib
import signal
from collections.abc import Callable
from functools import partial

from hyst_control.processes.node_list import NODES


def __getattr__(name: str) -> Callable[[], int]:
    if name not in NODES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return partial(run, name)


def run(name: str) -> int:
    """Load a node and run its executable."""
    _end_at_once_by_interrupts()
    status: int = importlib.import_module(NODES[name].module).main()
    return status


def hyst() -> int:
    """Load and run the command line; its exit status."""
    _end_at_once_by_interrupts()
    status: int = importlib.import_module("hyst_control.cli").main()
    return status


def _end_at_once_by_interrupts() -> None:
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as `nohup` and a shell's background jobs have it
        signal.signal(signal.SIGINT, signal.SIG_DFL)
