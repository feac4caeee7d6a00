"""Check the diagnosis blind: draw cases, diagnose each in a process that never sees its label, score, and write the page.

Seeds 0 to 999 are for tuning; scoring seeds begin at 100000 and are used once a version. A run that was interrupted goes on where
it stopped when it is called again with the same folder.

example:
  hyst blind-test --seed 100000 --count 800 --output blind --page docs/blind-test.md
  hyst blind-test --measured --page docs/blind-test-measured.md     models of measured plants that lost an element
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hyst_control.reporting.tables import Table

NAME = "blind-test"
HELP = "check the diagnosis on cases whose effect is withheld"
JSON = "result table"
WRITES = ("page",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--seed", type=int, help="of the cases")
    what.add_argument("--measured", action="store_true", help="diagnose measured records instead, with models that lost an element")
    parser.add_argument(
        "--modes",
        choices=("none", "middle", "all"),
        default="all",
        help="with --measured: at which levels of the mirror there are cases that lose one mode (default all)",
    )
    parser.add_argument("--count", type=int, default=800, help="number of cases")
    parser.add_argument(
        "--left-out", type=int, default=100, help="how many single effects to diagnose again without them in the catalogue"
    )
    parser.add_argument(
        "--output", default="blind_out", metavar="FOLDER", help="folder to write: cases, labels and reports (default blind_out)"
    )
    parser.add_argument(
        "--so-far", action="store_true", help="score what an interrupted run has diagnosed, and diagnose nothing more"
    )
    parser.add_argument("--page", metavar="OUT.md", help="page to write, with its figure")


def run(arguments: argparse.Namespace) -> Table:
    if arguments.measured:
        from hyst_control.blind_test import measured

        return measured.run(arguments.output, arguments.page, modes=arguments.modes)
    from hyst_control.blind_test.run import run_all

    return run_all(arguments.output, arguments.seed, arguments.count, arguments.left_out, arguments.page, so_far=arguments.so_far)
