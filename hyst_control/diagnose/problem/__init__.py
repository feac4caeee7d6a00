# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Problem of a diagnosis: records, simulator, uncertain coefficients, stages of one record."""
