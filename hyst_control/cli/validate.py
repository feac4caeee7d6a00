"""Score a model on recorded bags it was not fitted to: NRMSE, NME, RMSE, as a whole and by frequency and amplitude.

example:
  hyst validate hampi.yaml another_record
"""

from __future__ import annotations

import argparse

NAME = "validate"
HELP = "score a model on recorded bags"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL.yaml", help="model file")
    parser.add_argument("bags", nargs="+", metavar="BAG", help="recorded bags")
    add_options(parser)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options that validate and compare share."""
    parser.add_argument("--hold", choices=("zoh", "foh"), help="the command between samples")
    parser.add_argument("--start", choices=("settled", "unknown"), default="settled", help="settled: at the first "
                        "command, reached from 0 V; unknown: in the middle of something")
    parser.add_argument("--namespace", help="namespace of the topics")
    parser.add_argument("--unit", default="unknown", help="unit of the measurement in bags without a layout: um or mrad")
    parser.add_argument("--json", metavar="OUT", help="result table to write")


def run(arguments: argparse.Namespace) -> int:
    from hyst_control.validation import validate_bags

    models = arguments.models if hasattr(arguments, "models") else [arguments.model]
    table = validate_bags(models, arguments.bags, arguments.command, arguments.hold, arguments.start, arguments.namespace,
                          arguments.unit)
    if arguments.json:
        table.write(arguments.json)
    print(table.text())
    return 0
