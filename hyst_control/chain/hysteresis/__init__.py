# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stages with memory: play operators, Prandtl-Ishlinskii, Madelung, Duhem, Bouc-Wen, and their inverses."""
