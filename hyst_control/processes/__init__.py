# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Starting of nodes as processes on a ROS domain of their own, without importing ROS."""
