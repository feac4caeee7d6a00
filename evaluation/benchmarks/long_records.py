# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Time and memory of import, simulate, validate and identify by the length of the record, each in a process of its own.

Memory is the largest that a process has taken for itself (RssAnon): pages of temporary files, which the system takes back, are none of it.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evaluation.benchmarks import limits
from hyst_control.base import progress
from hyst_control.chain import Chain
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.model_file import Model, save_model
from hyst_control.reporting.tables import Table

RATE = 50e3
"""Hz."""
INTERVAL = 0.02
"""s between looks at the memory."""
BLOCK = 1 << 20
COMMANDS = ("import", "simulate", "validate", "identify", "identify hampi", "identify madelung")
"""`identify` alone: play operators. A second word is another family."""
HOUR = 60.0
"""min."""


def run(table: Table, minutes: Sequence[float], commands: Sequence[str] = COMMANDS) -> None:
    """Measure every command on records of several lengths, and draw the line of the two longest of them on to an hour."""
    found: dict[str, list[tuple[float, float, float]]] = {command: [] for command in commands}
    for length in sorted(minutes):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            rows = write_recording(folder / "recording.npy", length)
            save_model(plant(), folder / "model.yaml")
            limit = limits.reading(np.load(folder / "recording.npy", mmap_mode="r"))
            for command in commands:
                progress.step(f"{command}, {length:g} min at {RATE / 1e3:g} kHz")
                seconds, processor, memory = measured(arguments_of(command, folder))
                case = f"{length:g} min at {RATE / 1e3:g} kHz"
                table.add("long records", case, command, "time_per_million_samples", "s", 1e6 * seconds / rows, n=rows)
                table.add("long records", case, command, "processor_time_per_million_samples", "s", 1e6 * processor / rows, n=rows)
                table.add("long records", case, command, "time", "s", seconds, n=rows, limit=limit)
                table.add("long records", case, command, "memory", "MiB", memory, n=rows)
                found[command].append((length, processor, memory))
    for command, measurements in found.items():
        if len(measurements) > 1:
            add_hour(table, command, measurements)


def add_hour(table: Table, command: str, measurements: Sequence[tuple[float, float, float]]) -> None:
    """Add how time and memory grow, and what an hour would take; memory that falls is taken to stay."""
    # measurements: length (min), processor time (s) and memory (MiB) by rising length, two or more. The last two tell how either
    # grows
    length, *last = measurements[-1]
    (shorter, *before) = measurements[-2]
    for quantity, unit, value, earlier in zip(("processor_time", "memory"), ("s", "MiB"), last, before, strict=True):
        slope = (value - earlier) / (length - shorter)
        case = f"{shorter:g} to {length:g} min"
        table.add("long records, growth", case, command, f"{quantity}_per_minute", f"{unit}/min", slope)
        table.add(
            "long records, growth", "an hour, extrapolated", command, quantity, unit, value + max(slope, 0.0) * (HOUR - length)
        )


def plant() -> Model:
    """Play operators, which are the model of `simulate` and `validate`."""
    stage = PrandtlIshlinskii([2.0, 5.0, 10.0, 20.0], [0.03, 0.02, 0.02, 0.01], w0=0.08)
    return Model("bench", ("x",), {"command": "V", "measurement": "um"}, 1.0 / RATE, Chain((stage,)), noise={"sigma": 0.01})


def write_recording(path: Path, minutes: float) -> int:
    """Write command and measurement of a plant of play operators as a .npy file, block by block."""
    rows = round(60.0 * minutes * RATE)
    table = np.lib.format.open_memmap(path, "w+", np.float64, (rows, 2))
    running = plant().filter()
    running.settle(np.zeros(1))
    before = np.zeros((1, 1))
    random = np.random.default_rng(0)
    for begin in range(0, rows, BLOCK):
        t = np.arange(begin, min(begin + BLOCK, rows)) / RATE
        command = 20.0 * (1.0 - np.cos(2 * np.pi * 20.0 * t)) * (1.0 + 0.5 * np.sin(2 * np.pi * 0.7 * t)) / 1.5
        output = np.concatenate([before, running.process(command[:, None])])
        before = output[-1:]
        table[begin : begin + len(t), 0] = command
        table[begin : begin + len(t), 1] = output[:-1, 0] + 0.01 * random.standard_normal(len(t))
    table.flush()
    return rows


def arguments_of(command: str, folder: Path) -> list[str]:
    """Arguments of a command that works in a folder."""
    bag, model, recording = (str(folder / name) for name in ("bag", "model.yaml", "recording.npy"))
    columns = ["--columns", "command=1[V],measurement=2[um]", "--rate", f"{RATE:g}"]
    verb, *family = command.split()
    options = ["--model", family[0]] if family else ["--model", "pi", "--operators", "5"]
    return {
        "import": ["import", recording, "--output", bag, *columns],
        "simulate": ["simulate", model, bag, "--output", str(folder / "simulated")],
        "validate": ["validate", model, bag],
        "identify": ["identify", bag, *options, "--output", str(folder / "identified.yaml")],
    }[verb]


def measured(arguments: Sequence[str]) -> tuple[float, float, float]:
    """Time, processor time and largest memory of a command, its worker processes included."""
    begin, before, memory = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime, 0.0
    call = "import sys; from hyst_control.cli import main; sys.exit(main(sys.argv[1:]))"
    with subprocess.Popen([sys.executable, "-c", call, *arguments, "--quiet"], stdout=subprocess.DEVNULL) as running:
        while True:
            try:
                status = running.wait(INTERVAL)
                break
            except subprocess.TimeoutExpired:
                memory = max(memory, own_memory(running.pid))
    if status:
        raise RuntimeError(f"hyst {' '.join(arguments)}: exit status {status}")
    processor = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    return time.perf_counter() - begin, processor, memory


def own_memory(process: int) -> float:
    """Memory (MiB) that a process and its children have taken for themselves; 0 of one that has ended."""
    folder = Path("/proc") / str(process)
    try:
        status, tasks = (folder / "status").read_text(encoding="ascii", errors="replace"), list((folder / "task").iterdir())
        children = [int(child) for task in tasks for child in (task / "children").read_text(encoding="ascii").split()]
    except OSError:
        return 0.0
    own = [float(line.split()[1]) / 1024.0 for line in status.splitlines() if line.startswith("RssAnon:")]
    return sum(own) + sum(own_memory(child) for child in children)
