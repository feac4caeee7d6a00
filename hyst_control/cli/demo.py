"""Excite, record, identify and track a simulated actuator through five ROS 2 nodes; ends with Table 5 of the HAMPI paper.

A last record has an effect in the actuator that the model does not know, and is diagnosed.

Writes a folder with the bags, the identified models, the figures, summary.json, report.html, and gap.html of that
diagnosis.

example:
  hyst demo --output demo_out
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hyst_control.reporting.tables import Table

NAME = "demo"
HELP = "the whole workflow on a simulated actuator, with a report"
JSON = "result table"
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--output", metavar="FOLDER", default="demo_out", help="folder to write (default demo_out)")


def run(arguments: argparse.Namespace) -> Table:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from hyst_control.base import progress
    from hyst_control.demo import workflow as demo

    with progress.steps(1 + 2 + len(demo.CONTROLLERS) + 2) as step:
        table = demo.run(arguments.output, step)
    table.notes.append(f"written: {arguments.output}/report.html, gap.html, summary.json, bags/, models/, figures/")
    return table
