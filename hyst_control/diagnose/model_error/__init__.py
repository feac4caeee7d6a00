# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Discrepancy of the model on healthy records, as baseline records show it."""
