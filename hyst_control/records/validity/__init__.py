# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of records before anything is fitted to them."""
