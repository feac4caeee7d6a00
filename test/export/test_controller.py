# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The exported controller: to the bit what the nodes' own parts do tick by tick, over faults, limits, learned rows and preview."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.control.feedback.filters import Filters
from hyst_control.control.feedback.loop import feedforward_rows
from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.export.c_source import Program
from hyst_control.export.compiled import CompiledProgram
from hyst_control.export.controller import Controller, FaultResponse
from hyst_control.export.programs import controller
from hyst_control.model_file import load_model

RATE = 20000.0


def compiled(controller: Controller, axes: tuple[str, ...] = ("x",), real: str = "double") -> CompiledProgram:
    program = Program("loop", controller.c_code(), len(axes), *controller.slots(axes, "um"), 1 / RATE, ("of a test",), real)
    return CompiledProgram(program)


def rows(seed: int, count: int, axes: int) -> np.ndarray:
    """References and measurements with NaN, infinities, long gaps, frozen and far samples, and a loop that is stopped for a while."""
    random = np.random.default_rng(seed)
    given = np.cumsum(random.normal(0.0, 0.02, (count, 2 * axes)), axis=0) + 4.0
    table = np.concatenate([given, np.ones((count, 1))], axis=1)
    table[random.random(count) < 0.01, 0] = np.nan
    table[random.random(count) < 0.01, -2] = np.inf
    table[600:760, 0] = np.nan
    table[1000:1180, -2] = -np.inf
    table[1400:2000, axes : 2 * axes] = 2.5
    table[2000:2003, axes] = 900.0
    table[2400:2600, -1] = 0.0
    table[:3, axes] = np.nan
    table[300, axes - 1] = 1e308  # too large for the steep law
    table[700:3000:600, -1] = 0.0  # raised again one tick later: ends a fault with manual recovery
    return table


FILTERS = Filters(1e-4, 3000.0, (800.0, 2500.0), (0.7, 0.3), (0.1, 0.02), 0.2, 900.0)
LAWS = {
    "integral": PI(0.3, 900.0, 1 / RATE, 0.0, 50.0, 2e5),
    "roll-off": PI(0.3, 900.0, 1 / RATE, 0.0, 50.0, 2e4, roll_off=300.0),
    "steep": PI(30.0, 900.0, 1 / RATE, 0.0, 50.0, 2e5),
    "proportional": PI(0.8, 0.0, 1 / RATE, -5.0, 50.0),
    "filters": PI(0.3, 900.0, 1 / RATE, 0.0, 50.0, 2e5, roll_off=2000.0, filters=FILTERS),
    "filters, proportional": PI(0.8, 0.0, 1 / RATE, -5.0, 50.0, roll_off=2000.0, filters=FILTERS),
}
RESPONSES = [("automatic", 1, "all"), ("manual", 2, "own")]
MORE = [("manual", 1, "all"), ("automatic", 2, "own"), ("automatic", 2, "all"), ("manual", 2, "all")]
CHOICES = [(law, *response) for law in LAWS for response in RESPONSES] + [("integral", *response) for response in MORE]
"""Law, recovery, axes, and which of them a fault stops: every law, and every response to faults, which knows nothing of the law."""


@pytest.mark.parametrize(("law", "recovery", "axes", "axis_fault"), CHOICES)
def test_c_and_python_agree_to_the_last_bit(law, recovery, axes, axis_fault):
    learned = np.random.default_rng(3).normal(0.0, 2.0, (37, axes))
    loop = FaultResponse((2.0,), 3000.0, axis_fault, 0.005, recovery, 0.01, -10.0, 30.0, 0.005)
    controller = Controller(LAWS[law], axes, loop, None, learned)
    c = compiled(controller, ("x", "y")[:axes])
    table = rows(4, 3000, axes)
    expected = controller.process(table)
    assert set(expected[:, -1]) >= {0.0, 1.0, 2.0, 3.0} | ({5.0} if law == "steep" else set()), "faults are in the test"
    if axis_fault == "own":
        assert np.any((expected[:, 0] == 2.0) != (expected[:, 1] == 2.0)), "one axis stops alone"
    assert np.isfinite(expected).all()
    if LAWS[law].slew_limit:
        step = LAWS[law].slew_limit / RATE
        assert np.abs(np.diff(expected[:, :axes], axis=0)).max() <= step * (1 + 1e-12)
    c.settle(table[0])
    first = c.process(table[:1500])
    saved = c.state.copy()
    c.process(table[:99])
    c.state[:] = saved
    np.testing.assert_array_equal(np.concatenate([first, c.process(table[1500:])]), expected)


def test_a_frozen_measurement_sends_the_command_to_safety_and_back():
    controller = Controller(LAWS["integral"], 1, FaultResponse((7.0,), 1e4, frozen_time=0.005, recovery_time=0.01))
    c = compiled(controller)
    random = np.random.default_rng(0)
    table = np.concatenate([random.normal(4.0, 0.1, (2000, 2)), np.ones((2000, 1))], axis=1)
    table[500:1000, 1] = 3.0
    c.settle(table[0])
    found = c.process(table)
    np.testing.assert_array_equal(found, controller.process(table))
    assert set(found[:, 3]) == {0.0, 4.0}
    assert found[999, 0] == 7.0 and found[999, 3] == 4.0 and found[1300, 3] == 0.0


def test_float_follows_double():
    controller = Controller(LAWS["roll-off"], 1, FaultResponse(frozen_time=0.0))
    c = compiled(controller, real="float")
    time = np.arange(3000) / RATE
    table = np.stack([3.0 + np.sin(60 * time), 3.0 + np.sin(60 * time - 0.01), np.ones(3000)], axis=1).astype(np.float32)
    expected = controller.process(table.astype(float))
    c.settle(table[0])
    np.testing.assert_allclose(c.process(table)[:, 0], expected[:, 0], atol=1e-5 * 50.0)


@pytest.mark.parametrize("preview", [True, False])
def test_a_feedforward_that_previews_meets_the_feedback_at_its_tick(preview):
    """The same as the offline loop: feedforward rows shifted by the preview, and the law of `control.pi`."""
    model = load_model(config_path("models/pea_hampi.yaml"))
    compensator = build_compensator(model, "hampi", sample_time=1 / RATE, preview=preview)
    pi = LAWS["integral"]
    controller = Controller(pi, 1, FaultResponse(frozen_time=0.0), compensator)
    c = compiled(controller)
    count, ahead = 2000, compensator.preview
    assert bool(ahead) == preview
    time = np.arange(count) / RATE
    reference = (2.0 * (1 - np.cos(2 * np.pi * 150.0 * time)))[:, None]
    measurement = reference - 0.01 * np.sin(900.0 * time)[:, None]
    early = np.concatenate([reference, np.repeat(reference[-1:], ahead, axis=0)])
    late = np.concatenate([np.repeat(measurement[:1], ahead, axis=0), measurement])
    table = np.concatenate([early, late, np.ones((len(early), 1))], axis=1)
    c.settle(table[0])
    found = c.process(table)
    controller.settle(table[0])
    np.testing.assert_array_equal(controller.process(table), found)
    ahead_rows = feedforward_rows(reference, compensator)
    np.testing.assert_array_equal(found[ahead:, 2], ahead_rows[:, 0])
    if not ahead:  # with a preview, the controller has run for some ticks before the first one
        running = pi.start(1)
        running.reset(np.zeros(1))
        command, feedback = running.step(reference, measurement, ahead_rows)
        np.testing.assert_array_equal(found[:, 0], command[:, 0])
        np.testing.assert_array_equal(found[:, 1], feedback[:, 0])


def test_unusable_settings_are_one_line():
    with pytest.raises(InputError, match="safe_command: 3 values for 2 axes"):
        Controller(LAWS["integral"], 2, FaultResponse((1.0, 2.0, 3.0)))
    with pytest.raises(InputError, match="recovery: 'never' is not one of automatic, manual"):
        FaultResponse(recovery="never")
    with pytest.raises(InputError, match="axis_fault: 'none' is not one of all, own"):
        FaultResponse(axis_fault="none")


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("safe_command: [x]", "pi_feedback.safe_command: must be a number, got 'x'"),
        ("safe_command: ['1.0']", "pi_feedback.safe_command: must be a number, got '1.0'"),
        ("safe_command: true", "pi_feedback.safe_command: must be a number, got True"),
    ],
)
def test_a_safe_command_that_is_no_number_is_one_line(wrong, told, tmp_path):
    (tmp_path / "loop.yaml").write_text(f"pi_feedback: {{ros__parameters: {{kp: 1.0, {wrong}}}}}")
    with pytest.raises(InputError, match=told):
        controller(tmp_path / "loop.yaml")


def test_a_model_that_is_nowhere_is_told_with_both_places(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "nodes").mkdir()
    nodes = "pi_feedback: {ros__parameters: {kp: 1.0}}\nhampi_feedforward: {ros__parameters: {model: hampi.yaml}}"
    (tmp_path / "nodes" / "loop.yaml").write_text(nodes)
    with pytest.raises(
        InputError, match="hampi.yaml: is neither in the present folder nor in nodes: put it there, or give its path"
    ):
        controller("nodes/loop.yaml")
