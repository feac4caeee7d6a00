# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Run the experiments of the papers and of public measurements, and print their tables beside the published figures.

examples:
  hyst reproduce hampi --json hampi.json --figures figures
  hyst reproduce page --results docs/data/hampi.json docs/data/mhl.json --page papers.md
Measurements are read from ../shared/data beside the repository, or from the folder named by HYST_DATA.
"""

from __future__ import annotations

import argparse

from hyst_control.base.errors import InputError
from hyst_control.reporting.result import CommandResult

NAME = "reproduce"
HELP = "run a published experiment and print its table"
JSON = "result table (page: list of written files)"
READS = ("results",)
WRITES = ("page",)
EXPERIMENTS = ("hampi", "mhl", "pea-p885", "fsm-cubespec", "bouc-wen", "exam", "mirror-levels")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument(
        "experiment",
        choices=(*EXPERIMENTS, "page"),
        metavar="NAME",
        help=f"{', '.join(EXPERIMENTS)}; page: targets of the papers, met and missed, from results",
    )
    parser.add_argument("--figures", metavar="FOLDER", help="folder for the figures")
    parser.add_argument("--results", nargs="+", metavar="JSON", help="page: JSON results of hampi and mhl")
    parser.add_argument("--page", metavar="OUT.md", help="page: Markdown to write")


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from importlib import import_module

    given = [arguments.results is not None, arguments.page is not None]
    if not all(given) if arguments.experiment == "page" else any(given):
        raise InputError("--results, --page: give both with `hyst reproduce page`, and neither with an experiment")
    if arguments.experiment == "page":
        from evaluation.reproduction.page import write_page
        from hyst_control.reporting.artifacts import Artifacts

        write_page(arguments.results, arguments.page)
        return Artifacts("reproduce page", [arguments.page])
    experiment = import_module(f"evaluation.reproduction.{arguments.experiment.replace('-', '_')}")
    table: CommandResult = experiment.run(arguments.figures)
    return table
