# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A Python function in place of a model file: the nominal model that has it as its only stage."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.yaml_files import read_yaml
from hyst_control.chain import Chain
from hyst_control.chain.external_simulator import ExternalSimulator, Simulate, external_simulator, title_of
from hyst_control.model_file import Model
from hyst_control.records.record import Record


def simulator_model(simulate: Simulate, parameters: Mapping[str, Sequence[Any]], records: Sequence[Record]) -> Model:
    """The model of a function: axes, units and clock are those of the records, the uncertainty that of the parameters."""
    if not records:
        raise InputError("records: there is none: give at least one with command and measurement")
    record = records[0]
    record.check_axes()
    part = record.aligned(allow_gaps=True)[0]
    stage, deviations = external_simulator(simulate, parameters)
    _check_repeatable(stage, part.command, part.sample_time)
    stage = stage if record.hold == "foh" else stage.stepped(part.command, part.sample_time)
    known = {"parameters": [f"{stage.name}.{name}" for name in stage.names], "factor": np.diag(deviations).tolist()}
    return Model(
        name=title_of(simulate),
        axes=part.axes,
        units={"command": record.command_unit, "measurement": record.unit},
        sample_time=part.sample_time,
        chain=Chain((stage,)),
        hold=record.hold,
        uncertainty=known if any(deviations) else {},
    )


def _check_repeatable(stage: ExternalSimulator, command: Array, sample_time: float) -> None:
    """Refuse a function whose second call gives something else: derivatives by differences would be noise."""
    if not np.array_equal(stage.run(command, sample_time), replace(stage, recent={}).run(command, sample_time)):
        raise InputError(
            f"simulator {title_of(stage.simulate)}: a second call gives other values: begin each call from the same state, and seed "
            "its random numbers"
        )


def named_simulator(name: str) -> Simulate:
    """The function that `module:function` names, of a module here or installed."""
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise InputError(f"--simulator {name}: give it as module:function")
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        found: Any = importlib.import_module(module)
        for part in attribute.split("."):
            found = getattr(found, part)
    except (Exception, SystemExit) as error:  # of any kind: it is foreign code
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(
            f"--simulator {name}: cannot be imported ({reason}): start from the folder that the module is in"
        ) from None
    if not callable(found):
        raise InputError(f"--simulator {name}: is no function: give it as module:function")
    simulate: Simulate = found
    return simulate


def read_parameters(path: str | Path) -> Mapping[str, Sequence[Any]]:
    """Parameters of a YAML file, a line each: `stiffness: [1.2, 0.1, N/um]`."""
    document = read_yaml(path, "give a YAML file with lines such as stiffness: [1.2, 0.1, N/um]")
    if not isinstance(document, Mapping):
        raise InputError(f"{path}: must be a mapping with lines such as stiffness: [1.2, 0.1, N/um]")
    return document
