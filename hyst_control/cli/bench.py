"""Measure speed: the chain's kernels beside the same loops in C (needs gcc), and reading and writing bags.

The rates are of this machine at this moment; the table names the machine.
"""

from __future__ import annotations

import argparse

NAME = "bench"
HELP = "measure the speed of kernels and bags on this machine"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--only", choices=("kernels", "bags"), help="one group of measurements")
    parser.add_argument("--json", metavar="OUT", help="result table to write")


def run(arguments: argparse.Namespace) -> int:
    from hyst_control.experiments import bench

    table = bench.run(arguments.only)
    if arguments.json:
        table.write(arguments.json)
    print(table.text())
    return 0
