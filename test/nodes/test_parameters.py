# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters: every one is described, and the shipped files hold only such as their nodes declare, within their ranges."""

from __future__ import annotations

import importlib
import math
from contextlib import contextmanager

import pytest
import yaml
from rclpy.parameter import Parameter

from hyst_control.base.config_files import config_folders, config_path
from hyst_control.hardware.linux_iio import IioStage
from hyst_control.hardware.physik_instrumente import PhysikInstrumenteStage
from hyst_control.hardware.simulated_converter import SimulatedStage
from hyst_control.nodes.diagnosis import DiagnosisNode
from hyst_control.nodes.hampi_feedforward import HampiFeedforward
from hyst_control.nodes.identification import Identification
from hyst_control.nodes.live_view import LiveView
from hyst_control.nodes.mhl_feedforward import MhlFeedforward
from hyst_control.nodes.pi_feedback import PiFeedback
from hyst_control.nodes.pipeline import COMPOSABLE, node_class
from hyst_control.nodes.recorder import Recorder
from hyst_control.nodes.reference_generator import ReferenceGenerator
from hyst_control.nodes.signal_node.common_parameters import COMMON
from hyst_control.processes import node_list
from hyst_control.records.excitation.excitation import KINDS
from hyst_plant_sim.node import PlantNode

NODES = {
    "reference_generator": ReferenceGenerator,
    "hampi_feedforward": HampiFeedforward,
    "mhl_feedforward": MhlFeedforward,
    "pi_feedback": PiFeedback,
    "plant": PlantNode,
    "simulated_stage": SimulatedStage,
    "pi_stage": PhysikInstrumenteStage,
    "iio_stage": IioStage,
    "recorder": Recorder,
    "live_view": LiveView,
    "identification": Identification,
    "diagnosis": DiagnosisNode,
}
NEEDED = {
    "reference_generator": {"signal": "rest", "duration": 1.0},
    "hampi_feedforward": {"kind": "proportional", "gain": [1.0]},
    "mhl_feedforward": {"kind": "proportional", "gain": [1.0]},
    "plant": {"plant": "pea"},
    "simulated_stage": {"autostart": False},
    "pi_stage": {"autostart": False},
    "iio_stage": {"autostart": False},
    "diagnosis": {"model": str(config_path("models/pea_hampi.yaml"))},
}
"""What a node does not start without."""
FILES = sorted((config_folders()[0] / "nodes").glob("*.yaml"))


@contextmanager
def started(name, context, folder):
    """The node of that name, with no more than it needs; it is closed as at the end of a run."""
    given = (
        {"output": str(folder / "output"), **NEEDED.get(name, {})} if name in ("recorder", "diagnosis") else NEEDED.get(name, {})
    )
    node = NODES[name](context=context, parameter_overrides=[Parameter(key, value=value) for key, value in given.items()])
    try:
        yield node
    finally:
        node.close()
        node.destroy_node()


@pytest.mark.parametrize("name", NODES)
def test_every_parameter_of_a_node_is_described(name, ros_context, tmp_path):
    with started(name, ros_context, tmp_path) as node:
        settings = {setting.name: setting for setting in (*COMMON, *node.SETTINGS)}
        declared = [parameter for parameter in node._parameters if parameter in settings]
        assert {setting.name for setting in node.SETTINGS} <= set(declared)
        for parameter in declared:
            described = node.describe_parameter(parameter).description
            assert settings[parameter].meaning in described
            assert not settings[parameter].unit or f"[{settings[parameter].unit}]" in described


@pytest.mark.parametrize("name", NODES)
def test_every_parameter_says_what_it_is_and_numbers_their_unit_and_range(name, ros_context, tmp_path):
    with started(name, ros_context, tmp_path) as node:
        pass
    for setting in (*COMMON, *node.SETTINGS):
        value = setting.default[0] if isinstance(setting.default, tuple) else setting.default
        assert setting.meaning, setting.name
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            assert setting.unit and setting.lower > -math.inf and setting.upper < math.inf, setting.name
            assert setting.lower <= value <= setting.upper


def test_one_number_is_a_list_of_one():
    """As hyst tune prints it."""
    [frequency] = [each for each in PiFeedback.SETTINGS if each.name == "notch_frequency"]
    assert frequency.checked(1231) == (1231.0,)


def test_the_list_of_nodes_is_what_there_is():
    """Every entry has its module with an executable and its class; what composes is what a parameter file can configure."""
    for name, entry in node_list.NODES.items():
        module = importlib.import_module(entry.module)
        assert callable(module.main)
        assert not entry.node_class or node_class(name).__module__ == entry.module
    assert set(COMPOSABLE) == set(NODES) - {"identification"}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_a_shipped_file_holds_what_its_nodes_declare(file, ros_context, tmp_path):
    document = yaml.safe_load(file.read_text(encoding="utf-8"))
    for key, entry in document.items():
        assert key.startswith("/**")  # whatever the namespace
        name = key.rpartition("/")[2]
        given = entry["ros__parameters"]
        settings = {setting.name: setting for setting in COMMON}
        if name in NODES:
            with started(name, ros_context, tmp_path) as node:
                settings |= {setting.name: setting for setting in node.SETTINGS}
        signal = set()
        if name == "reference_generator" and given["signal"] in KINDS:
            signal = set(KINDS[given["signal"]].__code__.co_varnames)
        assert set(given) <= set(settings) | signal, f"{file.name}: {name}"
        for parameter in set(given) & set(settings):
            settings[parameter].checked(given[parameter])


def test_every_node_has_a_parameter_file():
    named = {key.rpartition("/")[2] for file in FILES for key in yaml.safe_load(file.read_text(encoding="utf-8"))}
    assert set(NODES) - {"mhl_feedforward"} <= named  # which takes the parameters of hampi_feedforward
