# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of a fitted candidate: reduction on left-out samples, presence in baseline records."""
