# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rows that arrive from other programs: checks, order, repetition, storage, and the signal message."""
