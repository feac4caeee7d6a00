# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Environment variables that rclpy needs before it is initialized; those set by the user are kept."""

from __future__ import annotations

import os
import sys

from hyst_control.processes import middleware

LIFELINE = "HYST_CONTROL_LIFELINE"
"""Variable with the number of an open pipe that ends when the process that started the nodes does."""


def exposure() -> str:
    """One line, before `prepare`, that says who can hear and command the nodes; "" where the user has chosen this machine, or security."""
    if not (used := middleware.chosen()).keeps_discovery_range:
        return (
            f"every machine that reaches the router of {used.name} can hear these nodes and command the actuator: this middleware does "
            "not keep ROS_AUTOMATIC_DISCOVERY_RANGE, so let the router listen on localhost alone (docs/middleware.md)"
        )
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
    if os.path.isdir(os.path.join(sys.prefix, "share", "ament_index")):
        os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)
    middleware.chosen().set_defaults()  # which looks for ROS where AMENT_PREFIX_PATH leads
