# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Lockstep: composed in one process or as five processes, what is recorded equals the offline computation bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from loop_case import assert_same_bits, offline, parameters, recorded
from rclpy.parameter import Parameter

from hyst_control.nodes.execution.run import run
from hyst_control.nodes.pipeline import DEFAULT, node_class
from hyst_control.processes.node_processes import Processes


def composed(context, settings, order=DEFAULT):
    nodes = [
        node_class(name)(
            context=context, parameter_overrides=[Parameter(key, value=value) for key, value in settings[name].items()]
        )
        for name in order
    ]
    assert run(nodes, context, timeout=60.0) == 0
    return nodes


def test_composed_closed_loop_equals_offline(tmp_path, ros_context):
    composed(ros_context, parameters(tmp_path, 700))
    expected = offline(700)
    assert np.ptp(expected["measurement"]) > 2.0 and np.any(expected["feedback"] != 0)
    assert_same_bits(recorded(tmp_path / "bag"), expected)


@pytest.mark.parametrize("block, lead", [(1, 40), (64, 0), (300, 700)])
def test_open_loop_streams_blocks_of_any_length(tmp_path, ros_context, block, lead):
    settings = parameters(
        tmp_path,
        1500,
        reference_generator={"block": block, "lead": max(lead, 40)},
        pi_feedback={"feedback": False, "start": "first_command"},
        plant={"start": "first_command"},
    )
    composed(ros_context, settings)
    assert_same_bits(recorded(tmp_path / "bag"), offline(1500, feedback=False, start="first_command"))


def test_starting_order_does_not_matter(tmp_path, ros_context):
    composed(
        ros_context,
        parameters(tmp_path, 200, plant={"retry": 0.05}),
        order=("plant", "recorder", "pi_feedback", "hampi_feedforward", "reference_generator"),
    )
    assert_same_bits(recorded(tmp_path / "bag"), offline(200))


def test_a_short_run_that_waits_for_no_recorder_is_recorded_from_its_first_row_on(tmp_path, ros_context):
    """The plant sends it before the recorder is there: the run ended without it, and the recorder waited for ever."""
    composed(ros_context, parameters(tmp_path, 300, plant={"wait_for_recorder": False}))
    assert_same_bits(recorded(tmp_path / "bag"), offline(300))


def test_message_objects_give_the_same_bits(tmp_path, ros_context):
    settings = parameters(tmp_path, 200)
    for node in settings.values():
        node["message_objects"] = True
    composed(ros_context, settings)
    assert_same_bits(recorded(tmp_path / "bag"), offline(200))


def test_five_processes_equal_offline_and_end_cleanly(tmp_path, domain):
    settings = parameters(tmp_path, 1000)
    with Processes(tmp_path / "log", domain) as processes:
        for name in DEFAULT:
            processes.start(name, settings[name])
        processes.wait("plant", "recorder", timeout=90)
        assert processes.stop() == dict.fromkeys(DEFAULT, 0)
        for name in DEFAULT:
            assert "Traceback" not in processes.log(name).read_text()
    assert_same_bits(recorded(tmp_path / "bag"), offline(1000))
