# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The base of every node: its signals, its parameters, its schedule, its diagnostics."""
