# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Draw cases from the reference simulations: recorded bags with a model each and their labels in a separate file; or draw all effects.

examples:
  hyst cases make --seed 7 --count 20 --output cases
  hyst cases make --seed 7 --count 12 --output mirror --plants fsm --kinds single pair --excitations rich --switched 0.5
  hyst cases make --measured --seed 7 --count 20 --output injected --plants stack
  hyst cases make --fleet 20 30 --seed 7 --output fleet   # units and runs; then: hyst fleet diagnose fleet/manifest.csv --output study
  hyst cases figures --output docs/figures/effects   # a figure for every effect
"""

from __future__ import annotations

import argparse
from typing import Any

from hyst_control.reporting.result import CommandResult

NAME = "cases"
HELP = "draw recorded cases with effects in them, labels in a separate file"
JSON = "list of written files"


OPTIONS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("--seed", "seed of the cases (make)", {"type": int}),
    ("--count", "number of cases (make; default 60)", {"type": int, "default": 60}),
    ("--output", "folder to write: cases/ and labels.json (make), pictures (figures)", {"required": True, "metavar": "FOLDER"}),
    ("--measured", "put known effects into records of machines, measured and simulated (make)", {"action": "store_true"}),
    ("--fleet", "record a simulated fleet with its manifest (make)", {"nargs": 2, "type": int, "metavar": ("UNITS", "RUNS")}),
    (
        "--plants",
        "reference simulations (make): pea, pea_published, fsm, fsm_published, third; default: the blind test's",
        {"nargs": "+"},
    ),
    ("--kinds", "content of the cases (make): single, pair, parameters, none, open_set (default: all)", {"nargs": "+"}),
    ("--excitations", "records (make): rich, multisine, sine, closed_loop (default: all)", {"nargs": "+"}),
    (
        "--switched",
        "share of the cases with effects that begin within the record (make; default 0)",
        {"type": float, "default": 0.0},
    ),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("action", choices=("make", "figures"), help="make: draw and record cases; figures: draw every effect")
    for option, meaning, given in OPTIONS:
        parser.add_argument(option, help=meaning, **given)


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from pathlib import Path

    from evaluation.blind_test.run import Batch, make
    from hyst_control.base.errors import InputError
    from hyst_control.reporting.artifacts import Artifacts

    folder = Path(arguments.output)
    if arguments.action == "figures":
        from evaluation.blind_test.effect_figures import write

        return Artifacts("cases figures", write(folder))
    if arguments.seed is None:
        raise InputError("--seed: is missing: give it, as in hyst cases make --seed 7 --output cases")
    if arguments.fleet:
        from evaluation.benchmarks.simulated_fleet import make_fleet
        from hyst_control.base import progress

        units, runs = arguments.fleet
        labels = make_fleet(folder, arguments.seed, units, runs, note=progress.step)
        made = Artifacts("cases make", [labels.parent / "manifest.csv", labels])
        made.add("", "records", "", units * runs)
        return made
    options = _options(arguments)
    labels = make(Batch("injected" if arguments.measured else "simulated", folder, arguments.seed, arguments.count, options))
    made = Artifacts("cases make", [labels.parent / "cases", labels])
    made.add("", "cases", "", arguments.count)
    return made


def _options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Options of the drawing that are given and known."""
    from evaluation.blind_test.case import EXCITATIONS, KINDS
    from evaluation.blind_test.injected_machines import PLANTS
    from evaluation.blind_test.plant_setups import SETUPS
    from hyst_control.base.errors import InputError

    known = {"plants": tuple(PLANTS if arguments.measured else SETUPS)}
    known |= {} if arguments.measured else {"kinds": KINDS, "excitations": EXCITATIONS}
    options = {option: value for option in known if (value := getattr(arguments, option))}
    for option, values in options.items():
        for value in values:
            if value not in known[option]:
                raise InputError(f"--{option}: must be among {', '.join(known[option])}, got {value}")
    if not 0 <= arguments.switched <= 1:
        raise InputError(f"--switched: must be from 0 to 1, got {arguments.switched:g}")
    return options | ({"switched": arguments.switched} if arguments.switched and not arguments.measured else {})
