# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Score a model on recorded bags that it was not fitted to: NRMSE, NME and RMSE, in total and by frequency and amplitude.

example:
  hyst validate hampi.yaml another_record
"""

from __future__ import annotations

import argparse

from hyst_control.reporting.result import CommandResult

NAME = "validate"
HELP = "score a model on recorded bags"
READS = ("model", "bags")
PASSED_ON = ("hold", "start", "namespace", "unit", "columns", "shift", "strict")
"""Arguments that `validate_bags` takes under the same names."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("model", metavar="MODEL.yaml", help="model file")
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recorded bags, or tables")
    add_options(parser)


def add_bag_options(parser: argparse.ArgumentParser) -> None:
    """Add the options on reading bags with command and measurement."""
    add_shift(parser)
    parser.add_argument("--namespace", help="namespace of the topics, where a bag holds several plants")
    parser.add_argument("--unit", default="unknown", help="unit of the measurement in bags without a layout, such as um")
    parser.add_argument("--columns", help="fields of bags of other messages, or columns of tables, as in hyst import --columns")


def add_shift(parser: argparse.ArgumentParser) -> None:
    """Add the option on the time between the two recordings."""
    parser.add_argument(
        "--shift",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="take the measurement later by this time, where its recording did not start with the command's (below 0: earlier)",
    )


def add_hold_and_start(parser: argparse.ArgumentParser) -> None:
    """Add the options on the command between samples and on the state at the start."""
    parser.add_argument(
        "--hold",
        choices=("auto", "zoh", "foh"),
        help="command between samples: zoh, held by a DAC; foh, a sampled smooth source (default: auto, as "
        "stated in the bag, else the model's, or what explains held-out rows)",
    )
    parser.add_argument(
        "--start",
        choices=("auto", "settled", "unknown"),
        default="auto",
        help="state at the start: settled at the first command, reached from 0 V on the initial loading curve; unknown; or found from the "
        "record (default)",
    )


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that `validate` and `compare` share."""
    add_hold_and_start(parser)
    add_bag_options(parser)
    parser.add_argument(
        "--strict",
        action="store_true",
        help="exit status 3 where a record is no measurement of its command, or the model does not describe it",
    )


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from hyst_control.identify.validation import validate_bags

    models = arguments.models if hasattr(arguments, "models") else [arguments.model]
    given = {name: getattr(arguments, name) for name in PASSED_ON}
    return validate_bags(models, arguments.bags, arguments.command, **given)
