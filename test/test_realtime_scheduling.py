# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A real-time priority keeps the processors awake, where the system has a way to ask for it."""

from __future__ import annotations

import os
import struct
import subprocess
import sys

import pytest

PROGRAM = """
import os, sys
from pathlib import Path
from hyst_control.processes import realtime_scheduling
realtime_scheduling.WAKE_LATENCY = Path(sys.argv[1])
refused = [realtime_scheduling.set_scheduler(int(sys.argv[2]), realtime_scheduling.ANY_CORE) for _ in range(2)]
held = [os.readlink(link) for link in Path("/proc/self/fd").iterdir() if link.exists()]
print(refused[1], held.count(sys.argv[1]), sep=";")
"""


def run(path: str, priority: int) -> list[str]:
    found = subprocess.run([sys.executable, "-c", PROGRAM, path, str(priority)], capture_output=True, text=True, check=True)
    return found.stdout.strip().split(";")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel's interface")
def test_the_request_is_held_while_the_process_lives(tmp_path):
    """Zero microseconds as a binary number of four bytes (Linux, Documentation/power/pm_qos_interface.rst), in a file kept open once."""
    file = tmp_path / "cpu_dma_latency"
    file.touch()
    refused, held = run(str(file), 1)
    if refused:
        pytest.skip(f"no real-time priority here: {refused}")
    assert file.read_bytes() == struct.pack("i", 0) and held == "1"


def test_without_priority_nothing_is_asked_for(tmp_path):
    file = tmp_path / "cpu_dma_latency"
    file.touch()
    assert run(str(file), 0) == ["", "0"] and not file.read_bytes()


def test_a_system_without_it_gives_the_priority(tmp_path):
    refused, held = run(os.fspath(tmp_path / "missing"), 1)
    assert held == "0" and "No such file" not in refused
