"""Cost of a fleet's records: of handing them out, of one record, what a second worker brings, and the memory of the caller."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.benchmarks.simulated_fleet import CLEAN_NIGHTS, make_fleet
from hyst_control.base.cluster import LOOPBACK
from hyst_control.base.errors import InputError
from hyst_control.base.parallel import Workers, outcomes
from hyst_control.fleet.manifest import read_manifest
from hyst_control.fleet.record_jobs import GAPS, ONSETS, RecordJob, compute
from hyst_control.reporting.tables import Table

RECORDS = 10_000
"""Records without any work in them; after half of them the memory is taken for comparison."""
STARTED = 30.0
"""Seconds that a scheduler has to come up."""
BUSY = 0.1
"""Processor time of a job with which scaling is measured, s."""
JOBS = 60
UNITS, NIGHTS = 2, 12
MIB = 2.0**20


def run(table: Table, records: int = RECORDS, jobs: int = JOBS, clusters: Sequence[str | None] = (None, "local")) -> None:
    """Measure what records of a fleet cost beside and in their computation."""
    for cluster in clusters:
        name = "processes" if cluster is None else f"Dask {cluster}"
        seconds, grown = _handing_out(Workers(2, cluster), records)
        table.add("fleet", f"{records} records without work", name, "overhead", "ms/record", 1e3 * seconds, n=records)
        table.add("fleet", f"from {records // 2} to {records} records", name, "client_memory_growth", "MiB", grown, n=records)
        one, two = (_rate(Workers(count, cluster), jobs) for count in (1, 2))
        table.add("fleet", f"jobs of {BUSY:g} s", name, "rate of 2 workers / of 1", "1", two / one, n=jobs)
    if any(clusters):
        with own_cluster() as address:
            seconds, grown = _handing_out(Workers(None, address), records)
        name = "Dask, processes of its own"
        table.add("fleet", f"{records} records without work", name, "overhead", "ms/record", 1e3 * seconds, n=records)
        table.add("fleet", f"from {records // 2} to {records} records", name, "client_memory_growth", "MiB", grown, n=records)
    with tempfile.TemporaryDirectory() as folder:
        make_fleet(Path(folder) / "fleet", 1, UNITS, NIGHTS, 0.0)
        entries = read_manifest([str(Path(folder) / "fleet" / "manifest.csv")])
        for only in (ONSETS, GAPS):
            spent = []
            for entry in entries:
                if entry.baseline:
                    begin = time.process_time()
                    compute(RecordJob("diagnose", entry, {"only": only}, folder))
                    spent.append(time.process_time() - begin)
            case = f"healthy unit, {NIGHTS - CLEAN_NIGHTS} nights of 6000 samples"
            table.add("fleet", case, f"diagnose --only {only}", "processor_time", "s/record", float(np.median(spent)), n=len(spent))


@contextmanager
def own_cluster(workers: int = 2) -> Iterator[str]:
    """Run a scheduler and workers as processes of their own, on the loopback address only."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as running:
        file = Path(folder) / "scheduler.json"

        def start(what: str, *options: str) -> None:
            words = [
                sys.executable,
                "-m",
                f"distributed.cli.dask_{what}",
                "--scheduler-file",
                str(file),
                "--host",
                LOOPBACK,
                *options,
            ]
            process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
            running.callback(process.wait)
            running.callback(os.killpg, process.pid, signal.SIGTERM)

        start("scheduler", "--port", "0", "--dashboard-address", f"{LOOPBACK}:0", "--no-jupyter")
        end = time.monotonic() + STARTED
        while not file.exists():
            if time.monotonic() > end:
                raise InputError(f"bench: no Dask scheduler came up within {STARTED:g} s")
            time.sleep(0.1)
        start("worker", "--nthreads", "1", "--nworkers", str(workers), "--no-dashboard")
        yield str(file)


def nothing(number: int) -> dict[str, Any]:
    """Compute a record without any work: a row of the size that a record's has."""
    return {"number": number, "report_file": "x" * 200, "effects": [{"name": "creep", "probability": 1.0}], "seconds": 0.0}


def busy(number: int) -> int:
    """Compute for `BUSY` seconds of processor time."""
    end = time.process_time() + BUSY
    while time.process_time() < end:
        pass
    return number


def _handing_out(workers: Workers, records: int) -> tuple[float, float]:
    """Seconds a record, and growth of this process from half of the records to all, MiB."""
    first = before = 0.0
    for done, _ in enumerate(outcomes(nothing, range(records), workers), 1):
        if done == 1:
            first = time.perf_counter()
        if done == records // 2:
            before = _resident()
    return (time.perf_counter() - first) / (records - 1), _resident() - before


def _rate(workers: Workers, jobs: int) -> float:
    """Jobs a second, without the start of the workers."""
    first = 0.0
    for done, _ in enumerate(outcomes(busy, range(jobs), workers), 1):
        if done == min(4, jobs):
            first = time.perf_counter()
    return (jobs - min(4, jobs)) / (time.perf_counter() - first)


def _resident() -> float:
    """Memory of this process, MiB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / MIB
