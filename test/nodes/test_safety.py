"""Every fault of the loop: it shows in the diagnostics, takes the command to its safe value, and the way back has no jump."""

from __future__ import annotations

import time

import numpy as np
import pytest
from loop_case import MODEL
from rclpy.parameter import Parameter
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, Trigger

from hyst_control.control.feedback.sensor_watch import FROZEN, OUT_OF_RANGE, MeasurementWatch
from hyst_control.nodes.execution.run import spin
from hyst_control.nodes.feedforward import Feedforward
from hyst_control.nodes.pi_feedback import PiFeedback
from hyst_control.nodes.reference_generator import ReferenceGenerator
from hyst_plant_sim.node import PlantNode

RATE = 200.0
PERIOD = 1 / RATE
SLEW, SAFE_RATE, SAFE = 2000.0, 400.0, 2.0  # V/s, V/s, V
SETTINGS = dict(
    schedule="timer",
    rate_hz=RATE,
    upper=50.0,
    slew_limit=SLEW,
    safe_rate=SAFE_RATE,
    safe_command=[SAFE],
    timeout=0.25,
    measurement_lower=-1.0,
    measurement_upper=20.0,
    frozen_time=0.1,
)


class Loop:
    """A feedback node on the wall clock, fed with a moving reference and a stage that is command / 8."""

    def __init__(self, bench, **changes):
        self.bench = bench
        self.node = bench.add(PiFeedback, **{**SETTINGS, "kp": 0.5, "ki": 100.0, **changes})
        bench.listen("command")
        bench.listen_to_diagnostics()
        self.senders = {
            topic: bench.sender(topic, label)
            for topic, label in [("reference", "t[s],x[um]"), ("measurement", "t[s],x[um]"), ("feedforward", "t[s],x[V]")]
        }
        self.measure = lambda honest: honest  # what the sensor makes of the position
        self.rival = None  # a second sensor's value
        self.shift = 0  # ticks by which the senders' clock is off
        self.silent = ""  # the signal whose source says nothing any more
        self.last = 0
        self.feeding = bench.probe.create_timer(PERIOD, self.feed)

    def feed(self):
        tick = int(time.monotonic() / PERIOD)
        first, self.last = max(self.last + 1, tick - 3), tick
        for each in range(first, tick + 1):
            position = self.command[-1] / 8 if len(self.command) else 0.0
            wanted = 3.5 + 0.5 * np.sin(2 * np.pi * 2.0 * each * PERIOD)
            now = (each + self.shift) * PERIOD
            for topic, value in [("reference", wanted), ("measurement", self.measure(position)), ("feedforward", 8 * wanted)]:
                if topic != self.silent:
                    self.senders[topic].send(np.array([[now, value]]))
            if self.rival is not None:
                self.senders["measurement"].send(np.array([[now, self.rival]]))

    @property
    def command(self):
        return self.bench.rows("command")[:, 1]

    def tracks(self):
        return len(self.command) and self.command[-1] > 20.0

    def safe(self):
        return len(self.command) and self.command[-1] == SAFE

    def runs(self):
        """No fault: "running", or on a machine that is busy with others the ticks that were missed."""
        return self.bench.says("pi_feedback", "running") or self.bench.says("pi_feedback", "ticks missed")

    def assert_smooth(self):
        rows = self.bench.rows("command")
        ticks = np.rint(rows[:, 0] / PERIOD)
        slope = np.abs(np.diff(rows[:, 1])) / np.diff(ticks) / PERIOD
        assert slope.max() <= SLEW * (1 + 1e-9)
        assert rows[:, 1].min() >= 0 and rows[:, 1].max() <= 50.0

    def assert_ramps_down_from(self, start):
        way = self.command[start:]
        way = way[: np.argmax(way == SAFE) + 1]
        steps = np.diff(way)
        falling = steps[np.argmax(steps < 0) :]
        assert len(falling) and np.all(falling[-10:] >= -SAFE_RATE * PERIOD * (1 + 1e-9))


def frozen(loop):
    held = loop.command[-1] / 8
    loop.measure = lambda honest: held
    return "measurement frozen"


def out_of_range(loop):
    loop.measure = lambda honest: 21.0
    return "measurement out of range"


def below_range(loop):
    loop.measure = lambda honest: -1.5
    return "measurement out of range"


def second_plant(loop):
    loop.rival = 1.0
    return "two sources of measurement"


def clock_set_back(loop):
    loop.shift = -400
    return "no feedforward and no reference and no measurement for 0.25 s"


def goes_silent(topic):
    def stale(loop):
        loop.silent = topic
        return f"no {topic} for 0.25 s"

    stale.__name__ = f"stale_{topic}"
    return stale


def well_again(loop):
    loop.measure, loop.rival, loop.shift, loop.silent = lambda honest: honest, None, 0, ""


@pytest.mark.parametrize(
    "break_it",
    [
        frozen,
        out_of_range,
        below_range,
        second_plant,
        clock_set_back,
        goes_silent("reference"),
        goes_silent("feedforward"),
        goes_silent("measurement"),
    ],
    ids=lambda break_it: break_it.__name__,
)
def test_fault_goes_to_safety_and_back_by_itself(bench, break_it):
    loop = Loop(bench)
    bench.until(loop.tracks)
    start = len(loop.command)
    said = break_it(loop)
    bench.until(loop.safe)
    bench.until(lambda: bench.says("pi_feedback", said))
    loop.assert_ramps_down_from(start)
    well_again(loop)
    bench.until(loop.tracks)
    bench.until(loop.runs)
    assert loop.node.counts["faults"] >= 1
    loop.assert_smooth()


def test_ticks_that_take_too_long_are_a_fault(bench, monkeypatch):
    node = bench.add(PiFeedback, **SETTINGS, overrun_ticks=3, kp=0.5, ki=100.0)
    node.timer.call_instead(None)  # ticked by hand: a node that takes longer than its time leaves none to the test
    node.loop.restart(np.full(1, 30.0), away=False)
    node._waiting = False
    senders = [
        bench.sender(topic, f"t[s],x[{unit}]") for topic, unit in [("reference", "um"), ("measurement", "um"), ("feedforward", "V")]
    ]
    commands = []
    monkeypatch.setattr(node.command, "send", lambda tick, rows: (commands.extend(rows[:, 0]), time.sleep(1.2 * PERIOD)))
    for _ in range(6):
        now = time.monotonic()
        for sender, value in zip(senders, (4.0, 3.75, 30.0)):
            sender.send(np.array([[int(now / PERIOD) * PERIOD, value]]))
        node.timer.call(now)
    assert node.counts["overruns"] >= 4 and node.trouble() == "ticks take longer than their time"
    assert commands[-1] < commands[2] and np.diff(commands).min() >= -SAFE_RATE * PERIOD * 3


@pytest.mark.parametrize("gains", [{}, {"ki": 0.0}, {"feedback": False, "kp": 0.0, "ki": 0.0}])
def test_disabled_and_enabled_again_without_a_jump(bench, gains):
    """With integral action, without, and in open loop, where the way back is at the safe rate."""
    loop = Loop(bench, **gains) if gains.get("feedback", True) else OpenLoop(bench, **gains)
    bench.until(loop.tracks)
    assert bench.call(SetBool, "pi_feedback/enable", SetBool.Request(data=False)).success
    bench.until(loop.safe)
    back = len(loop.command)
    assert bench.call(SetBool, "pi_feedback/enable", SetBool.Request(data=True)).success
    bench.until(loop.tracks)
    loop.assert_smooth()
    if not gains.get("ki", 1.0):
        way = loop.command[back:]
        rising = np.diff(way[: np.argmax(way > 20.0) + 1])
        assert rising.max() <= SAFE_RATE * PERIOD * (1 + 1e-9)


class OpenLoop(Loop):
    def __init__(self, bench, **changes):
        super().__init__(OnlyFeedforward(bench), **changes)
        self.bench = bench


class OnlyFeedforward:
    """The bench, with senders that nobody hears left out."""

    def __init__(self, bench):
        self._bench = bench

    def __getattr__(self, name):
        return getattr(self._bench, name)

    def sender(self, topic, label):
        return self._bench.sender(topic, label) if topic == "feedforward" else Silent()


class Silent:
    def send(self, block):
        pass


def test_manual_recovery_waits_for_reset(bench):
    loop = Loop(bench, recovery="manual", timeout=5.0)  # a busy computer's pause is no second fault
    bench.until(loop.tracks)
    out_of_range(loop)
    bench.until(loop.safe)
    well_again(loop)
    count = len(loop.command)
    bench.until(lambda: len(loop.command) > count + 40)
    assert loop.command[-1] == SAFE
    assert bench.call(Trigger, "pi_feedback/reset", Trigger.Request()).success
    bench.until(loop.tracks)
    loop.assert_smooth()


def test_saturated_drive_is_told(bench):
    loop = Loop(bench, upper=25.0, saturation_time=0.2)
    bench.until(lambda: bench.says("pi_feedback", "saturated"))
    assert loop.command.max() <= 25.0


def test_safe_rate_and_recovery_may_change_while_running_and_the_backend_may_not(bench):
    loop = Loop(bench, min_safe_rate=100.0)
    bench.until(loop.tracks)
    results = loop.node.set_parameters(
        [
            Parameter("safe_rate", value=200),
            Parameter("recovery", value="manual"),
            Parameter("backend", value="c"),
            Parameter("recovery", value="perhaps"),
        ]
    )
    assert [result.successful for result in results] == [True, True, False, False]
    assert "manual" in results[3].reason and "read-only" in results[2].reason
    start = len(loop.command)
    out_of_range(loop)
    bench.until(loop.safe)
    way = loop.command[start:]
    assert np.diff(way)[np.argmax(np.diff(way) < 0) + 5 :].min() >= -200 * PERIOD * (1 + 1e-9)


def test_lost_late_and_repeated_rows_are_counted_apart(bench):
    node = bench.add(lambda **options: Feedforward("feedforward", **options), schedule="timer", rate_hz=RATE)
    sender = bench.sender("reference", "t[s],x[um]")
    tick = int(time.monotonic() / PERIOD)
    for each in (tick, tick + 3, tick + 1, tick + 3, tick - 1000):
        sender.send(np.array([[each * PERIOD, 1.0]]))
    bench.until(lambda: node.counts["reference: time ran backwards"] == 1)
    assert {key: count for key, count in node.counts.items() if key.startswith("reference") and count} == {
        "reference: lost": 2,
        "reference: late": 1,
        "reference: duplicate": 1,
        "reference: time ran backwards": 1,
    }


def test_plant_started_twice_shows_in_the_diagnostics(bench):
    bench.listen_to_diagnostics()
    common = dict(schedule="timer", rate_hz=RATE)
    bench.add(PiFeedback, **common)
    bench.add(PlantNode, model=MODEL, **common)
    bench.until(lambda: "/pi_feedback: loop" in bench.said)
    assert not bench.says("pi_feedback", "several sources")
    bench.add(PlantNode, model=MODEL, **common)
    bench.until(lambda: bench.says("pi_feedback", "several sources"))
    assert bench.said["/pi_feedback: loop"]["several sources"] == "measurement"


def test_simulated_time_paces_the_node_and_may_start_again(bench):
    node = bench.add(PlantNode, model=MODEL, schedule="timer", rate_hz=100.0, use_sim_time=True)
    bench.listen("measurement")
    clock = bench.probe.create_publisher(Clock, "/clock", 10)
    bench.until(lambda: clock.get_subscription_count() > 0 and node.measurement.publisher.get_subscription_count() > 0)

    def advance(begin, seconds):
        for now in np.arange(begin, begin + seconds, 0.01):
            message = Clock()
            message.clock.sec, message.clock.nanosec = int(now), int(now % 1 * 1e9)
            clock.publish(message)
            count = node.counts["ticks"]
            end = time.monotonic() + 0.05
            while node.counts["ticks"] == count and time.monotonic() < end:
                spin(bench.executor, Future(), 0.002)

    advance(1000.0, 0.5)
    bench.until(lambda: len(bench.rows("measurement")) >= 30)
    times = bench.rows("measurement")[:, 0]
    assert 999.9 < times[0] and times[-1] < 1000.6 and np.all(np.diff(times) > 0)
    advance(10.0, 0.5)
    bench.until(lambda: node.counts["time ran backwards"] >= 1)
    bench.until(lambda: bench.rows("measurement")[-1, 0] < 20.0)


def test_watch_takes_a_resting_stage_for_well_and_a_hanging_sensor_for_frozen():
    watch = MeasurementWatch(-10.0, 10.0, 5, 1.0)
    assert not any(watch.check(np.array([1.0]), np.array([20.0])) for _ in range(50))
    stepped = [watch.check(np.array([1.0]), np.array([40.0])) for _ in range(4)] + [watch.check(np.array([1.1]), np.array([40.0]))]
    assert not any(stepped)  # a stage answers a step a little later
    found = [watch.check(np.array([2.0]), np.array([20.0 + 0.6 * k])) for k in range(12)]
    assert found[:6] == [()] * 6 and found[6:] == [(FROZEN,)] * 6
    assert watch.check(np.array([2.1]), np.array([23.0])) == ()
    assert watch.check(np.array([10.1]), np.array([23.0])) == (OUT_OF_RANGE,)


def test_watch_names_the_axis_whose_sensor_hangs_beside_a_live_one():
    watch = MeasurementWatch(-10.0, 10.0, 5, 1.0)
    found = [watch.check(np.array([1.0, 0.1 * k]), np.array([k, k])) for k in range(20)]
    assert found[:6] == [()] * 6 and found[6:] == [(FROZEN, "")] * 14
    still = MeasurementWatch(-10.0, 10.0, 5, 1.0)  # the command of the axis at rest does not move
    assert not any(still.check(np.array([1.0, 0.1 * k]), np.array([7.0, k])) for k in range(20))


def test_rows_that_nobody_uses_are_not_kept(bench):
    """The generator's reference does not depend on the measurement; a disabled feedforward uses no reference."""
    common = dict(schedule="timer", rate_hz=RATE)
    generator = bench.add(ReferenceGenerator, signal="rest", duration=1.0, **common)
    feedforward = bench.add(lambda **options: Feedforward("feedforward", **options), **common)
    feedforward.enabled = False
    plant = bench.add(PlantNode, model=MODEL, **common)
    bench.until(lambda: plant.counts["ticks"] > 100 and generator.measurement.rows.end and feedforward.reference.rows.end)
    assert generator.measurement.rows.available < 20 and feedforward.reference.rows.available < 20
