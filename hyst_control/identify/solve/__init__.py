# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Solvers shared by the families: Gauss-Newton, simulation error, Gram sums, covariance."""
