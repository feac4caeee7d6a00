# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Look whether this computer has what the nodes and the commands need, and say what to do where it has not.

Checks Python and the packages, ROS, who can hear the nodes, messages on this computer, the clock, the real-time priority, the
processor's speed, memory and the disk. Ends with 1 where something does not work; a note is no fault.

example:
  hyst doctor --folder /data/records
"""

from __future__ import annotations

import argparse

from hyst_control.reporting.result import CommandResult

NAME = "doctor"
HELP = "check what this computer offers: Python, ROS, messages, clock, priority, disk"
JSON = "checks"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--folder", default=".", metavar="FOLDER", help="where records are going to be written (default: here)")


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from hyst_control.processes.installation import examine

    return examine(arguments.folder)
