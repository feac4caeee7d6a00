# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The loop around a stage on hardware: reference, feedforward, feedback, stage, and a recorder if there is a bag to write.

ros2 launch hyst_control hardware.launch.py stage:=pi_stage params:=bench.yaml bag:=run
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
    "params": (os.path.join(SHARE, "config", "nodes", "hardware.yaml"), "parameter file of all nodes"),
    "package": ("hyst_control", "package of the stage's executable"),
    "stage": ("simulated_stage", "executable of the stage: simulated_stage, pi_stage, iio_stage, or your own"),
    "model": ("", "model file: that of a simulated stage, and of the feedforward where its kind needs one"),
    "feedforward": ("hampi_feedforward", "executable of the feedforward"),
    "autostart": ("true", "false: the stage and the feedback wait for lifecycle transitions"),
    "bag": ("", "folder to record to; empty: no recorder"),
}


def nodes(context):
    """Nodes of the loop, with the arguments' values."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    common = {"package": "hyst_control", "namespace": given["namespace"], "output": "screen"}
    managed = {"autostart": given["autostart"] == "true"}
    model = {"model": given["model"]} if given["model"] else {}
    own = {"reference_generator": {}, given["feedforward"]: model, "pi_feedback": managed}
    if given["bag"]:
        own["recorder"] = {"output": given["bag"]}
    found = [Node(executable=name, name=name, parameters=[given["params"], changed], **common) for name, changed in own.items()]
    stage = {**managed, **(model if given["stage"] == "simulated_stage" else {})}
    common["package"] = given["package"]
    return [Node(executable=given["stage"], name=given["stage"], parameters=[given["params"], stage], **common), *found]


def generate_launch_description():
    """Arguments and nodes, as `ros2 launch` asks for them."""
    declared = [DeclareLaunchArgument(name, default_value=value, description=text) for name, (value, text) in ARGUMENTS.items()]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])
