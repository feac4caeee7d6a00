# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Excitations as a user gives them, in words or a file, and as other programs take them: table, array, description or bag."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.files import replacing, write_text
from hyst_control.base.yaml_files import parse_yaml, read_yaml
from hyst_control.records.excitation.excitation import KINDS
from hyst_control.records.record import Record, Signal, axis_names
from hyst_control.records.stream.signal_message import label_for
from hyst_control.records.tables.importing import write_bag

UNITS = ("V", "um", "mrad")


def read_description(words: Sequence[str]) -> dict[str, Any]:
    """A description for `excitation.build`: a kind or a .yaml file, then `parameter=value` words, values as in YAML.

    Raises `InputError` naming the word that cannot be used.
    """
    first, *rest = words
    spec: Any = {"signal": first}
    if first.endswith((".yaml", ".yml")):
        spec = read_yaml(Path(first), f"give an existing file or one of {', '.join(sorted(KINDS))}")
        if not isinstance(spec, dict):
            raise InputError(f"{Path(first)}: holds no description: must be signal: KIND and its parameters")
    for word in rest:
        name, mark, text = word.partition("=")
        if not mark or not name:
            raise InputError(f"must be parameter=value, such as frequency=10, got {word!r}")
        try:
            spec[name] = parse_yaml(text, name)
        except InputError:
            raise InputError(f"{word!r}: the value must be a number, a text or a list such as [1, 2]") from None
    return dict(spec)


def write_excitation(
    path: str | Path, spec: Mapping[str, Any], rows: Annotated[Array, "N A"], sample_time: float, unit: str
) -> None:
    """Write an excitation in the format that the ending of the file name selects.

    .csv, .npy and .yaml (the description, for the reference generator) are known; a name without an ending, or with .bag, is a bag,
    which holds the rows as `command` when their unit is V, as `reference` otherwise; time starts at 0.
    """
    path = Path(path)
    axes, time = axis_names(rows.shape[1]), np.asarray(np.arange(len(rows)) * sample_time, dtype=np.float64)
    if unit not in UNITS:
        raise InputError(f"unit: must be one of {', '.join(UNITS)}, got {unit!r}")
    if os.path.lexists(path):
        raise InputError(f"{path}: exists already: choose another name or remove it")
    if path.suffix == ".csv":
        with replacing(path) as file:
            np.savetxt(file, np.column_stack([time, rows]), "%.17g", ",", header=label_for(axes, unit), comments="")
    elif path.suffix == ".npy":
        with replacing(path) as file:
            np.save(file, rows)
    elif path.suffix in (".yaml", ".yml"):
        write_text(path, yaml.safe_dump(dict(spec), sort_keys=False))
    elif path.suffix[1:2].isalpha() and path.suffix != ".bag":  # a bag may be named run_0.5
        raise InputError(f"{path}: its ending says what is written: .csv, .npy, .yaml, or none or .bag for a bag")
    else:
        write_bag(path, Record({"command" if unit == "V" else "reference": Signal(time, rows, axes, unit)}, str(path)))
