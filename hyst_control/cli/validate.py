"""Score a model on recorded bags it was not fitted to: NRMSE, NME, RMSE, as a whole and by frequency and amplitude.

example:
  hyst validate hampi.yaml another_record
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hyst_control.reporting.tables import Table

NAME = "validate"
HELP = "score a model on recorded bags"
JSON = "result table"
READS = ("model", "bags")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL.yaml", help="model file")
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recorded bags")
    add_options(parser)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options that validate and compare share."""
    parser.add_argument(
        "--hold",
        choices=("zoh", "foh"),
        help="zoh: a DAC holds the command between samples; foh: a smooth source "
        "was sampled (default: what the bag says, else zoh)",
    )
    parser.add_argument(
        "--start",
        choices=("settled", "unknown"),
        default="settled",
        help="settled: at the first command, reached from 0 V; unknown: in the middle of something",
    )
    parser.add_argument("--namespace", help="namespace of the topics")
    parser.add_argument("--unit", default="unknown", help="unit of the measurement in bags without a layout: um or mrad")


def run(arguments: argparse.Namespace) -> Table:
    from hyst_control.identify.validation import validate_bags

    models = arguments.models if hasattr(arguments, "models") else [arguments.model]
    return validate_bags(
        models, arguments.bags, arguments.command, arguments.hold, arguments.start, arguments.namespace, arguments.unit
    )
