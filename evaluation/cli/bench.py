# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Measure the speed of kernels, bags, the running loop, and workflows.

Kernels are compared with the same loops in C (needs gcc), exported controllers are timed and compared with Python bit by bit, the
running loop (rounds per second in lockstep; period, latency, loss and load at 1 kHz) with the same loop in plain rclpy. Workflows are
the identification from one minute at 20 kHz and the diagnosis of a record. Coverage is the share of 200 simulated identifications whose
90 % intervals hold the truth, round_trips the error of every identified family on a record of another session.
Beside a figure stands its limit, where one is known: what the same work takes in the same run with nothing around it (`of` tells what), and
the figure as a multiple of that.
The figures hold for this machine at this moment; the table names the machine.

examples:
  hyst bench --only loops --json suite.json
  hyst bench --only lockstep                an hour in lockstep at full speed: lost rows, repetitions, load
  hyst bench --only wall-clock              ten minutes at 1 kHz against a stage: lost rows, missed ticks, load
  hyst bench --only lockstep --soak 5       the same for five minutes
  hyst bench --minutes 0.5 1 2 4            commands on long records, their growth and an hour, extrapolated
  hyst bench --minutes 60                   the hour itself: 180 million samples, some 20 GB of temporary files
"""

from __future__ import annotations

import argparse

from hyst_control.reporting.result import CommandResult

NAME = "bench"
HELP = "measure the speed of kernels, bags and the running loop on this machine"
CHOICES = (
    *("kernels", "exported", "bags", "loops", "coverage", "round_trips", "workflows"),
    *("dashboard", "lockstep", "wall-clock"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument(
        "--only",
        choices=CHOICES,
        help="run only this group of measurements; dashboard, the cost of a live page, is a part of loops; "
        "lockstep (60 min) and wall-clock (10 min at 1 kHz) only run when they are named",
    )
    parser.add_argument("--seconds", type=float, default=6.0, help="length of every run of the loop in s (default 6)")
    parser.add_argument("--soak", type=float, metavar="MINUTES", help="with --only lockstep or wall-clock: length of that run")
    parser.add_argument(
        "--minutes",
        type=float,
        nargs="+",
        metavar="MINUTES",
        help="instead, measure time and memory of import, simulate, validate and identify on records of these lengths at 50 kHz, and "
        "from the two longest of them what an hour would take",
    )


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from evaluation.benchmarks import suite

    return suite.run(arguments.only, arguments.seconds, arguments.soak, arguments.minutes)
