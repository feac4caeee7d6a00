# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identify a model from all records of bags with `command` and `measurement` together.

examples:
  hyst identify demo_out/bags/excitation --model hampi --output hampi.yaml --json fit.json
  hyst identify loops --figure choice.svg                   # the best family, to model.yaml
  hyst identify loops sweeps --model hapi --method paper --output hapi.yaml
  hyst identify loops --model madelung --degree 7 --output madelung.yaml
"""

from __future__ import annotations

import argparse
from typing import Any

from hyst_control.cli.validate import add_bag_options, add_hold_and_start
from hyst_control.reporting.result import CommandResult

NAME = "identify"
HELP = "fit a model's parameters to recorded bags"
JSON = "fit report"
READS = ("bags",)
WRITES = ("output", "figure")
PASSED_ON = ("hold", "start", "allow_gaps", "force", "strict", "shift", "namespace", "unit", "columns", "figure")
"""Arguments that `identify_bags` takes under the same names, as those of the families."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("bags", nargs="+", metavar="BAG", help="rosbag2 directories, folders of them, or .mcap or .db3 files")
    add("--model", "--family", metavar="NAME", help="model family (default: auto, the best of several on held-out data)")
    add("--figure", metavar="OUT.svg", help="figure of the families that auto tried, to write (.svg, .png, .pdf)")
    add("--output", metavar="MODEL.yaml", default="model.yaml", help="model file to write (default model.yaml)")
    add_hold_and_start(parser)
    add("--allow-gaps", action="store_true", help="accept records with lost samples, and use the stretches between them")
    add(
        "--force",
        action="store_true",
        help="fit records, too, that are no measurement of their command, and write the model whatever it explains",
    )
    add(
        "--strict",
        action="store_true",
        help="exit status 3 unless the verdict is explains: explains_poorly, explains_nothing, records_disagree and invalid_record fail",
    )
    add_bag_options(parser)
    _add_when_needed(parser)


def _add_when_needed(parser: argparse.ArgumentParser) -> None:
    """Add the families' options only when this command is parsed or explained, because they take seconds of imports."""
    plain = parser.parse_known_args
    added: list[str] = []

    def parse(*arguments: Any, **keywords: Any) -> Any:  # overloaded in argparse
        if not added:
            added.extend(add_options(parser))
        return plain(*arguments, **keywords)

    parser.parse_known_args = parse  # type: ignore[method-assign]


def add_options(parser: argparse.ArgumentParser) -> list[str]:
    """Add the options of all model families, none of which has a default."""
    from textwrap import fill

    from hyst_control.identify.families.estimator import described, estimators, every_option
    from hyst_control.identify.families.options import TRUTH

    families = "\n".join(fill(f"{name}: {each.sentence}", 78, subsequent_indent="  ") for name, each in estimators().items())
    group = parser.add_argument_group(
        "model families and their options", f"{families}\n\nAn option that the family does not have is refused."
    )
    options = every_option()
    for name, having in options.items():
        text = described(having).replace("%", "%%")
        flag = f"--{name.replace('_', '-')}"
        if all(option.kind is TRUTH for option in having.values()):
            group.add_argument(flag, action=argparse.BooleanOptionalAction, default=None, help=text)
        else:
            group.add_argument(flag, metavar=name.upper(), help=text)
    return list(options)


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from hyst_control.identify.families.estimator import every_option
    from hyst_control.identify.workflow import identify_bags

    given = {name: getattr(arguments, name) for name in every_option()}
    given |= {name: getattr(arguments, name) for name in PASSED_ON}
    return identify_bags(arguments.bags, arguments.model, arguments.output, method=given.pop("method") or "joint", **given)
