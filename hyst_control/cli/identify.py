"""Identify a model from bags that hold `command` and `measurement`, all records at once.

examples:
  hyst identify demo_out/excitation --model hampi --output hampi.yaml --json fit.json
  hyst identify loops.bag sweeps.bag --model hapi --method paper --output hapi.yaml
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hyst_control.identify.workflow import Result

NAME = "identify"
HELP = "fit a model's parameters to recorded bags"
JSON = "fit report"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bags", nargs="+", metavar="BAG", help="rosbag2 directories, or .mcap or .db3 files")
    parser.add_argument(
        "--model",
        metavar="NAME",
        help="model family: pi, hapi, rdpi, hampi, madelung, mhl or linear; without it the best of the first four on held-out data",
    )
    parser.add_argument("--output", metavar="MODEL.yaml", required=True, help="model file to write")
    parser.add_argument(
        "--method", choices=("joint", "paper"), default="joint", help="all records together, or the paper's sequence"
    )
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
    parser.add_argument("--allow-gaps", action="store_true", help="use the stretches between lost samples")
    parser.add_argument("--namespace", help="namespace of the topics, where a bag holds several plants")
    parser.add_argument("--unit", default="unknown", help="unit of the measurement in bags without a layout: um or mrad")
    parser.add_argument("--operators", type=int, help="number of play operators (default 10)")
    parser.add_argument("--thresholds", help="thresholds in V, separated by commas, instead of the default ones")
    parser.add_argument("--one-sided", action="store_true", help="one-sided play operators")


def run(arguments: argparse.Namespace) -> Result:
    from hyst_control.identify.workflow import identify_bags

    return identify_bags(
        arguments.bags,
        arguments.model,
        arguments.output,
        method=arguments.method,
        hold=arguments.hold,
        start=arguments.start,
        allow_gaps=arguments.allow_gaps,
        namespace=arguments.namespace,
        unit=arguments.unit,
        operators=arguments.operators,
        thresholds=arguments.thresholds,
        one_sided=arguments.one_sided,
    )
