# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The blind test of the diagnosis: cases, run, scores, page."""
