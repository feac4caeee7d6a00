# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A node whose constructor refuses is gone at the end of its test, and any other one once it is destroyed."""

from __future__ import annotations

import gc
import os

import left_over_nodes
import pytest
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node

from hyst_control.nodes.pi_feedback import PiFeedback


class Refusing(Node):
    """Refuses once it is on the graph, and is kept by the test."""

    kept: list[Node] = []

    def __init__(self, **options):
        super().__init__("refusing", **options)
        self.kept.append(self)
        raise ValueError("no such stage")


def test_a_refused_node_is_destroyed(ros_context):
    Refusing.kept.clear()
    with left_over_nodes.destroyed():
        with pytest.raises(ValueError):
            Refusing(context=ros_context)
        (node,) = Refusing.kept
        assert node.get_name() == "refusing"
    with pytest.raises(InvalidHandle):
        node.get_name()


def test_a_destroyed_node_leaves_the_middleware_before_garbage_is_collected(ros_context):
    Node("first", context=ros_context).destroy_node()  # what the middleware keeps of its first participant
    gc.collect()
    before = len(os.listdir("/proc/self/task"))
    gc.disable()
    try:
        node = PiFeedback(context=ros_context)
        assert len(os.listdir("/proc/self/task")) > before
        node.close()
        node.destroy_node()
        assert len(os.listdir("/proc/self/task")) == before
    finally:
        gc.enable()
