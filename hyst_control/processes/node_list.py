# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""List of all nodes: executables, modules and classes.

Data only and without imports of this package, so that `setup.py` can run it before anything is installed.
"""

from __future__ import annotations

from typing import NamedTuple


class NodeEntry(NamedTuple):
    """One node."""

    module: str  # Module whose `main` is the executable
    node_class: str = ""  # Name of its class if the node can be composed with others in one process; otherwise ""
    installed: bool = True  # True when the executable is installed


NODES = {
    "reference_generator": NodeEntry("hyst_control.nodes.reference_generator", "ReferenceGenerator"),
    "hampi_feedforward": NodeEntry("hyst_control.nodes.hampi_feedforward", "HampiFeedforward"),
    "mhl_feedforward": NodeEntry("hyst_control.nodes.mhl_feedforward", "MhlFeedforward"),
    "pi_feedback": NodeEntry("hyst_control.nodes.pi_feedback", "PiFeedback"),
    "plant": NodeEntry("hyst_plant_sim.node", "PlantNode"),
    "simulated_stage": NodeEntry("hyst_control.hardware.simulated_converter", "SimulatedStage"),
    "pi_stage": NodeEntry("hyst_control.hardware.physik_instrumente", "PhysikInstrumenteStage"),
    "iio_stage": NodeEntry("hyst_control.hardware.linux_iio", "IioStage"),
    "recorder": NodeEntry("hyst_control.nodes.recorder", "Recorder"),
    "identification": NodeEntry("hyst_control.nodes.identification"),
    "diagnosis": NodeEntry("hyst_control.nodes.diagnosis", "DiagnosisNode"),
    "live_view": NodeEntry("hyst_control.nodes.live_view", "LiveView"),
    "pipeline": NodeEntry("hyst_control.nodes.pipeline"),
    "monitor": NodeEntry("hyst_control.nodes.signal_node.diagnostics_monitor", installed=False),
}
