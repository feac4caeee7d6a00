# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Controllers: feedforward compensators and PI feedback, and the loop they close."""
