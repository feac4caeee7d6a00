# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The diagnosis node beside a closed loop: silent while the plant is the model within its tolerance, and not once it is not."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest
from loop_case import MODEL, RATE, parameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from hyst_control.base.errors import InputError
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.model_file import Simulator, load_model, simulate
from hyst_control.nodes.diagnosis import DiagnosisNode
from hyst_control.nodes.pipeline import DEFAULT, node_class
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag
from hyst_plant_sim.node import PlantNode
from hyst_plant_sim.physics import load_plant

pytestmark = pytest.mark.long_file

WINDOW, CONSECUTIVE = 0.02, 3
SETTINGS = {"model": MODEL, "rate_hz": RATE, "window": WINDOW, "settle": 0.02, "calibrate": 0.1, "consecutive": CONSECUTIVE}


class Noisy:
    """A scattered model with white noise, as a plant."""

    def __init__(self, model, seed):
        scatter = scatter_of(model)
        self._random = np.random.default_rng(seed)
        self._inner = Simulator(model.with_stages(scatter.at(self._random.standard_normal(len(scatter.coefficients)))), 1 / RATE)
        self._sigma = model.noise["sigma"]
        self.axes, self.units = self._inner.axes, self._inner.units

    def reset(self, command):
        return self._inner.reset(command) + self._sigma * self._random.standard_normal(1)

    def step(self, commands):
        return self._inner.step(commands) + self._sigma * self._random.standard_normal(commands.shape)


def run_loop(bench, tmp_path, plant, count, **changes):
    """The closed loop with this plant, composed, to its end; the diagnosis node, and what it said by window and by tick."""
    settings = parameters(tmp_path, count)
    bench.listen("gap", "residual")
    node = bench.add(DiagnosisNode, output=str(tmp_path / "diagnosis"), **{**SETTINGS, **changes})
    nodes = {}
    for name in DEFAULT:
        make = node_class(name) if name != "plant" else lambda **options: PlantNode(plant=plant, **options)
        nodes[name] = bench.add(make, **settings[name])
    bench.until(lambda: nodes["plant"].finished.done() and nodes["recorder"].finished.done(), timeout=60)
    bench.until(lambda: len(bench.rows("residual")) >= count)
    return node, bench.rows("gap"), bench.rows("residual")


def once(rows):
    """Without what lockstep repeated."""
    return rows[np.unique(rows[:, 0], return_index=True)[1]]


def test_silent_beside_a_plant_within_tolerance(bench, tmp_path):
    model, count = load_model(MODEL), 5000
    bench.listen("command", "measurement")
    _, gap, residual = run_loop(bench, tmp_path, Noisy(model, 5), count)
    assert len(gap) >= (count / RATE - 0.02) / WINDOW - 1
    assert not gap[:, 2].any()
    command, measurement = (once(bench.rows(topic))[:count] for topic in ("command", "measurement"))
    # by tick, and what simulating the whole record at once gives
    np.testing.assert_array_equal(residual[:, 0], measurement[:, 0])
    np.testing.assert_allclose(residual[:, 1:], measurement[:, 1:] - simulate(model, command[:, 1:], 1 / RATE), atol=1e-9)
    last = residual[:, 0] <= gap[-1, 0] + 1e-9
    rows = residual[last][-round(WINDOW * RATE) :, 1]
    assert gap[-1, 1] == pytest.approx(100 * np.sqrt(np.mean(rows**2)) / np.ptp(measurement[round(0.02 * RATE) :][:, 1]), rel=0.05)


def test_alarm_and_diagnosis_once_a_delay_switches_on(bench, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))  # calibrated anew, as on the first run
    plant = load_plant(
        {"plant": "pea_published", "seed": 3, "effects": [{"name": "delay", "tau": 2e-4, "from": 0.2}]}, sample_time=1 / RATE
    )
    bench.listen_to_diagnostics()
    node, gap, _ = run_loop(bench, tmp_path, plant, 7000, buffer=0.15)
    alarmed = gap[gap[:, 2] > 0, 0]
    assert 0.2 < alarmed[0] <= 0.2 + (CONSECUTIVE + 1) * WINDOW
    assert gap[-1, 2] == 1.0
    bench.until(lambda: bench.says("diagnosis", "gap alarm"))
    started = bench.call(Trigger, "/diagnosis/diagnose", Trigger.Request())
    assert started.success and started.message.startswith("started")
    assert "running" in bench.call(Trigger, "/diagnosis/diagnose", Trigger.Request()).message
    bench.until(lambda: not node._job.running, timeout=180)
    told = bench.call(Trigger, "/diagnosis/diagnose", Trigger.Request()).message
    assert "delay" in told
    [report] = (tmp_path / "diagnosis").glob("*/gap.json")
    document = json.loads(report.read_text())
    assert "delay" in [effect["name"] for effect in document["effects"]] + [
        name for effect in document["effects"] for name in effect["equivalent"]
    ]
    bench.until(lambda: told in bench.said["/diagnosis: loop"]["diagnosis"])


def stream(bench, ticks, commands, measured):
    """Send rows of these ticks, 100 a message."""
    for begin in range(0, len(ticks), 100):
        part = slice(begin, begin + 100)
        for topic, values in (("command", commands), ("measurement", measured)):
            bench.senders[topic].send(np.column_stack([ticks[part] / RATE, values[part]]))


@pytest.fixture
def talking(bench, tmp_path):
    """A bench whose probe stands in for the loop, with a diagnosis node under the timer."""
    bench.node = bench.add(DiagnosisNode, schedule="timer", output=str(tmp_path / "diagnosis"), **SETTINGS)
    bench.listen("gap", "residual")
    bench.senders = {"command": bench.sender("command", "t[s],x[V]"), "measurement": bench.sender("measurement", "t[s],x[um]")}
    return bench


def record(count):
    model = load_model(MODEL)
    commands = 20 * (1 - np.cos(2 * np.pi * 50 * np.arange(count) / RATE))[:, None]
    return commands, simulate(model, commands, 1 / RATE) + 0.003 * np.random.default_rng(2).standard_normal((count, 1))


def test_short_gaps_are_bridged_and_long_ones_settle_anew(talking):
    commands, measured = record(6000)
    ticks = np.arange(6000) + 10**6
    held = commands.copy()
    held[2002:2006] = held[2001]  # what the plant got while nobody sent: the newest command, held
    measured += simulate(load_model(MODEL), held, 1 / RATE) - simulate(load_model(MODEL), commands, 1 / RATE)
    there = np.r_[0:2002, 2006:4000]
    stream(talking, ticks[there], commands[there], measured[there])
    talking.until(lambda: len(talking.rows("residual")) == len(there))
    rows = talking.rows("residual")
    np.testing.assert_array_equal(np.rint(rows[:, 0] * RATE), ticks[there])
    assert np.abs(rows[:, 1]).max() < 6 * 0.003
    assert talking.node.status()["ticks bridged"] == 4 and talking.node.status()["settled anew"] == 0
    windows = len(talking.rows("gap"))
    stream(talking, ticks[5000:5300] + 5000, commands[5000:5300], measured[5000:5300])
    talking.until(lambda: len(talking.rows("residual")) == len(there) + 300)
    assert talking.node.status()["settled anew"] == 1
    assert len(talking.rows("gap")) == windows  # within `settle`: not counted


def test_ticks_at_which_the_actuator_does_not_follow_are_a_gap(talking):
    """A stage that approaches its first command at a safe rate, and says so: neither compared nor learned from."""
    commands, _ = record(6000)
    commands = commands + 20.0
    ramp = 0.02 * np.arange(6000)[:, None]
    approach = int(np.argmax(ramp > commands))
    applied = np.where(np.arange(6000)[:, None] < approach, ramp, commands)
    measured = simulate(load_model(MODEL), applied, 1 / RATE) + 0.003 * np.random.default_rng(2).standard_normal((6000, 1))
    assert approach > 1000
    said = talking.sender("applied", "t[s],x[V]")
    ticks, interval = np.arange(6000) + 10**6, round(0.005 * RATE)
    for begin in range(0, 6000, interval):
        stream(talking, ticks[begin : begin + interval], commands[begin : begin + interval], measured[begin : begin + interval])
        if begin < approach:
            said.send(np.column_stack([ticks[[begin]] / RATE, applied[[begin]]]))
    talking.until(lambda: len(talking.rows("residual")) and talking.rows("residual")[-1, 0] == ticks[-1] / RATE)
    rows = talking.rows("residual")
    begin = int(np.rint(rows[0, 0] * RATE)) - 10**6
    assert approach <= begin < approach + 2 * interval and len(rows) == 6000 - begin
    assert talking.node.status()["ticks not followed"] == begin and talking.node.status()["settled anew"] == 0
    assert np.abs(rows[:, 1]).max() < 6 * 0.003  # the memory of the hysteresis is that of the way there
    assert talking.node.alarm.noise == pytest.approx(0.003, rel=0.1) and not talking.rows("gap")[:, 2].any()


def test_what_is_applied_is_heard_after_a_long_silence_too(talking):
    """A stage follows its command for longer than rows may lie ahead, then its watchdog takes over; a time to come is refused."""
    applied, first = talking.node._applied, 10**6
    for tick in (first, first + 2 * talking.node.settings.most_waiting, 10**12):
        applied.receive(np.array([[tick / RATE, 1.0]]))
    assert applied.rows.end == first + 2 * talking.node.settings.most_waiting + 1
    assert applied.rows.available == 2, "what waits to be used stays"
    assert talking.node.counts["applied: far ahead"] == 1 and talking.node.counts["applied: missed ticks"] == 0


def test_bad_messages_are_refused_and_a_new_time_begins_anew(talking):
    commands, measured = record(3000)
    ticks = np.arange(3000) + 10**6
    nan = np.full((100, 1), np.nan)
    stream(talking, ticks[:100], commands, nan)
    stream(talking, ticks[:100] + 0.5, commands, measured)
    talking.until(
        lambda: talking.node.counts["measurement: not finite"] == 1 and talking.node.counts["command: off the clock"] == 1
    )
    stream(talking, ticks, commands, measured)
    talking.until(lambda: len(talking.rows("residual")) == 3000)
    stream(talking, np.arange(3000), commands, measured)
    talking.until(lambda: talking.rows("residual")[-1, 0] == 2999 / RATE)
    assert talking.node.counts["time ran backwards"] >= 1
    assert np.abs(talking.rows("residual")[-3000:, 1]).max() < 6 * 0.003


def test_a_baseline_keeps_the_models_own_error_from_raising_the_alarm(bench, tmp_path):
    """The plant has a third harmonic of 1 % that the model lacks; with a baseline that is no gap, and sixteen times as much is one."""
    commands, clean = record(12000)
    wrong = 0.3 * np.sin(3 * 2 * np.pi * 50 * np.arange(12000) / RATE)[:, None] * (np.arange(12000) >= 2500)[:, None]
    time = np.arange(6000) / RATE
    signals = {
        "command": Signal(time, commands[:6000], ("x",), "V"),
        "measurement": Signal(time, (clean + wrong)[6000:], ("x",), "um"),
    }
    write_bag(tmp_path / "clean", Record(signals, "clean"))
    measured = clean + wrong
    measured[9000:] += 15.0 * wrong[9000:]
    alone = bench.add(partial(DiagnosisNode, "alone"), schedule="timer", **SETTINGS)
    beside = bench.add(partial(DiagnosisNode, "beside"), schedule="timer", baseline=[str(tmp_path / "clean")], **SETTINGS)
    bench.senders = {"command": bench.sender("command", "t[s],x[V]"), "measurement": bench.sender("measurement", "t[s],x[um]")}
    stream(bench, np.arange(9000), commands, measured)
    bench.until(lambda: alone.status()["rows compared"] == beside.status()["rows compared"] == 9000)
    assert alone.status()["alarm"] and not beside.status()["alarm"]
    stream(bench, np.arange(9000, 12000), commands[9000:], measured[9000:])
    bench.until(lambda: beside.status()["rows compared"] == 12000)
    assert beside.status()["alarm"]


def test_held_samples_are_counted(talking):
    commands, measured = record(4000)
    repeated = np.arange(5, 4000, 20)
    measured[repeated] = measured[repeated - 1]
    stream(talking, np.arange(4000) + 10**6, commands, measured)
    talking.until(lambda: len(talking.rows("residual")) == 4000)
    assert talking.node.held_share() == pytest.approx(0.05, abs=0.005)


def test_nothing_to_diagnose_and_a_model_of_another_plant_are_told_in_one_line(talking):
    answer = talking.call(Trigger, "/diagnosis/diagnose", Trigger.Request())
    assert not answer.success and "no data yet" in answer.message
    with pytest.raises(InputError, match="set the parameters axes and unit"):
        talking.add(DiagnosisNode, **{**SETTINGS, "unit": "mrad"})
    with pytest.raises(InputError, match="model"):
        talking.add(DiagnosisNode, rate_hz=RATE)


def test_a_diagnosis_under_way_ends_with_the_node(talking, tmp_path):
    commands, measured = record(3000)
    assert not talking.node.set_parameters([Parameter("output", value="/elsewhere")])[0].successful  # no peer chooses where
    stream(talking, np.arange(3000) + 10**6, commands, measured)
    talking.until(lambda: len(talking.rows("residual")) == 3000)
    assert talking.call(Trigger, "/diagnosis/diagnose", Trigger.Request()).success
    assert talking.node._job.running
    canceled = talking.call(Trigger, "/diagnosis/cancel", Trigger.Request())
    assert canceled.success and canceled.message.startswith("canceled: ") and not talking.node._job.running
    assert not talking.call(Trigger, "/diagnosis/cancel", Trigger.Request()).success
    assert talking.call(Trigger, "/diagnosis/diagnose", Trigger.Request()).success
    assert talking.node._job.running
    talking.node.close()
    assert not talking.node._job.running
    assert len(list((tmp_path / "diagnosis").iterdir())) == 2  # that of the canceled one too
    found = read_bag(talking.node._job.folder / "record").aligned(allow_gaps=True)
    # cut from a run: what does not start at rest is behind a gap, which the diagnosis knows what to do with
    assert [len(stretch.time) for stretch in found] == [1, 2998]
    np.testing.assert_array_equal(found[1].measurement, measured[2:])


def test_a_folder_that_cannot_be_written_is_told(talking, tmp_path):
    commands, measured = record(300)
    (tmp_path / "diagnosis").write_text("")
    stream(talking, np.arange(300) + 10**6, commands, measured)
    talking.until(lambda: len(talking.rows("residual")) == 300)
    answer = talking.call(Trigger, "/diagnosis/diagnose", Trigger.Request())
    assert not answer.success and "set the parameter output" in answer.message
