# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reports of a fit: errors, explained share, choice of family, consistency of records."""
