# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The gap between a simulator and a recorded system: where it lies, which effect causes it, how much of it the effect removes."""
