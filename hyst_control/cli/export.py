# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Write a model or a controller as C, with a harness that holds it against Python, or as an FMU; or a bag as a file of other tools.

MODEL.yaml is exported as the plant, with --kind as a feedforward, with --twin as the model beside the running system,
with --discrepancy as the error that it states of itself. A file of nodes'
parameters is exported as the controller of its pi_feedback and its feedforward node.

A BAG is exported with --to: as MCAP with one message a row at its sample time, which players draw, or as a table or arrays.

examples:
  hyst export config/models/pea_hampi.yaml --output plant
  hyst export config/models/pea_hampi.yaml --kind hampi --causal --output feedforward
  hyst export tracking.yaml --reference-ahead --output controller
  hyst export tracking.yaml --reference-ahead --ros2-control --output controller_package
  hyst export config/models/pea_hampi.yaml --fmu --output plant.fmu
"""

from __future__ import annotations

import argparse

from hyst_control.reporting.result import CommandResult

NAME = "export"
HELP = "write a model, a feedforward or a controller as C or FMU, or a bag for other tools"
JSON = "list of written files"
READS = ("source", "plant", "inverse_model")
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("source", metavar="MODEL|CONTROLLER|BAG", help="model file, file of nodes' parameters, or bag")
    add("--target", choices=("c",), default="c", help="language (default c: C99)")
    add("--to", choices=("mcap", "csv", "parquet", "mat"), help="of a bag: form of the file")
    add("--namespace", help="of a bag: namespace of its topics, where it holds several plants")
    add(
        "--output",
        metavar="OUT",
        help="folder to write into, created where it is missing (default: the source's name and _c); of a bag, and with --fmu: file "
        "(default: its name with the form's ending)",
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument(
        "--fmu", action="store_true", help="write one .fmu file: co-simulation by FMI 2.0, with the C compiled for this machine"
    )
    form.add_argument(
        "--ros2-control", action="store_true", help="of a controller: write a package with a chainable controller of ros2_control"
    )
    add("--name", default="", help="prefix of everything in C (default: the model's name, or the file's)")
    add("--real", choices=("double", "float"), default="double", help="type of the signals (default double)")
    add("--rate", type=float, metavar="HZ", help="sample rate of a model in Hz (default: the model's)")
    add("--kind", help="of a model: the feedforward of this kind, such as hapi, hampi, mhl, mhl_inverse")
    add("--twin", action="store_true", help="of a model: measurement minus prediction beside the running system")
    add("--discrepancy", action="store_true", help="of a model: mean and standard deviation of the error that it states of itself")
    add("--inverse", default="zpetc", help="with --kind: inverse of the dynamics (default zpetc)")
    add("--discretisation", default="zoh", help="with --kind: of the dynamics, zoh or tustin (default zoh)")
    add("--iterations", type=int, help="with --kind: of the inverse of the hysteresis (default: the kind's)")
    add("--inverse-model", default="", metavar="MODEL.yaml", help="with --kind: separately identified inverse curves")
    add(
        "--rate-filter",
        type=float,
        nargs="+",
        metavar="C",
        help="with --kind mhl: denominator of N(s), s^2, s, 1; a single 0: without (default: below the model's first resonance)",
    )
    add("--smoothing", type=int, default=0, help="with --kind: order of a low-pass without phase, which looks ahead")
    add(
        "--limits",
        type=float,
        nargs=2,
        metavar=("LOWER", "UPPER"),
        help="with --kind: rating of the drive in V (default: the model's)",
    )
    add("--causal", action="store_true", help="with --kind: do not look ahead; the command is late")
    form.add_argument(
        "--plant", metavar="MODEL.yaml", help="of a controller: also a program that closes the loop against this model's simulator"
    )
    add("--reference-ahead", action="store_true", help="the reference is known as far ahead as the feedforward looks")


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    import os
    from functools import partial

    from hyst_control.base.errors import InputError
    from hyst_control.control.feedforward.compensator import FROM_MODEL
    from hyst_control.export import programs
    from hyst_control.export.fmu import write_fmu
    from hyst_control.export.folder import sizes, write_folder
    from hyst_control.export.ros2_control import write_package
    from hyst_control.model_file import load_model
    from hyst_control.reporting.artifacts import Artifacts

    given = arguments
    if given.output is None:
        ending = f".{given.to}" if given.to else ".fmu" if given.fmu else "_c"
        given.output = os.path.basename(os.path.realpath(given.source)).partition(".")[0] + ending
    if given.to:
        return _bag(given)
    if given.rate is not None and not 0 < given.rate < 1e12:
        raise InputError(f"--rate: must be > 0 Hz and < 1e12 Hz, got {given.rate!r}")
    kinds = [name for name in ("kind", "twin", "discrepancy") if getattr(given, name)]
    if len(kinds) > 1:
        raise InputError(f"--{kinds[1]}: give it, or --{kinds[0]}, not both")
    time = 1.0 / given.rate if given.rate else None
    files = [given.source]
    if not programs.is_model(given.source):
        chosen = [name for name in ("rate", "kind", "twin", "discrepancy", "causal", "limits") if getattr(given, name)]
        if chosen:
            raise InputError(f"--{chosen[0]}: {given.source} has nodes' parameters, which say that: change it there")
        exported = programs.controller(given.source, given.real, given.name, given.reference_ahead)
    else:
        model = load_model(given.source)
        try:
            if given.kind:
                chosen_filter = FROM_MODEL if given.rate_filter is None else given.rate_filter
                same = ("inverse", "discretisation", "iterations", "smoothing", "inverse_model")
                options = programs.FeedforwardOptions(
                    given.kind,
                    **{name: getattr(given, name) for name in same},
                    rate_filter=tuple(chosen_filter) if any(chosen_filter) else None,
                    limits=tuple(given.limits) if given.limits else None,
                    preview=not given.causal,
                )
                files += [given.inverse_model] if given.inverse_model else []
                exported = programs.feedforward(model, options, time, given.real, given.name, given.reference_ahead)
            else:
                plant_alone = partial(programs.simulator, hold="zoh" if given.fmu else None)  # a simulator holds what it sets
                alone = programs.twin if given.twin else programs.stated_error if given.discrepancy else plant_alone
                exported = alone(model, time, given.real, given.name)
        except InputError as error:
            raise InputError(f"{given.source}: {error}") from None
    if given.fmu:
        program = exported.program
        lines = [f"{program.name}: {len(program.inputs)} inputs, {len(program.outputs)} outputs, tick {program.sample_time:g} s"]
        return Artifacts("export", [write_fmu(program, given.output)], lines=[*lines, *exported.notes])
    if given.ros2_control:
        written = write_package(exported, given.output)
        line = f"colcon build of {given.output} makes {exported.program.name}_controller/Controller"
        return Artifacts("export", written, lines=[line])
    plant = None
    if given.plant:
        plant = programs.simulator(load_model(given.plant), exported.program.sample_time, given.real, hold="zoh")
        files.append(given.plant)
    written = write_folder(exported, given.output, files, plant)
    program, size = exported.program, sizes(exported.program)
    flash = "unknown without a compiler" if size.flash is None else f"{size.flash} bytes (this machine, -Os)"
    lines = [
        f"{program.name}: {len(program.inputs)} inputs, {len(program.outputs)} outputs, {program.real}, tick {program.sample_time:g} s",
        *exported.notes,
        f"state {size.state} bytes, flash {flash}",
        f"make -C {given.output} test compiles it and compares it with Python",
    ]
    made = Artifacts("export", written, lines=lines)
    made.add("", "state", "byte", size.state)
    if size.flash is not None:
        made.add("", "flash", "byte", size.flash)
    return made


def _bag(given: argparse.Namespace) -> CommandResult:
    """Export a bag's signals."""
    from hyst_control.base.errors import InputError
    from hyst_control.base.files import check_writable
    from hyst_control.records.bags.bag_reader import read_bag
    from hyst_control.records.tables.exporting import export_record
    from hyst_control.reporting.artifacts import Artifacts

    for name in ("rate", "kind", "twin", "discrepancy", "causal", "limits", "plant", "fmu", "ros2_control"):
        if getattr(given, name):
            raise InputError(f"--{name.replace('_', '-')}: is of a model, not of a bag: leave it out")
    if given.to != "mcap":
        check_writable(given.output)
    record = read_bag(given.source, given.namespace)
    export_record(record, given.output, given.to)
    made = Artifacts("export", [given.output], lines=[f"note: {note}" for note in record.notes])
    for topic, signal in record.signals.items():
        made.add(topic, "rows", "", len(signal.time))
    return made
