"""Draw cases from the truth plants: recorded bags with a model each, and what is in them in one file apart.

example:
  hyst cases make --seed 7 --count 20 --out cases
"""

from __future__ import annotations

import argparse

NAME = "cases"
HELP = "draw recorded cases with effects in them, labels apart"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("action", choices=("make",), metavar="make", help="draw and record")
    parser.add_argument("--seed", type=int, required=True, help="of the cases")
    parser.add_argument("--count", type=int, default=60, help="number of cases")
    parser.add_argument("--out", required=True, metavar="FOLDER", help="folder to write, with cases/ and labels.json")
    parser.add_argument("--plants", nargs="+", metavar="PLANT", help="truth plants (default: all)")


def run(arguments: argparse.Namespace) -> int:
    from hyst_control.experiments.blind_test import make_cases

    make_cases(arguments.out, arguments.seed, arguments.count, arguments.plants)
    return 0
