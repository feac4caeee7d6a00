# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A node whose constructor refuses is gone at the end of its test."""

from __future__ import annotations

import left_over_nodes
import pytest
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node


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
