# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Executables: `executables:NAME` is the function that runs the node NAME of `NODES`, `executables:hyst` the command line.

Loading takes a second or more, in which a Ctrl-C would print a traceback of whatever is being loaded. Until node or command listens for
interrupts itself, one ends the process at once, as it does a program in C.
"""

from __future__ import annotations

import importlib
import signal
import sys
from collections.abc import Callable
from functools import partial

from hyst_control.processes.node_list import NODES

ROS = ("rclpy", "std_msgs", "std_srvs", "diagnostic_msgs", "rcl_interfaces")
"""Packages that nodes need and pip does not install."""


def ros_missing(error: ModuleNotFoundError) -> str:
    """One line on the part of ROS that could not be imported and how to get it; "" where it was no part of ROS."""
    package = str(error.name).partition(".")[0]
    if package not in ROS:
        return ""
    return (
        f"{package} is not installed, and nodes need ROS 2 Jazzy or Kilted: source its setup.bash, or use the environment that make "
        "builds (make env, then .venv/bin)"
    )


def __getattr__(name: str) -> Callable[[], int]:
    if name not in NODES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return partial(run, name)


def run(name: str) -> int:
    """Load a node and run its executable."""
    _end_at_once_by_interrupts()
    try:
        status: int = importlib.import_module(NODES[name].module).main()
    except ModuleNotFoundError as error:
        if not (missing := ros_missing(error)):
            raise
        print(f"{name}: {missing}", file=sys.stderr)
        return 2
    return status


def hyst() -> int:
    """Load and run the command line; its exit status."""
    _end_at_once_by_interrupts()
    status: int = importlib.import_module("hyst_control.cli").main()
    return status


def _end_at_once_by_interrupts() -> None:
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as `nohup` and a shell's background jobs have it
        signal.signal(signal.SIGINT, signal.SIG_DFL)
