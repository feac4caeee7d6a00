# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated plants: physics that shares nothing with the models, and the node that runs one."""
