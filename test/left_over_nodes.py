# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that a test leaves over, one whose constructor refused its parameters, say, are destroyed with it.

The garbage collector would do it at any later time, beside the nodes of another test, where Fast DDS may wait for itself for ever.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any
from unittest.mock import patch
from weakref import WeakSet


@contextmanager
def destroyed() -> Iterator[None]:
    """At the end, destroy the nodes that were begun meanwhile and are still there."""
    from rclpy.exceptions import InvalidHandle
    from rclpy.node import Node

    nodes: WeakSet[Node] = WeakSet()
    begin = Node.__init__

    def noted(node: Node, *arguments: Any, **options: Any) -> None:
        nodes.add(node)
        begin(node, *arguments, **options)

    try:
        with patch.object(Node, "__init__", noted):
            yield
    finally:
        for node in list(nodes):
            with suppress(AttributeError, InvalidHandle), node.handle:  # it never came to be, or is destroyed
                node.destroy_node()
