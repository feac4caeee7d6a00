# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Discrepancy of a fitted model on its own records: learned discrepancy and error spectrum."""
