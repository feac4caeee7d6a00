# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Common ground of the model families: declaration, options and registration."""
