# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Signals in time: records, bags, foreign files, the signal message, excitations."""
