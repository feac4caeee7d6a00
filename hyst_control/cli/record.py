# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Record signal topics to a bag with the recorder node until Ctrl-C, for a time, or for a number of ticks.

The bag is readable at any moment, even if the recorder is killed; where nothing was received, none is kept and the exit status is 2.
Use `--schedule timer` for signals on the wall clock and `lockstep` for a simulation that waits for its inputs; `--rate` is the sample
rate of the signals.

examples:
  hyst record --rate 1000 --duration 60 --output run.bag
  hyst record --schedule lockstep --rate 20000 --ticks 40000 --topics command measurement --output run.bag
"""

from __future__ import annotations

import argparse

from hyst_control.reporting.result import CommandResult

NAME = "record"
HELP = "record signal topics to a bag"
JSON = "list of written files"
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("--output", metavar="BAG", default="record", help="bag to write, which must not exist (default record)")
    add("--topics", nargs="+", help="topics (default: the five of the loop)")
    add("--rate", type=float, default=1000.0, help="sample rate of the signals in Hz (default 1000)")
    add("--schedule", choices=("timer", "lockstep"), default="timer", help="schedule of the loop (default timer)")
    add("--duration", type=float, help="end after this time in s")
    add("--ticks", type=int, help="end after this many rows of every topic")
    add("--merge", type=int, default=1, help="least number of rows stored in one message (default 1)")
    add("--namespace", help="namespace of the topics")


def run(arguments: argparse.Namespace) -> CommandResult | int:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    import json
    import shutil
    from pathlib import Path

    from hyst_control.base import progress
    from hyst_control.base.errors import InputError
    from hyst_control.base.yaml_files import read_yaml
    from hyst_control.nodes.execution.command_line import in_namespace
    from hyst_control.nodes.execution.run import main
    from hyst_control.nodes.recorder import Recorder
    from hyst_control.reporting.artifacts import Artifacts

    for name in ("duration", "ticks"):
        value = getattr(arguments, name)
        if value is not None and not 0 < value < 1e12:
            raise InputError(f"--{name}: must be > 0 and < 1e12, got {value!r}")
    same = ("output", "topics", "schedule", "duration", "ticks", "merge")
    parameters = {"rate_hz": arguments.rate} | {name: getattr(arguments, name) for name in same}
    given = [word for name, value in parameters.items() if value is not None for word in ("-p", f"{name}:={json.dumps(value)}")]
    remaps = in_namespace(arguments.namespace or "")
    progress.step(f"record to {arguments.output}; Ctrl-C ends it")
    if status := main(Recorder, args=["hyst", "--ros-args", *given, *remaps]):
        return status
    made = Artifacts("record", [arguments.output])
    metadata = read_yaml(Path(arguments.output) / "metadata.yaml")
    topics = metadata["rosbag2_bagfile_information"]["topics_with_message_count"]
    counts = {topic["topic_metadata"]["name"]: topic["message_count"] for topic in topics}
    if not any(counts.values()):
        shutil.rmtree(arguments.output)
        raise InputError(
            f"nothing was received on {', '.join(counts)}, and no bag is kept: check that the nodes run under these names"
        )
    for name, count in counts.items():
        made.lines.append(
            f"{name}: {count} messages" if count else f"{name}: nothing was received: check that its node runs under this name"
        )
        made.add(name, "messages", "", count)
    return made
