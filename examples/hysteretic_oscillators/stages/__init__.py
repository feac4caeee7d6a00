# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stages: Duhem hysteresis, and mechanics with a hysteretic force inside their feedback."""
