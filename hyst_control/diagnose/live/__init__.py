# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnosis beside a running machine."""
