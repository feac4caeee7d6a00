# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Run a model file over a recorded command or an excitation, and write a bag with `command` and `measurement`.

examples:
  hyst simulate model.yaml run.bag --output simulated.bag
  hyst simulate model.yaml --excitation diagnostic lowest=0 highest=80 --output simulated.bag --seed 1
"""

from __future__ import annotations

import argparse

from hyst_control.reporting.result import CommandResult

NAME = "simulate"
HELP = "run a model over a recorded command or an excitation"
JSON = "list of written files"
READS = ("model", "bag", "excitation")
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("model", metavar="MODEL.yaml", help="model file")
    add("bag", nargs="?", metavar="BAG", help="bag whose command is used")
    add("--excitation", nargs="+", metavar="WORD", help="kind of signal or .yaml file, and parameter=value (see hyst excite)")
    add("--output", metavar="BAG", default="simulated", help="bag to write, which must not exist (default simulated)")
    add("--rate", type=float, help="sample rate of an excitation in Hz (default: the model's)")
    add("--seed", type=int, help="add the model's noise, drawn with this seed (default: no noise)")
    add("--namespace", help="namespace of the topics, where a bag holds several plants")


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    import numpy as np

    from hyst_control.base import progress
    from hyst_control.base.errors import InputError
    from hyst_control.model_file import load_model, simulate
    from hyst_control.records.bags.bag_files import one_bag
    from hyst_control.records.bags.bag_reader import read_bag
    from hyst_control.records.excitation.excitation import build
    from hyst_control.records.excitation.excitation_files import read_description
    from hyst_control.records.record import Record, Signal, regular_times
    from hyst_control.records.stream.row_store import blocks
    from hyst_control.records.tables.importing import write_bag
    from hyst_control.reporting.artifacts import Artifacts

    if bool(arguments.bag) == bool(arguments.excitation):
        raise InputError("give either a bag or --excitation")
    model = load_model(arguments.model)
    hold, notes = model.hold, []
    if arguments.bag:
        if arguments.rate is not None:
            raise InputError("--rate: a bag has its own rate: leave it out")
        record = read_bag(one_bag(arguments.bag), arguments.namespace, topics=("command",))
        [data] = record.aligned(["command"])
        commands, sample_time, hold = data.command, data.sample_time, record.hold if record.states_hold else model.hold
        if commands.shape[1] != len(model.axes):
            raise InputError(f"{arguments.bag}: command has {commands.shape[1]} axes, {arguments.model} {len(model.axes)}")
        notes = [f"note: {note}" for note in record.notes]
    else:
        rate = 1.0 / model.sample_time if arguments.rate is None else arguments.rate
        if not np.isfinite(rate) or rate <= 0:
            raise InputError(f"--rate: must be > 0 Hz, got {rate!r}")
        sample_time = 1.0 / rate
        commands = build(read_description(arguments.excitation), sample_time, len(model.axes))
    progress.step(f"simulate {len(commands)} samples")
    try:
        measurement = simulate(model, commands, sample_time, hold)
    except (MemoryError, OverflowError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{arguments.model}: cannot run at {1.0 / sample_time:g} Hz ({error}): choose another rate") from None
    sigma = np.broadcast_to(np.asarray(model.noise.get("sigma", 0.0), dtype=float), len(model.axes))
    noise = None if arguments.seed is None else np.random.default_rng(arguments.seed)
    lowest, highest = np.inf, -np.inf
    for part in blocks(len(measurement)):
        if noise is not None:
            measurement[part] += sigma * noise.standard_normal(measurement[part].shape)
        if not np.isfinite(measurement[part]).all():
            raise InputError(
                f"{arguments.model}: the simulation diverges with this command: check that the model is stable and the command within "
                "its range"
            )
        lowest, highest = min(lowest, float(measurement[part].min())), max(highest, float(measurement[part].max()))
    time = regular_times(len(commands), sample_time)
    rows = {"command": commands, "measurement": measurement}
    signals = {topic: Signal(time, values, tuple(model.axes), model.units[topic]) for topic, values in rows.items()}
    write_bag(arguments.output, Record(signals, arguments.output, (), hold, states_hold=True))
    unit, rate = model.units["measurement"], 1.0 / sample_time
    line = f"{len(commands)} samples at {rate:g} Hz, measurement {lowest:.4g} to {highest:.4g} {unit}"
    made = Artifacts("simulate", [arguments.output], lines=[*notes, line])
    made.add("", "samples", "", len(commands))
    made.add("", "rate", "Hz", rate)
    made.add("measurement", "minimum", unit, lowest)
    made.add("measurement", "maximum", unit, highest)
    return made
