# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""C of the stages, beside the kernels that it equals to the last bit."""
