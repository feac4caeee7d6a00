# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Locate the gap between a model and recorded bags, name the effect that causes it, and compute how much of it that effect removes.

The bags need command and measurement; reference, feedforward and feedback are replayed if they were recorded. The first run for a
model, command and noise level calibrates its threshold on simulated records without a gap, and stores it for later runs.

example:
  hyst diagnose record --model hampi.yaml --json gap.json --report gap.html --augmented better.yaml
  hyst diagnose today --model hampi.yaml --baseline yesterday
  hyst diagnose today --baseline yesterday        # the same command: what has changed since?
  hyst diagnose record --simulator joint:simulate --parameters prior.yaml
"""

from __future__ import annotations

import argparse

from hyst_control.cli.validate import add_bag_options

NAME = "diagnose"
HELP = "explain the gap between a model and recorded bags"
JSON = "gap report"
READS = ("bags", "model", "parameters", "baseline", "on")
WRITES = ("report", "augmented")
PASSED_ON = (
    *("json", "report", "augmented", "without", "seed", "namespace", "unit", "columns", "warm_up", "on", "baseline"),
    *("core", "own_records", "simulator", "parameters", "shift"),
)
"""Arguments that `diagnose_bags` takes under the same names."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("bags", nargs="+", metavar="BAG", help="recorded bags of one plant")
    add("--model", metavar="MODEL.yaml", help="model file of the simulator; needed unless a baseline has the same command")
    add(
        "--simulator",
        metavar="MODULE:FUNCTION",
        help="Python function in place of the model file: simulate(command, sample_time, **parameters) returns the measurement",
    )
    add("--parameters", metavar="PRIOR.yaml", help="its parameters, a line each: name: [value, standard deviation, unit]")
    add(
        "--baseline",
        nargs="+",
        default=[],
        metavar="BASELINE",
        help="baseline records of the same machine: the model's residual on them is its discrepancy; best with the same command",
    )
    add("--report", metavar="OUT.html", help="HTML page to write")
    add("--augmented", metavar="OUT.yaml", help="model file to write: the model with the effects added")
    add(
        "--learned-residual",
        action="store_true",
        help="where no known effect explains the gap, add to that model what is left, as far as it follows the command",
    )
    add(
        "--core",
        choices=("by_regime", "rules", "likelihood"),
        default="by_regime",
        help="core that weighs the hypotheses: tuned rules, or one likelihood of all; by regime: the likelihood beside baseline records "
        "of other commands, else the rules (default by_regime)",
    )
    add(
        "--own-records",
        action="store_true",
        help="the records are those that the model was identified from: look for what it lacks, beyond the noise alone and not beyond "
        "the error that its file states",
    )
    add("--without", action="append", default=[], metavar="EFFECT", help="leave an effect out of the catalogue")
    add(
        "--on",
        metavar="COMMAND",
        help="bag or .npy file (rows by axes, V) with the command of a future run: print the predicted reduction of the gap on it",
    )
    add(
        "--warm-up",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="initial part of each record that only brings the simulation into the "
        "plant's state and is not counted, for records that do not begin at rest (default 0)",
    )
    add("--seed", type=int, default=0, help="seed of the simulated records and of the resampling (default 0)")
    add("--no-cache", action="store_true", help="calibrate the threshold again")
    add_bag_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    import gc
    import sys

    from hyst_control.base import progress
    from hyst_control.diagnose.workflow import diagnose_bags

    gc.freeze()  # what is loaded stays: looking for garbage among it takes a tenth of a second
    given = {name: getattr(arguments, name) for name in PASSED_ON} | {"cache": not arguments.no_cache}
    shows_progress = not arguments.quiet and sys.stderr.isatty()
    residual = arguments.learned_residual
    gap = diagnose_bags(arguments.bags, arguments.model, learned_residual=residual, progress=shows_progress, **given)
    progress.end()
    if gap.diagnosis is None:
        print(gap.words, file=sys.stderr)
        return 2
    print(gap.words)
    return 0
