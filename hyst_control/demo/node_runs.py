# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""One run of the loop through the real nodes, each a process of its own, from a reference array to a recorded bag."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from hyst_control.base import progress
from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.processes.node_processes import Processes
from hyst_control.processes.ros_domain import own_domain

ROUNDS_TIMEOUT = 0.05
"""Patience (s) for one lockstep round; a run that takes longer than this for each of them has stalled."""


def run_processes(
    folder: Path,
    reference: Annotated[Array, "N A"],
    sample_time: float,
    nodes: Mapping[str, Mapping[str, Any]],
    axes: tuple[str, ...] = ("x",),
    unit: str = "um",
    block: int = 1,
    lead: int = 0,
    feedforward: str = "hampi_feedforward",
) -> Path:
    """Run the five nodes in lockstep over a reference."""
    progress.step(f"run {len(reference)} ticks through the nodes ({folder.name})")
    folder.mkdir(parents=True, exist_ok=True)
    signal = folder / "reference.npy"
    np.save(signal, reference)
    ticks = len(reference)
    bag = folder / "bag"
    common = {"rate_hz": 1.0 / sample_time, "axes": list(axes), "unit": unit}
    settings: dict[str, dict[str, Any]] = {
        "reference_generator": {"signal": str(signal), "block": block, "lead": max(lead, block), "ramp_time": 0.0},
        feedforward: {},
        "pi_feedback": {"feedback": False},
        "plant": {"ticks": ticks, "wait_for_recorder": True},
        "recorder": {"output": str(bag), "ticks": ticks, "merge": 50},
    }
    for name in nodes:
        if name not in settings:
            raise InputError(f"{name}: is not one of the nodes of a run: {', '.join(settings)}")
    with own_domain() as domain, Processes(folder / "log", domain) as processes:
        for name, own in settings.items():
            processes.start(name, {**common, **own, **nodes.get(name, {})})
        processes.wait("plant", "recorder", timeout=60.0 + ticks / max(block, 1) * ROUNDS_TIMEOUT)
        processes.stop()
        processes.check()
    signal.unlink()
    return bag
