# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Findings in a record that need no fit: repeated values, quantization steps, spectral lines."""
