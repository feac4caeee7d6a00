# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of processes and of the disk, with real processes; and devices side by side, each in its namespace."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from loop_case import MODEL, RATE, SIGNALS, assert_same_bits, offline, parameters, recorded, write_record
from pipeline_thread import ProcessesBesideThread
from rclpy.parameter import Parameter
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from hyst_control.base.config_files import config_folders
from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.identify.workflow import identify_bags
from hyst_control.nodes.execution.run import run
from hyst_control.nodes.pipeline import node_class
from hyst_control.processes.node_processes import Processes
from hyst_control.records.bags.bag_reader import read_bag

pytestmark = pytest.mark.long_file

COUNT = 2400


def wait_for_size(processes, bag, size):
    """Until the recorder has written so many bytes; the nodes must be running meanwhile."""
    file, end = bag / f"{bag.name}_0.mcap", time.monotonic() + 60
    while not (file.exists() and file.stat().st_size > size):
        assert time.monotonic() < end
        processes.check()
        time.sleep(0.02)


def wait_for_rows(processes, bag, least):
    """Until so many rows of every topic can be read: under load the middleware may keep one of them back for seconds."""
    end = time.monotonic() + 60
    while True:
        assert time.monotonic() < end
        processes.check()
        with suppress(InputError):
            signals = read_bag(bag).signals
            if set(SIGNALS) <= set(signals) and min(len(signals[topic].time) for topic in SIGNALS) >= least:
                return
        time.sleep(0.05)


def assert_prefix(bag, least):
    """What `hyst` reads from a bag: every topic from tick 0 without a gap, equal to the run that was not disturbed."""
    record, expected = read_bag(bag), offline(COUNT)
    for topic in SIGNALS:
        signal = record.signals[topic]
        count = len(signal.time)
        assert count >= least
        np.testing.assert_array_equal(signal.time, np.arange(count) * (1 / RATE))
        np.testing.assert_array_equal(signal.values, expected[topic][:count])


def assert_rosbags_reads_the_repaired(bag, target):
    assert main(["import", str(bag), "--output", str(target)]) == 0
    with AnyReader([target], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        assert {connection.topic for connection in reader.connections} == {f"/{topic}" for topic in SIGNALS}
    assert_prefix(target, 1)


def test_killed_recorder_leaves_what_was_flushed_and_a_new_one_goes_on(tmp_path, domain):
    settings = parameters(tmp_path, COUNT, recorder={"merge": 8})
    with ProcessesBesideThread(tmp_path / "log", domain) as processes:
        processes.compose({name: own for name, own in settings.items() if name != "recorder"})
        recorder = processes.start("recorder", settings["recorder"])
        wait_for_rows(processes, tmp_path / "bag", 100)
        recorder.kill()
        recorder.wait()
        processes.start("recorder", {**settings["recorder"], "output": str(tmp_path / "second")})
        processes.wait("pipeline", "recorder", timeout=60)
    assert_prefix(tmp_path / "bag", 100)
    assert_rosbags_reads_the_repaired(tmp_path / "bag", tmp_path / "repaired")
    second = read_bag(tmp_path / "second").signals["measurement"]
    assert round(second.time[-1] * RATE) == COUNT - 1 and np.all(np.diff(np.rint(second.time * RATE)) == 1)


LIMITED = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (150_000, 150_000))
from hyst_control.nodes.recorder import main
raise SystemExit(main())
"""


def test_full_disk_ends_the_recorder_with_one_line_and_a_readable_bag(tmp_path, domain, monkeypatch):
    """A limit on the size of files stands for the full disk: both make the write fail."""
    settings = parameters(tmp_path, COUNT, recorder={"merge": 8, "ticks": 0})
    (tmp_path / "limited.py").write_text(LIMITED)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}:{config_folders()[0].parent}")
    monkeypatch.delenv("COVERAGE_PROCESS_CONFIG", raising=False)  # the limit would meet the measurement's own file
    with ProcessesBesideThread(tmp_path / "log", domain) as processes:
        processes.compose({name: own for name, own in settings.items() if name != "recorder"})
        file = tmp_path / "recorder.json"
        file.write_text(json.dumps({"/**": {"ros__parameters": settings["recorder"]}}))
        processes.run("recorder", "limited", "--ros-args", "--params-file", str(file))
        with pytest.raises(InputError, match="recorder ended with status 2: .*recording ends here"):
            processes.wait("recorder", timeout=60)
        told = processes.log("recorder").read_text()
    assert "Traceback" not in told and told.count("recording ends here") == 1
    assert_prefix(tmp_path / "bag", 100)
    assert_rosbags_reads_the_repaired(tmp_path / "bag", tmp_path / "repaired")


def test_killed_plant_is_started_again_and_the_run_goes_on_to_its_end(tmp_path, domain):
    settings = parameters(tmp_path, COUNT, plant={"retry": 0.1}, recorder={"merge": 64})
    with ProcessesBesideThread(tmp_path / "log", domain) as processes:
        processes.compose({name: own for name, own in settings.items() if name != "plant"})
        plant = processes.start("plant", settings["plant"])
        wait_for_size(processes, tmp_path / "bag", 80_000)
        plant.kill()
        plant.wait()
        processes.start("plant", settings["plant"])
        processes.wait("plant", "pipeline", timeout=60)
        told = processes.log("plant").read_text()
    rows = recorded(tmp_path / "bag")
    ticks = np.rint(rows["measurement"][:, 0] * RATE)
    assert ticks[-1] == COUNT - 1 and np.all(np.diff(ticks) >= 1)
    if (
        "joining a run in progress" not in told
    ):  # the commands were still there from the first on: the new plant repeats what the old one did
        assert_same_bits(rows, offline(COUNT))


def test_killed_diagnosis_leaves_the_loop_alone_and_starts_again(tmp_path, domain):
    """It listens only: the run is to the last bit what it is without it."""
    settings = parameters(tmp_path, COUNT, recorder={"merge": 64})
    watching = {"model": MODEL, "rate_hz": RATE, "output": str(tmp_path / "diagnosis")}
    with ProcessesBesideThread(tmp_path / "log", domain) as processes:
        processes.start("monitor", {})
        diagnosis = processes.start("diagnosis", watching)
        wait_for_diagnostics(processes, "diagnosis", 1)
        processes.compose(settings)
        wait_for_size(processes, tmp_path / "bag", 80_000)
        diagnosis.kill()
        diagnosis.wait()
        said = processes.log("monitor").read_text().count(SAYS.format("diagnosis"))
        again = processes.start("diagnosis", watching)
        processes.wait("pipeline", timeout=60)
        wait_for_diagnostics(processes, "diagnosis", said + 1)
        assert again.poll() is None and processes.stop()["diagnosis"] == 0
        assert "Traceback" not in processes.log("diagnosis").read_text()
    assert_same_bits(recorded(tmp_path / "bag"), offline(COUNT))


def running():
    """Every process that runs, with its parent."""
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, parent = stat.read_text().rpartition(")")[2].split()[:2]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if state != "Z":
            found[int(stat.parent.name)] = int(parent)
    return found


def test_killed_identification_leaves_nothing_half_written_and_starts_again(tmp_path, domain):
    """Killed in the middle of a fit, while its workers are at it: they end too, and the same call then gives the same model."""
    write_record(tmp_path / "bag")
    settings = {
        "bags": [str(tmp_path / "bag")],
        "family": "hapi",
        "output": str(tmp_path / "model.yaml"),
        "json": str(tmp_path / "fit.json"),
        "once": True,
    }
    before = {path.name for path in tmp_path.iterdir()}
    with Processes(tmp_path / "log", domain) as processes:
        identification, end = processes.start("identification", settings), time.monotonic() + 60
        while not (workers := {worker for worker, parent in running().items() if parent == identification.pid}):
            assert identification.poll() is None and time.monotonic() < end
            time.sleep(0.002)
        identification.kill()
        identification.wait()
        while workers & running().keys():
            assert time.monotonic() < end, "a worker outlives the process that it works for"
            time.sleep(0.01)
        assert {path.name for path in tmp_path.iterdir()} == before | {"log"}
        processes.start("identification", settings)
        processes.wait("identification", timeout=60)
        assert "Traceback" not in processes.log("identification").read_text()
    identify_bags([tmp_path / "bag"], "hapi", tmp_path / "again.yaml")
    assert (tmp_path / "model.yaml").read_text() == (tmp_path / "again.yaml").read_text()


SAYS = '"node": "{}"'


def wait_for_diagnostics(processes, node, count):
    """Until the node has published its diagnostics so many times."""
    end = time.monotonic() + 60
    while processes.log("monitor").read_text().count(SAYS.format(node)) < count:
        assert time.monotonic() < end
        processes.check()
        time.sleep(0.02)


def test_nodes_that_join_late_find_the_loop_running(tmp_path, domain):
    """On the wall clock: recorder and feedback start after the others have run for a while; the command begins at rest."""
    settings = parameters(tmp_path, 400)
    for own in settings.values():
        own.update({"schedule": "timer", "rate_hz": 500.0})
    settings["plant"].update(ticks=0)
    settings["recorder"].update(ticks=400, merge=8)
    with ProcessesBesideThread(tmp_path / "log", domain) as processes:
        processes.compose({name: settings[name] for name in ("reference_generator", "hampi_feedforward", "plant")})
        time.sleep(1.0)
        processes.start("pi_feedback", settings["pi_feedback"])
        processes.start("recorder", settings["recorder"])
        processes.wait("recorder", timeout=60)
        assert set(processes.stop().values()) == {0}
        assert all("Traceback" not in processes.log(name).read_text() for name in ("pi_feedback", "recorder"))
    record = read_bag(tmp_path / "bag")
    assert all(len(record.signals[topic].time) >= 400 for topic in SIGNALS)
    assert record.signals["command"].values.min() >= 0.0


def test_four_devices_run_side_by_side(tmp_path, ros_context):
    """Twenty nodes in one process, a namespace per device: each device's record is that of the device alone."""
    count, nodes = 150, []
    for device in range(4):
        (tmp_path / f"device{device}").mkdir()
        np.save(tmp_path / f"device{device}" / "reference.npy", signal(count, device))
        for name, own in parameters(tmp_path / f"device{device}", count).items():
            nodes.append(
                node_class(name)(
                    context=ros_context,
                    namespace=f"/device{device}",
                    parameter_overrides=[Parameter(key, value=value) for key, value in own.items()],
                )
            )
    assert run(nodes, ros_context, timeout=60.0) == 0
    for device in range(4):
        rows = recorded(tmp_path / f"device{device}" / "bag")
        np.testing.assert_array_equal(rows["reference"][:, 1:], signal(count, device))
        assert all(len(rows[topic]) == count for topic in SIGNALS)
        if device == 1:
            assert_same_bits(rows, offline(count))


def signal(count, device):
    time = np.arange(count) / RATE
    return device * 2.0 * (1 - np.cos(2 * np.pi * 150.0 * time))[:, None]


STARTER = """
import sys, time
from pathlib import Path
from hyst_control.processes.node_processes import Processes

processes = Processes(Path(sys.argv[1]), int(sys.argv[2]))
for name in ("hampi_feedforward", "pi_feedback"):
    print(processes.start(name, {"kind": "proportional"}).pid, flush=True)
time.sleep(1000)
"""


def test_killed_starter_leaves_no_nodes(tmp_path, domain):
    """kill -9 of what started the nodes, as of a demo: they end by themselves."""
    starter = subprocess.Popen([sys.executable, "-c", STARTER, str(tmp_path), str(domain)], stdout=subprocess.PIPE, text=True)
    nodes = {int(starter.stdout.readline()) for _ in range(2)}
    assert nodes <= running().keys()
    starter.kill()
    starter.wait()
    end = time.monotonic() + 60
    while nodes & running().keys():
        assert time.monotonic() < end, "a node outlives the process that started it"
        time.sleep(0.05)
    starter.stdout.close()
