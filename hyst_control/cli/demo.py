# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Excite, record, identify and track a simulated actuator through five ROS 2 nodes; ends with Table 5 of the HAMPI paper.

Without ROS 2 the same numbers are computed in one process.

A last record has an effect in the actuator that the model does not know, and is diagnosed.

Writes a folder with the bags, the identified models, the figures, summary.json, report.html, and gap.html of that
diagnosis.

example:
  hyst demo --output demo_out
"""

from __future__ import annotations

import argparse

from hyst_control.reporting.result import CommandResult

NAME = "demo"
HELP = "the whole workflow on a simulated actuator, with a report"
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--output", metavar="FOLDER", default="demo_out", help="folder to write (default demo_out)")
    parser.add_argument("--without-ros", action="store_true", help="compute in one process, as where rclpy is not installed")


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from importlib.util import find_spec

    from hyst_control.base import progress
    from hyst_control.demo import workflow as demo

    ros = not arguments.without_ros and find_spec("rclpy") is not None
    with progress.steps(1 + 2 + len(demo.CONTROLLERS) + 2) as step:
        table = demo.run(arguments.output, step, ros)
    if not ros:
        table.notes.append("without ROS 2: the nodes' computation in one process, which gives the same numbers")
    table.notes.append(f"written: {arguments.output}/report.html, gap.html, summary.json, bags/, models/, figures/")
    return table
