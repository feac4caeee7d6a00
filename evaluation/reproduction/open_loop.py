# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A command driven through the real nodes in open loop, on a reference simulation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hyst_control.base.arrays import Array
from hyst_control.base.config_files import config_path
from hyst_control.demo.node_runs import run_processes

BLOCK = 500
"""Rows of a message."""


def open_loop(
    folder: Path,
    command: Array,
    sample_time: float,
    plant: str,
    seed: int,
    rating: tuple[float, float],
    feedforward: str = "hampi_feedforward",
    start: str = "first_command",
    **how: Any,
) -> Path:
    """Run the five nodes over a command (N, A) in V; the bag."""
    nodes: dict[str, dict[str, Any]] = {
        feedforward: {"kind": "proportional", "gain": [1.0], "offset": [0.0]},
        "pi_feedback": {"lower": rating[0], "upper": rating[1], "start": start},
        "plant": {"plant": str(config_path(f"plants/{plant}.yaml")), "seed": seed},
    }
    return run_processes(folder, command, sample_time, nodes, block=BLOCK, feedforward=feedforward, **how)
