"""The conformance records: noise-free, of the two published models, from an independent implementation at a 200 kHz step."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from hyst_control.model_file import Simulator, load_model, simulate
from hyst_control.records.stream.signal_message import decode, parse_label

FOLDER = Path(os.environ.get("HYST_CONFORMANCE", Path(__file__).resolve().parents[2] / "shared" / "conformance"))
RECORDS = ("pea_multisine", "pea_staircase", "fsm_multisine", "fsm_staircase")
EXACT = {"pea_multisine": 1e-9, "pea_staircase": 1e-9}
"""The PEA's records hold exactly what the chain computes; the FSM's differ by what their internal step leaves."""

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason=f"no conformance records in {FOLDER}: set HYST_CONFORMANCE")


def signal(name: str, topic: str) -> tuple[np.ndarray, np.ndarray, str]:
    """Times (N,), values (N, A) and unit of one topic of a record."""
    with AnyReader([FOLDER / name / "real"]) as reader:
        blocks = [decode(raw) for _, _, raw in reader.messages([c for c in reader.connections if c.topic.strip("/") == topic])]
    data = np.concatenate([block for _, block in blocks])
    return data[:, 0], data[:, 1:], parse_label(blocks[0][0])[1][-1]


@pytest.mark.parametrize("name", RECORDS)
def test_the_chain_reproduces_the_record(name):
    """Within 0.05 % of the range, every axis, every sample, the start included."""
    model = load_model(FOLDER / name / "model.yaml")
    time, command, unit = signal(name, "command")
    measured_time, measurement, measured_unit = signal(name, "measurement")
    np.testing.assert_array_equal(time, measured_time)
    np.testing.assert_allclose(np.diff(time), model.sample_time, rtol=1e-6)
    assert (unit, measured_unit) == (model.units["command"], model.units["measurement"])
    deviation = np.max(np.abs(simulate(model, command) - measurement), axis=0) / np.ptp(measurement, axis=0)
    assert np.all(deviation <= EXACT.get(name, 5e-4)), f"{name}: {100 * deviation} % of range"


@pytest.mark.parametrize("name", RECORDS)
def test_the_streaming_simulator_gives_the_same_bits(name):
    model = load_model(FOLDER / name / "model.yaml")
    _, command, _ = signal(name, "command")
    command = command[:3000]
    simulator = Simulator(model)
    streamed = [simulator.reset(command[0])[None]]
    for begin in range(0, len(command), 7):
        streamed.append(simulator.step(command[begin : begin + 7]))
    np.testing.assert_array_equal(np.concatenate(streamed)[:-1], simulate(model, command))
