# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Draw what a bag or a model holds: signals, loops, spectra or frequency responses, as a picture or a zoomable page.

examples:
  hyst plot record                                         signals over time, to record.png
  hyst plot record --xy command measurement --output loops.html
  hyst plot record --xy measurement.x measurement.y        the path of a mirror
  hyst plot record --spectrum --from 2 --to 10
  hyst plot record --bode --model model.yaml               frequency response with coherence, and the model's
  hyst plot record --model model.yaml                      measured against simulated, and what is left
  hyst plot model.yaml                                     the model's frequency response
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from hyst_control.reporting.result import CommandResult

if TYPE_CHECKING:
    from hyst_control.reporting.signal_figures import Panel

NAME = "plot"
HELP = "draw a bag's or a model's signals, loops, spectra or frequency responses"
JSON = "list of written files"
READS = ("file", "model")
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("file", metavar="BAG", help="recorded bag, or a model file (.yaml)")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument(
        "--xy",
        nargs="*",
        metavar="SIGNAL",
        help="draw the second signal over the first one (default: command measurement), axis by axis",
    )
    kind.add_argument("--spectrum", action="store_true", help="draw amplitude spectral densities")
    kind.add_argument(
        "--bode", action="store_true", help="draw the frequency response from command to measurement, with the coherence"
    )
    parser.add_argument("--model", metavar="MODEL.yaml", help="model that is drawn beside the bag")
    parser.add_argument("--signals", nargs="+", metavar="SIGNAL", help="signals to draw (default: all)")
    parser.add_argument("--from", dest="begin", type=float, default=None, metavar="S", help="first sample time, s")
    parser.add_argument("--to", dest="end", type=float, default=None, metavar="S", help="last sample time, s")
    parser.add_argument("--output", metavar="FILE", help="file to write, .png, .svg, .pdf or .html (default: the bag's name, .png)")
    parser.add_argument("--namespace", help="namespace of the topics, where a bag holds several plants")


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    import os
    from pathlib import Path

    from hyst_control.base.errors import InputError
    from hyst_control.base.files import check_writable
    from hyst_control.reporting.artifacts import Artifacts
    from hyst_control.reporting.signal_figures import write_drawing

    output = arguments.output or f"{Path(os.path.realpath(arguments.file)).stem}.png"
    check_writable(output)
    if arguments.file.endswith((".yaml", ".yml")):
        if arguments.xy is not None or arguments.spectrum or arguments.model or arguments.signals:
            raise InputError(f"{arguments.file}: of a model the frequency response is drawn: leave the other options out")
        panels, notes = _of_model(arguments.file)
    else:
        panels, notes = _of_bag(arguments)
    write_drawing(panels, output, Path(arguments.file).name)
    return Artifacts("plot", [output], lines=[f"note: {note}" for note in notes])


def _of_model(path: str) -> tuple[list[Panel], tuple[str, ...]]:
    from hyst_control.control.model_figures import bode_of
    from hyst_control.model_file import load_model

    return bode_of(load_model(path)), ()


def _of_bag(arguments: argparse.Namespace) -> tuple[list[Panel], tuple[str, ...]]:
    """What the options ask for of a bag, and the notes of its reading."""
    from hyst_control.base.errors import InputError
    from hyst_control.records.bags.bag_reader import read_bag
    from hyst_control.reporting.frequency_figures import bode_of_record
    from hyst_control.reporting.signal_figures import over_each_other, over_time, spectra

    xy = arguments.xy if arguments.xy is None else arguments.xy or ["command", "measurement"]
    if xy is not None and len(xy) != 2:
        raise InputError(f"--xy: takes two signals, got {len(xy)}")
    compared = arguments.bode or arguments.model
    if compared and (xy is not None or arguments.spectrum or arguments.signals):
        raise InputError("--bode, --model: are about command and measurement: leave --xy, --spectrum and --signals out")
    wanted = ("command", "measurement", "applied") if compared else arguments.signals
    if xy is not None and not wanted:
        wanted = [name.partition(".")[0] for name in xy]
    record = read_bag(arguments.file, arguments.namespace, topics=wanted).between(arguments.begin, arguments.end)
    if arguments.model:
        from hyst_control.control.model_figures import beside, bode_of  # with every stage, for which the others need not wait
        from hyst_control.model_file import load_model

        return (bode_of if arguments.bode else beside)(load_model(arguments.model), record), record.notes
    if arguments.bode:
        return bode_of_record(record), record.notes
    if xy is not None:
        return over_each_other(record, *xy), record.notes
    return (spectra(record) if arguments.spectrum else over_time(record)), record.notes
