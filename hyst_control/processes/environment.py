"""Environment variables that rclpy needs before it is initialized; those set by the user are kept."""

from __future__ import annotations

import os
import sys


def prepare() -> None:
    """Keep DDS traffic on this machine and let ROS from wheels find its packages, unless the user has chosen otherwise."""
    if "ROS_LOCALHOST_ONLY" not in os.environ:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if os.path.isdir(os.path.join(sys.prefix, "share", "ament_index")):
        os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
