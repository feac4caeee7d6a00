# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters common to all nodes of the loop."""

from __future__ import annotations

from hyst_control.nodes.signal_node.parameters import Setting

LOCKSTEP, TIMER = "lockstep", "timer"
PYTHON, C = "python", "c"

BACKEND = Setting(
    "backend",
    PYTHON,
    "",
    "python, or c: what hyst export writes, compiled at the start (needs a C compiler); the same bits",
    choices=(PYTHON, C),
)

COMMON = (
    Setting(
        "schedule",
        LOCKSTEP,
        "",
        "schedule of the node: lockstep (ticks when its inputs are there) or timer (wall clock)",
        choices=(LOCKSTEP, TIMER),
    ),
    Setting("rate_hz", 1000.0, "Hz", "sample rate of the signals", 1e-3, 1e6),
    Setting("block", 1, "samples", "samples per message, and per tick of the timer", 1, 1_000_000),
    Setting("axes", ("x",), "", "names of the axes"),
    Setting("unit", "um", "", "unit of reference and measurement", choices=("um", "mrad")),
    Setting("timeout", 0.1, "s", "age from which an input is stale, under the timer", 1e-4, 1e3, live=True, wider="higher"),
    Setting(
        "ahead",
        1.0,
        "s",
        "an input whose time is ahead of the clock by more than this is dropped, under the timer; more than the lead of its source",
        1e-3,
        1e9,
        live=True,
        wider="higher",
    ),
    Setting(
        "backwards",
        1.0,
        "s",
        "an input whose time goes back by this much has another clock: dropped, under the timer",
        1e-3,
        1e9,
        live=True,
    ),
    Setting(
        "most_waiting",
        65536,
        "rows",
        "most rows of an input that wait to be used; further ones are refused",
        1,
        100_000_000,
    ),
    Setting("realtime_priority", 0, "level", "SCHED_FIFO priority of the process, 0 for the default scheduler", 0, 99),
    Setting("cpu", -1, "core", "core that the process is pinned to, -1 for any", -1, 1023),
    Setting("message_objects", False, "", "exchange message objects instead of serialized bytes"),
)
