# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The loop around a simulated plant: reference, feedforward, feedback, plant, and a recorder if there is a bag to write.

ros2 launch hyst_control simulation.launch.py namespace:=left model:=stage.yaml bag:=run
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SHARE = get_package_share_directory("hyst_control")
ARGUMENTS = {
    "namespace": ("", "namespace of the nodes"),
    "params": (os.path.join(SHARE, "config", "nodes", "timer.yaml"), "parameter file of all nodes"),
    "plant": ("", "reference simulation in place of that of the parameter file: a name in config/plants, or a file"),
    "model": ("", "model file that the plant runs, in place of a reference simulation"),
    "feedforward": ("hampi_feedforward", "executable of the feedforward"),
    "bag": ("", "folder to record to; empty: no recorder"),
}


def nodes(context):
    """Nodes of the loop, with the arguments' values."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    common = {"package": "hyst_control", "namespace": given["namespace"], "output": "screen"}
    simulated = {}
    if given["plant"] or given["model"]:
        simulated = {"plant": given["plant"], "model": given["model"]}
    own = {"reference_generator": {}, given["feedforward"]: {}, "pi_feedback": {}, "plant": simulated}
    if given["bag"]:
        own["recorder"] = {"output": given["bag"]}
    return [Node(executable=name, name=name, parameters=[given["params"], changed], **common) for name, changed in own.items()]


def generate_launch_description():
    """Arguments and nodes, as `ros2 launch` asks for them."""
    declared = [DeclareLaunchArgument(name, default_value=value, description=text) for name, (value, text) in ARGUMENTS.items()]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
