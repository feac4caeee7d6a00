# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Score several models on the same recorded bags, side by side.

example:
  hyst compare hapi.yaml hampi.yaml --bags another_record
"""

from __future__ import annotations

import argparse

from hyst_control.cli import validate
from hyst_control.reporting.result import CommandResult

NAME = "compare"
HELP = "score several models on the same bags"
READS = ("models", "bags")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument(
        "models", nargs="+", metavar="MODEL.yaml|BAG", help="model files, then the bag; only model files with --bags"
    )
    parser.add_argument("--bags", nargs="+", metavar="BAG", help="recorded bags")
    validate.add_options(parser)


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from hyst_control.base.errors import InputError

    if not arguments.bags:
        # `hyst compare MODEL… BAG`: a path that is not a model file is a bag.
        arguments.bags = [path for path in arguments.models if not path.endswith((".yaml", ".yml"))]
        arguments.models = [path for path in arguments.models if path.endswith((".yaml", ".yml"))]
    if not arguments.bags or not arguments.models:
        raise InputError("models, bags: give at least one model file (.yaml) and one bag: hyst compare MODEL.yaml… BAG")
    return validate.run(arguments)
