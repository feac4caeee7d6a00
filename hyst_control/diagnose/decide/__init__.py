# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The verdict of a diagnosis: from evidence to a name, with its reasons."""
