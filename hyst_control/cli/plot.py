"""Draw what a bag holds: its signals over time, hysteresis loops or paths, or spectra, as a picture or a zoomable page.

examples:
  hyst plot record                                         signals over time, to record.png
  hyst plot record --xy command measurement --output loops.html
  hyst plot record --xy measurement.x measurement.y        the path of a mirror
  hyst plot record --spectrum --from 2 --to 10
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hyst_control.reporting.artifacts import Artifacts

NAME = "plot"
HELP = "draw a bag's signals, loops or spectra"
JSON = "list of written files"
READS = ("bag",)
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("bag", metavar="BAG", help="recorded bag")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--xy",
        nargs="*",
        metavar="SIGNAL",
        help="draw the second signal over the first one (default: command measurement), axis by axis",
    )
    kind.add_argument("--spectrum", action="store_true", help="draw amplitude spectral densities")
    parser.add_argument("--signals", nargs="+", metavar="SIGNAL", help="signals to draw (default: all)")
    parser.add_argument("--from", dest="begin", type=float, default=None, metavar="S", help="first sample time, s")
    parser.add_argument("--to", dest="end", type=float, default=None, metavar="S", help="last sample time, s")
    parser.add_argument("--output", metavar="FILE", help="file to write, .png, .svg, .pdf or .html (default: the bag's name, .png)")
    parser.add_argument("--namespace", help="namespace of the topics, where a bag holds several plants")


def run(arguments: argparse.Namespace) -> Artifacts:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    import os
    from pathlib import Path

    from hyst_control.errors import InputError
    from hyst_control.files import check_writable
    from hyst_control.records.bag_reader import read_bag
    from hyst_control.reporting.artifacts import Artifacts
    from hyst_control.reporting.signal_figures import over_each_other, over_time, spectra, write_drawing

    output = arguments.output or f"{Path(os.path.realpath(arguments.bag)).stem}.png"
    check_writable(output)
    xy = arguments.xy if arguments.xy is None else arguments.xy or ["command", "measurement"]
    if xy is not None and len(xy) != 2:
        raise InputError(f"--xy: takes two signals, got {len(xy)}")
    wanted = arguments.signals or (None if xy is None else [name.partition(".")[0] for name in xy])
    record = read_bag(arguments.bag, arguments.namespace, topics=wanted).between(arguments.begin, arguments.end)
    if xy is not None:
        panels = over_each_other(record, *xy)
    else:
        panels = spectra(record) if arguments.spectrum else over_time(record)
    write_drawing(panels, output, Path(arguments.bag).name)
    return Artifacts("plot", [output], lines=[f"note: {note}" for note in record.notes])
