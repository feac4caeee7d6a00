# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Evaluation of the package in a checkout: published experiments, the blind test of the diagnosis, benchmarks."""
