# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""What the nodes refuse, and what the command does then: messages are sent to one node and its answers read."""

from __future__ import annotations

import copy
import os
import subprocess
import sys
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from loop_case import MODEL, RATE, parameters, recorded
from pipeline_thread import ProcessesBesideThread
from rclpy.parameter import Parameter
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from hyst_control.base.config_files import config_folders
from hyst_control.base.errors import InputError
from hyst_control.nodes.feedforward import Feedforward
from hyst_control.nodes.pi_feedback import PiFeedback
from hyst_control.nodes.recorder import Recorder
from hyst_control.nodes.reference_generator import ReferenceGenerator
from hyst_control.nodes.signal_node.message_io import QUEUE, to_message
from hyst_control.processes.node_processes import Processes
from hyst_control.records.stream.row_repetition import REPEAT_INTERVAL
from hyst_plant_sim.node import PlantNode
from hyst_plant_sim.physics import load_plant

pytestmark = pytest.mark.long_file

PERIOD = 1e-3


def row(tick, *values):
    return np.array([[tick * PERIOD, *values]])


def test_bad_messages_are_dropped_counted_and_leave_no_trace(bench):
    node = bench.add(Feedforward_named, kind="proportional", gain=[10])
    bench.listen("feedforward")
    good, wrong_unit = bench.sender("reference", "t[s],x[um]"), bench.sender("reference", "t[s],x[mrad]")
    wide = bench.sender("reference", "t[s],x[um],y[um]")
    bench.until(lambda: node.feedforward.publisher.get_subscription_count() > 0)
    good.send(row(0, 1.0))
    good.send(row(1, np.nan))
    good.send(row(1, np.inf))
    wrong_unit.send(row(1, 1.0))
    wide.send(row(1, 1.0, 2.0))
    good.send(row(1.4, 1.0))
    good.send(row(5, 1.0))
    bench.until(lambda: node.counts["reference: out of order"] == 1 and node.reference.age > REPEAT_INTERVAL)
    good.send(row(0, 7.0))
    good.send(row(1, 3.0))
    bench.until(lambda: node.counts["reference: duplicate"] == 1 and len(bench.rows("feedforward")) >= 3)
    np.testing.assert_allclose(bench.rows("feedforward"), [[0.0, 10.0], [0.0, 10.0], [1e-3, 30.0]])
    assert {key: count for key, count in node.counts.items() if count} == {
        "reference: not finite": 2,
        "reference: wrong label": 2,
        "reference: off the clock": 1,
        "reference: out of order": 1,
        "reference: duplicate": 1,
        "reference: conflict": 1,
    }


@pytest.mark.parametrize("objects", [False, True])
def test_messages_of_another_size_than_they_say_are_dropped_and_counted(bench, objects):
    """Layouts that do not fit their data, rows cut short, no layout, no values: as bytes, and as message objects."""
    node = bench.add(Feedforward_named, kind="proportional", gain=[10], message_objects=objects)
    publisher = bench.probe.create_publisher(Float64MultiArray, "reference", QUEUE)
    bench.until(lambda: publisher.get_subscription_count() > 0)
    whole = to_message("t[s],x[um]", np.array([[0.0, 1.0], [PERIOD, 2.0]]))
    short, third, bare, empty = (copy.deepcopy(whole) for _ in range(4))
    short.data = short.data[:3]  # three values, 2 by 2 are announced
    third.layout.dim = [*third.layout.dim, third.layout.dim[0]]
    bare.layout.dim, bare.data = [], bare.data[:1]
    empty.layout.dim, empty.data = [], []
    for message in (short, third, bare, empty, whole):
        publisher.publish(message)
    bench.until(lambda: node.reference.rows.end == 2)
    assert {key: count for key, count in node.counts.items() if count} == {"reference: unreadable": 2, "reference: wrong label": 2}


def Feedforward_named(**options):
    return Feedforward("feedforward", **options)


def test_timer_stale_inputs_take_the_command_to_its_safe_value_and_back_without_a_jump(bench):
    settings = dict(
        schedule="timer", rate_hz=200, kp=1.0, ki=200, upper=50, slew_limit=4000, safe_rate=400, safe_command=[2.0], timeout=0.25
    )
    bench.add(PiFeedback, **settings)
    bench.listen("command")
    senders = {
        topic: bench.sender(topic, label)
        for topic, label in [("reference", "t[s],x[um]"), ("measurement", "t[s],x[um]"), ("feedforward", "t[s],x[V]")]
    }
    period = 1 / 200

    def feed():
        tick = int(time.monotonic() / period)
        measurement = bench.rows("command")[-1, 1] / 8 if bench.heard["command"] else 0.0
        for topic, value in [("reference", 5.0), ("measurement", measurement), ("feedforward", 30.0)]:
            senders[topic].send(np.array([[tick * period, value]]))

    fed = bench.probe.create_timer(period, feed)
    bench.until(lambda: len(bench.rows("command")) and abs(bench.rows("command")[-1, 1] - 40.0) < 0.1)
    fed.cancel()
    before = len(bench.rows("command"))
    bench.until(lambda: bench.rows("command")[-1, 1] == 2.0)
    after = len(bench.rows("command"))
    fed.reset()
    bench.until(lambda: abs(bench.rows("command")[-1, 1] - 40.0) < 0.1)
    command = bench.rows("command")
    ticks = np.rint(command[:, 0] / period)
    assert np.all(np.diff(np.rint(ticks)) >= 1)
    slope = np.abs(np.diff(command[:, 1])) / period
    assert slope.max() <= 4000 * (1 + 1e-9)
    assert np.diff(command[before:after, 1]).min() >= -400 * period * (1 + 1e-9)
    assert command[:, 1].max() <= 50.0


def test_stop_service_ramps_down_and_reset_returns(bench):
    node = bench.add(PiFeedback, feedback=False, upper=50, start="first_command", safe_rate=1000, safe_command=[1])
    bench.listen("command")
    sender = bench.sender("feedforward", "t[s],x[V]")
    bench.until(lambda: node.command.publisher.get_subscription_count() > 0)
    sender.send(row(0, 4.5))
    bench.until(lambda: len(bench.rows("command")) == 1)
    assert bench.call(Trigger, "pi_feedback/stop", Trigger.Request()).success
    for tick in range(1, 6):
        sender.send(row(tick, 4.5))
    bench.until(lambda: len(bench.rows("command")) == 6)
    np.testing.assert_allclose(bench.rows("command")[:, 1], [4.5, 3.5, 2.5, 1.5, 1.0, 1.0])


def test_timer_loop_runs_on_the_clock_that_all_share(bench, tmp_path):
    common = dict(schedule="timer", rate_hz=200, timeout=1.0)
    bench.listen("measurement")
    begin = time.monotonic() - 1.0 / 200.0
    nodes = [
        bench.add(ReferenceGenerator_of(np.full((10, 1), 3.0)), lead=4, **common),
        bench.add(Feedforward_named, kind="proportional", gain=[10], **common),
        bench.add(PiFeedback, feedback=True, upper=100, **common),
        bench.add(PlantNode, model=MODEL, **common),
        bench.add(Recorder, output=str(tmp_path / "bag"), **common),
    ]
    bench.until(lambda: len(rows := bench.rows("measurement")) > 120 and rows[-1, 1] > 1.0)  # after all have found each other
    for node in nodes:
        node.close()
    measurement = bench.rows("measurement")
    ticks = measurement[:, 0] * 200
    np.testing.assert_allclose(ticks, np.rint(ticks), atol=1e-6)
    assert begin <= measurement[0, 0] and measurement[-1, 0] < time.monotonic() + 1.0 / 200.0
    assert np.all(np.diff(np.rint(ticks)) >= 1)


def test_diagnostics_tell_rate_drops_and_saturation(bench):
    bench.add(PiFeedback, feedback=False, upper=5, start="first_command")
    heard = []
    bench.probe.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 10)
    sender = bench.sender("feedforward", "t[s],x[V]")
    sender.send(row(0, 7.0))
    sender.send(row(1, np.nan))

    def told():
        return {value.key: value.value for message in heard for status in message.status for value in status.values}

    bench.until(lambda: told().get("saturated samples") == "1" and told().get("feedforward: not finite") == "1")
    assert told()["schedule"] == "lockstep" and {"rate [Hz]", "jitter [us]", "stale", "age of feedforward [s]"} <= set(told())
    assert heard[-1].status[0].name == "/pi_feedback: loop"


def ReferenceGenerator_of(signal):
    return lambda **options: ReferenceGenerator(signal=signal, **options)


@pytest.mark.parametrize(
    "kind, settings, words",
    [
        (PlantNode, {}, "plant"),
        (PlantNode, {"model": "nowhere.yaml"}, "nowhere.yaml"),
        (PlantNode, {"plant": "pea", "effects": "delay"}, r"plant: effects: must be a list .*, got 'delay'"),
        (PlantNode, {"plant": "pea", "effects": "[{name: dealy}]"}, "'dealy' is unknown"),
        (PlantNode, {"plant": "pea", "parameters": "{color: 1}"}, "parameters.color"),
        (PlantNode, {"model": MODEL, "parameters": "{noise: 0.0}"}, "write them into the model file"),
        (PlantNode, {"model": MODEL, "axes": ["x", "y"]}, "axes"),
        (PiFeedback, {"upper": -1.0}, "upper"),
        (PiFeedback, {"kp": "fast"}, "kp"),
        (PiFeedback, {"kp": -1}, "kp"),
        (Recorder, {}, "output"),
        (PiFeedback, {"schedule": "sometimes"}, "lockstep"),
        (ReferenceGenerator, {"signal": "nowhere.npy"}, "nowhere.npy"),
        (
            ReferenceGenerator,
            {"signal": "rest", "duration": 0.1, "offset": 90.0, "model": MODEL},
            "cannot be reached with 0 to 50 V",
        ),
    ],
)
def test_bad_parameters_are_refused_in_one_line(ros_context, kind, settings, words):
    with pytest.raises(InputError, match=words) as caught:
        kind(context=ros_context, parameter_overrides=[Parameter(key, value=value) for key, value in settings.items()])
    assert "\n" not in str(caught.value)


def test_the_truth_plant_is_parametrised_by_ros_parameters(bench):
    """Effects and single physical parameters; without them it is the one of the file."""
    own = {"parameters": "{noise: 0.0, amplifier_cutoff: 500.0}", "effects": "[{name: offset, offset: 3.0, from: 0.01}]"}
    rows = np.full((400, 1), 20.0)
    expected = load_plant(
        {"plant": "pea", "effects": [{"name": "offset", "offset": 3.0, "from": 0.01}]},
        seed=4,
        sample_time=5e-5,
        noise=0.0,
        amplifier_cutoff=500.0,
    )
    bench.listen("measurement")
    node = bench.add(PlantNode, plant="pea", seed=4, rate_hz=20000.0, start="first_command", **own)
    sender = bench.sender("command", "t[s],x[V]")
    bench.until(lambda: node.measurement.publisher.get_subscription_count() > 0)
    sender.send(np.column_stack([np.arange(400) * 5e-5, rows]))
    bench.until(lambda: len(bench.rows("measurement")) >= 401)
    first = expected.reset(rows[0])
    np.testing.assert_array_equal(bench.rows("measurement")[:401, 1:], np.concatenate([first[None], expected.step(rows)]))


def test_commands_that_were_there_before_a_plant_of_the_timer_take_it_nowhere(bench):
    """Restarted beside a running loop: it has the time of the clock, not that of the rows that wait for it."""
    node = bench.add(PlantNode, model=MODEL, schedule="timer", rate_hz=200.0)
    now = round(time.monotonic() * 200.0)
    node.timer.clocks.look_at(now / 200.0, 1.0)  # as at a tick
    node.command.receive("t[s],x[V]", np.column_stack([np.arange(now, now + 100) / 200.0, np.full(100, 5.0)]))
    bench.until(lambda: node.counts["ticks"] >= 10)
    assert now <= node._tick <= time.monotonic() * 200.0 + 1.0


def test_live_change_is_checked_and_applied_and_the_rest_is_read_only(bench):
    node = bench.add(PiFeedback, max_timeout=2.0)

    def change(name, value):
        return node.set_parameters([Parameter(name, value=value)])[0]

    assert change("timeout", 1).successful and node.settings.timeout == 1.0
    assert not change("timeout", -1.0).successful and node.settings.timeout == 1.0
    assert not change("timeout", "soon").successful
    assert change("kp", 3.0).successful and not change("kp", -1.0).successful
    assert "read-only" in change("axes", ["x"]).reason


def test_bad_parameter_of_a_process_gives_one_line_and_status_2(tmp_path, domain):
    with Processes(tmp_path, domain) as processes:
        processes.start("plant", {"model": "nowhere.yaml"})
        with pytest.raises(InputError, match=r"plant ended with status 2: plant: nowhere\.yaml"):
            processes.wait("plant", timeout=60)


def test_killed_feedforward_and_feedback_cost_time_only(tmp_path, domain, capfd):
    """kill -9 in a run under way, then a new process: the run goes on to its end; rows that died with a node are named."""
    count = 2400
    settings = parameters(tmp_path, count, plant={"retry": 0.1}, recorder={"merge": 64})
    victims = ["hampi_feedforward", "pi_feedback", "reference_generator"]
    with ProcessesBesideThread(tmp_path / "log", domain) as processes:
        processes.compose({name: own for name, own in settings.items() if name not in victims})
        for name in victims:
            processes.start(name, settings[name])
        bag = tmp_path / "bag" / "bag_0.mcap"
        for number, victim in enumerate(victims):
            grown = (number + 1) * 30_000
            end = time.monotonic() + 60
            while not (bag.exists() and bag.stat().st_size > grown):
                assert time.monotonic() < end and processes.running["pipeline"].poll() is None
                time.sleep(0.02)
            processes.running[victim].kill()
            processes.running[victim].wait()
            processes.start(victim, settings[victim])
        processes.wait("pipeline", timeout=60)
    told = capfd.readouterr().err
    assert "[recorder]: ready" in told
    for topic, rows in recorded(tmp_path / "bag").items():
        ticks = np.rint(rows[:, 0] * RATE)
        assert ticks[0] == 0 and ticks[-1] == count - 1
        assert np.all(np.diff(np.rint(ticks)) >= 1)
        assert np.all(np.diff(ticks) == 1) or topic != "measurement" and f"/{topic}: ticks" in told


def until_it_spins(processes, name):
    """Its handler of signals is older: it says that it is ready from within its first spinning."""
    end = time.monotonic() + 60.0
    while "ready: " not in processes.log(name).read_text():
        assert time.monotonic() < end and processes.running[name].poll() is None
        time.sleep(0.01)


def test_interrupt_and_terminate_end_a_node_without_a_traceback(tmp_path, domain):
    for name, number, own in (("pi_feedback", 2, {}), ("hampi_feedforward", 15, {"kind": "proportional"})):
        with Processes(tmp_path / name, domain) as processes:
            process = processes.start(name, own)
            until_it_spins(processes, name)
            process.send_signal(number)
            assert process.wait(30) == 0
            assert "Traceback" not in processes.log(name).read_text()


SWALLOWED = """
import signal
from hyst_control.nodes.pi_feedback import PiFeedback
from hyst_control.nodes.execution.run import main

def make():
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        pass
    return PiFeedback()

raise SystemExit(main(make))
"""


STUCK = """
import ctypes
from functools import partial
from hyst_control.nodes.execution import run
from hyst_control.nodes.recorder import Recorder

run.exit_within = partial(run.exit_within, seconds=1.0)  # instead of 5

class Stuck(Recorder):
    def destroy_node(self):
        print("stuck", flush=True)
        ctypes.PyDLL(None).sleep(1000)  # holds the interpreter's lock, as the middleware's call does

raise SystemExit(run.main(Stuck))
"""


def test_middleware_that_never_comes_back_does_not_keep_a_node_from_ending(tmp_path, domain, monkeypatch):
    (tmp_path / "stuck.py").write_text(STUCK)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}:{config_folders()[0].parent}")
    with Processes(tmp_path / "log", domain) as processes:
        process = processes.run("stuck", "stuck", "--ros-args", "-p", f"output:={tmp_path / 'bag'}", "-p", "duration:=0.1")
        assert process.wait(40) == 0
        lines = processes.log("stuck").read_text().splitlines()
        assert lines[-1] == "stuck" and all(line.startswith(("[INFO]", "[WARN]")) for line in lines[:-1])  # what it has recorded
    assert (tmp_path / "bag" / "metadata.yaml").exists()


@pytest.mark.parametrize("status", [0, 3])
def test_exit_watchdog_keeps_the_status_while_the_interpreter_is_locked(status):
    """The lock is held by a call that does not come back: no Python code could end the process."""
    program = (
        "import ctypes\n"
        "from hyst_control.nodes.execution.exit_watchdog import exit_within\n"
        f"exit_within({status}, 0.2)\n"
        "ctypes.PyDLL(None).sleep(1000)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], timeout=60, capture_output=True)
    assert (ended.returncode, ended.stdout, ended.stderr) == (status, b"", b"")


def test_a_row_without_a_time_does_not_end_the_recorder(bench, tmp_path):
    """A NaN as a value is evidence and stored; as a time it is no tick."""
    node = bench.add(Recorder, output=str(tmp_path / "bag"), topics=["command"], rate_hz=1 / PERIOD)
    [command] = node._topics
    for time_of_row in (0.0, np.nan, PERIOD):
        command.receive("t[s],x[V]", np.array([[time_of_row, np.nan]]))
    node.close()
    assert node.counts["/command: off the clock"] == 1
    np.testing.assert_array_equal(recorded(tmp_path / "bag")["command"], [[0.0, np.nan], [PERIOD, np.nan]])


def test_interrupt_that_a_library_swallows_ends_the_node_all_the_same(tmp_path, domain, monkeypatch):
    (tmp_path / "swallowed.py").write_text(SWALLOWED)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}:{config_folders()[0].parent}")
    with Processes(tmp_path / "log", domain) as processes:
        process = processes.run("swallowed", "swallowed")
        assert process.wait(30) == 0, processes.log("swallowed").read_text()
