# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Linear stages: exact discretization, state-space kernels, transfer functions, delays."""
