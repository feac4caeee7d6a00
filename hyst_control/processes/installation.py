# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of a computer on which loops are to run in real time, with what to do where it is not enough."""

from __future__ import annotations

import importlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from enum import Enum
from importlib.metadata import version
from pathlib import Path

import numpy as np

from hyst_control.processes import environment, middleware
from hyst_control.processes.ros_domain import own_domain

PACKAGES = ("numpy", "scipy", "numba")
OLDEST_PYTHON = (3, 10)
TICKS = 1000  # Ticks of 1 ms that the clock is tried with
LATE = 1e-3  # Lateness of a tick, s, over which a loop at 1 kHz misses it
LOOPBACK_TIMEOUT = 30.0  # Seconds after which messages on this computer are taken not to arrive
WRITTEN = 32 << 20  # Bytes that the disk is tried with
ROW_BYTES = 5 * 2 * 64  # Bytes of a bag for a row of five signals of two axes, with their messages' frames
MIN_MEMORY = 2.0  # GiB that an identification of an hour's record may take


class Verdict(Enum):
    """Judgment of a check."""

    GOOD = "good"
    NOTE = "note"
    FAULT = "fault"


@dataclass(frozen=True)
class Check:
    """One thing that was looked at."""

    name: str  # What was looked at
    verdict: Verdict  # Good, worth a note, or a fault that keeps something from working
    found: str  # What was found, in words
    remedy: str = ""  # What to do; "" where there is nothing to do


@dataclass(frozen=True)
class Installation:
    """All checks of a computer."""

    checks: tuple[Check, ...]  # In the order in which they were made

    @property
    def exit_status(self) -> int:
        """0 where everything works, else 1."""
        return 0 if self.works else 1

    @property
    def works(self) -> bool:
        """True where nothing is at fault."""
        return all(check.verdict is not Verdict.FAULT for check in self.checks)

    def text(self) -> str:
        """One line a check, and the remedy below it."""
        lines = []
        width = max(len(check.name) for check in self.checks)
        for check in self.checks:
            lines.append(f"{check.verdict.value:<5}  {check.name:<{width}}  {check.found}")
            if check.remedy:
                lines.append(f"{'':<5}  {'':<{width}}  -> {check.remedy}")
        return "\n".join(lines)

    def document(self) -> dict[str, object]:
        """For programs: whether everything works, and every check."""
        return {"works": self.works, "checks": [{**asdict(check), "verdict": check.verdict.value} for check in self.checks]}


def examine(folder: str | Path = ".") -> Installation:
    """Make all checks; takes a few seconds."""
    reach = discovery()  # before the defaults of this package's own processes
    environment.prepare()
    software = python(), packages(), ros(), reach, loopback()
    return Installation((*software, clock(), realtime_priority(), processor_speed(), memory(), disk(folder)))


def python() -> Check:
    """Python's version."""
    found = f"Python {platform.python_version()} on {platform.platform(terse=True)}, {os.cpu_count()} processors"
    if sys.version_info < OLDEST_PYTHON:
        return Check("Python", Verdict.FAULT, found, f"install Python {'.'.join(map(str, OLDEST_PYTHON))} or newer")
    return Check("Python", Verdict.GOOD, found)


def packages() -> Check:
    """The numerical packages, imported."""
    versions = []
    for name in PACKAGES:
        try:
            importlib.import_module(name)
            versions.append(f"{name} {version(name)}")
        except ImportError as error:
            return Check("packages", Verdict.FAULT, f"{name} cannot be imported ({error})", "install what requirements.txt names")
    return Check("packages", Verdict.GOOD, ", ".join(versions))


def ros() -> Check:
    """Presence of ROS; without it everything but the nodes works."""
    remedy = "source a ROS 2 installation, or use the environment that make env builds; all but the nodes works without it"
    missing = [name for name in ("rclpy", "std_msgs", "diagnostic_msgs") if importlib.util.find_spec(name) is None]
    if missing:
        return Check("ROS", Verdict.NOTE, f"{', '.join(missing)} not found", remedy)
    distribution = os.environ.get("ROS_DISTRO", "from wheels, no ROS_DISTRO set")
    used = middleware.chosen()
    found = f"{distribution}, {os.environ.get('RMW_IMPLEMENTATION', 'default middleware')}"
    if used.tried:
        return Check("ROS", Verdict.GOOD, found)
    return Check("ROS", Verdict.NOTE, f"{found}, on which this package was never tried", f"RMW_IMPLEMENTATION={middleware.DEFAULT}")


def discovery() -> Check:
    """Reach of the nodes on the network: every computer in it can command the actuator."""
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    if not middleware.chosen().keeps_discovery_range:
        return Check("discovery", Verdict.NOTE, f"domain {domain}, {environment.exposure()}", "see docs/middleware.md")
    if not {"ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"} & set(os.environ):  # what `environment.prepare` goes by
        return Check(
            "discovery", Verdict.GOOD, f"domain {domain}, this computer alone: nothing is set, and the nodes take LOCALHOST"
        )
    if reach in ("LOCALHOST", "OFF") or os.environ.get("ROS_LOCALHOST_ONLY") == "1":
        return Check("discovery", Verdict.GOOD, f"domain {domain}, this computer alone")
    return Check(
        "discovery",
        Verdict.NOTE,
        f"domain {domain}, range {reach}: every computer of the network can hear the nodes and command the actuator",
        "export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST, unless other computers take part",
    )


def loopback() -> Check:
    """Messages between two participants of this computer, and how long one takes there and back."""
    if importlib.util.find_spec("rclpy") is None:
        return Check("messages", Verdict.NOTE, "not tried without ROS")
    remedy = middleware.chosen().remedy
    with own_domain() as domain:
        surroundings = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        command = [sys.executable, "-m", "hyst_control.nodes.execution.loopback_check"]
        try:
            ended = subprocess.run(command, env=surroundings, capture_output=True, text=True, timeout=LOOPBACK_TIMEOUT)
        except subprocess.TimeoutExpired:
            return Check("messages", Verdict.FAULT, f"none came back within {LOOPBACK_TIMEOUT:g} s", remedy)
    if ended.returncode != 0:
        said = (ended.stderr.strip().splitlines() or ["no word"])[-1]
        return Check("messages", Verdict.FAULT, f"they could not be exchanged: {said}", remedy)
    return Check("messages", Verdict.GOOD, ended.stdout.strip())


def clock() -> Check:
    """Lateness with which this process wakes, as a loop at 1 kHz would."""
    source = _first_line("/sys/devices/system/clocksource/clocksource0/current_clocksource") or "unknown source"
    late = np.empty(TICKS)
    begin = time.monotonic()
    for tick in range(TICKS):
        due = begin + 1e-3 * (tick + 1)
        time.sleep(max(0.0, due - time.monotonic()))
        late[tick] = time.monotonic() - due
    often, worst = np.quantile(late, 0.99), late.max()
    found = f"{source}; of 1000 ticks of 1 ms 99 % at most {1e3 * max(often, 0.0):.2f} ms late, the latest {1e3 * worst:.2f} ms"
    if often > LATE:
        remedy = "close what else is running, allow a real-time priority (below), or lower rate_hz"
        return Check("clock", Verdict.NOTE, found, remedy)
    return Check("clock", Verdict.GOOD, found)


def realtime_priority() -> Check:
    """Permission of this user to give a process real-time priority."""
    attempt = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50))"
    if not hasattr(os, "sched_setscheduler"):
        return Check("real-time priority", Verdict.NOTE, "this system has none")
    if subprocess.run([sys.executable, "-c", attempt], capture_output=True).returncode == 0:
        return Check("real-time priority", Verdict.GOOD, "allowed: the nodes' parameter priority works")
    return Check(
        "real-time priority",
        Verdict.NOTE,
        "not allowed to this user",
        "for loops of 1 kHz and more: a line '@realtime - rtprio 98' in /etc/security/limits.conf, and this user in that group",
    )


def processor_speed() -> Check:
    """Governor of the processor's speed, which may be lowered when idle."""
    governor = _first_line("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
    if governor is None:
        return Check("processor speed", Verdict.GOOD, "not governed by this system")
    if governor == "performance":
        return Check("processor speed", Verdict.GOOD, "governor performance")
    return Check("processor speed", Verdict.NOTE, f"governor {governor}", "cpupower frequency-set -g performance, for even ticks")


def memory() -> Check:
    """Memory that programs can have."""
    sizes = {}
    with suppress(OSError, ValueError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            name, size = line.split()[:2]
            sizes[name.rstrip(":")] = int(size) / 2**20
    if "MemAvailable" not in sizes:
        return Check("memory", Verdict.NOTE, "this system does not tell")
    found = f"{sizes['MemAvailable']:.1f} of {sizes['MemTotal']:.1f} GiB available"
    if sizes["MemAvailable"] < MIN_MEMORY:
        return Check("memory", Verdict.NOTE, found, "close what else is running, or identify from shorter records")
    return Check("memory", Verdict.GOOD, found)


def disk(folder: str | Path) -> Check:
    """Speed at which records can be written."""
    block = os.urandom(1 << 20)
    try:
        free = shutil.disk_usage(folder).free
        if free < 2 * WRITTEN:
            return Check(
                "disk", Verdict.FAULT, f"{free / 2**20:.0f} MiB free in {os.path.realpath(folder)}", "make room for records"
            )
        with tempfile.TemporaryFile(dir=folder) as file:
            begin = time.monotonic()
            for _ in range(WRITTEN // len(block)):
                file.write(block)
            file.flush()
            os.fsync(file.fileno())
            speed = WRITTEN / (time.monotonic() - begin)
    except OSError as error:
        return Check("disk", Verdict.FAULT, f"{os.path.realpath(folder)}: {error.strerror}", "choose a folder that can be written")
    rows = float(f"{speed / ROW_BYTES:.2g}")
    found = f"{speed / 1e6:.0f} MB/s, {free / 2**30:.0f} GiB free: a recorder can keep {rows:,.0f} rows a second of two axes"
    if rows < 20e3:
        return Check("disk", Verdict.NOTE, found, "record to a faster disk")
    return Check("disk", Verdict.GOOD, found)


def _first_line(path: str) -> str | None:
    try:
        return Path(path).read_text().splitlines()[0].strip()
    except (OSError, IndexError):
        return None
