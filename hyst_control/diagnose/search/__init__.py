# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Candidates of the catalogue, their fits, the search among them, and the null threshold."""
