# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes of real stages: what reaches the device, what its failures lead to, managed states, and the three examples on small stand-ins."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest
from gcs_controller import GAIN, RANGE, GcsController
from lifecycle_msgs.srv import GetState
from loop_case import MODEL
from stage_bed import LOWER, PERIOD, RATE, SAFE, SETTINGS, UPPER, Bed, Drive, change, failed_calls
from std_srvs.srv import Trigger

from hyst_control.base.errors import InputError
from hyst_control.control.feedback.command_limits import CommandLimits
from hyst_control.hardware import physik_instrumente
from hyst_control.hardware import simulated_converter as simulated
from hyst_control.hardware.linux_iio import IioStage
from hyst_control.hardware.physik_instrumente import PhysikInstrumenteStage
from hyst_control.model_file import Simulator, load_model, simulate
from hyst_control.nodes.pi_feedback import PiFeedback
from hyst_control.nodes.signal_node.managed import UNCONFIGURED


def test_limits_are_kept_from_where_the_actuator_is():
    limits = CommandLimits(0.0, 10.0, 2.0)
    assert limits.limited(np.array([50.0, -50.0, 5.0]), np.array([9.0, 1.0, 4.0])).tolist() == [10.0, 0.0, 5.0]
    assert limits.limited(np.array([5.0]), np.array([14.0])).tolist() == [12.0]
    assert CommandLimits().limited(np.array([1e9]), np.array([0.0])).tolist() == [1e9]


def test_stage_keeps_its_own_limits_and_goes_to_its_safe_value_without_commands(bench):
    bed = Bed(bench)
    bench.until(lambda: bed.last == 40.0)
    for value, expected in ((500.0, UPPER), (-500.0, LOWER), (30.0, 30.0)):
        bed.value = value
        bench.until(lambda expected=expected: bed.last == expected)
    bench.until(lambda: bench.says("stage", "limited ticks"))
    bed.sending = False
    bench.until(lambda: bed.last == SAFE)
    bench.until(lambda: bench.says("stage", "no trusted command: the actuator goes to its safe value, or back to the command"))
    assert bench.rows("applied")[-1, 1] == SAFE
    bed.sending = True
    bench.until(lambda: bed.last == 30.0)
    assert bench.call(Trigger, "stage/stop", Trigger.Request()).success
    bench.until(lambda: bed.last == SAFE)
    assert bench.call(Trigger, "stage/reset", Trigger.Request()).success
    bench.until(lambda: bed.last == 30.0)
    bed.node.wind_down()
    bench.until(lambda: bed.node.wound_down)
    assert bed.last == SAFE
    bed.assert_sound()


def test_measurements_have_the_tick_of_the_machines_clock_once_and_nothing_is_written_before_a_command(bench):
    begin = time.monotonic() - PERIOD
    bed = Bed(bench)
    bed.sending = False
    bench.until(lambda: len(bench.rows("measurement")) > 20)
    rows = bench.rows("measurement")
    assert begin <= rows[0, 0] and rows[-1, 0] < time.monotonic() + PERIOD and np.all(np.diff(rows[:, 0]) > 0.5 * PERIOD)
    ticks = rows[:, 0] / PERIOD
    assert np.abs(ticks - np.rint(ticks)).max() < 1e-6
    assert rows[-1, 1] == 2.0 and not bed.node.written
    bench.until(lambda: "offset to ROS time [s]" in bench.said.get("/stage: loop", {}))
    assert abs(float(bench.said["/stage: loop"]["offset to ROS time [s]"]) - (time.time() - time.monotonic())) < 1.0


WRONG = [
    (dict(upper=-10.0), "parameter upper: must be above lower"),
    (dict(safe_command=[90.0]), "parameter safe_command: must be within lower and upper"),
    (dict(safe_command=[0.0, 0.0]), "parameter safe_command: 2 values, 1 axes"),
    (dict(axes=["x", "y"], safe_command=[0.0]), r"initial_command\(\) must return 2 values"),
    (dict(schedule="lockstep"), "must be timer, got"),
    (dict(block=10), "parameter block"),
]


@pytest.mark.parametrize("changes, reason", WRONG)
def test_what_a_stage_cannot_be_is_one_line(bench, changes, reason):
    with pytest.raises(InputError, match=reason) as error:
        bench.add(Drive, **{**SETTINGS, **changes})
    assert "\n" not in str(error.value) and str(error.value).startswith("stage: ")


def state(bench, node):
    return bench.call(GetState, f"{node}/get_state", GetState.Request()).current_state.label


def test_stage_follows_the_managed_states(bench):
    bed = Bed(bench, autostart=False)
    node = bed.node
    assert state(bench, "stage") == "unconfigured" and not node.open
    assert not change(bench, "stage", "activate") and state(bench, "stage") == "unconfigured"
    node.fault = "connect"
    assert not change(bench, "stage", "configure") and state(bench, "stage") == "unconfigured"
    node.fault = ""
    assert change(bench, "stage", "configure") and state(bench, "stage") == "inactive"
    assert node.open == 1 and not len(bench.rows("measurement")) and not node.written
    assert change(bench, "stage", "activate")
    bench.until(lambda: bed.last == 40.0 and len(bench.rows("measurement")) > 5)
    assert change(bench, "stage", "deactivate")
    bench.until(lambda: bed.last == SAFE)
    assert change(bench, "stage", "activate")
    bench.until(lambda: bed.last == 40.0)
    assert change(bench, "stage", "shutdown") and state(bench, "stage") == "finalized"
    bench.until(node.finished.done)
    assert bed.last == SAFE and node.finished.result() == 0
    bed.assert_sound()


@pytest.mark.parametrize("recovery_time", [0.0, 0.1])
@pytest.mark.parametrize("ahead", [1, 0])  # ticks; a row of 0 comes after the node's own tick
def test_feedback_follows_the_managed_states(bench, ahead, recovery_time):
    bench.listen("command")
    settings = dict(feedback=False, safe_command=[SAFE], autostart=False, timeout=1.0, recovery_time=recovery_time)
    node = bench.add(PiFeedback, schedule="timer", rate_hz=RATE, **settings)
    sender = bench.sender("feedforward", "t[s],x[V]")
    own_tick, sending = node.tick, [True]

    def tick(number):
        own_tick(number)
        if sending[0]:
            sender.send(np.array([[(number + ahead) * PERIOD, 20.0]]))

    node.tick = tick

    def commands(value):
        return lambda: len(bench.rows("command")) and bench.rows("command")[-1, 1] == value

    assert change(bench, "pi_feedback", "configure") and not len(bench.rows("command"))
    assert change(bench, "pi_feedback", "activate")
    bench.until(commands(20.0))
    assert change(bench, "pi_feedback", "deactivate") and not node.working
    bench.until(commands(SAFE))
    assert change(bench, "pi_feedback", "activate")
    bench.until(commands(20.0))
    sending[0] = False
    bench.until(commands(SAFE))
    sending[0] = True
    bench.until(commands(20.0))
    rows = bench.rows("command")
    assert np.diff(rows[:, 0]).min() > 0.5 * PERIOD
    steps = np.abs(np.diff(rows[:, 1]))
    assert steps.max() <= 1000.0 * PERIOD * (1 + 1e-9)  # safe_rate, both ways


def test_second_measurement_of_a_tick_does_not_stop_the_feedback(bench):
    bench.listen("command")
    node = bench.add(PiFeedback, schedule="timer", rate_hz=RATE, kp=0.0, ki=0.0, timeout=1.0, frozen_time=0.0)
    senders = {topic: bench.sender(topic, f"t[s],x[{unit}]") for topic, unit in (("reference", "um"), ("feedforward", "V"))}
    senders["measurement"] = bench.sender("measurement", "t[s],x[um]")
    count = iter(range(10**9))

    def feed():
        tick = int(time.monotonic() / PERIOD)
        for sender in senders.values():
            sender.send(np.array([[tick * PERIOD, 2.0]]))
        if next(count) % 10 == 0:
            senders["measurement"].send(np.array([[tick * PERIOD, 3.0]]))

    bench.probe.create_timer(PERIOD, feed)
    bench.until(lambda: node.counts["measurement: replaced"] >= 5)
    assert not node.counts["measurement: conflict"] and not node.counts["faults"]


def test_simulated_converter_is_the_model_on_the_clock_in_steps(monkeypatch):
    """Of five samples at a time, as when ticks are missed: what is read is the model's own record."""
    clock = [100.0 + 0.5 * PERIOD]
    monkeypatch.setattr(simulated.time, "monotonic", lambda: clock[0])
    model = load_model(MODEL)
    converter = simulated.Converter(Simulator(model, PERIOD), 1, PERIOD, output_step=0.5)
    volts = 20.0 * np.sin(np.arange(20.0))[:, None] ** 2
    read = []
    for each in volts:
        converter.hold(each)
        clock[0] += 5 * PERIOD
        read.append(converter.sample()[0])
    held = np.repeat(np.rint(volts / 0.5) * 0.5, 5, axis=0)
    expected = simulate(model, np.vstack([np.zeros((1, 1)), held, held[-1:]]), sample_time=PERIOD)
    np.testing.assert_allclose(read, expected[6:106:5, 0], rtol=0, atol=1e-9)
    assert simulated._rounded(np.array([1.26]), 0.5).tolist() == [1.5]


def test_simulated_stage_measures_what_its_model_gives(bench):
    bed = Bed(bench, simulated.SimulatedStage, model=MODEL)
    bed.value = 30.0
    level = float(simulate(load_model(MODEL), np.full((400, 1), 30.0), sample_time=PERIOD)[-1, 0])
    bench.until(lambda: len(bench.rows("measurement")) and abs(bench.rows("measurement")[-1, 1] - level) < 0.2 * level)
    with pytest.raises(InputError, match="simulated_stage: parameter model: give a model file"):
        bench.add(simulated.SimulatedStage)


@pytest.fixture
def iio(tmp_path):
    """Two devices as the kernel shows them: a DAC of 16 bit for 0 to 5 V, and an ADC of 16 bit for ±5 V with an offset."""
    dac, adc = tmp_path / "iio:device0", tmp_path / "iio:device3"
    for device, files in (
        (dac, {"name": "ad5686", "out_voltage0_raw": "0", "out_voltage1_raw": "6554", "out_voltage_scale": "0.076293945"}),
        (adc, {"name": "ad7606", "in_voltage2_raw": "1000", "in_voltage2_scale": "0.152587890", "in_voltage2_offset": "-500"}),
    ):
        device.mkdir()
        for name, text in files.items():
            (device / name).write_text(text + "\n")
    return tmp_path


IIO = dict(dac="ad5686", adc="iio:device3", outputs=["out_voltage1"], inputs=["in_voltage2"], amplifier_gain=12.0, sensor_gain=-4.0)


def test_iio_stage_writes_counts_and_reads_units(bench, iio):
    bed = Bed(bench, IioStage, devices=str(iio), sensor_zero=1.0, **IIO)
    present = 6554 * 0.076293945e-3 * 12.0
    np.testing.assert_allclose(bed.node.initial_command(), [present], rtol=1e-12)
    bench.until(lambda: len(bench.rows("measurement")))
    assert bench.rows("measurement")[-1, 1] == pytest.approx(1.0 - 4.0 * (1000 - 500) * 0.152587890e-3, rel=1e-12)
    bed.value = 24.0  # V on the actuator: 2 V of the DAC
    file = iio / "iio:device0" / "out_voltage1_raw"
    bench.until(lambda: file.read_text().splitlines()[0] == str(round(2.0 / 0.076293945e-3)))


@pytest.mark.parametrize(
    "changes, reason",
    [
        (dict(dac="ad9999"), r"has no device ad9999 \(devices: iio:device0, iio:device3, ad5686, ad7606\)"),
        (dict(outputs=["out_voltage7"]), "out_voltage7_raw: No such file"),
        (dict(inputs=["in_voltage2", "in_voltage3"]), "parameter inputs: 2 channels, 1 axes"),
    ],
)
def test_iio_device_or_channel_that_is_not_there_is_one_line(bench, iio, changes, reason):
    with pytest.raises(InputError, match=reason) as error:
        bench.add(IioStage, **{**SETTINGS, "devices": str(iio), **IIO, **changes})
    assert "\n" not in str(error.value)
    opened = [os.path.realpath(f"/proc/self/fd/{each}") for each in os.listdir("/proc/self/fd")]
    assert not [path for path in opened if path.startswith(f"{iio}/iio:device")], "what was opened before is closed again"


def test_controller_of_physik_instrumente_through_its_own_package(bench):
    pytest.importorskip("pipython", reason="PI's package: pip install PIPython")
    with GcsController() as controller:
        settings = {"host": "127.0.0.1", "port": controller.port, "controller_axes": ["2"]}
        bed = Bed(bench, PhysikInstrumenteStage, **settings, upper=200.0)
        bench.until(lambda: controller.voltage["2"] == 40.0)
        assert controller.servo == {"1": True, "2": False} and controller.voltage["1"] == 12.0
        bench.until(lambda: bench.rows("measurement")[-1, 1] == pytest.approx(40.0 * GAIN))
        bed.value = RANGE[1] + 20.0  # within this node's limits, not within the controller's
        bench.until(lambda: bed.node.counts["write: failed"] > 0)
        assert controller.voltage["2"] <= RANGE[1] and not controller.lost
        bed.value = 10.0
        bench.until(lambda: controller.voltage["2"] == 10.0)
        with pytest.raises(InputError, match=r"has no axis 7 \(axes: 1, 2\)"):
            bench.add(PhysikInstrumenteStage, **{**SETTINGS, **settings, "controller_axes": ["7"]})
        bench.until(lambda: controller.connections == 1)  # the refused one has not kept its connection, of which there are few
        bed.node.close()
        bench.until(lambda: controller.connections == 0)
    with pytest.raises(InputError, match="127.0.0.1:1: Connection refused"):
        bench.add(PhysikInstrumenteStage, **{**SETTINGS, "host": "127.0.0.1", "port": 1})


def test_controller_of_physik_instrumente_that_falls_silent_is_connected_again(bench, monkeypatch):
    pytest.importorskip("pipython", reason="PI's package: pip install PIPython")
    monkeypatch.setattr(physik_instrumente, "ANSWER_TIMEOUT", 0.2)
    monkeypatch.setattr(physik_instrumente, "ERROR_CHECK_INTERVAL", 0.1)
    with GcsController() as controller:
        settings = {"host": "127.0.0.1", "port": controller.port, "controller_axes": ["2"]}
        bed = Bed(bench, PhysikInstrumenteStage, **settings)
        bench.until(lambda: controller.voltage["2"] == 40.0)
        controller.silent = True
        bench.until(lambda: bed.node.state == UNCONFIGURED)
        assert failed_calls(bed.node) == 1
        bench.until(lambda: controller.connections == 0)
        assert controller.voltage["2"] == SAFE
        with pytest.raises(InputError, match=r"Timeout.*is this a controller of Physik Instrumente\?"):
            bench.add(PhysikInstrumenteStage, **{**SETTINGS, **settings})
        controller.silent = False
        assert bench.call(Trigger, "pi_stage/reset", Trigger.Request()).success
        count = len(bench.rows("measurement"))
        bench.until(lambda: len(bench.rows("measurement")) > count)
        bench.until(lambda: controller.connections == 1)


def test_late_answer_of_physik_instrumente_is_not_taken_for_the_next_one(bench, monkeypatch):
    pytest.importorskip("pipython", reason="PI's package: pip install PIPython")
    monkeypatch.setattr(physik_instrumente, "ANSWER_TIMEOUT", 0.1)
    with GcsController() as controller:
        bed = Bed(bench, PhysikInstrumenteStage, host="127.0.0.1", port=controller.port, controller_axes=["2"])
        bench.until(lambda: controller.voltage["2"] == 40.0)
        controller.late = 0.15
        bench.until(lambda: failed_calls(bed.node) == 1)
        bench.until(lambda: bed.node.state == UNCONFIGURED and controller.connections == 0)
        bench.until(lambda: controller.late == 0.0)
        assert bench.call(Trigger, "pi_stage/reset", Trigger.Request()).success
        before, (answer,), after = controller.voltage["2"], bed.node.initial_command(), controller.voltage["2"]
        # Not the position that was asked for last. The stage may be on its way to the command meanwhile.
        assert min(before, after) - 1e-9 <= answer <= max(before, after) + 1e-9
