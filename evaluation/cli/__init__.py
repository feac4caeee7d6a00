# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Subcommands of `hyst` that exist in a checkout only."""
