# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Results for people and programs: tables, lists of written files, HTML pages."""
