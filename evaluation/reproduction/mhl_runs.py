# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Runs of the MHL experiments through the real nodes: records in open loop, and tracking, on the simulated mirror."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from evaluation.reproduction.open_loop import BLOCK, open_loop
from hyst_control.base.arrays import Array
from hyst_control.base.config_files import config_path
from hyst_control.control.feedforward.whole_inverse import lifted_inverse
from hyst_control.control.tuning import Tuning
from hyst_control.demo.node_runs import run_processes
from hyst_control.identify.data.dataset import Dataset
from hyst_control.identify.workflow import datasets_of
from hyst_control.model_file import Model
from hyst_control.records.bags.bag_reader import read_bag

SAMPLE_TIME = 2e-4
"""s, of the loop and its records (paper §4.5)."""
AXES = ("x", "y")
RATING = (0.0, 100.0)
SLEW_LIMIT = 1e6
CENTRE, REACH = 1.0, 0.9
"""mrad; of 0 … 2 mrad the last twentieth at either end is left, where remanence keeps the mirror from its end."""
SEED = 626
MIRROR: dict[str, Any] = {"axes": AXES, "unit": "mrad", "feedforward": "mhl_feedforward"}
"""Parameters of the mirror's nodes that all runs share."""


def record(folder: Path, signal: Annotated[Array, "N 2"], sample_time: float, seed: int) -> Dataset:
    """Record the simulated mirror in open loop, through the five nodes."""
    return datasets_of(read_bag(open_loop(folder, signal, sample_time, "fsm", seed, RATING, **MIRROR)))[0]


def track(
    folder: Path,
    kind: str,
    path: Path,
    reference: Annotated[Array, "N 2"],
    tuning: Tuning | None,
    settings: Mapping[str, Any],
    preview: int,
    plant: Mapping[str, Any] | None = None,
) -> dict[str, Array]:
    """Run one tracking experiment with a compensator, and with feedback if it is tuned."""
    bag = run_processes(
        folder,
        reference,
        SAMPLE_TIME,
        {
            "mhl_feedforward": {"kind": kind, "model": str(path), "limits": list(RATING), **settings},
            "pi_feedback": feedback_parameters(tuning),
            "plant": {"plant": str(config_path("plants/fsm.yaml")), "seed": SEED + 4, **(plant or {})},
        },
        block=1 if tuning else BLOCK,
        lead=preview + 1,
        **MIRROR,
    )
    return signals_of(bag)


def feedback_parameters(tuning: Tuning | None) -> dict[str, Any]:
    """Parameters of the feedback node for a `tuning`; None: open loop."""
    limits = {"lower": RATING[0], "upper": RATING[1], "slew_limit": SLEW_LIMIT, "feedback": tuning is not None}
    return limits if tuning is None else {**limits, "kp": tuning.kp, "ki": tuning.ki, "roll_off": float(tuning.roll_off)}


def lifted(folder: Path, model: Model, reference: Annotated[Array, "N 2"]) -> dict[str, Array]:
    """Track open loop with the whole model inverted over the whole reference by iteration: the limit of any feedforward."""
    command = lifted_inverse(model, reference, sample_time=SAMPLE_TIME, limits=RATING).command
    bag = open_loop(folder, command, SAMPLE_TIME, "fsm", SEED + 4, RATING, start="rest", **MIRROR)
    return {**signals_of(bag), "reference": reference}


def signals_of(bag: Path) -> dict[str, Array]:
    """Read every signal of a tracking bag on one clock."""
    return dict(read_bag(bag).aligned(("reference", "feedforward", "feedback", "command", "measurement"))[0].values)
