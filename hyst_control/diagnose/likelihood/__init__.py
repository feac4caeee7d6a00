# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Likelihood core of the diagnosis: one statistical model of record minus simulation, and one list of hypotheses."""
