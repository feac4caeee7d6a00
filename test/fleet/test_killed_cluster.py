# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A study on Dask of which a worker and then the scheduler are killed: every record is there, as one process computes it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("pyarrow")
pytest.importorskip("distributed")
import pyarrow.parquet

from hyst_control.base.config_files import config_path
from hyst_control.base.parallel import Workers
from hyst_control.fleet.manifest import read_manifest
from hyst_control.fleet.record_jobs import ONSETS
from hyst_control.fleet.study import run_study
from hyst_control.model_file import load_model, simulate
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag

UNITS, RUNS, TS = 3, 8, 1e-4


@pytest.fixture(scope="module")
def entries(tmp_path_factory):
    """Short records of one model, each with its own noise."""
    folder = tmp_path_factory.mktemp("killed")
    path = config_path("models/pea_hampi.yaml")
    time = TS * np.arange(1500)
    command = 25.0 - 25.0 * np.cos(2 * np.pi * 20.0 * time)[:, None]
    clean = simulate(load_model(path), command, TS)
    bags = []
    for unit in range(UNITS):
        for run in range(RUNS):
            noise = 1e-3 * np.random.default_rng([unit, run]).standard_normal(clean.shape)
            signals = {"command": Signal(time, command, ("x",), "V"), "measurement": Signal(time, clean + noise, ("x",), "um")}
            bags.append(str(folder / f"u{unit}_{run}"))
            write_bag(folder / f"u{unit}_{run}", Record(signals, "made"))
    return read_manifest(bags, r"(?P<unit>u\d)_(?P<time>\d)", str(path))


@pytest.fixture
def started():
    """Start processes of Dask; all are ended with the test."""
    running = []

    def start(program, *words):
        command = [sys.executable, "-m", f"distributed.cli.{program}", *words, "--host", "127.0.0.1", "--no-dashboard"]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        running.append(process)
        return process

    yield start
    for process in running:
        end(process)


def end(process):
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def rows(folder):
    """Results without what depends on the moment at which they were computed."""
    table = pyarrow.parquet.read_table(folder / "records.parquet").to_pylist()
    return [{name: value for name, value in row.items() if name != "seconds"} for row in table]


def test_a_study_outlives_its_workers_and_its_scheduler(entries, started, tmp_path):
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        port = server.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"

    def cluster(workers):
        scheduler = started("dask_scheduler", "--port", str(port), "--no-jupyter")
        return [scheduler, *(started("dask_worker", address, "--nthreads", "1", "--no-nanny") for _ in range(workers))]

    parts, noted = cluster(2), []

    def note(line):
        noted.append(line)
        if len(noted) == 6:
            end(parts[1])  # a worker
        if len(noted) == 16:
            for process in parts:
                end(process)
            parts[:] = cluster(1)

    options = {"only": ONSETS}
    study = run_study("diagnose", entries, tmp_path / "cluster", options, Workers(None, address), note)
    assert (study.computed, study.failed, len(noted)) == (len(entries), {}, len(entries)), "every record once"
    run_study("diagnose", entries, tmp_path / "alone", options, Workers(1))
    assert rows(tmp_path / "cluster") == rows(tmp_path / "alone"), "the same to the bit"
