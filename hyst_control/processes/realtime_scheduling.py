# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Real-time priority and processor core of the process."""

from __future__ import annotations

import os
import struct
from contextlib import suppress
from pathlib import Path

ANY_CORE = -1  # No core in particular
WAKE_LATENCY = Path("/dev/cpu_dma_latency")
"""Holds the time in us that processors may take to wake up, for as long as a process has it open (the kernel's PM QoS interface)."""

_awake: dict[Path, int] = {}


def set_scheduler(priority: int, cpu: int) -> str:
    """Request a real-time priority, under which no processor sleeps where the system allows it, and a core for this process."""
    try:
        if cpu != ANY_CORE:
            os.sched_setaffinity(0, {cpu})
        if priority:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
            _keep_processors_awake()
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _keep_processors_awake() -> None:
    if WAKE_LATENCY not in _awake:
        with suppress(OSError):  # another system, or no right to: the priority counts without it
            _awake[WAKE_LATENCY] = os.open(WAKE_LATENCY, os.O_WRONLY | os.O_CLOEXEC)
            os.write(_awake[WAKE_LATENCY], struct.pack("i", 0))
