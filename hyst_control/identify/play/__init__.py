# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Families of play operators: Prandtl-Ishlinskii, HAPI, HAMPI, RDPI."""
