"""Measure the speed of kernels, bags, the running loop, and workflows.

Kernels run beside the same loops in C (needs gcc); the loop (rounds per second in lockstep; period, latency, loss and load at 1 kHz)
beside the same loop written the plain way; workflows are identification from a minute at 20 kHz and the diagnosis of a
record. The figures are of this machine at this moment; the table names the machine.

examples:
  hyst bench --only loops --json suite.json
  hyst bench --soak 60                      long runs, to see that memory stays flat
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hyst_control.reporting.tables import Table

NAME = "bench"
HELP = "measure the speed of kernels, bags and the running loop on this machine"
JSON = "result table"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--only", choices=("kernels", "bags", "loops", "workflows"), help="one group of measurements")
    parser.add_argument("--seconds", type=float, default=6.0, help="length of every run of the loop (default 6)")
    parser.add_argument(
        "--soak",
        type=float,
        metavar="MINUTES",
        help="run the loop that long in lockstep instead, then a sixth of it on the wall clock, and look at its memory",
    )


def run(arguments: argparse.Namespace) -> Table:
    from hyst_control.benchmarks import suite

    return suite.run(arguments.only, arguments.seconds, arguments.soak)
