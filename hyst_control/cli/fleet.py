# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identify, validate or diagnose the records of many units, on all cores or on a Dask cluster, into one Parquet table.

`population` makes one model file of a study of identifications: the fleet's coefficients with their usual scatter. `score` compares the
changes that a study of a simulated fleet found with the fleet's labels.

A manifest is a CSV or Parquet file with the columns bag, unit, time, model, baseline and any others; bags, or patterns of their names,
make one. A study is taken up again where it was ended: what is done is not done again, unless its bag, its model, the options or the
version changed. A record that fails costs itself only; it is listed with its reason.

examples:
  hyst fleet diagnose manifest.csv --output study
  hyst fleet diagnose "runs/*/*.bag" --names "runs/(?P<time>[^/]+)/(?P<unit>[^.]+).bag" --model model.yaml --output study
  hyst fleet identify manifest.csv --family hampi --output models --cluster tcp://10.0.0.1:8786
  hyst fleet diagnose manifest.csv --output study --pages --limit gap_rms=0.3
  hyst fleet diagnose manifest.csv --output study --only onsets          thousands of records: which units changed, and in which run
  hyst fleet population models --output population.yaml      for: hyst diagnose NEW --model population.yaml
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from hyst_control.reporting.result import CommandResult

NAME = "fleet"
HELP = "identify, validate or diagnose the records of many units"
JSON = "summary of the study"
READS = ("manifest", "model", "baseline")
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("kind", choices=("identify", "validate", "diagnose", "population", "score"), help="what is computed of every record")
    add(
        "manifest",
        nargs="+",
        metavar="MANIFEST|BAG",
        help="CSV or Parquet file, or bags, or patterns of their names; population, score: folder of a study",
    )
    add("--output", metavar="STUDY", help="folder of the study to write, or to take up again; population: model file")
    add("--labels", metavar="LABELS.json", help="score: labels of the simulated fleet")
    add("--of", metavar="UNIT", help="population: model of this unit, drawn toward the fleet's")
    add("--model", metavar="MODEL.yaml", help="model of the records whose manifest names none")
    add("--baseline", nargs="+", default=[], metavar="BAG", help="baseline records, for those whose manifest names none")
    add("--names", metavar="REGEX", help="finds unit and time in a bag's path: groups (?P<unit>...) and (?P<time>...)")
    add("--family", help="identify: model family (default: the best on held-out data)")
    add("--split-axes", action="store_true", help="take every axis of a record for a unit of its own")
    add("--pages", action="store_true", help="diagnose: write a page of every record with a gap; the fleet's page leads there")
    add(
        "--only",
        choices=("gaps", "onsets"),
        help="diagnose: try effects only on records with a gap, or only on the clearest record of every unit that changed",
    )
    add(
        "--limit",
        action="append",
        default=[],
        metavar="QUANTITY=VALUE",
        help="limit of a quantity, as gap_rms=0.3: when a unit that drifts will be there (may be repeated)",
    )
    add("--workers", type=int, metavar="N", help="worker processes (default: one a core)")
    add("--cluster", metavar="ADDRESS", help="Dask scheduler, its scheduler file, or local to start one")
    add("--namespace", help="namespace of the topics")
    add("--unit", default="unknown", help="unit of the measurement in bags without a layout: um or mrad")


def run(arguments: argparse.Namespace) -> CommandResult:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    from hyst_control.base import progress
    from hyst_control.base.errors import InputError
    from hyst_control.base.parallel import Workers
    from hyst_control.fleet.manifest import read_manifest
    from hyst_control.fleet.overview import check_limits
    from hyst_control.fleet.study import run_study

    if arguments.kind == "score":
        from hyst_control.fleet.onset_scores import score_study

        if arguments.labels is None or len(arguments.manifest) > 1:
            raise InputError("fleet score: takes one study and its labels, as in hyst fleet score STUDY --labels labels.json")
        return score_study(arguments.manifest[0], arguments.labels)
    if arguments.labels:
        raise InputError(f"--labels: goes with score, not with {arguments.kind}")
    if arguments.output is None:
        raise InputError("--output: is missing: name the folder of the study, or the model file of population")
    if arguments.kind == "population":
        from hyst_control.fleet.population_model import population_of_study

        if len(arguments.manifest) > 1:
            raise InputError(f"{arguments.manifest[1]}: a population is made of one study: give one folder")
        return population_of_study(arguments.manifest[0], arguments.output, arguments.of)
    for name, kind in (("of", "population"), ("family", "identify"), ("pages", "diagnose"), ("only", "diagnose")):
        if getattr(arguments, name) and arguments.kind != kind:
            raise InputError(f"--{name}: goes with {kind}, not with {arguments.kind}")
    options: dict[str, object] = {"namespace": arguments.namespace, "unit": arguments.unit}
    if arguments.kind == "identify":
        from hyst_control.identify.families.estimator import estimators
        from hyst_control.identify.workflow import AUTO

        if arguments.family not in (None, AUTO, *estimators()):
            raise InputError(f"--family: must be one of {', '.join(estimators())}, got {arguments.family}")
        options["family"] = arguments.family
    options |= {name: value for name in ("pages", "only") if (value := getattr(arguments, name))}
    limits = _limits(arguments.limit)
    check_limits(arguments.kind, limits)
    entries = read_manifest(arguments.manifest, arguments.names, arguments.model, arguments.baseline)
    workers = Workers(arguments.workers, arguments.cluster)
    return run_study(arguments.kind, entries, arguments.output, options, workers, progress.step, limits, arguments.split_axes)


def _limits(texts: Sequence[str]) -> dict[str, float]:
    from math import isfinite

    from hyst_control.base.errors import InputError

    found: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = float("nan")
        if not name or not isfinite(found[name]):
            raise InputError(f"--limit {text}: must be QUANTITY=VALUE, as gap_rms=0.3")
    return found
