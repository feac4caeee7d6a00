# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The MHL family: Madelung curves, rate correction, delay and linear dynamics."""
