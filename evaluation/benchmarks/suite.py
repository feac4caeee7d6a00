"""`hyst bench`: speed of kernels, bags and the running loop on this machine, and what intervals hold, as a result table."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from evaluation.benchmarks import (
    coverage,
    exported,
    fleets,
    kernels,
    learned_priors,
    long_records,
    loops,
    many_axes,
    round_trips,
    workflows,
)
from hyst_control.base import progress
from hyst_control.base.errors import InputError
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.stream.signal_message import Encoder
from hyst_control.reporting.tables import Table

MESSAGES, ROWS = 24_000, 50
"""Per topic: 1.2 million samples, a minute at 20 kHz, in blocks of 50."""
REPEATS = 5


GROUPS = ("kernels", "exported", "bags", "loops", "dashboard", "workflows", "coverage", "round_trips")

NAMED_ONLY: dict[str, Callable[[Table], None]] = {
    "fleet": fleets.run,
    "many_axes": many_axes.run,
    "learned_priors": learned_priors.run,
}
"""Groups that are run only when they are asked for."""

LONG_RUNS = {"lockstep": loops.soak_lockstep, "wall-clock": loops.soak_wall_clock}
"""Long runs by name, which are run only when they are asked for."""


def run(
    only: str | None = None, seconds: float = loops.SECONDS, soak: float | None = None, minutes: Sequence[float] | None = None
) -> Table:
    """Run all groups of benchmarks, or one of `GROUPS`."""
    table = Table("bench")
    for name, value in (("seconds", seconds), ("soak", soak), *(("minutes", length) for length in minutes or ())):
        if value is not None and not 0 < value < 1e6:
            raise InputError(f"{name}: must be > 0 and < 1e6, got {value!r}")
    if only in LONG_RUNS:
        LONG_RUNS[only](table, **({} if soak is None else {"minutes": soak}))
        return table
    if soak is not None:
        loops.soak(table, soak)
        return table
    if minutes is not None:
        long_records.run(table, minutes)
        return table
    if only in (None, "kernels"):
        progress.step("kernels beside C")
        for row in kernels.run():
            table.add("kernels", row.case, row.subject, "kernel_rate", "samples/s", row.rate, n=kernels.REPEATS)
    if only in (None, "exported"):
        exported.run(table)
    if only in (None, "bags"):
        progress.step("write and read bags")
        bags(table)
    if only in (None, "loops"):
        loops.run(table, seconds)
    if only == "dashboard":
        loops.dashboard(table, seconds)
    if only in (None, "coverage"):
        progress.step("coverage of identified intervals")
        coverage.run(table)
    if only in (None, "round_trips"):
        round_trips.run(table)
    if only is not None and only in NAMED_ONLY:
        progress.step(only.replace("_", " "))
        NAMED_ONLY[only](table)
    if only in (None, "workflows"):
        progress.step("workflows")
        workflows.run(table)
    return table


def bags(table: Table) -> None:
    """Write and read a bag of two topics; messages of both topics per second, medians."""
    labels = {"/command": "t[s],x[V]", "/measurement": "t[s],x[um]"}
    rng = np.random.default_rng(0)
    blocks = rng.normal(size=(MESSAGES, ROWS, 2))
    blocks[:, :, 0] = 5e-5 * np.arange(MESSAGES * ROWS).reshape(MESSAGES, ROWS)
    writing, reading = [], []
    with tempfile.TemporaryDirectory() as folder:
        for repeat in range(REPEATS):
            path = Path(folder) / f"bag{repeat}"
            encoders = {topic: Encoder(label) for topic, label in labels.items()}
            begin = time.perf_counter()
            with BagWriter(path) as writer:
                for index in range(MESSAGES):
                    for topic, encoder in encoders.items():
                        writer.write(topic, encoder.encode(blocks[index]), index * 2_500_000)
            writing.append(time.perf_counter() - begin)
            begin = time.perf_counter()
            record = read_bag(path)
            reading.append(time.perf_counter() - begin)
            assert len(record.signals["command"].time) == MESSAGES * ROWS
    case = f"2 topics of {MESSAGES} messages of {ROWS} rows"
    table.add("bags", case, "hyst", "bag_write_rate", "messages/s", 2 * MESSAGES / np.median(writing), n=REPEATS)
    table.add("bags", case, "hyst", "bag_read_rate", "messages/s", 2 * MESSAGES / np.median(reading), n=REPEATS)
    table.add("bags", case, "hyst", "bag_read_time", "s", np.median(reading), n=REPEATS)
