# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Test the diagnosis blind: draw cases, diagnose each in a process that never sees its label, score, and write the page.

Seeds 0 to 999 are for tuning; scoring seeds begin at 100000, and each is used for one version. An interrupted run continues when it is
called again with the same folder.

example:
  hyst blind-test --seed 100000 --count 800 --output blind --page blind.md
  hyst blind-test --measured --page measured.md     models of measured plants with one element removed
  hyst blind-test --injected --seed 7 --count 60 --output injected   # known effects put into records of machines
  hyst blind-test --seed 100000 --count 300 --with-injected 200 --output blind --page blind.md     both on one page
  hyst blind-test --seed 7 --count 800 --output blind --cluster tcp://10.0.0.1:8786      on the workers of a Dask cluster
"""

from __future__ import annotations

import argparse
from typing import Any

from hyst_control.base.errors import InputError
from hyst_control.reporting.result import CommandResult

NAME = "blind-test"
HELP = "test the diagnosis on cases whose effect is withheld"
WRITES = ("page",)

COUNT: dict[str, Any] = {"type": int, "metavar": "COUNT"}
OPTIONS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    (
        "--injected",
        "with --seed: only put known effects into records of machines, measured and simulated",
        {"action": "store_true"},
    ),
    (
        "--plants",
        "with --injected or --measured: plants, stack and mirror, and simulated with --injected (default: all)",
        {"nargs": "+"},
    ),
    ("--count", "number of cases (default 800)", {**COUNT, "default": 800}),
    ("--with-injected", "with --seed: number of injected cases beside the others", {**COUNT, "default": 0}),
    ("--without-gap", "with --seed: number of further cases without a gap, for the false alarms", {**COUNT, "default": 0}),
    ("--left-out", "single effects to diagnose again without them in the catalogue (default 100)", {**COUNT, "default": 100}),
    ("--output", "folder to write: cases, labels and reports (default blind_out)", {"default": "blind_out", "metavar": "FOLDER"}),
    ("--stop-after", "begin no further diagnosis after this time; the same call continues", {"type": float, "metavar": "SECONDS"}),
    ("--so-far", "score the cases that an interrupted run has diagnosed, without diagnosing more", {"action": "store_true"}),
    ("--core", "core of the diagnosis (default by_regime)", {"choices": ("by_regime", "rules", "likelihood"), "default": "by_regime"}),
    ("--workers", "with --seed: worker processes (default: one a core)", {"type": int, "metavar": "N"}),
    (
        "--cluster",
        "with --seed: Dask scheduler, its scheduler file, or local; its workers must see --output",
        {"metavar": "ADDRESS"},
    ),
    ("--page", "page to write, with its figure", {"metavar": "OUT.md"}),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--seed", type=int, help="seed of the cases")
    what.add_argument("--measured", action="store_true", help="diagnose measured records with models that lost one element")
    for option, meaning, given in OPTIONS:
        parser.add_argument(option, help=meaning, **given)


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from dataclasses import replace
    from pathlib import Path

    from evaluation.blind_test import injected_machines, withheld
    from evaluation.blind_test.run import Batch
    from evaluation.blind_test.run import run as run_all
    from hyst_control.base.parallel import Workers

    given = arguments.workers is not None or arguments.cluster is not None
    if arguments.measured and given:
        raise InputError("--workers, --cluster: go with --seed, not with --measured: leave them out")
    known = withheld.PLANTS if arguments.measured else injected_machines.PLANTS
    for plant in arguments.plants or ():
        if plant not in known:
            raise InputError(f"--plants {plant}: unknown, give some of {', '.join(known)}")
    folder, seed = Path(arguments.output), arguments.seed
    chosen = {"plants": arguments.plants} if arguments.plants else {}
    names: tuple[str, ...]
    if arguments.measured:
        batches, names = [Batch("withheld", folder / "measured", options=chosen)], ("measured",)
    elif arguments.injected:
        batches, names = [Batch("injected", folder, seed, arguments.count, chosen)], ("injected", "seed", "count")
    else:
        batches = [Batch("simulated", folder, seed, arguments.count, left_out=arguments.left_out)]
        names = ("seed", "count", "left_out")
        if arguments.with_injected:
            batches.append(Batch("injected", folder / "injected", seed, arguments.with_injected))
        if arguments.without_gap:
            quiet = {"kinds": ("none",)}
            batches.append(Batch("simulated", folder / "without_gap", seed, arguments.without_gap, quiet, "without_gap"))
        names += tuple(name for name in ("with_injected", "without_gap") if getattr(arguments, name))
    given_values = {name: getattr(arguments, name) for name in names}
    said = [f"--{name.replace('_', '-')}" + (f" {value}" if value is not True else "") for name, value in given_values.items()]
    said += [f"--plants {' '.join(arguments.plants)}"] if chosen else []
    said += [f"--core {arguments.core}"] if arguments.core != "rules" else []
    return run_all(
        [replace(batch, core=arguments.core) for batch in batches],
        " ".join(["blind-test", *said]),
        arguments.page,
        so_far=arguments.so_far,
        stop_after=arguments.stop_after,
        workers=Workers(arguments.workers, arguments.cluster) if given else None,
    )
