# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes as a ROS user meets them: parameters that are refused, changed and described, states in the log, arguments of the executables."""

from __future__ import annotations

import logging
import signal
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from loop_case import MODEL
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import Parameter
from scipy.special import betainc
from std_srvs.srv import Trigger

from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.hardware import StageNode
from hyst_control.hardware.simulated_converter import SimulatedStage
from hyst_control.nodes.execution import command_line
from hyst_control.nodes.execution.ending_node import EndingNode
from hyst_control.nodes.execution.run import main
from hyst_control.nodes.hampi_feedforward import HampiFeedforward
from hyst_control.nodes.identification import Identification
from hyst_control.nodes.pi_feedback import PiFeedback
from hyst_control.nodes.pipeline import COMPOSABLE, node_class
from hyst_control.nodes.recorder import Recorder
from hyst_control.nodes.reference_generator import ReferenceGenerator
from hyst_control.nodes.signal_node.common_parameters import COMMON
from hyst_control.nodes.signal_node.node_diagnostics import NodeHealth, StateLog
from hyst_control.processes import executables
from hyst_control.processes.node_list import NODES
from hyst_control.records.stream.signal_rows import Wait
from hyst_plant_sim.node import PlantNode

RATE = 1000.0
SINE = {"signal": "sine", "frequency": 5.0, "amplitude": 2.0, "offset": 3.0, "duration": 0.2, "repeat": True}


def changed(bench, node, **values):
    """Answers of `ros2 param set`, one after the other: [(successful, reason)]."""
    given = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    answer = bench.call(SetParameters, f"/{node}/set_parameters", SetParameters.Request(parameters=given))
    return [(result.successful, result.reason) for result in answer.results]


@pytest.mark.parametrize(
    ("node", "needed", "name", "meant"),
    [
        (PiFeedback, {}, "uper", "upper"),
        (PiFeedback, {}, "kP", "kp"),
        (PiFeedback, {}, "frozentime", "frozen_time"),
        (HampiFeedforward, {"kind": "proportional"}, "Gain", "gain"),
        (PlantNode, {"model": MODEL}, "most_ahed", "most_ahead"),
        (ReferenceGenerator, SINE, "amplitud", "amplitude"),
        (ReferenceGenerator, {"signal": "rest", "duration": 1.0}, "amplitude", ""),
        (Identification, {}, "familiy", "family"),
    ],
)
def test_a_parameter_that_does_not_exist_is_refused_with_the_nearest_name(node, needed, name, meant, ros_context, tmp_path):
    given = [Parameter(key, value=value) for key, value in {**needed, name: 60.0}.items()]
    with pytest.raises(
        InputError, match=f"parameter {name}: there is no such parameter: {f'did you mean {meant}' if meant else ''}"
    ):
        node(context=ros_context, parameter_overrides=given)


def test_a_refused_recorder_leaves_no_bag(ros_context, tmp_path):
    given = [Parameter("output", value=str(tmp_path / "bag")), Parameter("tick", value=3)]
    with pytest.raises(InputError, match="did you mean ticks"):
        Recorder(context=ros_context, parameter_overrides=given)
    assert not (tmp_path / "bag").exists()


def test_a_composed_node_may_be_given_what_another_one_declares(ros_context, monkeypatch):
    monkeypatch.setattr(EndingNode, "elsewhere", frozenset({"kp"}))
    ReferenceGenerator(
        context=ros_context, parameter_overrides=[Parameter("kp", value=1.0)], signal=np.zeros((5, 1))
    ).destroy_node()


def test_what_is_given_to_a_composed_node_by_its_name_is_its_own(ros_context, monkeypatch, tmp_path):
    """Alone it refuses what it does not know; composed, a gain below the wrong name acted nowhere."""
    file = tmp_path / "p.yaml"
    file.write_text("/**: {ros__parameters: {ki: 1.0}}\n/**/reference_generator: {ros__parameters: {kp: 1.0}}\n")
    named = command_line.given_by_name(["--params-file", str(file), "-p", "plant:kp:=2.0"])
    assert named["reference_generator"] == named["plant"] == {"kp"}
    monkeypatch.setattr(EndingNode, "elsewhere", frozenset({"kp", "ki"}))
    monkeypatch.setattr(EndingNode, "named", named)
    given = [Parameter("ki", value=1.0), Parameter("kp", value=1.0)]
    with pytest.raises(InputError, match="reference_generator: parameter kp: there is no such parameter"):
        ReferenceGenerator(context=ros_context, parameter_overrides=given, signal=np.zeros((5, 1)))


def test_what_cannot_act_live_is_read_only_and_what_is_accepted_acts(bench):
    node = bench.add(PiFeedback, kp=1.0, ki=10.0, upper=100.0, rate_hz=RATE)
    for name, value in {"backend": "c", "feedback": False, "rate_hz": 10.0}.items():
        [(successful, reason)] = changed(bench, "pi_feedback", **{name: value})
        assert not successful and "read-only" in reason and name in reason
    assert changed(bench, "pi_feedback", kp=2.5, ki=20, upper=60.0, safe_command=[3.0], measurement_upper=7.0) == 5 * [(True, "")]
    law = node.loop.controller.description
    assert (law.kp, law.ki, law.upper) == (2.5, 20.0, 60.0)
    assert node.loop.safety.command.tolist() == [3.0] and node.loop.watch.upper == 7.0
    assert node.get_parameter("kp").value == 2.5
    for values, reason in (
        ({"kp": -1.0}, "range"),
        ({"lower": 70.0}, "lower: 70 V must be below upper, 60 V"),
        ({"kp": "much"}, "kp: must be a number"),
        ({"safe_command": [1.0, 2.0]}, "safe_command: 2 values, 1 axes"),
    ):
        [(successful, said)] = changed(bench, "pi_feedback", **values)
        assert not successful and reason in said
    assert node.loop.controller.description == law and node.settings.kp == 2.5


STARTED = {
    PiFeedback: {
        "lower": 10.0,
        "upper": 50.0,
        "slew_limit": 400.0,
        "safe_rate": 200.0,
        "timeout": 0.25,
        "ahead": 1.0,
        "frozen_time": 0.1,
        "overrun_ticks": 100,
        "measurement_lower": -1.0,
        "measurement_upper": 20.0,
        "recovery_time": 0.1,
        "rival_time": 0.5,
    },
    PlantNode: {"timeout": 0.25, "ahead": 1.0},
    SimulatedStage: {"timeout": 0.25, "ahead": 1.0},
}
NEEDED = {PiFeedback: {}, PlantNode: {"model": MODEL}, SimulatedStage: {"model": MODEL}}
LOWER_IS_WIDER = ("lower", "measurement_lower", "safe_rate", "recovery_time", "rival_time")
ZERO_IS_NONE = ("slew_limit", "frozen_time", "overrun_ticks")


@pytest.mark.parametrize("kind", STARTED)
def test_what_protects_the_actuator_may_be_narrowed_live_but_not_widened(bench, kind):
    """Limits, slew and timeouts, of every node that has any."""
    node = bench.add(kind, schedule="timer", rate_hz=100.0, **NEEDED[kind], **STARTED[kind])
    assert set(STARTED[kind]) == {each.name for each in (*COMMON, *kind.SETTINGS) if each.live and each.wider}
    name = node.get_name()
    for parameter, value in STARTED[kind].items():
        lower = parameter in LOWER_IS_WIDER
        wider, narrower = (type(value)(value + (-change if lower else change) * 0.2 * abs(value)) for change in (1.0, -1.0))
        for beyond in (wider, *([type(value)(0)] if parameter in ZERO_IS_NONE else [])):
            [(successful, reason)] = changed(bench, name, **{parameter: beyond})
            assert not successful and f"{parameter}: a live change may not widen it beyond {value:g}" in reason
            assert f"{'min' if lower else 'max'}_{parameter}" in reason
        assert changed(bench, name, **{parameter: narrower}) == [(True, "")]
        assert changed(bench, name, **{parameter: value}) == [(True, "")], "back to what it was started with"
    assert vars(node.settings).items() >= STARTED[kind].items()


def test_a_bound_given_at_the_start_allows_to_widen_as_far_as_it_says(bench, ros_context):
    node = bench.add(PiFeedback, upper=50.0, max_upper=80.0, max_slew_limit=0.0, slew_limit=100.0, rate_hz=RATE)
    assert changed(bench, "pi_feedback", upper=80.0, slew_limit=0.0) == 2 * [(True, "")]
    [(successful, reason)] = changed(bench, "pi_feedback", upper=80.1)
    assert not successful and "80 V, got 80.1" in reason and node.settings.upper == 80.0
    [(successful, reason)] = changed(bench, "pi_feedback", max_upper=1e6)
    assert not successful and "read-only" in reason
    given = [Parameter("upper", value=50.0), Parameter("max_upper", value=40.0)]
    with pytest.raises(InputError, match="parameter max_upper: is narrower than upper, 50, got 40"):
        PiFeedback(context=ros_context, parameter_overrides=given)


def test_gains_that_are_compiled_in_are_refused(bench):
    node = bench.add(PiFeedback, kp=1.0, ki=10.0, backend="c", min_safe_rate=5.0, rate_hz=RATE)
    [(successful, reason)] = changed(bench, "pi_feedback", kp=2.0)
    assert not successful and "backend: c" in reason
    assert node.settings.kp == 1.0 and changed(bench, "pi_feedback", safe_rate=7.0) == [(True, "")]


def test_the_reference_goes_over_to_a_new_amplitude_without_a_jump(bench):
    """Lockstep: every row is compared with the closed form, also those that are sent again."""
    node = bench.add(ReferenceGenerator, rate_hz=RATE, transition=0.1, ramp_time=0.0, **SINE)
    bench.listen("reference")
    measurement = bench.sender("measurement", "t[s],x[um]")
    bench.until(lambda: bench.heard["reference"])
    measurement.send(np.column_stack([np.arange(50) / RATE, np.zeros(50)]))
    bench.until(lambda: node._end >= 50)
    assert changed(bench, "reference_generator", amplitude=0.5, lower=2.4) == [(True, ""), (True, "")]
    [(successful, reason)] = changed(bench, "reference_generator", amplitude=9.0)  # below its own `lower`
    assert not successful and "lower the amplitude" in reason
    first = node._end
    measurement.send(np.column_stack([np.arange(50, 400) / RATE, np.zeros(350)]))
    bench.until(lambda: node._end >= 400)
    ticks = np.arange(400)
    old, new = (3.0 + amplitude * np.sin(2 * np.pi * 5.0 * ticks / RATE) for amplitude in (2.0, 0.5))
    expected = old + betainc(3, 3, np.clip(ticks - first + 1, 0, 100) / 100) * (new - old)
    np.testing.assert_allclose(node.rows(0, 400)[:, 0], expected, atol=1e-12)
    bench.until(lambda: any(round(block[-1, 0] * RATE) >= 399 for block in bench.heard["reference"]))
    for block in bench.heard["reference"]:
        at = np.rint(block[:, 0] * RATE).astype(int)
        np.testing.assert_allclose(block[at < 400, 1], expected[at[at < 400]], atol=1e-12)


def test_parameters_of_a_signal_are_described(bench):
    bench.add(ReferenceGenerator, rate_hz=RATE, **SINE)
    request = DescribeParameters.Request(names=["frequency", "amplitude"])
    frequency, amplitude = bench.call(DescribeParameters, "/reference_generator/describe_parameters", request).descriptors
    assert "Frequency" in frequency.description and "[Hz]" in frequency.description
    assert "[signal unit]" in amplitude.description and amplitude.floating_point_range[0].to_value == 1e12


def test_lists_have_their_range_in_the_descriptor(bench):
    [described] = bench.add(PiFeedback, rate_hz=RATE).describe_parameters(["safe_command"])
    assert (described.floating_point_range[0].from_value, described.floating_point_range[0].to_value) == (-1e6, 1e6)


class Log:
    """Node whose logger keeps its lines."""

    def __init__(self, **remedies):
        self.lines, self.REMEDIES = [], remedies

    def get_logger(self):
        return self

    def info(self, text):
        self.lines.append((logging.INFO, text))

    def warning(self, text):
        self.lines.append((logging.WARNING, text))


def test_a_node_says_what_it_does_once_for_every_state():
    log = Log(recorded="is a recorder running?")
    state = StateLog(log)
    waiting = NodeHealth(waits=[Wait("recorded", 0, 2.5)])
    for health in (
        NodeHealth(unheard=["measurement"]),
        waiting,
        NodeHealth(waits=[Wait("recorded", 0, 3.5)]),
        NodeHealth(),
        NodeHealth(),
        NodeHealth(slow="844 of 1000 Hz: 156 ticks missed"),
        NodeHealth(slow="850 of 1000 Hz: 150 ticks missed"),
        NodeHealth(),
        NodeHealth(enabled=False),
        NodeHealth(),
        waiting,
    ):
        state.tell(health)
    assert log.lines == [
        (logging.INFO, "waiting for measurement: nothing has come yet"),
        (logging.INFO, "waiting for recorded, tick 0: is a recorder running?"),
        (logging.INFO, "running"),
        (logging.WARNING, "844 of 1000 Hz: 156 ticks missed"),
        (logging.INFO, "running again, after: 844 of 1000 Hz: 156 ticks missed"),
        (logging.WARNING, "stopped"),
        (logging.INFO, "running again, after: stopped"),
        (logging.WARNING, "waiting for recorded, tick 0: is a recorder running?"),
    ]


def test_diagnostics_say_stopped(bench):
    bench.add(PiFeedback, rate_hz=RATE)
    bench.listen_to_diagnostics()
    assert bench.call(Trigger, "/pi_feedback/stop", Trigger.Request()).success
    bench.until(lambda: bench.said.get("/pi_feedback: loop", {}).get("message") == "stopped")


@pytest.mark.parametrize(("ticks", "missed", "said"), [(844, 156, "844 of 1000 Hz: 156 ticks missed"), (999, 1, ""), (1000, 0, "")])
def test_a_rate_that_is_not_kept_is_a_warning(ticks, missed, said, bench):
    node = bench.add(PiFeedback, rate_hz=RATE, schedule="timer")
    assert node.timer.slow(ticks, missed, 1.0) == said
    assert NodeHealth(slow=said).warns == bool(said)


def test_diagnostics_are_made_in_parts_after_successive_ticks(bench):
    """Made all at once they would take about a tick at 1 kHz; where no tick comes, they do not wait for one."""
    node = bench.add(PiFeedback, rate_hz=RATE, schedule="timer")
    published = []
    node.diagnostics._publisher = SimpleNamespace(publish=published.append)
    node.diagnostics.publish()  # it has not ticked yet
    assert len(published) == 1
    node.counts["ticks"] += 10
    node.diagnostics.publish()
    parts = 1
    while len(published) == 1 and parts < 20:
        node.diagnostics.go_on()
        parts += 1
    assert 3 <= parts < 20
    node.diagnostics.publish()
    assert len(published) == 3
    keys = [{each.key for each in message.status[0].values} for message in published]
    assert {"ticks", "rate [Hz]"} <= keys[0] == keys[1] == keys[2]


def test_a_plant_that_stood_still_with_its_process_repeats_nothing(bench):
    """Late calls of the timer in a row are one look, and a command that waits to be served is no loss."""
    node = bench.add(PlantNode, model=MODEL, rate_hz=RATE, retry=60.0)
    repeated = []
    node.measurement.repeat = node.measurement.repeat_newest = lambda *given: repeated.append(given)
    sender = bench.sender("command", "t[s],x[V]")
    bench.until(lambda: node._tick == 0)

    def look(calls):
        node._looked -= 60.0
        for _ in range(calls):
            node._retry()

    look(1)
    look(5)
    assert node._standstill.looks == 1
    sender.send(np.array([[0.0, 1.0]]))
    bench.until(lambda: node._tick == 1)
    node._confirm()
    assert not repeated
    look(1)
    look(1)
    node._confirm()
    assert len(repeated) == 1


@pytest.mark.parametrize("name", [*COMPOSABLE, "identification"])
def test_help_lists_every_parameter_with_unit_and_default(name, capsys):
    node = Identification if name == "identification" else node_class(name)
    assert main(node, args=[name, "--help"]) == 0
    text = capsys.readouterr().out
    for setting in (*node.SETTINGS, *(COMMON if name != "identification" else ())):
        line = next(line for line in text.splitlines() if line.startswith(f"  {setting.name}  ["))
        assert setting.unit in line and "default" in line and (("live" in line) == setting.live or setting.name == "schedule")


def test_a_parameter_file_that_is_missing_is_one_line(capsys):
    assert main(PiFeedback, args=["pi_feedback", "--ros-args", "--params-file", "nowhere.yaml"]) == 2
    assert capsys.readouterr().err == "--params-file nowhere.yaml: there is no such file\n"


@pytest.mark.parametrize(
    "text, said",
    [
        ("/**/pi_feedback: {kp: 1.0}", "/**/pi_feedback: has no ros__parameters: put the parameters below it"),
        ("a: [", "is not valid YAML"),
        ("3", "must be nodes with their ros__parameters"),
    ],
)
def test_a_parameter_file_of_another_form_is_one_line(text, said, tmp_path, capsys):
    (tmp_path / "p.yaml").write_text(text)
    assert main(PiFeedback, args=["pi_feedback", "--ros-args", "--params-file", str(tmp_path / "p.yaml")]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


class MyStage(StageNode):
    """A stage of a user, as in docs/hardware.md."""

    NAME = "my_stage"


def test_a_misspelt_section_of_a_node_is_refused_where_it_runs_and_told_elsewhere(tmp_path, capsys):
    """Limits of a loop are in such sections: with a misspelled name they would act nowhere."""
    file = tmp_path / "p.yaml"
    file.write_text("/**: {ros__parameters: {}}\n/**/pi_feedbak: {ros__parameters: {}}\nlab: {second: {ros__parameters: {}}}\n")
    given = ["--ros-args", "--params-file", str(file)]
    told = f"--params-file {file}: /**/pi_feedbak: no node has this name: did you mean pi_feedback?"
    assert command_line.check(given, [Recorder]) == [told]
    for nodes in ([PiFeedback], [Recorder, PiFeedback]):
        assert main(*nodes, args=["pi_feedback", *given]) == 2
        assert capsys.readouterr().err == told + "\n"
    assert command_line.check([*given, "-p", "pi_feedback:kp:=1.0"], [PiFeedback]) == [], "its section is another one"
    for shipped in sorted(config_path("nodes/tracking.yaml").parent.glob("*.yaml")):
        assert command_line.check(["--params-file", str(shipped)]) == []


def test_a_stage_of_a_user_has_a_section(tmp_path):
    """The node itself is known, others take it for one of another process."""
    file = tmp_path / "p.yaml"
    file.write_text("/**/my_stage: {ros__parameters: {}}\n/**/pi_feedback: {ros__parameters: {}}\n")
    for node in (MyStage, PiFeedback, Recorder):
        assert command_line.check(["--params-file", str(file)], [node]) == []
    file.write_text("/**/my_stag: {ros__parameters: {}}\n")
    with pytest.raises(InputError, match="my_stag: no node has this name: did you mean my_stage"):
        command_line.check(["--params-file", str(file)], [MyStage])


def test_a_feedforward_that_looks_ahead_says_what_lead_it_waits_for(bench):
    node = bench.add(HampiFeedforward, model=MODEL, rate_hz=RATE)
    ahead = node.status()["preview [ticks]"]
    assert ahead > 0 and f"a lead of {ahead} at least" in node.REMEDIES["reference"]


def test_arguments_that_nobody_looks_at_are_refused():
    command_line.check_rest("/bin/pi_feedback", [])
    with pytest.raises(InputError, match="pi_feedback: -p: there is no such argument: put --ros-args before it"):
        command_line.check_rest("/bin/pi_feedback", ["-p", "kp:=1.0"])


def test_a_recorder_says_how_much_it_has_recorded(bench, tmp_path):
    recorder = bench.add(Recorder, output=str(tmp_path / "bag"), topics=["command", "measurement"], rate_hz=RATE)
    log = Log()
    recorder.get_logger = log.get_logger
    recorder._topics[0].receive("t[s],x[V]", np.column_stack([np.arange(7) / RATE, np.zeros(7)]))
    recorder.close()
    recorder.close()
    assert log.lines == [
        (logging.INFO, f"{tmp_path / 'bag'}: recorded 0 to 7 rows of each of 2 topics"),
        (logging.WARNING, "nothing has come on /measurement"),
    ]


@pytest.mark.parametrize("module", ["hyst_control.nodes.pi_feedback", "rclpy", "hyst_control.nodes.execution.interrupts"])
def test_an_interrupt_while_a_node_is_being_loaded_prints_nothing(module):
    program = f"""
import os, signal, sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
from hyst_control.processes import executables
executables.pi_feedback()
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert ended.returncode == -signal.SIGINT and ended.stderr == ""


def test_every_installed_node_has_its_executable():
    for name, entry in NODES.items():
        assert getattr(executables, name).args == (name,) and entry.module
    with pytest.raises(AttributeError):
        executables.no_such_node()
