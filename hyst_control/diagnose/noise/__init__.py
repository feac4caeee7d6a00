# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of a residual: white, 1/f, narrow-band."""
