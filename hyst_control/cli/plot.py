# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Draw bags, a model or a fit: signals, loops, spectra, frequency responses, poles, margins, as a picture or a zoomable page.

examples:
  hyst plot record                                         signals over time, to record.png
  hyst plot record --xy command measurement --output loops.html
  hyst plot record --xy measurement.x measurement.y        the path of a mirror
  hyst plot record --spectrum --from 2 --to 10
  hyst plot record --bode --model model.yaml               frequency response with coherence, and the model's
  hyst plot record --model model.yaml                      measured against simulated, residual and its correlations
  hyst plot monday friday --xy --color record              loops of several bags over each other
  hyst plot record --xy --color time                       color tells when; of one bag it tells the frequency
  hyst plot model.yaml                                     the model's frequency response
  hyst plot model.yaml --poles                             its poles and zeros
  hyst plot model.yaml --tuning                            margins and step of the PI feedback that hyst tune finds
  hyst plot fit.json                                       the orders or structures among which hyst identify chose
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
READS = ("files", "model")
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("files", nargs="+", metavar="BAG", help="recorded bags, a folder of them, or a model file (.yaml) or fit report (.json)")
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
    kind.add_argument("--poles", action="store_true", help="of a model: draw its poles and zeros")
    kind.add_argument(
        "--tuning", action="store_true", help="of a model: draw open loop, sensitivities and step of its tuned PI feedback"
    )
    add("--color", choices=("record", "time", "frequency"), help="of --xy: what the colors tell")
    add("--model", metavar="MODEL.yaml", help="model that is drawn beside the bag")
    add("--signals", nargs="+", metavar="SIGNAL", help="signals to draw (default: all)")
    add("--from", dest="begin", type=float, default=None, metavar="S", help="first sample time, s")
    add("--to", dest="end", type=float, default=None, metavar="S", help="last sample time, s")
    add("--output", metavar="FILE", help="file to write, .png, .svg, .pdf or .html (default: the bag's name, .png)")
    add("--namespace", help="namespace of the topics, where a bag holds several plants")


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    import os
    from pathlib import Path

    from hyst_control.base.errors import InputError
    from hyst_control.base.files import check_writable
    from hyst_control.reporting.artifacts import Artifacts
    from hyst_control.reporting.signal_figures import write_drawing

    first = arguments.files[0]
    output = arguments.output or f"{Path(os.path.realpath(first)).stem}.png"
    check_writable(output)
    notes: tuple[str, ...] = ()
    if first.endswith((".yaml", ".yml", ".json")):
        others = ("xy", "spectrum", "model", "signals", "color", "begin", "end", "bode")
        if len(arguments.files) > 1 or any(getattr(arguments, name) not in (None, False) for name in others):
            raise InputError(f"{first}: of a model or a fit nothing but --poles or --tuning is chosen: leave the other options out")
        panels = _of_report(first) if first.endswith(".json") else _of_model(arguments, first)
    elif arguments.poles or arguments.tuning:
        raise InputError(f"{first}: --poles and --tuning are of a model: give a model file (.yaml)")
    else:
        panels, notes = _of_bags(arguments)
    write_drawing(panels, output, Path(first).name)
    return Artifacts("plot", [output], lines=[f"note: {note}" for note in notes])


def _of_model(arguments: argparse.Namespace, path: str) -> list[Panel]:
    from hyst_control.control.model_figures import bode_of, poles_and_zeros, tuning_panels
    from hyst_control.control.tuning import tune
    from hyst_control.model_file import load_model

    model = load_model(path)
    if arguments.tuning:
        return tuning_panels(tune(model), model)
    return poles_and_zeros(model) if arguments.poles else bode_of(model)


def _of_report(path: str) -> list[Panel]:
    from hyst_control.base.errors import InputError
    from hyst_control.base.files import read_json
    from hyst_control.identify.assess.choice_figure import choice_panels

    report = read_json(path)
    if "family" not in report:
        raise InputError(f"{path}: is no fit report: give what hyst identify --json wrote")
    return choice_panels(report)


def _of_bags(arguments: argparse.Namespace) -> tuple[list[Panel], tuple[str, ...]]:
    """Panels of bags that the options ask for, and the notes on reading the bags."""
    from hyst_control.base.errors import InputError
    from hyst_control.records.bags.bag_files import bags_in
    from hyst_control.records.bags.bag_reader import read_bag
    from hyst_control.reporting.frequency_figures import bode_of_record
    from hyst_control.reporting.signal_figures import over_each_other, over_time, spectra

    xy = arguments.xy if arguments.xy is None else arguments.xy or ["command", "measurement"]
    if xy is not None and len(xy) != 2:
        raise InputError(f"--xy: takes two signals, got {len(xy)}")
    compared = arguments.bode or arguments.model
    if compared and (xy is not None or arguments.spectrum or arguments.signals):
        raise InputError("--bode, --model: are about command and measurement: leave --xy, --spectrum and --signals out")
    named = [*(arguments.signals or ()), *(name.partition(".")[0] for name in xy or ())]
    wanted = ("command", "measurement", "applied") if compared else named or None
    bags = bags_in(arguments.files)
    if compared and len(bags) > 1:
        raise InputError("--bode, --model: are of one bag: give one")
    if arguments.color and xy is None:
        raise InputError("--color: is of loops: give --xy too")
    read = [read_bag(bag, arguments.namespace, topics=wanted) for bag in bags]
    record, *others = records = [each.between(arguments.begin, arguments.end) for each in read]
    notes = tuple(note for each in records for note in each.notes)
    if arguments.model:
        from hyst_control.control.model_figures import beside, bode_of  # with every stage, for which the others need not wait
        from hyst_control.identify.validation import check_pair
        from hyst_control.model_file import load_model

        model = load_model(arguments.model)
        panels = (bode_of if arguments.bode else beside)(model, record)
        notes = (*record.notes, *check_pair(model.name, model, record))
    elif arguments.bode:
        panels = bode_of_record(record)
    if arguments.bode and not any(len(line.x) for line in panels[-1].lines):  # of the coherence, which every measured frequency has
        raise InputError(f"{record.source}: too few samples for a frequency response: choose a longer part (--from, --to)")
    if compared:
        return [panel for panel in panels if any(len(line.x) for line in panel.lines)], notes  # an empty one has no scale
    if xy is not None:
        return over_each_other(record, *xy, *others, color=arguments.color), notes
    return (spectra if arguments.spectrum else over_time)(*records), notes
