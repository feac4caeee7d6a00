# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A live page of a running loop: what a browser shows of it, without ROS."""
