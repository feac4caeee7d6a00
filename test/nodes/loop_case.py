# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""What the tests of the nodes share: the five nodes with a real model, and reading what was recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from hyst_control.base.config_files import config_path
from hyst_control.control.feedback.filters import Filters
from hyst_control.control.feedback.loop import run_loop
from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.model_file import Simulator, load_model, simulate
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.stream.signal_message import Encoder, decode

MODEL = str(config_path("models/pea_hampi.yaml"))
RATE = 20000.0
SIGNALS = ("reference", "feedforward", "feedback", "command", "measurement")
RUNNING = r"(running|\d+ of \d+ Hz: \d+ ticks missed)"
"""State of a node without a fault: on a machine that is busy with other things, such as a browser, it may miss ticks."""


def reference(count: int) -> np.ndarray:
    """A 150 Hz tracking task of a few um from rest, rows (count, 1)."""
    time = np.arange(count) / RATE
    return (2.0 * (1 - np.cos(2 * np.pi * 150.0 * time)))[:, None]


def parameters(folder: Path, count: int, **changes: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Parameters of the five nodes by name; `changes` per node."""
    path = folder / "reference.npy"
    if not path.exists():
        np.save(path, reference(count))
    each = {
        "reference_generator": {"signal": str(path), "lead": 40},
        "hampi_feedforward": {"model": MODEL, "limits": [0.0, 150.0]},
        "pi_feedback": {"kp": 0.5, "ki": 2000.0, "upper": 150.0, "slew_limit": 2e5},
        "plant": {"model": MODEL, "ticks": count, "wait_for_recorder": True},
        "recorder": {"output": str(folder / "bag"), "ticks": count},
    }
    return {name: {"rate_hz": RATE, **own, **changes.get(name, {})} for name, own in each.items()}


def offline(count: int, feedback: bool = True, start: str = "rest", filters: Filters | None = None) -> dict[str, np.ndarray]:
    """The same run computed without nodes."""
    model = load_model(MODEL)
    compensator = build_compensator(model, "hampi", sample_time=1 / RATE, limits=(0.0, 150.0))
    controller = PI(0.5, 2000.0, 1 / RATE, 0.0, 150.0, 2e5, filters=filters or Filters()).start(1)
    return run_loop(reference(count), compensator, controller, Simulator(model, 1 / RATE), feedback, start)


def write_record(path):
    """Nested 20 Hz loops of the published model, sampled at 2 kHz."""
    time = np.arange(3000) / 2000
    command = (40 * (1 - np.cos(2 * np.pi * 20 * time)) * np.exp(-time) / 2)[:, None]
    measurement = simulate(load_model(MODEL), command, sample_time=1 / 2000)
    with BagWriter(path) as bag:
        for topic, unit, values in (("/command", "V", command), ("/measurement", "um", measurement)):
            bag.write(topic, Encoder(f"t[s],x[{unit}]").encode(np.concatenate([time[:, None], values], axis=1)), 10**9)


def recorded(bag: Path) -> dict[str, np.ndarray]:
    """Rows (N, 1 + A) by topic, time in column 0, in the order they stand in the bag."""
    rows: dict[str, list[np.ndarray]] = {}
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, raw in reader.messages():
            rows.setdefault(connection.topic.rsplit("/", 1)[-1], []).append(decode(raw)[1])
    return {topic: np.concatenate(blocks) for topic, blocks in rows.items()}


def assert_same_bits(found: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    """Every topic complete, on the clock, and equal to the last bit."""
    assert set(found) == set(SIGNALS)
    for topic, rows in expected.items():
        np.testing.assert_array_equal(found[topic][:, 0], np.arange(len(rows)) * (1 / RATE), err_msg=topic)
        np.testing.assert_array_equal(found[topic][:, 1:], rows, err_msg=topic)
