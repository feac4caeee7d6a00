# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings of other tools: text tables and the containers of other programs, with columns named by the user."""
