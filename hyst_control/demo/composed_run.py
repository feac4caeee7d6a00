# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""One run of the loop without ROS: what the nodes compute in lockstep, to the last bit, in this process and into the same bag."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from hyst_control.base import progress
from hyst_control.base.arrays import Array
from hyst_control.control.feedback.loop import Compensator, run_loop
from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.control.feedforward.static_gain import Proportional
from hyst_control.model_file import load_model
from hyst_control.records.record import Record, Signal, regular_times
from hyst_control.records.tables.importing import write_bag
from hyst_plant_sim.physics import load_plant


def run_composed(
    folder: Path, reference: Annotated[Array, "N A"], sample_time: float, nodes: Mapping[str, Mapping[str, Any]], **_streaming: int
) -> Path:
    """Compute the run that `run_processes` makes of the same parameters of the nodes; blocks and lead do not change it."""
    progress.step(f"compute {len(reference)} ticks ({folder.name})")
    feedback, plant = dict(nodes["pi_feedback"]), nodes["plant"]
    closed, start = feedback.pop("feedback", False), feedback.pop("start", "rest")
    controller = PI(**{"kp": 0.0, "ki": 0.0, "sample_time": sample_time, **feedback}).start(reference.shape[1])
    machine = load_plant(
        plant["plant"], seed=plant["seed"], sample_time=sample_time, effects=json.loads(plant.get("effects", "[]"))
    )
    signals = run_loop(reference, _compensator(nodes["hampi_feedforward"], sample_time), controller, machine, closed, start)
    time = regular_times(len(reference), sample_time)
    units = {"reference": "um", "measurement": "um"}
    record = Record({name: Signal(time, rows, ("x",), units.get(name, "V")) for name, rows in signals.items()}, folder.name)
    write_bag(folder / "bag", record)
    return folder / "bag"


def _compensator(given: Mapping[str, Any], sample_time: float) -> Compensator:
    if given["kind"] == "proportional":
        return Proportional(np.array(given["gain"]), np.array(given["offset"]))
    return build_compensator(load_model(given["model"]), given["kind"], sample_time=sample_time, limits=given["limits"])
