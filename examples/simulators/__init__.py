# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Simulators of other people, each beside a record of a machine with an effect that it lacks."""
