"""Stages on real converters: a base class of which a node for any hardware is made, and three complete nodes (docs/hardware.md)."""

from __future__ import annotations

from hyst_control.hardware.stage_node import StageNode
from hyst_control.nodes.execution.run import main
from hyst_control.nodes.signal_node.parameters import Setting

__all__ = ["Setting", "StageNode", "main"]
