# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Fleets: thousands of records of many units, each identified, validated or diagnosed by itself, and what only many can tell."""
