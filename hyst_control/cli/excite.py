# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Build an excitation or a reference and write it as a table, an array, a bag, or a description for the reference generator.

The signal is a kind (see --list) or a .yaml file with its description, followed by parameter=value.

examples:
  hyst excite --list
  hyst excite hampi_identification peak=80 --rate 20000 --output excitation.yaml
  hyst excite sine frequency=10 amplitude=20 offset=25 duration=2 --rate 5000 --output drive.csv
  hyst excite diagnostic lowest=0 highest=100 --plant pea --output diagnostic.bag
  hyst excite raster width=1 height=1 lines=20 line_time=0.05 --axes 2 --unit mrad --rate 5000 --output scan.bag
"""

from __future__ import annotations

import argparse
from typing import Any

from hyst_control.reporting.result import CommandResult

NAME = "excite"
HELP = "build an excitation and write it as a table, array, bag or description"
JSON = "list of written files, or of kinds with --list,"
READS = ("signal", "plant")
WRITES = ("output",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add = parser.add_argument
    add("signal", nargs="*", metavar="KIND parameter=value", help="kind of signal or .yaml file, and parameters")
    add("--list", action="store_true", help="print every kind with its parameters, their units and meaning")
    add("--output", metavar="FILE", help="file to write: .csv, .npy or .yaml, or a bag (no ending, or .bag); it must not exist")
    add("--rate", type=float, default=20000.0, help="sample rate in Hz (default 20000)")
    add(
        "--plant",
        metavar="PLANT",
        help="reference simulation (a name in config/plants or a file) whose axes are used, "
        "and whose rating and slew limit bound an excitation in V",
    )
    add("--axes", type=int, help="number of axes (default 1, or the plant's)")
    add("--unit", default="V", help="unit: V for an excitation (default), um or mrad for a reference")


def run(arguments: argparse.Namespace) -> CommandResult | Kinds:
    """Run this command with the parsed `arguments` and return its result, as described in `hyst_control.cli`."""
    import numpy as np

    from hyst_control.base.errors import InputError
    from hyst_control.records.excitation.excitation import build
    from hyst_control.records.excitation.excitation_files import read_description, write_excitation
    from hyst_control.reporting.artifacts import Artifacts

    if arguments.list:
        return Kinds()
    if not arguments.signal:
        raise InputError("give a kind of signal: hyst excite --list shows them")
    if not np.isfinite(arguments.rate) or arguments.rate <= 0:
        raise InputError(f"--rate: must be > 0 Hz, got {arguments.rate!r}")
    if arguments.axes is not None and not 1 <= arguments.axes <= 100:
        raise InputError(f"--axes: must be 1 to 100, got {arguments.axes}")
    spec, axes = read_description(arguments.signal), arguments.axes or 1
    if arguments.plant:
        limits, axes = plant_limits(arguments.plant, arguments.unit)
        if arguments.axes not in (None, axes):
            raise InputError(f"--axes: must be {axes} for the plant {arguments.plant}, got {arguments.axes}: leave it out")
        spec = {**limits, **spec}
    rows = build(spec, 1.0 / arguments.rate, axes)
    if not arguments.output:
        raise InputError("--output: give the file to write")
    write_excitation(arguments.output, spec, rows, 1.0 / arguments.rate, arguments.unit)
    unit, duration = arguments.unit, len(rows) / arguments.rate
    slope = np.abs(np.diff(rows, axis=0)).max(initial=0.0) * arguments.rate
    asked = float(spec.get("duration", duration))
    longer = f" (duration={asked:g} s does not count ramps and steps)" if abs(duration - asked) * arguments.rate > 1 else ""
    line = f"{len(rows)} samples, {duration:g} s{longer}, {rows.min():.4g} to {rows.max():.4g} {unit}, at most {slope:.4g} {unit}/s"
    made = Artifacts("excite", [arguments.output], lines=[line])
    made.add("", "samples", "", len(rows))
    made.add("", "duration", "s", duration)
    made.add("", "minimum", unit, rows.min())
    made.add("", "maximum", unit, rows.max())
    made.add("", "slope", f"{unit}/s", slope)
    return made


def plant_limits(name: str, unit: str) -> tuple[dict[str, float], int]:
    """Bounds of an excitation for a reference simulation."""
    from hyst_control.base.errors import InputError
    from hyst_plant_sim.physics import PlantError, load_plant

    if unit != "V":
        raise InputError(f"--plant: bounds an excitation in V, not in {unit}: leave out --plant or --unit")
    try:
        plant = load_plant(name)
    except PlantError as error:
        raise InputError(f"--plant: {error}") from None
    limits = {"lower": plant.rating[0], "upper": plant.rating[1]}
    return ({**limits, "slew_limit": plant.slew_limit} if plant.slew_limit > 0 else limits), len(plant.axes)


class Kinds:
    """List of all kinds of signals with their parameters and a sentence each."""

    def document(self) -> dict[str, Any]:
        """JSON document: kinds by name, each with parameters (a default of null must be given) and a sentence."""
        import inspect

        from hyst_control.records.excitation.excitation import KINDS
        from hyst_control.records.excitation.parameters import COMMON

        kinds = {}
        for name in sorted(KINDS):
            parameters = {
                key: None if each.default is inspect.Parameter.empty else each.default
                for key, each in inspect.signature(KINDS[name]).parameters.items()
                if key not in ("sample_time", "axes")
            }
            kinds[name] = {"parameters": parameters, "text": (inspect.getdoc(KINDS[name]) or "").splitlines()[0]}
        return {"schema": "hyst_control/excitations", "version": 1, "kinds": kinds, "common_parameters": list(COMMON)}

    def text(self) -> str:
        """Text for people: two lines per kind, and a line per parameter."""
        from hyst_control.records.excitation.parameters import described

        lines = []
        listed = self.document()
        for name, kind in listed["kinds"].items():
            words = [key if default is None else f"{key}={default}" for key, default in kind["parameters"].items()]
            lines += [f"{name} {' '.join(words)}", f"    {kind['text']}"]
            declared = [described(name, key) for key in kind["parameters"]]
            lines += [f"      {f'{each.name} [{each.unit}]' if each.unit else each.name}: {each.meaning}" for each in declared]
        bounds, others = (", ".join(part) for part in (listed["common_parameters"][:3], listed["common_parameters"][3:]))
        return "\n".join([*lines, f"Parameters of every kind: {bounds} (bounds that it is checked against), {others}."])
