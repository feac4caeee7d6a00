# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A chain, a compensator or a whole controller as C."""
