# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Tell of recorded bags what is there and what is missing: rows, ticks without a row, values that are no numbers, damage of the file.

A bag is whole where command and measurement are there and cover the same time, every topic has a row at every tick from its first to its
last, and nothing was damaged or left out. Other notes do not count. The exit status is 0 if all bags are whole, 3 if one is not, 2 if one
cannot be read.

example:
  hyst check recording
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import TYPE_CHECKING

from hyst_control.reporting.result import CommandResult

if TYPE_CHECKING:
    from hyst_control.records.losses import TopicAccount

NAME = "check"
HELP = "tell what is missing in recorded bags"
READS = ("bags",)
ALONE = 0.05  # Share of its time up to which command or measurement may be without the other: a recorder meets one first
TICKS = 3  # And ticks, in a short bag


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("bags", nargs="+", metavar="BAG", help="recorded bags, of this package or of others")
    add("--namespace", help="namespace of the topics")
    add("--unit", default="unknown", help="unit of the measurement in bags without a layout, such as um")
    add("--columns", help="fields of bags of other messages, or columns of tables, as in hyst import --columns")


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from hyst_control.base.errors import Loss
    from hyst_control.records.bags.bag_reader import read_bag
    from hyst_control.records.losses import account
    from hyst_control.reporting.artifacts import Artifacts

    made = Artifacts("check", [])
    whole = True
    for bag in arguments.bags:
        record = read_bag(bag, arguments.namespace, unit=arguments.unit, columns=arguments.columns)
        topics = account(record)
        incomplete = _incomplete(bag, {one.topic: one for one in topics})
        sound = all(one.whole for one in topics) and not incomplete and not any(isinstance(note, Loss) for note in record.notes)
        whole &= sound
        made.lines.append(f"{bag}: {'whole' if sound else 'not whole'}")
        for one in topics:
            case = one.topic if len(arguments.bags) == 1 else f"{bag}: {one.topic}"
            rate = "" if one.rows < 2 else f" at {1.0 / one.step:.6g} Hz, {one.first:.6g} to {one.last:.6g} s" if one.step else ""
            lost = f", {one.missing} ticks missing (at most {one.longest} in a row)" if one.missing else ""
            bad = f", {one.invalid} rows that are no numbers" if one.invalid else ""
            made.lines.append(f"  {one.topic:<12} {one.rows} rows{rate} by the {one.clock}{lost}{bad}")
            counts = {"rows": one.rows, "missing": one.missing, "longest gap": one.longest, "invalid": one.invalid}
            for quantity, value in counts.items():
                made.add(case, quantity, "", value)
            made.add(case, "largest jitter", "steps", one.irregular)
        made.lines += [f"  note: {note}" for note in (*incomplete, *record.notes)]
    made.exit_status = 0 if whole else 3
    return made


def _incomplete(bag: str, topics: Mapping[str, TopicAccount]) -> list[str]:
    """Notes on a missing command or measurement, and on times that only one of the two covers."""
    pair = [topics[name] for name in ("command", "measurement") if name in topics]
    if len(pair) < 2:
        lacking = " and no ".join(name for name in ("command", "measurement") if name not in topics)
        return [f"{bag}: has no {lacking}: record it, or name its topic with --columns"]
    both = max(min(one.last for one in pair) - max(one.first for one in pair), 0.0)
    for one, other in (pair, pair[::-1]):
        span = one.last - one.first
        if span - both > max(ALONE * span, TICKS * one.step):
            return [
                f"{bag}: {one.topic} has no {other.topic} beside it for {span - both:.6g} s of {span:.6g} s: the times are of two "
                "clocks, or one was recorded for a part only"
            ]
    return []
