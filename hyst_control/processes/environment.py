"""Environment variables that rclpy needs before it is initialized; those set by the user are kept."""

from __future__ import annotations

import os
import sys
from contextlib import suppress

from hyst_control.config_files import config_path
from hyst_control.errors import InputError

LIFELINE = "HYST_CONTROL_LIFELINE"
"""Variable with the number of an open pipe that ends when the process that started the nodes does."""

PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
"""Variables that name a file with settings of Fast DDS."""


def exposure() -> str:
    """One line that says who can hear the nodes and command the actuator; "" where the user has chosen this machine, or security.

    To be asked before `prepare`, which sets what the user has not.
    """
    if os.environ.get("ROS_SECURITY_ENABLE", "").lower() == "true" and os.environ.get("ROS_SECURITY_STRATEGY") == "Enforce":
        return ""
    chosen = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    if os.environ.get("ROS_LOCALHOST_ONLY") == "1" or chosen in ("LOCALHOST", "OFF"):
        return ""
    if chosen or "ROS_LOCALHOST_ONLY" in os.environ:
        return (
            "every machine on this network can hear these nodes and command the actuator: set ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST "
            "to keep them on this machine, or see docs/safety.md for SROS 2"
        )
    return (
        "every program on this machine can hear these nodes and command the actuator, other machines cannot: "
        "ROS_AUTOMATIC_DISCOVERY_RANGE is not set and taken as LOCALHOST"
    )


def prepare() -> None:
    """Keep DDS traffic on this machine and let ROS from wheels find its packages, unless the user has chosen otherwise."""
    if "ROS_LOCALHOST_ONLY" not in os.environ:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if not any(variable in os.environ for variable in PROFILES):
        with suppress(InputError):  # an installation without its files
            os.environ[PROFILES[0]] = str(config_path("fastdds/loop.xml"))
    if os.path.isdir(os.path.join(sys.prefix, "share", "ament_index")):
        os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
