# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Choice between families: slow ones are tried only where the usual ones do badly, and win only by their held-out error."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from hyst_control.base.errors import InputError
from hyst_control.identify import Fit, workflow
from hyst_control.identify.assess.attainable import leaves_noise
from hyst_control.identify.assess.model_choice import POOR, USELESS, best_family
from hyst_control.identify.workflow import identified
from hyst_control.model_file import simulate
from hyst_control.records.record import sampled_record


class Stand:
    """Fits by name of given held-out errors (%) and numbers of parameters; notes which were asked for."""

    def __init__(self, **known: tuple[float, int]) -> None:
        self.known, self.asked = known, []

    def __call__(self, name: str) -> Fit:
        self.asked.append(name)
        if name not in self.known:
            raise InputError(f"{name}: does not suit")
        error, count = self.known[name]
        return Fit(None, {"family": name, "held_out_nrmse": [error], "parameters": [{}] * count, "records": [], "notes": []})


def slow_too(best):
    return ["slow"]


def test_of_those_named_for_the_best_one_the_first_that_does_well_ends_the_search():
    stand = Stand(a=(2.0 * POOR, 5), quick=(0.1, 7), slow=(0.05, 20))
    named = []

    def further(best):
        named.append(best.report["family"])
        return ["quick", "slow"]

    assert best_family(["a"], stand, further).report["family"] == "quick"
    assert stand.asked == ["a", "quick"] and named == ["a"]


@pytest.mark.parametrize(
    "first, slow, asked, chosen",
    [
        (0.9 * POOR, 0.1, ["a", "b"], "a"),
        (1.5 * POOR, 0.1, ["a", "b", "slow"], "slow"),
        (0.91, 0.2, ["a", "b", "slow"], "slow"),  # what hampi leaves of the plant `third`: too much
        (1.5 * POOR, 1.6 * POOR, ["a", "b", "slow"], "a"),
    ],
)
def test_the_second_choice_is_tried_where_the_first_is_poor_and_wins_by_its_error(first, slow, asked, chosen):
    stand = Stand(a=(first, 5), b=(2.0 * first, 3), slow=(slow, 20))
    fit = best_family(["a", "b"], stand, slow_too)
    assert stand.asked == asked and fit.report["family"] == chosen
    assert [row["family"] for row in fit.report["tried"] if row["chosen"]] == [chosen]


def test_a_second_choice_that_does_not_suit_leaves_the_first():
    fit = best_family(["a"], Stand(a=(2.0 * POOR, 5)), slow_too)
    assert fit.report["family"] == "a" and fit.report["tried"][1]["refused"] == "slow: does not suit"


def test_the_families_named_for_a_better_one_are_asked_anew():
    stand = Stand(a=(3.0 * POOR, 5), quick=(2.0 * POOR, 7), slow=(0.1, 20))
    further = {"a": ["quick", "slow"], "quick": []}  # the quick one leaves noise: the slow one could not be better
    fit = best_family(["a"], stand, lambda best: further[best.report["family"]])
    assert fit.report["family"] == "quick" and stand.asked == ["a", "quick"]


@pytest.mark.parametrize("error, is_noise", [("white", True), ("slow", False), ("quick", False), ("small", True)])
def test_only_white_errors_beyond_the_limit_are_noise(error, is_noise):
    rows = np.arange(8000)
    values = {
        "white": 0.02 * np.random.default_rng(4).normal(size=len(rows)),
        "slow": 0.02 * np.sin(0.05 * rows),
        "quick": 0.02 * np.sin(2.9 * rows),
        "small": 0.005 * np.sin(0.05 * rows),
    }[error]
    motion = np.sin(0.01 * rows)
    record = sampled_record("one", motion[:, None], motion[:, None], 1e-3, ("x",), "um", "zoh", "unknown")
    assert leaves_noise([record], [values[:, None]], 0.005) is is_noise


def test_a_family_whose_simulation_explains_nothing_is_passed_over():
    """Rows that were not fitted are predicted with a zero of their own, and do not show that a simulation runs away."""
    stand = Stand(a=(0.2, 5), b=(0.4, 3), slow=(0.3, 20))
    fit = best_family(["a", "b"], stand, slow_too, lambda fit: fit.report["family"] != "a")
    assert stand.asked == ["a", "b"] and fit.report["family"] == "b"
    assert fit.report["tried"][0]["refused"] == USELESS


def test_the_second_choice_is_tried_where_no_other_simulation_is_of_use():
    stand = Stand(a=(0.2, 5), slow=(0.4, 20))
    assert best_family(["a"], stand, slow_too, lambda fit: fit.report["family"] == "slow").report["family"] == "slow"
    assert best_family(["a"], stand, slow_too, lambda fit: False).report["family"] == "a"


THREE = {180.0: 0.1, 520.0: 0.05, 1350.0: 0.04}


def modes(command, gains, step=1e-4):
    """Modes (Hz) of a stage without hysteresis, each with its gain, exactly as a converter holds their command."""
    answer = np.zeros(len(command))
    for frequency, gain in gains.items():
        omega = 2 * np.pi * frequency
        top, bottom, _ = cont2discrete(([gain * omega**2], [1.0, 0.06 * omega, omega**2]), step, "zoh")
        answer += lfilter(np.ravel(top)[1:], bottom, np.concatenate([[0.0], command[:-1]]))
    return answer


@pytest.fixture
def one_family_of_play_operators(monkeypatch):
    """The quickest of those that are compared: the others take half a minute."""
    monkeypatch.setattr(workflow, "chosen_families", lambda *_: ["pi"])


@pytest.mark.usefixtures("one_family_of_play_operators")
def test_a_stage_without_hysteresis_gets_the_linear_family_unasked():
    random = np.random.default_rng(2)
    command = 50.0 + 40.0 * np.repeat(random.uniform(-1.0, 1.0, 700), 5)
    measurement = modes(command - 50.0, THREE) + 1e-3 * random.normal(size=len(command))
    record = sampled_record("modes", command[:, None], measurement[:, None], 1e-4, ("x",), "um", "zoh", "unknown")
    fit = identified([record])
    assert fit.report["family"] == "linear"
    fresh = 50.0 + 40.0 * np.repeat(random.uniform(-1.0, 1.0, 700), 5)
    wanted = modes(fresh - 50.0, THREE)
    left = (simulate(fit.model, fresh[:, None], 1e-4, "zoh")[:, 0] - wanted)[-2000:]
    assert np.std(left) < 2e-3


@pytest.mark.usefixtures("one_family_of_play_operators")
def test_axes_that_move_each_other_get_the_linear_family_unasked():
    random = np.random.default_rng(3)
    command = 50.0 + 40.0 * np.repeat(random.uniform(-1.0, 1.0, (700, 2)), 5, axis=0)
    motion = [modes(column - 50.0, {180.0: 0.1}) for column in command.T]
    measurement = np.column_stack([motion[0] + 0.2 * motion[1], motion[1]]) + 1e-3 * random.normal(size=command.shape)
    record = sampled_record("axes", command, measurement, 1e-4, ("x", "y"), "um", "zoh", "unknown")
    fit = identified([record])
    assert fit.report["family"] == "linear" and fit.report["records"][0]["nrmse"] < 0.1
