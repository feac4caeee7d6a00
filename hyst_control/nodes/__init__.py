# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""ROS 2 nodes, each a thin file around an algorithm without ROS."""
