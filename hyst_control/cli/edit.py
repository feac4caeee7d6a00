# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Prepare a bag: merge, cut, remove outliers, detrend, filter and resample, in this order. The new bag keeps the list of steps.

examples:
  hyst edit record --from 0.5 --to 1.5 --output slow_part
  hyst edit record --outliers --low-pass 200 --resample 500
  hyst edit record --detrend linear --output without_drift
  hyst edit monday tuesday --output both                      # for hyst identify both --allow-gaps
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hyst_control.reporting.artifacts import Artifacts

NAME = "edit"
HELP = "cut, resample, filter, detrend or merge bags, remove outliers, or bring two clocks together"
JSON = "list of written files"
READS = ("bags",)
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("bags", nargs="+", metavar="BAG", help="bag; several are merged, with a gap of one sample between them")
    add("--from", dest="begin", type=float, metavar="S", help="first sample time, s")
    add("--to", dest="end", type=float, metavar="S", help="last sample time, s")
    add(
        "--outliers",
        nargs="?",
        type=float,
        const=8.0,
        metavar="FACTOR",
        help="replace measurements this many standard deviations away from their running median (default 8)",
    )
    add("--detrend", choices=("linear", "constant"), help="remove the measurement's line of best fit, or its mean")
    add("--low-pass", type=float, metavar="HZ", help="corner of a low-pass without phase, of all signals")
    add("--high-pass", type=float, metavar="HZ", help="corner of a high-pass without phase, of all signals")
    add(
        "--clock", type=float, metavar="PPM", help="bring a measurement whose clock is slower by so many ppm to the command's clock"
    )
    add("--resample", type=float, metavar="HZ", help="new sample rate")
    add("--output", metavar="BAG", help="bag to write, which must not exist (default: the first bag's name and _edited)")
    add("--namespace", help="namespace of the topics, where a bag holds several plants")


def run(arguments: argparse.Namespace) -> Artifacts:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    import os
    from pathlib import Path

    from hyst_control.api.record import read_bag
    from hyst_control.base.errors import InputError
    from hyst_control.reporting.artifacts import Artifacts

    given = arguments
    records = [read_bag(path, namespace=given.namespace) for path in given.bags]
    record = records[0].merge(*records[1:]) if len(records) > 1 else records[0]
    record = record.cut(given.begin, given.end)
    if given.clock:
        record = record.reclock(given.clock)
    if given.outliers is not None:
        record = record.remove_outliers(given.outliers)
    if given.detrend:
        record = record.detrend(given.detrend)
    if given.low_pass is not None or given.high_pass is not None:
        record = record.filter(given.low_pass, given.high_pass)
    if given.resample is not None:
        record = record.resample(given.resample)
    if record.history == records[0].history:
        raise InputError(
            "nothing to do: give --from, --to, --clock, --outliers, --detrend, --low-pass, --high-pass, --resample or several bags"
        )
    output = given.output or f"{Path(os.path.realpath(given.bags[0])).stem}_edited"
    record.save(output)
    return Artifacts("edit", [output], lines=record.summary().splitlines())
