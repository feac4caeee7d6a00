# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The demo's runs without ROS give the bags that the nodes record, to the last bit: so its figures are the same."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hyst_control.base.config_files import config_path
from hyst_control.demo.composed_run import run_composed
from hyst_control.demo.node_runs import run_processes
from hyst_control.demo.workflow import BLOCK, RATING, SAMPLE_TIME, WITHHELD
from hyst_control.records.bags.bag_reader import read_bag

PLANT = str(config_path("plants/pea.yaml"))
TIME = np.arange(600)[:, None] * SAMPLE_TIME
EXCITATION = 20 * (1 - np.cos(2 * np.pi * 100 * TIME))
REFERENCE = 1 - np.cos(2 * np.pi * 100 * TIME)
MODEL = str(config_path("models/pea_hampi.yaml"))
OPEN = {
    "hampi_feedforward": {"kind": "proportional", "gain": [1.0], "offset": [0.0]},
    "pi_feedback": {"lower": RATING[0], "upper": RATING[1], "start": "first_command"},
    "plant": {"plant": PLANT, "seed": 3, "effects": json.dumps([WITHHELD])},
}
CLOSED = {
    "hampi_feedforward": {"kind": "hampi", "model": MODEL, "limits": list(RATING)},
    "pi_feedback": {"lower": RATING[0], "upper": RATING[1], "slew_limit": 2e6, "feedback": True, "kp": 0.3, "ki": 1e4},
    "plant": {"plant": PLANT, "seed": 4},
}


@pytest.mark.parametrize(("nodes", "signal", "block"), [(OPEN, EXCITATION, BLOCK), (CLOSED, REFERENCE, 1)], ids=["open", "closed"])
def test_a_run_without_ros_equals_that_of_the_nodes(nodes, signal, block, tmp_path):
    through = read_bag(run_processes(tmp_path / "nodes", signal, SAMPLE_TIME, nodes, block=block, lead=40))
    computed = read_bag(run_composed(tmp_path / "computed", signal, SAMPLE_TIME, nodes, block=block, lead=40))
    assert set(through.signals) == set(computed.signals) and np.ptp(computed.signal("measurement").values) > 0.5
    for topic, due in through.signals.items():
        found = computed.signal(topic)
        assert (found.axes, found.unit) == (due.axes, due.unit)
        np.testing.assert_array_equal(found.time, due.time, err_msg=topic)
        np.testing.assert_array_equal(found.values, due.values, err_msg=topic)
