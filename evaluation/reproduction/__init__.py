# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The experiments of the papers and of the public measurements, table by table."""
