# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of a simulated machine through the real nodes: records in open loop, and tracking."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hyst_control.base.arrays import Array
from hyst_control.base.config_files import config_path
from hyst_control.demo.node_runs import run_processes
from hyst_control.identify.workflow import gapless_records
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import Record

BLOCK = 500
"""Rows of a message where nothing feeds back."""
SIGNALS = ("reference", "feedforward", "feedback", "command", "measurement")
UNITY = {"kind": "proportional", "gain": [1.0], "offset": [0.0]}
"""Feedforward that passes a command through."""


@dataclass(frozen=True)
class Machine:
    """A reference simulation, and what all runs on it share."""

    plant: str  # Name of its file
    feedforward: str  # Name of the feedforward node
    rating: tuple[float, float]  # V
    sample_time: float  # s
    axes: tuple[str, ...] = ("x",)
    unit: str = "um"

    def open_loop(
        self, folder: Path, command: Array, seed: int, sample_time: float | None = None, start: str = "first_command"
    ) -> Path:
        """Run the five nodes over a command (N, A) in V; the bag."""
        return self._run(folder, command, sample_time or self.sample_time, UNITY, {"start": start}, {"seed": seed}, block=BLOCK)

    def record(self, folder: Path, command: Array, seed: int, sample_time: float | None = None) -> Record:
        """Record a command (N, A) in V in open loop."""
        return gapless_records(read_bag(self.open_loop(folder, command, seed, sample_time)))[0]

    def track(
        self,
        folder: Path,
        reference: Array,
        feedforward: Mapping[str, Any],
        feedback: Mapping[str, Any],
        preview: int,
        plant: Mapping[str, Any],
    ) -> dict[str, Array]:
        """Track a reference (N, A) with a compensator, and with feedback where its parameters say so; every signal on one clock."""
        own = {"limits": list(self.rating), **feedforward}
        block = 1 if feedback.get("feedback") else BLOCK
        return signals_of(self._run(folder, reference, self.sample_time, own, feedback, plant, block=block, lead=preview + 1))

    def _run(
        self,
        folder: Path,
        rows: Array,
        sample_time: float,
        feedforward: Mapping[str, Any],
        feedback: Mapping[str, Any],
        plant: Mapping[str, Any],
        **how: int,
    ) -> Path:
        nodes: dict[str, dict[str, Any]] = {
            self.feedforward: dict(feedforward),
            "pi_feedback": {"lower": self.rating[0], "upper": self.rating[1], **feedback},
            "plant": {"plant": str(config_path(f"plants/{self.plant}.yaml")), **plant},
        }
        return run_processes(folder, rows, sample_time, nodes, self.axes, self.unit, feedforward=self.feedforward, **how)


def signals_of(bag: Path) -> dict[str, Array]:
    """Read every signal of a tracking bag on one clock."""
    return read_bag(bag).aligned(SIGNALS)[0].values
