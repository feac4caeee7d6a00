# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Speed, latency, loss and load of the loop through the real nodes, beside the same loop in plain rclpy.

The loop is the MHL paper's: two axes, inverse hysteresis and PI feedback on the published model. Every case has processes and a ROS domain
of its own; figures come from the nodes' diagnostics, the operating system and the bag.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from enum import Enum
from functools import partial
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.benchmarks import exported, limits
from hyst_control.base import progress
from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.processes.node_processes import Processes
from hyst_control.processes.ros_domain import own_domain
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.reporting.tables import Limit, Table

SECONDS = 6.0
"""Length of one measurement; diagnostics come once a second."""
TITLES = {"lockstep": "lockstep, MHL loop of two axes", "timer": "wall clock, 1 kHz"}
"""Tables by schedule."""
LOCKSTEP_RATE, TIMER_RATE = 5000.0, 1000.0  # Hz
START_TIMEOUT = 90.0  # s; a first start compiles the kernels
SETTLING = 2.0  # s, of a run before it is measured
PAGE_LOADING = 5.0  # s
HYST = "import sys; from hyst_control.cli import main; sys.exit(main())"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
STREAMED = 16
"""Rows of a message where the reference is streamed: 3 ms of it at 5 kHz."""
MIB = 2.0**20
STAGE, PRIORITY = "simulated_stage", 50
"""Node in place of the plant where the loop is measured with hardware, and its process' priority under SCHED_FIFO."""
PROCESSES = 4
"""Processes of the loop without a recorder: reference, feedforward, feedback and plant."""
ACTUATORS = ("plant", STAGE)
SINE = {"signal": "sine", "frequency": 20.0, "amplitude": 0.5, "offset": 0.8}
GAINS = {"kp": 2.0, "ki": 5000.0}
SIGNALS = ("reference", "feedforward", "feedback", "command", "measurement")


@dataclass(frozen=True)
class Run:
    """Figures of one run, between two diagnostics of its plant."""

    rate: float  # Rounds (ticks) per second
    cpu: float  # Processor load of all its processes, % of one core
    memory: list[float]  # Resident memory at every sample, MiB
    values: Mapping[str, dict[str, str]]  # Last diagnostics by node
    begin: Mapping[str, dict[str, str]]  # Those at the beginning
    priority: int  # Of its processes under SCHED_FIFO, 0 for none

    def microseconds(self, entry: str) -> float:
        """Return an entry of the plant's diagnostics."""
        found = (values[entry] for name, values in self.values.items() if name.endswith(ACTUATORS) and entry in values)
        return float(next(found, "nan"))

    def count(self, node: str, entry: str) -> int:
        """Return how far a counter of a node's diagnostics has gone on in the run; what belongs to its start is not counted."""
        begin, end = (int(values.get(node, {}).get(entry, 0)) for values in (self.begin, self.values))
        return end - begin


class Watched(Enum):
    """Parts of a live page that run beside a measured loop."""

    NOT = "not"
    BY_NOBODY = "live view without a page"
    ON_A_PAGE = "live view with a page open in a browser"


def run(table: Table, seconds: float = SECONDS) -> None:
    """Measure all cases: lockstep and wall clock, composed and as processes, plain and with the recorder."""
    streamed = measure("composed", "hyst", "lockstep", seconds, block=STREAMED)
    rounds = {"composed": exported.rounds(), "processes": limits.ring(PROCESSES)}
    _add(table, "lockstep", f"composed, reference streamed in {STREAMED} rows", "hyst", streamed, rounds["composed"])
    for schedule, case in product(TITLES, ("composed", "processes")):
        for subject in ("hyst", "plain rclpy"):
            _add(table, schedule, case, subject, measure(case, subject, schedule, seconds), rounds[case])
        if (schedule, case) == ("timer", "composed"):
            _add(table, schedule, f"{case}, backend: c", "hyst", measure(case, "hyst", schedule, seconds, backend="c"))
        limit = rounds["composed"] if case == "composed" else limits.ring(PROCESSES + 1)
        for way in ("", " from outside") if case == "composed" else ("",):
            with tempfile.TemporaryDirectory() as folder:
                bag, recorded = Path(folder) / "bag", f"{case}, recorded{way}"
                _add(table, schedule, recorded, "hyst", measure(case, "hyst", schedule, seconds, bag, outside=bool(way)), limit)
                lost, count = missing_rows(bag)
                table.add(TITLES[schedule], recorded, "hyst", "loss", "%", 100.0 * sum(lost.values()) / count, n=count)
    dashboard(table, seconds)


def dashboard(table: Table, seconds: float = SECONDS) -> None:
    """Measure what a live page costs the composed loop at 1 kHz: without a live view, with one, and with a page open in a browser.

    All three also under real-time priority, with which what else runs on the cores does not delay the loop.
    """
    for priority in (0, PRIORITY):
        case = f"composed{f', SCHED_FIFO {priority}' if priority else ''}"
        _add(table, "timer", f"{case}, no live view", "hyst", measure("composed", "hyst", "timer", seconds, priority=priority))
        watched = measure("composed", "hyst", "timer", seconds, watched=Watched.BY_NOBODY, priority=priority)
        _add_view(table, f"{case}, live view", watched)
        if not _browser()[0] or find_spec("bokeh") is None:
            progress.step("no chromium or no bokeh: the cost of an open page is not measured")
        else:
            shown = measure("composed", "hyst", "timer", seconds, watched=Watched.ON_A_PAGE, priority=priority)
            _add_view(table, f"{case}, live view, page open", shown)


def _add_view(table: Table, case: str, measured: Run) -> None:
    """Timing of the loop, and the processor time of a poll of its live view, which comes 20 times a second."""
    _add(table, "timer", case, "hyst", measured)
    for label in ("p50", "p99"):
        value = float(measured.values["live_view"][f"poll {label} [us]"])
        table.add(TITLES["timer"], case, "hyst", f"poll_{label}", "us", value)


def _add(table: Table, schedule: str, case: str, subject: str, measured: Run, rounds: Limit | None = None) -> None:
    """Rate of a loop beside that of its limit, under the timer with its periods, latencies and load beside those of a bare timer."""
    name = TITLES[schedule]
    if schedule == "lockstep":
        table.add(name, case, subject, "rounds_rate", "rounds/s", measured.rate, limit=rounds)
        return
    bare = limits.timer(TIMER_RATE, measured.priority)
    for quantity, entry in (("period", "period"), ("latency", "loop latency")):
        for label in ("p50", "p99", "p99.9"):
            value, limit = measured.microseconds(f"{entry} {label} [us]"), bare.get(f"{quantity}_{label}")
            table.add(name, case, subject, f"{quantity}_{label}", "us", value, limit=limit)
    table.add(name, case, subject, "rate", "Hz", measured.rate)
    table.add(name, case, subject, "cpu", "%", measured.cpu, limit=bare["cpu"])


def soak_lockstep(table: Table, minutes: float = 60.0) -> None:
    """Run in lockstep at full speed, composed and recorded: lost rows, repeated messages, processor load, memory."""
    _soak(table, "lockstep", "soak, lockstep", minutes, "plant")


def soak_wall_clock(table: Table, minutes: float = 10.0) -> None:
    """Run at 1 kHz on the wall clock against a stage on hardware: lost rows, missed ticks, processor load, memory."""
    _soak(table, "timer", "soak, stage on hardware, 1 kHz", minutes, STAGE)


def _soak(table: Table, schedule: str, name: str, minutes: float, stage: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        measured = measure("composed", "hyst", schedule, 60.0 * minutes, Path(folder) / "bag", stage=stage)
        case = f"{minutes:g} min, composed, recorded"
        add, quarter = partial(table.add, name, case, "hyst"), max(len(measured.memory) // 4, 1)
        begin, end = float(np.mean(measured.memory[:quarter])), float(np.mean(measured.memory[-quarter:]))
        add("rounds_rate", "rounds/s", measured.rate)
        add("cpu", "%", measured.cpu)
        add("memory", "MiB", end)
        add("memory_growth", "MiB", end - begin, n=len(measured.memory))
        if schedule == "timer":
            for label in ("p50", "p99", "p99.9"):
                add(f"period_{label}", "us", measured.microseconds(f"period {label} [us]"))
            add("missed_ticks", "", measured.count(stage, "missed ticks"))
            add("faults", "", measured.count("pi_feedback", "faults"))
        else:
            add("repeated_messages", "", sum(measured.count("recorder", f"/{topic}: duplicate") for topic in SIGNALS))
        lost, count = missing_rows(Path(folder) / "bag")
        add("loss", "%", 100.0 * sum(lost.values()) / count, n=count)
        add("lost_rows", "", sum(lost.values()), n=count)
        for topic, missing in lost.items():
            table.add(name, f"{case}, {topic}", "hyst", "missing_rows", "", missing)


def measure(
    case: str,
    subject: str,
    schedule: str,
    seconds: float,
    bag: Path | None = None,
    block: int = 1,
    outside: bool = False,
    backend: str = "python",
    stage: str = "plant",
    watched: Watched = Watched.NOT,
    priority: int = 0,
) -> Run:
    """Run the loop once."""
    # block: rows of the reference, which is known ahead, in one message, and so of the feedforward; all else goes tick by tick
    progress.step(f"{schedule}, {case}, {subject}{', recorded' if bag else ''}{' from outside' if outside else ''}: {seconds:g} s")
    each = settings(schedule, bag, block, backend, stage)
    if priority:
        each[stage]["realtime_priority"] = priority
    if watched is not Watched.NOT:
        each["live_view"] = {name: each[stage][name] for name in ("schedule", "rate_hz", "axes", "unit")}
    with ExitStack() as stack:
        processes, plant = stack.enter_context(_running(case, subject, each, outside, stage))
        pids = [process.pid for name, process in processes.running.items() if name != "monitor"]
        log = stack.enter_context(closing(_Diagnostics(processes.log("monitor"))))
        _until(lambda: int(log.read().get(plant, {}).get("ticks", 0)) > 0, processes, START_TIMEOUT)
        if watched is Watched.ON_A_PAGE:
            _open_page(processes)
        time.sleep(SETTLING)
        begin = dict(log.read())
        before, cpu_before, clock = begin[plant], _processor_time(pids), time.monotonic()
        memory = []
        while time.monotonic() - clock < seconds:
            time.sleep(min(0.5, seconds))
            processes.check()
            memory.append(_resident(pids))
        cpu = (_processor_time(pids) - cpu_before) / (time.monotonic() - clock)
        _until(lambda: log.read()[plant]["stamp"] > before["stamp"], processes, 10.0)
        after, values = log.read()[plant], log.read()
        processes.stop()
        processes.check()
    rate = (int(after["ticks"]) - int(before["ticks"])) / (float(after["stamp"]) - float(before["stamp"]))
    return Run(rate, 100.0 * cpu, memory, values, begin, priority)


def missing_rows(bag: Path) -> tuple[dict[str, int], int]:
    """Count the rows missing between the first and the last one of each topic of a bag, and the rows due on all topics.

    Under the timer these are also the ticks that the node which publishes it has missed: a stage has no sample of them, while the feedback
    publishes the command that it held.
    """
    signals = {topic: signal for topic, signal in read_bag(bag).signals.items() if topic in SIGNALS}
    steps = {topic: float(np.median(np.diff(signal.time))) for topic, signal in signals.items()}
    due = {topic: round((signal.time[-1] - signal.time[0]) / steps[topic]) + 1 for topic, signal in signals.items()}
    return {topic: due[topic] - len(signal.time) for topic, signal in signals.items()}, sum(due.values())


def settings(
    schedule: str, bag: Path | None, block: int = 1, backend: str = "python", stage: str = "plant"
) -> dict[str, dict[str, Any]]:
    """Parameters of the nodes of the MHL loop."""
    rate = LOCKSTEP_RATE if schedule == "lockstep" else TIMER_RATE
    common = {"schedule": schedule, "rate_hz": rate, "axes": ["x", "y"], "unit": "mrad", "timeout": 1.0}
    model = str(config_path("models/fsm_mhl.yaml"))
    each: dict[str, dict[str, Any]] = {
        "reference_generator": {**SINE, "phase": -np.pi / 2, "duration": 0.05, "repeat": True, "block": block, "lead": block + 3},
        "mhl_feedforward": {"model": model, "limits": [0.0, 100.0], "backend": backend},
        "pi_feedback": {**GAINS, "upper": 100.0, "backend": backend},
        "plant": {"model": model, "wait_for_recorder": bag is not None},
    }
    if stage != "plant":
        each.pop("plant")
        each[stage] = {"model": model, "upper": 100.0, "realtime_priority": PRIORITY}
    if bag is not None:
        each["recorder"] = {"output": str(bag), "merge": 50}
    return {name: {**common, **own} for name, own in each.items()}


@contextmanager
def _running(
    case: str, subject: str, each: dict[str, dict[str, Any]], outside: bool, stage: str
) -> Iterator[tuple[Processes, str]]:
    """The processes of a run, and the name of its plant."""
    with tempfile.TemporaryDirectory() as folder, own_domain() as domain, Processes(Path(folder), domain) as processes:
        processes.start("monitor", {})
        if subject == "hyst":
            if outside:
                processes.start("recorder", each.pop("recorder"))
            if case == "composed":
                processes.compose(each)
            else:
                for name, own in each.items():
                    processes.start(name, own)
            yield processes, stage
            return
        plain = {name: each["plant"][name] for name in ("schedule", "rate_hz", "model")}
        file = Path(folder) / "plain.json"
        file.write_text(json.dumps({**plain, **GAINS, **SINE}), encoding="utf-8")
        names = ("reference", "feedforward", "feedback", "plant")
        for group in [names] if case == "composed" else [(name,) for name in names]:
            processes.run("-".join(group), "evaluation.benchmarks.plain_loop", *group, str(file))
        yield processes, "plain_plant"


def _open_page(processes: Processes) -> None:
    """Start the dashboard of the MHL loop and a browser that shows it."""
    arguments = ("--rate", str(TIMER_RATE), "--axes", "x", "y", "--unit", "mrad", "--folder", str(processes.folder))
    processes.execute("dashboard", [sys.executable, "-c", HYST, "dashboard", *arguments])
    log = processes.log("dashboard")
    _until(lambda: "http://" in log.read_text(encoding="utf-8"), processes, START_TIMEOUT)
    url = next(word for word in log.read_text(encoding="utf-8").split() if word.startswith("http://"))
    processes.execute("browser", [*_browser(), f"--user-data-dir={processes.folder / 'browser'}", url])
    time.sleep(PAGE_LOADING)


def _browser() -> list[str]:
    """Command line of a browser without a window; its address comes last."""
    path = next((path for name in BROWSERS if (path := shutil.which(name))), "")
    return [path, "--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--remote-debugging-port=0"]


class _Diagnostics:
    """Newest entries by node of the monitor's growing log; every line is read once."""

    def __init__(self, path: Path) -> None:
        self._file = open(path, encoding="utf-8")
        self._part = ""
        self._values: dict[str, dict[str, str]] = {}

    def read(self) -> Mapping[str, dict[str, str]]:
        *lines, self._part = (self._part + self._file.read()).split("\n")
        for line in lines:
            if line.startswith("{"):
                entry = json.loads(line)
                self._values[entry["node"]] = {**entry["values"], "stamp": repr(entry["stamp"])}
        return self._values

    def close(self) -> None:
        self._file.close()


def _until(condition: Callable[[], bool], processes: Processes, timeout: float) -> None:
    end = time.monotonic() + timeout
    while not condition():
        processes.check()
        if time.monotonic() > end:
            raise InputError(f"bench: no diagnostics of the loop within {timeout:g} s: check that DDS may use the loopback network")
        time.sleep(0.1)


def _processor_time(pids: list[int]) -> float:
    """Seconds of processor time that these processes have used."""
    total = 0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        total += int(fields[11]) + int(fields[12])
    return total / os.sysconf("SC_CLK_TCK")


def _resident(pids: list[int]) -> float:
    """MiB of memory that these processes hold."""
    return sum(int(Path(f"/proc/{pid}/statm").read_text().split()[1]) for pid in pids) * os.sysconf("SC_PAGE_SIZE") / MIB
