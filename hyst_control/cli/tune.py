# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Tune the PI feedback from a model to given stability margins, and report the properties of the loop.

examples:
  hyst tune config/models/fsm_mhl.yaml --rate 5000
  hyst tune config/models/fsm_mhl.yaml --rate 5000 --roll-off --at 100
  hyst tune config/models/pea_hampi.yaml --structure damping --output gains.yaml
  hyst tune config/models/fsm_mhl.yaml --rate 5000 --jitter quiet.csv     # how much of a vibration remains
  hyst tune hampi.yaml --gain-margin 8 --phase-margin 55 --loop-delay 1 --json tuning.json
"""

from __future__ import annotations

import argparse
from pathlib import Path

from hyst_control.reporting.result import CommandResult

NAME = "tune"
HELP = "tune the PI feedback from a model to stability margins"
READS = ("model", "jitter")
WRITES = ("output",)
SPREADS = ("gain_spread", "mode_spread", "model_error")
PASSED_ON = ("gain_margin", "phase_margin", "peak_sensitivity", "loop_delay", *SPREADS, "structure")
"""Arguments that `tune` takes under the same names."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("model", metavar="MODEL.yaml", help="model file")
    add("--rate", type=float, help="sample rate of the loop in Hz (default: the model's)")
    add("--gain-margin", type=float, default=6.0, metavar="DB", help="least gain margin in dB (default 6)")
    add("--phase-margin", type=float, default=45.0, metavar="DEG", help="least phase margin in degrees (default 45)")
    add("--peak-sensitivity", type=float, default=2.0, metavar="MS", help="greatest peak of the sensitivity (default 2)")
    add(
        "--loop-delay",
        type=int,
        default=0,
        metavar="TICKS",
        help="additional delay of the loop in ticks: 0 in lockstep (default), about 1 on wall-clock timers",
    )
    add("--gain-spread", type=float, default=0.1, help="relative spread of the plant's gain (default 0.1)")
    add("--mode-spread", type=float, default=0.2, help="relative spread of the resonances' frequencies (default 0.2)")
    add("--model-error", type=float, default=0.15, help="relative error of the model's response at any frequency (default 0.15)")
    add(
        "--roll-off",
        nargs="?",
        const="auto",
        default="0",
        metavar="HZ",
        help="tune with a roll-off of the feedback: chosen along with the gains, or of this corner in Hz (default: none); "
        "the gains then hold only with it",
    )
    add(
        "--structure",
        choices=("pi", "pid", "notch", "damping", "auto"),
        default="pi",
        help="pi (default), with a filtered derivative, a notch or damping of the resonance that peaks most in the loop, or the best of "
        "them (auto)",
    )
    add("--output", metavar="GAINS.yaml", help="parameter file of the node pi_feedback to write")
    add("--jitter", metavar="RECORD", help="record at rest without feedback: predict the rms of that motion with feedback")
    add("--at", type=float, nargs="+", default=[], metavar="HZ", help="print the sensitivity |S| at these frequencies as well")


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    import yaml

    from hyst_control.base.errors import InputError
    from hyst_control.base.files import write_text
    from hyst_control.control.tuning import tune
    from hyst_control.model_file import load_model

    model = load_model(arguments.model)
    if arguments.rate is not None and not 0 < arguments.rate < 1e12:
        raise InputError(f"--rate: must be > 0 Hz and < 1e12 Hz, got {arguments.rate!r}")
    if arguments.loop_delay < 0:
        raise InputError(f"--loop-delay: must be >= 0 ticks, got {arguments.loop_delay}")
    try:
        roll_off = "auto" if arguments.roll_off == "auto" else float(arguments.roll_off)
    except ValueError:
        raise InputError(f"--roll-off: {arguments.roll_off!r}: give a corner in Hz, or nothing for auto") from None
    given = {name: getattr(arguments, name) for name in PASSED_ON}
    result = tune(model, sample_time=1.0 / arguments.rate if arguments.rate else None, roll_off=roll_off, **given)
    nyquist = 0.5 / result.sample_time
    for frequency in arguments.at:
        if not 0 < frequency <= nyquist:
            raise InputError(f"--at: {frequency!r} Hz: must be above 0 and at most half the rate, {nyquist:g} Hz")
    table = result.table(model)
    for frequency, value in zip(arguments.at, result.sensitivity(model, arguments.at, arguments.loop_delay), strict=True):
        table.add("PI feedback", f"{frequency:g} Hz", "nominal", "sensitivity", "", value)
    if arguments.jitter is not None:
        from hyst_control.control.jitter import jitter
        from hyst_control.records.bags.bag_reader import read_bag
        from hyst_control.records.tables.importing import is_table, read_table

        path = Path(arguments.jitter)  # a table may hold the measurement alone
        record = read_table(path, topics=("measurement",)) if is_table(path) else read_bag(path)
        jitter(result, model, record, arguments.loop_delay).add_to(table)
    if arguments.output is not None:
        gains = {name: value if isinstance(value, list) else float(value) for name, value in result.parameters.items()}
        write_text(arguments.output, yaml.safe_dump({"/**/pi_feedback": {"ros__parameters": gains}}, sort_keys=False))
        table.notes.append(f"written: {arguments.output}")
    return table
