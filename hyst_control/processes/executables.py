"""Executables of the nodes: `executables:NAME` is the function that runs the node NAME of `NODES`.

Loading a node takes a second or more, in which a Ctrl-C would print a traceback of whatever is being loaded. Until the node listens for
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
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    status: int = importlib.import_module(NODES[name].module).main()
    return status
