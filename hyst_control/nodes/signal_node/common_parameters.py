# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters common to all nodes of the loop."""

from __future__ import annotations

from hyst_control.nodes.signal_node.parameters import Setting, settings_of

LOCKSTEP, TIMER = "lockstep", "timer"
PYTHON, C = "python", "c"

BACKEND = Setting(
    "backend",
    PYTHON,
    "",
    "python, or c: what hyst export writes, compiled at the start (needs a C compiler); the same bits",
    choices=(PYTHON, C),
)

COMMON = settings_of("common")
