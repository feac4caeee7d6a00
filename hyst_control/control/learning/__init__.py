# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Learning from trial to trial and from the feedback."""
