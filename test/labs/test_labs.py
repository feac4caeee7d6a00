# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The controller in laboratories' software, on the loopback: the loop, a device of bluesky, and an EPICS server."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from importlib.util import find_spec

import numpy as np
import pytest

from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.control.feedback.loop import run_loop
from hyst_control.control.feedback.pi import PI
from hyst_control.labs import epics_ioc
from hyst_control.labs.bluesky_device import PiezoAxis, Status, TrajectoryFlyer
from hyst_control.labs.control_loop import DRIVER, ControlLoop, SimulatedDriver
from hyst_control.model_file import Simulator, load_model

MODEL = str(config_path("models/pea_hampi.yaml"))
RATE = 200.0
PARAMETERS = """
/**: {ros__parameters: {rate_hz: 200.0, axes: [x], unit: um}}
pi_feedback: {ros__parameters: {kp: 0.0, ki: 60.0, upper: 100.0, safe_rate: 1000.0, timeout: 0.05, recovery_time: 0.02}}
"""


class Recorded(SimulatedDriver):
    """A simulated stage that keeps its commands, and can fail."""

    def __init__(self, model=MODEL, sample_time=1 / RATE):
        super().__init__(model, sample_time)
        self.commands, self.broken = [], False

    def read(self):
        if self.broken:
            raise OSError("unplugged")
        return super().read()

    def write(self, command):
        self.commands.append(command[0])
        super().write(command)


@pytest.fixture
def parameters(tmp_path):
    path = tmp_path / "loop.yaml"
    path.write_text(PARAMETERS)
    return path


@pytest.fixture
def driver():
    return Recorded()


@pytest.fixture
def loop(parameters, driver):
    return ControlLoop.from_file(parameters, driver, 100.0)


@pytest.fixture
def running(loop):
    loop.start()
    yield loop
    loop.stop()


def until(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "did not happen"
        time.sleep(0.002)


def test_its_ticks_are_the_loop_that_is_computed_offline(loop, driver):
    loop.target[:] = 2.0
    for _ in range(200):
        loop.tick()
    reference = np.minimum(0.5 * np.arange(1, 201), 2.0)[:, None]
    offline = run_loop(reference, None, PI(0.0, 60.0, 1 / RATE, 0.0, 100.0).start(1), Simulator(load_model(MODEL), 1 / RATE))
    np.testing.assert_array_equal(driver.commands, offline["command"][:, 0])
    assert abs(loop.measurement[0] - 2.0) < 0.01 and loop.fault == "none"


def test_a_driver_that_fails_is_a_fault_and_leads_to_the_safe_value(loop, driver):
    loop.target[:] = 3.0
    for _ in range(100):
        loop.tick()
    driver.broken = True
    loop.tick()
    assert loop.fault == DRIVER and loop.command[0] > 10.0, "one missing sample is bridged"
    for _ in range(40):
        loop.tick()
    assert loop.fault == "no measurement" and loop.command[0] == 0.0
    driver.broken = False
    for _ in range(600):
        loop.tick()
    assert loop.fault == "none" and abs(loop.measurement[0] - 3.0) < 0.01


@pytest.mark.parametrize("given", [None, 1.0, [], [1.0, 23.2], [[1.0]], "one", [1.0, [2.0]]], ids=repr)
def test_a_measurement_that_is_no_number_per_axis_is_a_fault_of_the_driver(loop, driver, monkeypatch, given):
    loop.target[:] = 3.0
    for _ in range(100):
        loop.tick()
    with monkeypatch.context() as patch:
        patch.setattr(driver, "read", lambda: given)
        loop.tick()
        assert loop.fault == DRIVER and loop.command[0] > 10.0
        for _ in range(40):
            loop.tick()
        assert loop.fault == "no measurement" and driver.commands[-1] == 0.0
        with pytest.raises(InputError, match=r"driver: read\(\) gave .*: return one number per axis \(x\)"):
            loop.start()
    for _ in range(600):
        loop.tick()
    assert loop.fault == "none" and abs(loop.measurement[0] - 3.0) < 0.01


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_positions_that_are_not_finite_are_refused(loop, driver, monkeypatch, value):
    loop.move(0, 2.0)
    for refused in (lambda: loop.move(0, value), lambda: loop.play([0.0, value]), lambda: loop.play([value, 0.0])):
        with pytest.raises(InputError, match=f"must be finite um, got {value}"):
            refused()
    with pytest.raises(InputError, match="play: has no rows"):
        loop.play([])
    assert not loop.playing and loop.target.tolist() == [2.0]
    monkeypatch.setattr(driver, "read", lambda: [value])
    with pytest.raises(InputError, match="must be finite"):
        loop.start()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_the_loop_goes_on_after_a_target_that_was_not_finite(loop, value):
    loop.target[:] = 2.0
    for _ in range(100):
        loop.tick()
    loop.target[:] = value
    for _ in range(60):
        loop.tick()
    assert loop.fault == "no reference" and loop.command[0] == 0.0 and loop.reference[0] == 2.0
    loop.move(0, 1.0)
    for _ in range(400):
        loop.tick()
    assert loop.fault == "none" and abs(loop.measurement[0] - 1.0) < 0.01


def test_the_thread_ends_at_the_safe_value(running, driver):
    running.target[:] = 2.0
    until(lambda: abs(running.measurement[0] - 2.0) < 0.01)
    running.stop()
    assert driver.commands[-1] == 0.0 and np.abs(np.diff(driver.commands)).max() < 10.0
    said = len(driver.commands)
    time.sleep(3 / RATE)
    assert len(driver.commands) == said


def test_a_loop_whose_sensor_never_spoke_ends_too(loop, driver):
    loop.start()
    driver.broken = True
    loop.stop()
    assert not loop._thread.is_alive()


def test_an_axis_moves_reads_and_stops(running):
    axis = PiezoAxis(running, "x", "piezo", tolerance=0.02)
    status = axis.set(1.5)
    called = threading.Event()
    status.add_callback(lambda ended: called.set())
    status.wait(30.0)
    assert status.success and called.wait(5.0) and axis.position == pytest.approx(1.5, abs=0.02)
    read, described = axis.read(), axis.describe()
    assert read.keys() == described.keys() == {"piezo", "piezo_reference", "piezo_command"}
    assert described["piezo"]["units"] == "um" and read["piezo_reference"]["value"] == 1.5
    assert axis.read_configuration().keys() == axis.describe_configuration().keys()
    far = axis.set(1000.0)
    axis.stop()
    with pytest.raises(RuntimeError, match="stopped"):
        far.wait(30.0)


def test_a_target_out_of_reach_is_an_error_with_its_distance(running):
    with pytest.raises(TimeoutError, match="um from 500"):
        PiezoAxis(running, "x", "piezo", tolerance=0.02, timeout=0.3).set(500.0).wait(30.0)


def test_a_fault_ends_a_move(running, driver):
    axis = PiezoAxis(running, "x", "piezo", tolerance=0.02)
    driver.broken = True
    with pytest.raises(RuntimeError, match="piezo: "):
        axis.set(2.0).wait(30.0)
    assert not Status().success


def test_a_flyer_collects_every_tick_of_its_trajectory(running):
    PiezoAxis(running, "x", "piezo", tolerance=0.02).set(1.0).wait(30.0)
    rows = 1.0 + 0.5 * (1 - np.cos(2 * np.pi * np.arange(100) / 100))
    flyer = TrajectoryFlyer(running, "scan", rows)
    flyer.kickoff().wait(5.0)
    flyer.complete().wait(30.0)
    events = list(flyer.collect())
    assert events[0]["data"].keys() == flyer.describe_collect()["scan"].keys() == events[0]["timestamps"].keys()
    np.testing.assert_array_equal([event["data"]["scan_reference_x"] for event in events], rows)
    assert np.diff([event["time"] for event in events]) == pytest.approx(1 / RATE, abs=1e-6)
    with pytest.raises(InputError, match="move there first"):
        TrajectoryFlyer(running, "scan", [9.0]).kickoff().wait(5.0)


@pytest.mark.skipif(not find_spec("bluesky"), reason="bluesky is not installed: pip install bluesky")
def test_plans_of_bluesky_run_with_the_devices(running):
    from bluesky import RunEngine
    from bluesky.plans import fly, scan
    from bluesky.protocols import Flyable, Movable, Readable, Stoppable

    axis = PiezoAxis(running, "x", "piezo", tolerance=0.02)
    for protocol in (Movable, Readable, Stoppable):
        assert isinstance(axis, protocol)
    documents = []
    engine = RunEngine({})
    engine(scan([axis], axis, 1.0, 2.0, 3), lambda name, document: documents.append((name, document)))
    found = [document["data"]["piezo"] for name, document in documents if name == "event"]
    np.testing.assert_allclose(found, [1.0, 1.5, 2.0], atol=0.02)
    flyer = TrajectoryFlyer(running, "scan", np.linspace(2.0, 1.0, 50))
    assert isinstance(flyer, Flyable)
    documents.clear()
    engine(fly([flyer]), lambda name, document: documents.append((name, document)))
    assert sum(len(document["seq_num"]) if name == "event_page" else name == "event" for name, document in documents) == 50


@pytest.mark.skipif(not find_spec("caproto"), reason="caproto is not installed: pip install caproto")
def test_an_epics_client_moves_the_stage_on_the_loopback(parameters, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    settings = {
        "EPICS_CA_SERVER_PORT": port,
        "EPICS_CA_ADDR_LIST": "127.0.0.1",
        "EPICS_CA_AUTO_ADDR_LIST": "NO",
        "EPICS_CAS_BEACON_ADDR_LIST": "127.0.0.1",
        "EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO",
    }
    words = [sys.executable, "-m", "hyst_control.labs.epics_ioc", str(parameters), "--model", MODEL, "--prefix", "T:"]
    log = (tmp_path / "ioc.log").open("w")
    server = subprocess.Popen(words, env={**os.environ, **settings}, stdout=log, stderr=log)
    client = "import sys; from caproto.sync.client import read, write\n" + CLIENT
    try:
        done = subprocess.run(
            [sys.executable, "-c", client], env={**os.environ, **settings}, capture_output=True, text=True, timeout=120, check=False
        )
        assert done.returncode == 0, done.stderr + (tmp_path / "ioc.log").read_text()
    finally:
        server.terminate()
        server.wait(30)
        log.close()


CLIENT = """
import time
from caproto import CaprotoTimeoutError

def value(name):
    data = read(name, timeout=5, repeater=False).data[0]
    return data.decode() if isinstance(data, bytes) else data

def until(condition):
    end = time.monotonic() + 60
    while True:
        try:
            if condition():
                return
        except (CaprotoTimeoutError, ConnectionError):
            pass
        assert time.monotonic() < end, "did not happen"
        time.sleep(0.05)

until(lambda: value("T:TICKS") > 0)
write("T:X:SETPOINT", 2.5, notify=True, repeater=False)
until(lambda: abs(value("T:X:READBACK") - 2.5) < 0.02)
assert value("T:X:REFERENCE") == 2.5 and value("T:X:COMMAND") > 10 and value("T:FAULT") == "none"
assert read("T:X:READBACK", data_type="control", timeout=5, repeater=False).metadata.units == b"um"
write("T:ENABLE", 0, notify=True, repeater=False)
until(lambda: value("T:X:COMMAND") == 0.0)
write("T:ENABLE", 1, notify=True, repeater=False)
until(lambda: abs(value("T:X:READBACK") - 2.5) < 0.02)
"""


def test_what_is_missing_is_said_in_one_line(parameters, loop, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "caproto", None)
    with pytest.raises(InputError, match="caproto is not installed: pip install caproto"):
        epics_ioc.database(loop, "T:")
    assert epics_ioc.main([str(parameters), "--driver", "nowhere:Driver"]) == 2
    assert "give MODULE:CLASS" in capsys.readouterr().err.splitlines()[-1]
    assert epics_ioc.main([str(parameters), "--model", MODEL, "--speed", "0"]) == 2
    assert "speed: must be above 0 um/s" in capsys.readouterr().err
