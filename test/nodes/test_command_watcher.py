# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The command, whatever happens: an independent watcher sees every row, on the wall clock and in lockstep, to the last one."""

from __future__ import annotations

import re
import signal
import time

import numpy as np
import pytest
from command_watcher import CommandWatcher
from loop_case import MODEL, RUNNING, recorded
from pipeline_thread import ProcessesBesideThread
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_srvs.srv import SetBool

from hyst_control.control.feedback.sensor_watch import FROZEN, TURNED
from hyst_control.nodes import reference_generator
from hyst_control.nodes.execution.run import spin
from hyst_control.nodes.feedforward import Feedforward
from hyst_control.nodes.pi_feedback import NOT_FOLLOWED, RIVAL, PiFeedback
from hyst_control.nodes.recorder import Recorder
from hyst_control.nodes.reference_generator import ReferenceGenerator
from hyst_control.nodes.signal_node.message_io import Sender
from hyst_control.records.stream import row_repetition
from hyst_plant_sim.node import PlantNode

pytestmark = pytest.mark.long_file

RATE = 200.0
PERIOD = 1 / RATE
LOWER, UPPER, SLEW, SAFE_RATE, SAFE, PLANT_SAFE = 0.0, 50.0, 400.0, 200.0, 2.0, 1.0  # V, V/s
GAIN = 8.0  # V/um
TOPICS = ("reference", "feedforward", "measurement", "command")


class Stage:
    """A stage that moves by 1 um for 8 V, whose sensors may make something else of the positions."""

    def __init__(self, axes, pace):
        self.axes = ("x", "y")[:axes]
        self.sensors, self._pace = {}, pace
        self.voltages = []
        """What was on the actuator, tick by tick."""

    def reset(self, command):
        return self._measured(np.asarray(command, dtype=float)[None])[0]

    def step(self, commands):
        time.sleep(self._pace)  # in lockstep as fast as the watcher reads
        self.voltages.extend(commands[:, 0])
        return self._measured(commands)

    def _measured(self, commands):
        rows = commands / GAIN
        for axis, sensor in self.sensors.items():
            rows[:, axis] = sensor(rows[:, axis])
        return rows


class Loop:
    """Reference, feedforward, feedback, stage and recorder on one executor, and the watcher beside them."""

    def __init__(self, bench, domain, schedule, folder, axes=1, **changes):
        self.bench, self.schedule, self.axes = bench, schedule, axes
        self.common = dict(schedule=schedule, rate_hz=RATE, axes=["x", "y"][:axes], timeout=0.25)
        self.stage = Stage(axes, 0.0 if schedule == "timer" else 0.001)
        self.limits = changes.pop("lower", LOWER), changes.pop("upper", UPPER)
        self.watcher = CommandWatcher(domain, PERIOD, *self.limits, SLEW * PERIOD)
        ticks = np.arange(400) * PERIOD
        reference = np.repeat((5.1 + 0.5 * np.sin(2 * np.pi * 2.0 * ticks))[:, None], axes, axis=1)
        bench.listen_to_diagnostics()
        self.generating = {"repeat": True, "lead": 4, "ramp_time": 0.4}
        self.generator = bench.add(
            lambda **options: ReferenceGenerator(signal=reference, **options), **self.generating, retry=0.05, **self.common
        )
        self.feedforward = bench.add(lambda **options: Feedforward("feedforward", **options), gain=[GAIN], **self.common)
        self.settings = {
            "kp": 0.5,
            "ki": 100.0,
            "lower": self.limits[0],
            "upper": self.limits[1],
            "slew_limit": SLEW,
            "safe_rate": SAFE_RATE,
            "safe_command": [max(SAFE, self.limits[0])],
            "frozen_time": 0.1,
            **self.common,
            **changes,
        }
        self.feedback = bench.add(PiFeedback, **self.settings)
        self.add_plant()
        self.recorder = bench.add(Recorder, output=str(folder / "bag"), **self.common)

    def add_plant(self):
        self.plant = self.bench.add(
            lambda **options: PlantNode(plant=self.stage, **options),
            safe_command=[PLANT_SAFE],
            safe_rate=SAFE_RATE,
            retry=0.05,
            **self.common,
        )

    def until(self, condition, timeout=30.0):
        """Looks from within the executor, which in lockstep always has something to do and would not come back by itself."""
        met, end = Future(), time.monotonic() + timeout

        def look():
            if not met.done() and (condition() or time.monotonic() > end):
                met.set_result(None)

        timer = self.bench.probe.create_timer(0.005, look)
        spin(self.bench.executor, met)
        self.bench.probe.destroy_timer(timer)
        assert time.monotonic() <= end, "condition not met in time"

    def go_on(self, rows=60):
        """Until so many further rows were published."""
        count = len(self.watcher.command())
        self.until(lambda: len(self.watcher.command()) >= count + rows)

    def tracks(self):
        last = self.watcher.last
        return last is not None and min(last) > 36.0

    def safe(self):
        return self.watcher.last == (max(SAFE, self.limits[0]),) * self.axes

    def says(self, text):
        return self.bench.says("pi_feedback", text)

    def runs(self):
        """No fault: "running", or on a machine that is busy with others the ticks that were missed."""
        return self.says("running") or self.says("ticks missed")

    def sender(self, topic):
        unit = "V" if topic in ("command", "feedforward") else "um"
        sender = Sender(self.bench.probe, topic, ",".join(["t[s]", *(f"{axis}[{unit}]" for axis in ("x", "y")[: self.axes])]))
        self.until(lambda: sender.publisher.get_subscription_count() > 1)
        return sender

    def now(self):
        """Time of the tick that is due, by the schedule's clock."""
        return round(time.monotonic() / PERIOD) * PERIOD if self.schedule == "timer" else self.watcher.command()[-1][0] * PERIOD

    def close(self):
        self.recorder.close()
        self.watcher.close()


@pytest.fixture(params=["timer", "lockstep"])
def loop(request, bench, domain, tmp_path):
    loops = []

    def make(until=Loop.tracks, **changes):
        loops.append(Loop(bench, domain, request.param, tmp_path, **changes))
        loops[0].until(lambda: until(loops[0]))
        return loops[0]

    try:
        yield make
    finally:
        for each in loops:
            each.close()


def test_times_that_are_none_pass_by(loop, tmp_path):
    loop = loop()
    senders = {topic: loop.sender(topic) for topic in TOPICS}
    for moment in (1e306, 1e300, 1e18, float("nan"), float("inf"), -1.0, 2.0**60):
        for sender in senders.values():
            sender.send(np.array([[moment, 30.0]]))
            sender.send(np.array([[moment, 30.0], [moment + PERIOD, 30.0], [float("nan"), 1.0]]))
    loop.until(lambda: all(signal.owner_drops() for signal in map(Dropped, (loop.feedback, loop.plant, loop.recorder))))
    loop.watcher.foreign.update({(30.0,), (1.0,)})
    loop.go_on()
    loop.until(loop.tracks)
    loop.watcher.check()
    loop.recorder.close()
    times = recorded(tmp_path / "bag")["command"][:, 0]
    assert len(times) > 60 and np.isfinite(times).all() and np.all(np.diff(times) > 0)


class Dropped:
    """Whether a node has dropped as many messages as were sent to it."""

    def __init__(self, node):
        self.node = node

    def owner_drops(self):
        kinds = (
            ": not finite",
            ": off the clock",
            ": out of range",
            ": far ahead",
            ": duplicate",
            ": late",
            ": time ran backwards",
        )
        return sum(count for key, count in self.node.counts.items() if key.endswith(kinds)) >= 13


@pytest.mark.parametrize("value", [1.7e308, -1.7e308, 9.9e11])
def test_reference_of_any_size_leaves_the_command_finite(loop, value):
    loop = loop(kp=5.0, ki=1e5)
    sender = loop.sender("reference")
    for _ in range(3):
        sender.send(np.array([[loop.now() + 5 * PERIOD, value]]))
        loop.go_on(20)
    loop.until(loop.tracks)
    loop.watcher.check()
    if abs(value) > 1e12:
        assert loop.feedback.counts["reference: out of range"] == 3 == loop.feedforward.counts["reference: out of range"]


@pytest.mark.parametrize("reaction", ["all", "own"])
def test_sensor_that_hangs_beside_a_live_one_takes_its_axis_to_safety(loop, reaction):
    loop = loop(axes=2, axis_fault=reaction)
    loop.stage.sensors[0] = lambda positions: 4.0
    loop.until(lambda: loop.watcher.last[0] == SAFE)
    loop.until(lambda: loop.says("x: measurement frozen"))
    loop.go_on()
    if reaction == "own":
        assert loop.watcher.last[0] == SAFE and loop.watcher.last[1] > 30.0
    else:
        loop.until(loop.safe)
    loop.stage.sensors.clear()
    loop.until(loop.tracks)
    loop.until(loop.runs)
    loop.watcher.check()


def flickering(positions, random=np.random.default_rng(0)):  # noqa: B008 one generator of all calls
    return 4.0 + 1e-4 * random.integers(0, 2, len(positions))


@pytest.mark.parametrize(("sensor", "fault"), [(flickering, FROZEN), (np.negative, TURNED)])
def test_sensor_that_does_not_follow_or_turns_takes_the_loop_to_safety(loop, sensor, fault):
    loop = loop(upper=60.0)  # which leaves the command some way to run away
    loop.go_on(200)
    loop.stage.sensors[0] = sensor
    loop.until(lambda: fault in loop.feedback.loop.faults.present)
    loop.until(loop.safe)
    loop.until(lambda: loop.says(fault))
    loop.go_on()
    assert loop.safe()
    loop.stage.sensors.clear()
    loop.until(loop.tracks)
    loop.until(loop.runs)
    loop.watcher.check()


def test_a_reference_that_is_too_steep_is_told_once(loop):
    """By the feedforward of itself, by the feedback of what it asks for: with the time and the slope."""
    loop = loop()
    told = []
    loop.feedforward.settings.slew_limit = SLEW
    loop.feedforward.warn = loop.feedback.warn = lambda key, text: told.append(text) if key == "slope" else None
    for level in (5.9, 5.0, 5.9):
        loop.generator._signal.replace(np.full((400, 1), level), loop.generator._sent_rows, 1)
        loop.go_on(60)
    assert len(told) == 2 and all(re.search(r"asks for \S+ V/s at \S+ s, slew_limit is 400 V/s", text) for text in told)
    assert loop.feedback.counts["slope above slew_limit"] == loop.feedforward.counts["slope above slew_limit"] == 1
    loop.watcher.check()


def test_reference_started_again_begins_at_rest_where_the_stage_is(bench, domain, tmp_path, monkeypatch):
    loop = Loop(bench, domain, "timer", tmp_path, safe_command=[20.0])
    try:
        loop.until(loop.tracks)
        monkeypatch.setattr(loop.generator, "tick", lambda tick: None)  # as if it were killed
        loop.until(lambda: loop.watcher.last == (20.0,) and loop.plant.measurement.sent.newest[0, 1] == 20.0 / GAIN)
        bench.listen("reference")
        ticks = np.arange(400) * PERIOD
        wanted = (5.1 + 0.5 * np.sin(2 * np.pi * 2.0 * ticks))[:, None]
        bench.add(lambda **options: ReferenceGenerator(signal=wanted, **options), **loop.generating, **loop.common)
        loop.until(lambda: len(bench.rows("reference")) > 40)
        begun = bench.rows("reference")[:, 1]
        assert abs(begun[0] - 20.0 / GAIN) < 0.05 and np.abs(np.diff(begun)).max() < 0.4
        loop.until(loop.tracks)
        loop.watcher.check()
        assert not loop.feedback.counts["slope above slew_limit"]
    finally:
        loop.close()


def test_feedback_started_again_takes_over_from_what_is_applied(loop, monkeypatch):
    for module, name, value in (
        (row_repetition, "KEPT_ROWS", 32),
        (row_repetition, "KEPT_BLOCKS", 2),
        (reference_generator, "KEPT_ROWS", 32),
    ):
        monkeypatch.setattr(module, name, value)
    loop = loop()
    loop.go_on(100)
    for name in ("advance", "tick", "repeat"):  # it hears nothing and says nothing any more, as if it were killed
        monkeypatch.setattr(loop.feedback, name, lambda *_: None)
    count = len(loop.watcher.command())
    loop.feedback = loop.bench.add(PiFeedback, **loop.settings)
    loop.until(lambda: len(loop.watcher.command()) > count)
    loop.go_on(100)
    loop.until(loop.tracks)
    loop.watcher.check()
    if loop.schedule == "lockstep":  # nothing moves while no command comes: the run goes on as if nothing had been
        assert np.all(np.diff([tick for tick, _ in loop.watcher.command()]) == 1)


def test_plant_started_again_beside_a_running_loop_goes_on_with_it(loop, monkeypatch):
    loop = loop()
    for _ in range(3):
        for name in ("advance", "tick", "_confirm"):  # as if it were killed
            monkeypatch.setattr(loop.plant, name, lambda *_: None)
        loop.add_plant()
        loop.go_on()
        loop.until(loop.tracks)
    loop.watcher.check()


def test_limits_that_a_peer_wants_wider_hold(loop):
    loop = loop()
    before = dict(vars(loop.feedback.settings))
    for name, value in (("upper", 1e6), ("lower", -1e6), ("slew_limit", 0.0), ("timeout", 1000.0), ("safe_rate", 1e-6)):
        assert not loop.feedback.set_parameters([Parameter(name, value=value)])[0].successful
    sender = loop.sender("reference")
    for _ in range(3):
        sender.send(np.array([[loop.now() + 5 * PERIOD, 1e6]]))
        loop.go_on(20)
    assert vars(loop.feedback.settings) == before
    loop.until(loop.tracks)
    loop.watcher.check()


@pytest.mark.parametrize("how", ["stop", "deactivate"])
def test_stage_stopped_alone_is_tracked_and_goes_on_without_a_jump(loop, how):
    """In lockstep the run stands still meanwhile: nothing can wind up."""
    loop = loop()
    loop.plant._stop() if how == "stop" else loop.plant.trigger_deactivate()
    if loop.schedule == "timer":
        loop.until(lambda: loop.watcher.applied and loop.watcher.applied[-1] == (PLANT_SAFE,))
        loop.until(lambda: loop.says(NOT_FOLLOWED))
        loop.go_on(150)
        assert all(abs(values[0] - PLANT_SAFE) < 0.5 for _, values in loop.watcher.command()[-100:])
    else:
        looks = [-1]

        def stands_still():
            looks.append(loop.plant._tick)
            return len(looks) > 100 and looks[-100] == looks[-1]

        loop.until(stands_still)
    ticks = len(loop.stage.voltages)
    if how == "stop":
        loop.bench.probe.create_client(SetBool, "/plant/enable").call_async(SetBool.Request(data=True))
    else:
        loop.plant.trigger_activate()
    loop.until(lambda: len(loop.stage.voltages) > ticks + 200)
    loop.until(loop.tracks)
    loop.until(loop.runs)
    on_it = np.array(loop.stage.voltages[ticks - 100 :])
    assert np.abs(np.diff(on_it)).max() <= SLEW * PERIOD * (1 + 1e-9)
    assert on_it.max() < 46.0, "what the reference asks for, and no more"
    loop.watcher.check()


@pytest.mark.parametrize("limits", [(20.0, 80.0), (-80.0, -20.0)])
def test_limits_that_leave_0_out_hold_from_the_first_row_on(loop, limits):
    loop = loop(until=lambda loop: len(loop.watcher.command()) > 40, lower=limits[0], upper=limits[1])
    loop.watcher.check()


PROCESSES = {
    "reference_generator": {
        "signal": "sine",
        "amplitude": 0.5,
        "frequency": 2.0,
        "offset": 5.1,
        "repeat": True,
        "duration": 2.0,
        "lead": 4,
    },
    "hampi_feedforward": {"kind": "proportional", "gain": [GAIN]},
    "plant": {"model": MODEL, "safe_command": [PLANT_SAFE], "safe_rate": SAFE_RATE, "retry": 0.05},
}
FEEDBACK = {
    "kp": 0.2,
    "ki": 20.0,
    "lower": LOWER,
    "upper": UPPER,
    "slew_limit": SLEW,
    "safe_rate": SAFE_RATE,
    "safe_command": [SAFE],
    "frozen_time": 0.0,
}


def wait(condition, processes, timeout=60.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "condition not met in time"
        processes.check()
        time.sleep(0.01)


def wait_for_commands(run, watcher, processes):
    """Wait for the commands of this run of the feedback: those of the one before may still be on their way when it starts."""
    log = processes.log("pi_feedback")
    said = re.compile(rf"\]: {RUNNING}$", re.MULTILINE)
    wait(lambda: said.search("".join(log.read_text().split("]: ready: ")[run : run + 1])), processes)
    count = len(watcher.command())
    wait(lambda: len(watcher.command()) > count + 60 and watcher.last[0] > 25.0, processes)


def test_feedback_that_ends_leaves_nothing_behind(tmp_path, domain):
    """By SIGTERM it brings the actuator to its safe value itself; after SIGKILL the watchdog does; it starts again; at last SIGINT.

    In lockstep `test_faults` kills it.
    """
    common = {"schedule": "timer", "rate_hz": RATE, "timeout": 0.25}
    watcher = CommandWatcher(domain, PERIOD, LOWER, UPPER, SLEW * PERIOD)
    try:
        with ProcessesBesideThread(tmp_path / "log", domain) as processes:
            processes.compose({name: {**own, **common} for name, own in PROCESSES.items()})
            for run, number in enumerate((signal.SIGTERM, signal.SIGKILL), 1):
                feedback = processes.start("pi_feedback", {**FEEDBACK, **common})
                wait_for_commands(run, watcher, processes)
                feedback.send_signal(number)
                status = feedback.wait(20)
                if number == signal.SIGKILL:
                    assert status == -signal.SIGKILL
                    del processes.running["pi_feedback"]
                    wait(lambda: watcher.applied and watcher.applied[-1] == (PLANT_SAFE,), processes)
                else:
                    assert status == 0 and "Traceback" not in processes.log("pi_feedback").read_text()
                    wait(lambda: watcher.last == (SAFE,), processes)
            processes.start("pi_feedback", {**FEEDBACK, **common})
            wait_for_commands(3, watcher, processes)
            assert set(processes.stop().values()) == {0}
            assert "Traceback" not in processes.log("pi_feedback").read_text()
            wait(lambda: watcher.last == (SAFE,), processes)  # what was sent last may still be on its way to the watcher
        watcher.check()
        values = [row[0] for row in watcher.applied]
        assert max(np.abs(np.diff(values)), default=0.0) <= SLEW
    finally:
        watcher.close()


@pytest.mark.parametrize("reaction", ["safe", "silent", "warn"])
def test_rival_on_the_command_is_a_fault(loop, reaction):
    loop = loop(rival=reaction)
    sender = loop.sender("command")
    loop.watcher.foreign.add((9.123,))
    swinging = loop.bench.probe.create_timer(0.01, lambda: sender.send(np.array([[loop.now() + PERIOD, 9.123]])))
    loop.until(lambda: loop.says("several sources") or loop.says(RIVAL) or reaction == "warn")
    if reaction == "safe":
        loop.until(lambda: loop.safe())
        loop.until(lambda: loop.says(RIVAL))
    elif reaction == "silent":
        loop.until(lambda: loop.feedback._waiting)
        last = round(loop.now() / PERIOD) if loop.schedule == "timer" else loop.feedback.measurement.rows.start
        loop.until(lambda: loop.says(RIVAL))
        assert max(tick for tick, _ in loop.watcher.command()) <= last  # rows sent before may come late, or again
    else:
        loop.go_on(10)
        # The plant, which two contradict, goes to its safe value: that the measurement does not follow is another fault, and true.
        assert RIVAL not in loop.feedback.loop.faults.present
    swinging.cancel()
    loop.bench.probe.destroy_publisher(sender.publisher)
    loop.until(loop.tracks)
    loop.until(loop.runs)
    loop.go_on(20)
    loop.watcher.check()


@pytest.mark.parametrize("ahead", [1, 2, 5])
def test_loop_goes_on_at_the_tick_that_the_plant_waits_for(bench, domain, tmp_path, ahead):
    """A rival has advanced the plant by some ticks; then the feedback computes the command that the plant needs next."""
    loop = Loop(bench, domain, "lockstep", tmp_path, rival="silent")
    try:
        loop.until(loop.tracks)
        sender = loop.sender("command")
        loop.watcher.foreign.add((9.123,))
        sent = {}  # the same rows until the feedback has begun anew

        def rows():
            first = sent.setdefault("first", round(loop.now() / PERIOD) + 1)
            return np.array([[(first + row) * PERIOD, 9.123] for row in range(ahead)])

        def swing():
            if not loop.feedback._waiting:
                sent.clear()
            sender.send(rows())

        swinging = bench.probe.create_timer(0.01, swing)
        loop.until(lambda: loop.feedback._waiting and loop.says(RIVAL))
        swinging.cancel()
        bench.probe.destroy_publisher(sender.publisher)
        loop.until(loop.runs)
        loop.until(loop.tracks)
        loop.go_on(20)
        loop.watcher.check()
    finally:
        loop.close()


def test_second_feedback_waits_while_the_first_one_runs(loop):
    loop = loop(rival="warn")
    second = loop.bench.add(lambda **options: PiFeedback("second", **options), **{**loop.settings, "rival": "safe"})
    loop.until(lambda: loop.bench.says("second", RIVAL))
    assert second._newest is None
    loop.until(lambda: all(signal.rows.joined for signal in second.inputs))
    loop.go_on()
    if loop.schedule == "lockstep":  # rows that the first feedback has answered are dropped
        assert max(signal.rows.available for signal in second.inputs) < 20
    loop.until(loop.tracks)
    loop.watcher.check()


def test_plant_brings_the_actuator_to_safety_while_two_commands_contradict(bench, domain, tmp_path):
    """Whatever the feedback does: here it only warns."""
    loop = Loop(bench, domain, "timer", tmp_path, rival="warn")
    try:
        loop.until(loop.tracks)
        sender = loop.sender("command")
        loop.watcher.foreign.add((9.123,))
        swinging = bench.probe.create_timer(0.01, lambda: sender.send(np.array([[loop.now(), 9.123]])))
        loop.until(lambda: loop.watcher.applied and loop.watcher.applied[-1] == (PLANT_SAFE,))
        loop.until(
            lambda: loop.bench.says("plant", "no trusted command: the actuator goes to its safe value, or back to the command")
        )
        swinging.cancel()
        loop.until(lambda: loop.plant._actuator.watchdog.following)
        applied = np.array(
            [[tick, *values] for topic, tick, values in loop.watcher.rows if topic == "applied" and tick is not None]
        )
        falling = applied[: np.flatnonzero(applied[:, 1] == PLANT_SAFE)[0] + 1]
        falling = falling[np.argmax(falling[:, 1]) :]  # from the highest that was heard: on a busy machine not from the beginning
        slope = np.diff(falling[:, 1]) / np.diff(falling[:, 0]) / PERIOD
        assert len(slope) > 5 and slope.min() >= -SAFE_RATE * (1 + 1e-6)
    finally:
        loop.close()


def test_command_of_the_far_future_passes_by(loop):
    loop = loop()
    sender = loop.sender("command")
    loop.watcher.foreign.add((17.0,))
    sender.send(np.array([[loop.now() + 10000.0, 17.0]]))
    loop.until(lambda: loop.plant.counts["command: far ahead"] + loop.plant.counts["command: out of order"] >= 1)
    loop.bench.probe.destroy_publisher(sender.publisher)
    loop.go_on()
    loop.until(loop.tracks)
    loop.until(loop.runs)
    assert loop.plant.command.rows.behind(round(loop.now() / PERIOD)) < 20 or loop.schedule == "lockstep"
    loop.watcher.check()


def test_measurements_that_are_old_on_arrival_are_a_fault(bench, domain, tmp_path):
    """Two seconds on the way, without a gap between them. In lockstep there is no clock that they could be late by."""
    loop = Loop(bench, domain, "timer", tmp_path)
    try:
        loop.until(loop.tracks)
        send = loop.plant.measurement.send
        loop.plant.measurement.send = lambda tick, rows: send(tick - round(2.0 / PERIOD), rows)
        loop.go_on(5)
        loop.feedback.measurement.forget()  # as of a source that has been late since its start
        loop.until(loop.safe)
        loop.until(lambda: loop.says("measurement older than 0.25 s"))
        loop.plant.measurement.send = send
        loop.until(loop.tracks)
        loop.watcher.check()
    finally:
        loop.close()
