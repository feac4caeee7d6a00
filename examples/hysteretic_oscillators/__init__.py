# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Hysteretic oscillators as a plugin: Duhem and Bouc-Wen stages, and the families that identify them."""
