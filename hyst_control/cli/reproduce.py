"""Run the experiments of the papers and of public measurements, and print their tables beside the published figures.

examples:
  hyst reproduce hampi
  hyst reproduce fsm-cubespec --json fsm.json --figures figures
Measurements are looked for in ../shared/data beside the repository, or in the folder that HYST_DATA names.
"""

from __future__ import annotations

import argparse

NAME = "reproduce"
HELP = "run a published experiment and print its table"
EXPERIMENTS = ("hampi", "mhl", "pea-p885", "fsm-cubespec")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("experiment", choices=EXPERIMENTS, metavar="NAME", help=", ".join(EXPERIMENTS))
    parser.add_argument("--json", metavar="OUT", help="result table to write")
    parser.add_argument("--figures", metavar="FOLDER", help="folder for the figures")


def run(arguments: argparse.Namespace) -> int:
    from importlib import import_module

    experiment = import_module(f"hyst_control.experiments.{arguments.experiment.replace('-', '_')}")
    print(experiment.run(arguments.json, arguments.figures).text())
    return 0
