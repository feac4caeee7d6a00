# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records prepared for a fit: windows, rests, initial memory, drift, excited band."""
