"""Parameters that all nodes of the loop have."""

from __future__ import annotations

from hyst_control.nodes.parameters import Setting

LOCKSTEP, TIMER = "lockstep", "timer"

COMMON = (
    Setting("schedule", LOCKSTEP, "", "what makes a node tick", choices=(LOCKSTEP, TIMER)),
    Setting("rate_hz", 1000.0, "Hz", "sample rate of the signals", 1e-3, 1e6),
    Setting("block", 1, "samples", "samples a message streams, and a tick of the timer covers", 1, 1_000_000),
    Setting("axes", ("x",), "", "names of the axes"),
    Setting("unit", "um", "", "unit of reference and measurement", choices=("um", "mrad")),
    Setting("timeout", 0.1, "s", "age from which an input is stale, under the timer", 1e-4, 1e3, live=True),
    Setting(
        "backwards", 1.0, "s", "an input that goes back by so much has another time: dropped, under the timer", 1e-3, 1e9, live=True
    ),
    Setting(
        "most_sources", 1, "publishers", "publishers of one input from which on the diagnostics warn, less one", 1, 1000, live=True
    ),
    Setting(
        "most_waiting",
        65536,
        "rows",
        "rows of an input that wait to be used; while there are so many, new ones are refused",
        1,
        100_000_000,
    ),
    Setting("realtime_priority", 0, "level", "SCHED_FIFO priority of the process, 0 for the ordinary scheduler", 0, 99),
    Setting("cpu", -1, "core", "core that the process is pinned to, -1 for any", -1, 1023),
    Setting("message_objects", False, "", "exchange message objects in place of serialized bytes"),
)
