"""Record signal topics to a bag with the recorder node, until Ctrl-C, for a time, or for a number of ticks.

The bag can be read at any moment, also when the recorder is killed. `--schedule timer` for signals on the wall clock, `lockstep` for
those of a simulation that waits; the rate is that of the signals.

examples:
  hyst record --rate 1000 --duration 60 --output run.bag
  hyst record --schedule lockstep --rate 20000 --ticks 40000 --topics command measurement --output run.bag
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hyst_control.reporting.artifacts import Artifacts

NAME = "record"
HELP = "record signal topics to a bag"
JSON = "what was recorded"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--output", metavar="BAG", required=True, help="bag to write, which must not exist")
    parser.add_argument("--topics", nargs="+", help="topics (default: the five of the loop)")
    parser.add_argument("--rate", type=float, default=1000.0, help="sample rate of the signals in Hz (default 1000)")
    parser.add_argument("--schedule", choices=("timer", "lockstep"), default="timer", help="what the loop ticks by (default timer)")
    parser.add_argument("--duration", type=float, help="end after so many seconds")
    parser.add_argument("--ticks", type=int, help="end after so many rows of every topic")
    parser.add_argument("--merge", type=int, default=1, help="rows stored in one message, at least (default 1)")
    parser.add_argument("--namespace", help="namespace of the topics")


def run(arguments: argparse.Namespace) -> Artifacts | int:
    import json
    from pathlib import Path

    import yaml

    from hyst_control import progress
    from hyst_control.errors import InputError
    from hyst_control.nodes.recorder import Recorder
    from hyst_control.nodes.run import main
    from hyst_control.reporting.artifacts import Artifacts

    for name in ("duration", "ticks"):
        value = getattr(arguments, name)
        if value is not None and not 0 < value < 1e12:
            raise InputError(f"{name}: {value!r}, more than 0 is due")
    parameters = {
        "output": arguments.output,
        "topics": arguments.topics,
        "rate_hz": arguments.rate,
        "schedule": arguments.schedule,
        "duration": arguments.duration,
        "ticks": arguments.ticks,
        "merge": arguments.merge,
    }
    given = [word for name, value in parameters.items() if value is not None for word in ("-p", f"{name}:={json.dumps(value)}")]
    remaps = ["-r", f"__ns:=/{arguments.namespace.strip('/')}"] if arguments.namespace else []
    progress.step(f"record to {arguments.output}; Ctrl-C ends it")
    if status := main(Recorder, args=["hyst", "--ros-args", *given, *remaps]):
        return status
    made = Artifacts("record", [arguments.output])
    metadata = yaml.safe_load((Path(arguments.output) / "metadata.yaml").read_text(encoding="utf-8"))
    for topic in metadata["rosbag2_bagfile_information"]["topics_with_message_count"]:
        name, count = topic["topic_metadata"]["name"], topic["message_count"]
        made.lines.append(f"{name}: {count} messages")
        made.add(name, "messages", "", count)
    return made
