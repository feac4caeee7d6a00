# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Speed of kernels, bags, the running loop and whole workflows."""
