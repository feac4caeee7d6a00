# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The controller in the software of laboratories: a device of bluesky and an EPICS server, beside the ROS nodes (docs/labs.md)."""
