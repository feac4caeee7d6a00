# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Ticks that a computer misses by itself: a loop that does nothing but wait for the next one, in a process of its own."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from dataclasses import dataclass

from hyst_control.processes.realtime_scheduling import ANY_CORE, set_scheduler

PHASE = 0.05
"""Share of a tick after its beginning at which the loop wakes, as the first node of a loop does."""


@dataclass(frozen=True)
class Wakes:
    """Wakes of a bare loop."""

    ticks: int  # Ticks at which it was awake
    missed: int  # Ticks in between at which it was not
    latest: float  # Longest time from when it was due until it was awake, s
    refused: str  # Why the system refused the priority; "" when it did not


def wait_for_ticks(rate: float, seconds: float, priority: int) -> Wakes:
    """Wait for every tick in this process."""
    refused, period = set_scheduler(priority, ANY_CORE), 1.0 / rate
    ticks = missed = 0
    latest = 0.0
    last = first = math.floor(time.monotonic() / period)
    while last < first + rate * seconds:
        due = (last + 1 + PHASE) * period
        time.sleep(max(due - time.monotonic(), 0.0))
        now = time.monotonic()
        number = math.floor(now / period)
        ticks, missed, latest = ticks + 1, missed + number - last - 1, max(latest, now - due)
        last = number
    return Wakes(ticks, missed, latest, refused)


def measure(rate: float, seconds: float, priority: int) -> Wakes:
    """Wait for every tick in a fresh process."""
    words = [sys.executable, "-m", __name__, str(rate), str(seconds), str(priority)]
    return Wakes(**json.loads(subprocess.run(words, stdout=subprocess.PIPE, check=True).stdout))


if __name__ == "__main__":
    print(json.dumps(wait_for_ticks(float(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])).__dict__))
