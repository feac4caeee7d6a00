"""What the failures of a stage's device lead to: what was written last before it is disconnected, and what goes on meanwhile."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from rclpy.lifecycle import TransitionCallbackReturn
from stage_bed import LOWER, PERIOD, SAFE, SAFE_RATE, SETTINGS, UPPER, Bed, Drive, change, failed_calls
from std_srvs.srv import Trigger

from hyst_control.base.errors import InputError
from hyst_control.hardware import StageNode, stage_node
from hyst_control.nodes.signal_node.managed import UNCONFIGURED


def moving(bench, **changes):
    """A stage that follows its command of 40 V."""
    bed = Bed(bench, **changes)
    bench.until(lambda: bed.last == 40.0)
    return bed


def reset(bench):
    return bench.call(Trigger, "stage/reset", Trigger.Request())


@pytest.mark.parametrize("fault, failures, failed", [("read", 5, 5), ("read and disconnect", 5, 5), ("connection", 10**6, 1)])
def test_stage_without_measurements_goes_to_its_safe_command_before_it_disconnects(bench, fault, failures, failed):
    bed = moving(bench, failures=failures)
    bed.node.fault = fault
    bench.until(lambda: bed.node.left)
    assert bed.node.left == [SAFE] and bed.node.counts["read: failed"] == failed
    assert np.abs(np.diff([40.0, *bed.node.written[bed.node.written.index(40.0) :]])).max() <= SAFE_RATE * PERIOD * (1 + 1e-9)
    bench.until(lambda: bed.node.state == UNCONFIGURED)
    assert bed.node.open == 0 and "call ~/reset" in bed.node.trouble()
    bed.assert_sound()


@pytest.mark.parametrize("fault", ["write", "deaf", "read and write", "connection, deaf"])
def test_stage_that_cannot_be_written_to_is_disconnected_at_once(bench, fault):
    bed = moving(bench)
    bed.node.fault = fault
    bench.until(lambda: bed.node.left)
    assert bed.node.left == [40.0] and failed_calls(bed.node) <= 2 * SETTINGS["failures"]
    assert bed.node.open == 0


def test_device_that_has_failed_can_be_connected_again(bench):
    bed = moving(bench)
    bed.node.fault = "read"
    bench.until(lambda: bed.node.counts["read: failed"] >= 1)
    assert bed.node.trouble() in ("read fails", "the device has failed: call ~/reset to connect again")
    bench.until(lambda: bed.node.left)
    answer = reset(bench)
    assert not answer.success and "sensor error" in answer.message and bed.node.open == 0
    bed.node.fault, count = "", len(bed.node.written)
    assert reset(bench).success
    bench.until(lambda: bed.last == 40.0)
    assert bed.node.connections == 3 and bed.node.open == 1
    assert abs(bed.node.written[count] - 20.0) <= SAFE_RATE * PERIOD * (1 + 1e-9)  # from what the actuator was said to have


def test_device_that_cannot_be_disconnected_hides_no_reason_and_keeps_no_node_from_its_end(bench, capfd):
    bed = moving(bench)
    bed.node.fault = "read and disconnect"
    bench.until(lambda: bed.node.left)
    answer = reset(bench)
    assert not answer.success and "sensor error" in answer.message
    bed.node.fault = "disconnect"
    assert reset(bench).success
    bed.node.close()
    assert bed.node.open == 0 and capfd.readouterr().err.count("disconnect: already closed") == 3


@pytest.mark.parametrize("fault", ["read", "connection"])
def test_connection_is_kept_where_failures_never_disconnect(bench, fault):
    bed = moving(bench, failures=0)
    bed.node.fault = fault
    bench.until(lambda: failed_calls(bed.node) > 2 * SETTINGS["failures"])
    assert bed.node.state == "active" and bed.node.open == 1 and bed.last == 40.0


def test_nothing_is_written_where_the_voltage_is_not_known_after_another_connection(bench):
    bed = moving(bench)
    bed.node.fault = "connection, deaf"
    bench.until(lambda: bed.node.left)
    bed.node.fault, count = "", len(bed.node.written)
    bed.node.initial_command = lambda: [498.0]
    assert WRONG in reset(bench).message
    assert len(bed.node.written) == count and bed.node.left == [40.0, 40.0]
    del bed.node.initial_command
    bed.node.PRESENT = [40.0]
    assert reset(bench).success


def test_stage_that_cannot_be_asked_for_its_voltage_begins_where_it_was_left(bench, monkeypatch):
    monkeypatch.setattr(Drive, "initial_command", StageNode.initial_command)
    bed = moving(bench, safe_rate=100.0)
    assert bed.node.written[0] == 100.0 * PERIOD  # from 0 V
    bed.node.fault = "connection"
    bench.until(lambda: bed.node.left)
    bed.node.fault, count = "", len(bed.node.written)
    assert reset(bench).success
    bench.until(lambda: len(bed.node.written) > count)
    assert bed.node.written[count] == pytest.approx(SAFE + 100.0 * PERIOD)


def test_cleanup_after_deactivate_takes_the_actuator_to_its_safe_command_first(bench):
    bed = moving(bench)
    for transition in ("deactivate", "cleanup", "configure", "activate"):
        assert change(bench, "stage", transition)
    assert bed.node.left == [SAFE]
    bench.until(lambda: bed.last == 40.0)
    bed.node.close()
    assert bed.node.left == [SAFE, SAFE] and bed.node.open == 0


def test_way_to_a_safe_command_that_takes_long_ends_with_the_node(bench, monkeypatch):
    monkeypatch.setattr(stage_node, "LONGEST_WIND_DOWN", 0.2)
    beds = [moving(bench, safe_rate=100.0) for _ in range(2)]
    bench.nodes.clear()
    beds[0].node.close()
    assert SAFE < beds[0].node.left[0] < 40.0
    beds[1].node.wind_down()
    beds[1].node.close()  # a second interrupt
    assert beds[1].node.left == [40.0]


def test_disconnecting_stage_says_what_is_on_the_actuator_and_connects_again_when_it_is_done(bench, monkeypatch):
    monkeypatch.setattr(stage_node, "LONGEST_ANSWER", 0.01)
    bed = moving(bench, safe_rate=60.0)
    bed.node.fault = "connection"
    bench.until(lambda: bed.node.state == UNCONFIGURED)
    assert "still on the way to its safe command" in reset(bench).message
    bed.node.fault = ""
    bench.until(lambda: bed.node.left)
    assert bench.rows("applied")[-1, 1] < 10.0
    assert reset(bench).success


WRONG = "must return what is on the actuator, within lower and upper, -5 to 60 V, got"


@pytest.mark.parametrize(
    "present, reason",
    [
        ([498.0], rf"{WRONG} \[498.0\]"),
        ([-6.0], WRONG),
        ([1e300], WRONG),
        ([float("nan")], WRONG),
        (None, rf"{WRONG} \[nan\]"),
        ([20.0, 20.0], "must return 2 values|must return 1 values"),
        ("on", "could not convert string to float"),
    ],
)
def test_voltage_that_the_actuator_cannot_have_is_refused_in_one_line(bench, monkeypatch, present, reason):
    monkeypatch.setattr(Drive, "PRESENT", present)
    made = []
    with pytest.raises(InputError, match=reason) as error:
        bench.add(lambda **options: made.append(Watched(**options)), **SETTINGS)
    assert "\n" not in str(error.value) and str(error.value).startswith("stage: ")
    assert Watched.newest.open == 0 and not Watched.newest.written


class Watched(Drive):
    """A stage that is known even where it cannot be made."""

    def __init__(self, **options):
        Watched.newest = self
        super().__init__(**options)


@pytest.mark.parametrize("present, start", [([60.3], UPPER), ([-5.3], LOWER)])
def test_voltage_read_back_beside_the_range_by_the_steps_of_a_converter_is_the_end_of_the_range(bench, monkeypatch, present, start):
    monkeypatch.setattr(Drive, "PRESENT", present)
    bed = moving(bench)
    bed.assert_sound(begin=start)


def test_voltages_whose_writing_fails_do_not_count_as_applied(bench):
    bed = moving(bench, failures=0, slew_limit=50.0, safe_rate=50.0)
    bed.node.fault, bed.value = "write", 10.0
    bench.until(lambda: bed.node.counts["write: failed"] > 20)
    bench.until(lambda: len(bench.rows("applied")) and bench.rows("applied")[-1, 1] == 40.0)
    assert bed.node.trouble() == "write fails" and not bed.node._actuator.safe
    count, bed.node.fault = len(bed.node.written), ""
    bench.until(lambda: len(bed.node.written) > count + 5)
    assert np.abs(np.diff(bed.node.written[count - 1 :])).max() <= 50.0 * PERIOD * (1 + 1e-9)


def test_after_failed_writes_the_command_is_approached_at_the_safe_rate(bench):
    bed = moving(bench, failures=0, slew_limit=0.0)
    bed.node.fault, bed.value = "write", 10.0
    bench.until(lambda: bed.node.counts["write: failed"] > 5)
    bed.node.fault = ""
    bench.until(lambda: bed.last == 10.0)
    falling = bed.node.written[len(bed.node.written) - 1 - bed.node.written[::-1].index(40.0) :]
    assert np.abs(np.diff(falling)).max() <= SAFE_RATE * PERIOD * (1 + 1e-9)


def test_useless_readings_are_counted(bench):
    bed = moving(bench, failures=0)
    for answer, key in (([np.nan], "measurement: not finite"), ([1.0, 2.0], "read: failed")):
        bed.node.answer = answer
        bench.until(lambda key=key: bed.node.counts[key] > 3)
    count, bed.node.answer = len(bench.rows("measurement")), None
    bench.until(lambda: len(bench.rows("measurement")) > count + 5)
    bed.node.read = lambda: None
    bench.until(lambda: bed.node.counts["measurement: none new"] > 3)
    assert bed.node.state == "active" and np.isfinite(bench.rows("measurement")).all()


@pytest.mark.parametrize("fault", ["hanging read", "hanging write"])
def test_driver_that_hangs_is_reported_and_the_command_is_approached_when_it_answers_again(bench, fault):
    bed = moving(bench, slew_limit=0.0, failures=5)
    bed.node.fault = fault
    bench.until(lambda: bench.says("stage", "driver does not answer since"))
    first = float(bench.said["/stage: loop"]["message"].split()[-2])
    bench.until(lambda: float(bench.said["/stage: loop"]["message"].split()[-2]) > first + 0.3)
    bed.value = 10.0
    assert bench.call(Trigger, "stage/stop", Trigger.Request()).success and reset(bench).success
    count = len(bed.node.written)
    heard = len(bench.rows("applied"))
    bench.until(lambda: len(bench.rows("applied")) > heard)
    assert bench.rows("applied")[-1, 1] == 40.0 == bed.node.written[-1]
    bed.node.fault = ""
    bed.node.answering.set()
    bench.until(lambda: bed.last == 10.0)
    late = {name for name, count in bed.node.counts.items() if name.endswith("no answer") and count}
    assert late == {f"{fault.split()[1]}: no answer"} and bed.node.state == "active"
    assert np.abs(np.diff([40.0, *bed.node.written[count:]])).max() <= SAFE_RATE * PERIOD * (1 + 1e-9)
    bench.until(lambda: not bench.says("stage", "driver does not answer"))


def test_driver_that_fails_after_it_hung_is_a_lost_connection(bench):
    bed = moving(bench)
    answers = iter([ConnectionResetError("the device has gone")])

    def read():
        bed.node.answering.wait()
        for error in answers:
            raise error
        return [1.0]

    bed.node.read = read
    bench.until(lambda: bed.node.trouble().startswith("driver does not answer"))
    bed.node.answering.set()
    bench.until(lambda: bed.node.left)
    assert bed.node.left == [SAFE] and bed.node.counts["read: failed"] == 1


def test_node_whose_driver_hangs_ends_and_is_disconnected_once_it_answers(bench, monkeypatch):
    monkeypatch.setattr(stage_node, "LONGEST_SILENCE", 0.4)
    bed = moving(bench)
    bed.node.fault = "hanging write"
    bench.until(lambda: bed.node.trouble().startswith("driver does not answer"))
    bed.node.wind_down()
    bench.until(lambda: bed.node.wound_down)
    begin = time.monotonic()
    bed.node.close()
    assert time.monotonic() - begin < 2.0 and bed.node.open == 1
    bed.node.fault = ""
    bed.node.answering.set()
    bench.until(lambda: bed.node.left)
    assert bed.node.open == 0


def test_device_that_does_not_connect_is_one_line_and_is_disconnected_when_it_does(bench, monkeypatch):
    for name in ("LONGEST_CONNECT", "LONGEST_ANSWER", "LONGEST_SILENCE"):
        monkeypatch.setattr(stage_node, name, 0.3)
    bed = Bed(bench, autostart=False)
    bed.node.fault = "hanging connect"
    for _ in range(2):
        assert bed.node.trigger_configure() == TransitionCallbackReturn.FAILURE
        assert bed.node._refusal.startswith("driver does not answer since ")
    assert bed.node.connections == 0
    bed.node.answering.set()
    bench.until(lambda: bed.node.left)
    assert bed.node.open == 0 and bed.node.left == [None]
    bench.until(bed.node._driver.ended)
    assert bed.node.trigger_configure() == TransitionCallbackReturn.SUCCESS and bed.node.open == 1


def test_interrupt_ends_the_waiting_for_a_device_that_does_not_connect(bench, monkeypatch):
    monkeypatch.setattr(stage_node, "LONGEST_SILENCE", 0.1)
    asked = iter([False, False, True])
    monkeypatch.setattr(stage_node.interrupts, "received", lambda: next(asked))
    bed = Bed(bench, autostart=False)
    bed.node.fault = "hanging connect"
    assert bed.node.trigger_configure() == TransitionCallbackReturn.FAILURE and bed.node._refusal == "interrupted"
    bed.node.answering.set()


def test_measurement_of_another_form_is_refused_when_a_stage_is_configured(bench):
    bed = Bed(bench, autostart=False)
    bed.node.answer = [1.0, 2.0]
    assert not change(bench, "stage", "configure")
    assert bed.node._refusal.startswith("read() must return 1 values") and bed.node.open == 0


def test_stage_whose_sensor_has_nothing_yet_can_be_configured(bench, monkeypatch):
    monkeypatch.setattr(Drive, "read", lambda self: None)
    bed = moving(bench)
    assert bed.node.state == "active" and bed.node.counts["measurement: none new"] > 0


@pytest.mark.parametrize("method", ["read", "write"])
def test_method_that_a_stage_lacks_is_named(bench, monkeypatch, method):
    monkeypatch.setattr(Drive, method, getattr(StageNode, method))
    bed = Bed(bench, autostart=False)
    assert change(bench, "stage", "configure") == (method == "write")
    if method == "read":
        assert bed.node._refusal == "Drive has no read()"
        return
    assert change(bench, "stage", "activate")
    bench.until(lambda: bed.node.left)
    assert bed.node.counts["write: failed"] == SETTINGS["failures"]


PROGRAM = """
import sys
sys.path.insert(0, {folder!r})
from test_stage_faults import Hanging

from hyst_control.hardware import main
raise SystemExit(main(Hanging))
"""


class Hanging(Drive):
    """A stage whose driver never comes back from the call that the environment names."""

    def hang(self, where):
        if os.environ["HANGS"] == where:
            print("hangs", flush=True)
            time.sleep(1e6)

    def connect(self):
        self.hang("connect")

    def read(self):
        if self.active:
            self.hang("read")
        return [1.0]


@pytest.mark.parametrize("where, number", [("connect", signal.SIGINT), ("read", signal.SIGINT), ("read", signal.SIGTERM)])
def test_process_whose_driver_hangs_ends_by_an_interrupt(domain, where, number):
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(folder=str(Path(__file__).parent))],
        env={**os.environ, "HANGS": where},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout.readline() == "hangs\n"
            if where == "read":
                assert any("driver does not answer since" in line for line in process.stderr)
            process.send_signal(number)
            told = process.communicate(timeout=20)[1]
        finally:
            process.kill()
    assert process.returncode == 0 and "Traceback" not in told
    assert where == "connect" or "ended without disconnecting" in told
