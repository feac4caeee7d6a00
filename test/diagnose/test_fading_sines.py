# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Sines that fade away, a usual command of bipolar stages: what an effect does to them is no line of its own."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.record_checks.spectral_lines import covers_command, lines
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.effects import EFFECTS
from hyst_control.model_file import Model
from test.diagnose.test_baseline import MODEL, RATE, machine, record

TIME = np.arange(round(2.0 * RATE)) / RATE
GAIN = Model("gain", ("x",), {"command": "V", "measurement": "um"}, 1.0 / RATE, Chain((TransferFunction((1.0,), (1.0,)),)))


def fading(frequency: float) -> np.ndarray:
    """Command, V."""
    return 90.0 * np.exp(-TIME / 0.6) * np.sin(2 * np.pi * frequency * TIME)


def problem_of(command: np.ndarray) -> Problem:
    return Problem(GAIN, (Piece(command[:, None], command[:, None]),), 1.0 / RATE, "zoh", np.array([1e-3]))


@pytest.mark.parametrize("frequency, covered", [(18.9, True), (20.0, True), (37.0, True), (28.0, False), (150.0, False)])
def test_a_line_that_swells_covers_the_command_and_its_first_harmonics(frequency: float, covered: bool) -> None:
    assert covers_command(problem_of(fading(20.0)), [frequency], reach=6.0) == covered


def test_beside_a_command_of_many_frequencies_no_line_covers_it() -> None:
    command = np.random.default_rng(1).standard_normal(len(TIME))
    assert not covers_command(problem_of(command), [18.9], reach=6.0)


@pytest.mark.parametrize("driven, found", [(50.0, []), (20.0, [50.0])])
def test_what_stands_at_the_frequency_of_the_command_is_no_hum(driven: float, found: list[float]) -> None:
    """A line of 50 Hz beside a command of that frequency is what the model does not know of its answer."""
    line = 0.05 * np.exp(-TIME / 0.6) * np.sin(2 * np.pi * 50.0 * TIME + 1.0)
    residual = line + 1e-3 * np.random.default_rng(2).standard_normal(len(TIME))
    assert lines(problem_of(fading(driven)), residual / 1e-3)["mains_hum"] == found


@pytest.mark.parametrize("frequency", [20.0, 50.0])
def test_a_drifting_gain_is_no_vibration(frequency: float) -> None:
    """Beside one baseline record of the same command: one number explains the gap as well as fifty of a line that swells."""
    command = fading(frequency)
    clean, new = machine(command, 1), machine(command, 2, sensor=lambda y: y * (1.0 - 0.15 * TIME / TIME[-1]))
    rivals = ("gain_drift", "vibration", "mains_hum", "gain", "offset_drift", "creep", "resonance")
    others = [name for name in EFFECTS if name not in rivals]
    document, *_ = diagnosed([record(command, new, "new")], MODEL, baseline=[record(command, clean, "clean")], without=others)
    assert document["verdict"] == "effect"
    assert [one["name"] for one in document["effects"]] == ["gain_drift"]
    change = document["effects"][0]["parameters"]["change"]
    low, high = change["ci90"]
    assert low <= -0.15 <= high or change["value"] == pytest.approx(-0.15, rel=0.1)
