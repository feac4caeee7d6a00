# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Feedback: PI controller, limits, watches and the safe loop."""
