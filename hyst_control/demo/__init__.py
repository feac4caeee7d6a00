# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The demonstration: excite, record, identify, track and diagnose a simulated actuator through the nodes."""
