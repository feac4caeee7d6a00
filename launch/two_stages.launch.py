# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Two stages side by side, each with the loop of hardware.launch.py in a namespace of its own.

ros2 launch hyst_control two_stages.launch.py left_stage:=pi_stage left_params:=left.yaml right_model:=right.yaml
"""

import os

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

SHARE = get_package_share_directory("hyst_control")
SIDES = ("left", "right")
ARGUMENTS = {
    "namespace": ("{side}", "namespace of the {side} stage's nodes"),
    "params": (os.path.join(SHARE, "config", "nodes", "hardware.yaml"), "parameter file of the {side} stage's nodes"),
    "package": ("hyst_control", "package of the {side} stage's executable"),
    "stage": ("simulated_stage", "executable of the {side} stage"),
    "model": ("", "model file of the {side} stage"),
    "bag": ("", "folder to record the {side} stage to; empty: no recorder"),
}


def generate_launch_description():
    """Arguments and both loops, as `ros2 launch` asks for them."""
    loop = os.path.join(SHARE, "launch", "hardware.launch.py")
    parts = []
    for side in SIDES:
        for name, (value, text) in ARGUMENTS.items():
            described = text.format(side=side)
            parts.append(DeclareLaunchArgument(f"{side}_{name}", default_value=value.format(side=side), description=described))
        passed = {name: LaunchConfiguration(f"{side}_{name}") for name in ARGUMENTS}
        parts.append(IncludeLaunchDescription(PythonLaunchDescriptionSource(loop), launch_arguments=passed.items()))
    return LaunchDescription(parts)
