# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Feedforward compensators: inverse models of hysteresis and dynamics."""
