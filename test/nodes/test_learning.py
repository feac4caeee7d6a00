"""Learning in the nodes, in lockstep: what is recorded equals the offline computation to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from loop_case import MODEL, RATE, SIGNALS, parameters, recorded
from pipeline_thread import ProcessesBesideThread
from rclpy.parameter import Parameter

from hyst_control.base.errors import InputError
from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.control.learning.feedback_error_learning import FeedbackErrorLearning
from hyst_control.control.learning.iterative_learning import IterativeLearning
from hyst_control.control.learning.learning_filter import model_filter
from hyst_control.control.learning.learning_loop import Played, run_learning_loop
from hyst_control.model_file import Simulator, load_model
from hyst_control.nodes.execution.run import run
from hyst_control.nodes.hampi_feedforward import HampiFeedforward
from hyst_control.nodes.pi_feedback import PiFeedback
from hyst_control.nodes.recorder import Recorder
from hyst_control.nodes.reference_generator import ReferenceGenerator
from hyst_plant_sim.node import PlantNode

CLASSES = {
    "reference_generator": ReferenceGenerator,
    "hampi_feedforward": HampiFeedforward,
    "pi_feedback": PiFeedback,
    "plant": PlantNode,
    "recorder": Recorder,
}
PERIOD = 200
TICKS = 9 * PERIOD
WAVE = (1.0 + (1 - np.cos(2 * np.pi * np.arange(PERIOD) / PERIOD)))[:, None]
"""um; from 0.5 um the command would be at 0 V over a part of the period, where there is nothing to be learned: the error grows."""
ROLL_OFF = 900.0
TRIALS = {"learning": "trials", "learning_period": PERIOD}
FEEDBACK_ERROR = {"learning": "feedback_error", "learning_time": 0.02, "learning_corner": 20.0}


def settings(folder, **learning):
    np.save(folder / "reference.npy", WAVE)
    return parameters(
        folder,
        TICKS,
        reference_generator={"repeat": True, "ramp_time": 0.0},
        hampi_feedforward=learning,
        pi_feedback={"roll_off": ROLL_OFF},
        recorder={"topics": [*SIGNALS, "learned"]},
    )


def offline(learner):
    """The same run without nodes; the reference goes on, so that the compensator's preview sees what it sees in the nodes."""
    model = load_model(MODEL)
    compensator = build_compensator(model, "hampi", sample_time=1 / RATE, limits=(0.0, 150.0))
    controller = PI(0.5, 2000.0, 1 / RATE, 0.0, 150.0, 2e5, roll_off=ROLL_OFF).start(1)
    signals = run_learning_loop(
        np.tile(WAVE, (TICKS // PERIOD + 1, 1)), compensator, controller, Simulator(model, 1 / RATE), learner
    )
    return {topic: rows[:TICKS] for topic, rows in signals.items()}


def composed(context, given):
    nodes = [
        CLASSES[name](context=context, parameter_overrides=[Parameter(key, value=value) for key, value in given[name].items()])
        for name in CLASSES
    ]
    assert run(nodes, context, timeout=60.0) == 0


def assert_same(bag, expected):
    found = recorded(bag)
    assert set(found) == set(expected)
    for topic, rows in expected.items():
        np.testing.assert_array_equal(found[topic][:, 0], np.arange(TICKS) * (1 / RATE), err_msg=topic)
        np.testing.assert_array_equal(found[topic][:, 1:], rows, err_msg=topic)


def learner_of_trials(begin=None):
    return IterativeLearning(model_filter(load_model(MODEL), PERIOD, sample_time=1 / RATE)).start(begin)


def test_trials_in_the_node_equal_offline(tmp_path, ros_context):
    composed(ros_context, settings(tmp_path, **TRIALS))
    learner = learner_of_trials()
    expected = offline(learner)
    assert len(learner.history) == 3 and learner.history[1].error < 0.5 * learner.history[0].error
    assert np.any(expected["learned"] != 0.0)
    assert_same(tmp_path / "bag", expected)


def test_feedback_error_learning_in_the_node_equals_offline(tmp_path, ros_context):
    composed(ros_context, settings(tmp_path, **FEEDBACK_ERROR))
    learner = FeedbackErrorLearning(1 / RATE, 0.02, 20.0).start(1)
    expected = offline(learner)
    assert learner.gain[0] != 0.0 and learner.lag[0] != 0.0
    assert_same(tmp_path / "bag", expected)


def test_what_was_learned_before_is_played_and_learned_on(tmp_path, ros_context):
    before = np.sin(2 * np.pi * np.arange(PERIOD) / PERIOD)[:, None]
    np.save(tmp_path / "before.npy", before)
    composed(ros_context, settings(tmp_path, learning="played", learned_file=str(tmp_path / "before.npy")))
    expected = offline(Played(before))
    np.testing.assert_array_equal(expected["learned"], np.tile(before, (TICKS // PERIOD, 1)))
    assert_same(tmp_path / "bag", expected)


def test_a_feedforward_in_a_process_of_its_own_learns_alike(tmp_path, domain):
    before = np.sin(2 * np.pi * np.arange(PERIOD) / PERIOD)[:, None]
    np.save(tmp_path / "before.npy", before)
    given = settings(tmp_path, **TRIALS, learned_file=str(tmp_path / "before.npy"))
    with ProcessesBesideThread(tmp_path / "log", domain) as processes:
        processes.compose({name: own for name, own in given.items() if name != "hampi_feedforward"})
        processes.start("hampi_feedforward", given["hampi_feedforward"])
        processes.wait("pipeline", timeout=90)
        assert set(processes.stop().values()) == {0}
    assert_same(tmp_path / "bag", offline(learner_of_trials(before)))


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"learning": "trials"}, "learning_period"),
        ({"learning": "played"}, "learned_file"),
        ({"learning": "played", "learned_file": "absent.npy"}, "learned_file"),
        ({"learning": "feedback_error", "learning_time": 1e-6}, "time"),
    ],
)
def test_what_cannot_be_learned_is_refused_by_name(ros_context, given, word):
    values = {"kind": "proportional", "gain": [1.0], **given}
    with pytest.raises(InputError, match=word):
        HampiFeedforward(context=ros_context, parameter_overrides=[Parameter(key, value=value) for key, value in values.items()])
