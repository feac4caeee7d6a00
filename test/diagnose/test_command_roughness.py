# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Commands that are rougher in the record than the plant received, against a plant of relays and a recursion of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.decide.record_findings import detected, not_received
from hyst_control.diagnose.evidence import RecordEvidence
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.record_checks.command_roughness import as_recorded, roughness_evidence, with_commands
from hyst_control.diagnose.record_checks.command_smoothing import smoothed
from hyst_control.diagnose.run.prepare import _beside_usual
from hyst_control.effects.effect import RecordCheck
from hyst_control.model_file import Model

STEP, ROWS = 5e-3, 2000
TIME = STEP * np.arange(ROWS)
SINE = 5.0 - 4.0 * np.cos(2 * np.pi * TIME) * (1.0 - 0.05 * TIME)
TRIANGLE = 5.0 + 8.0 * np.abs((0.9 * TIME) % 1.0 - 0.5) - 2.0
STAIRS = np.repeat(np.random.default_rng(9).uniform(1.0, 9.0, 20), ROWS // 20)
MODEL = Model("line", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((TransferFunction((2.0,), (0.01, 1.0)),)))
POLICY = CONFIGURATION.policy


def plant(command: np.ndarray, seed: int = 1) -> np.ndarray:
    """Sum of 40 relays and a line, behind a recursion of second order, with noise."""
    up = np.linspace(1.0, 10.0, 40)
    down, state, found = up - 1.0, np.zeros(40), np.empty(len(command))
    for k, value in enumerate(command):
        state = np.where(value >= up, 1.0, np.where(value <= down, 0.0, state))
        found[k] = 1.6 * value + 0.1 * state.sum()
    slow, before = np.empty(len(found)), np.full(2, found[0])
    for k, value in enumerate(found):
        slow[k] = 0.45 * before[0] - 0.05 * before[1] + 0.6 * value
        before = np.array([slow[k], before[0]])
    late = np.concatenate([slow[:1], slow[:-1]])
    return late + 0.02 * np.random.default_rng(seed).standard_normal(len(late))


def lowpass(command: np.ndarray, share: float) -> np.ndarray:
    found, state = np.empty(len(command)), command[0]
    for k, value in enumerate(command):
        state += share * (value - state)
        found[k] = state
    return found


def seen(command: np.ndarray, measurement: np.ndarray):
    problem = Problem(MODEL, (Piece(command[:, None], measurement[:, None]),), STEP, "zoh", np.array([0.02]))
    evidence, smooth = roughness_evidence(problem, 0)
    return evidence, smooth, problem


def rough(command: np.ndarray, step: float, seed: int = 3) -> np.ndarray:
    return command + step * np.random.default_rng(seed).uniform(-0.5, 0.5, len(command))


@pytest.mark.parametrize(
    "command, step",  # at stairs the model discrepancy is as large at every frequency, and hides a fine step
    [(SINE, 0.1), (SINE, 0.4), (TRIANGLE, 0.1), (TRIANGLE, 0.4), (STAIRS, 0.4), (STAIRS, 1.0), (SINE, 4.5)],
    ids=[
        "fine on a sine",
        "on a sine",
        "fine on a triangle",
        "on a triangle",
        "on stairs",
        "coarse on stairs",
        "a quarter of a sine",
    ],
)
def test_a_command_that_only_the_record_rounds_is_found_with_its_step(command, step):
    recorded = rough(command, step)
    evidence, smooth, problem = seen(recorded, plant(command))
    assert not_received(evidence, POLICY)
    assert np.sqrt(12.0) * evidence.rms == pytest.approx(step, rel=0.08)
    assert np.std(smooth[0] - command) < 0.6 * np.std(recorded - command)
    mended = with_commands(problem, 0, smooth)
    assert np.array_equal(as_recorded(mended).pieces[0].command, problem.pieces[0].command)


@pytest.mark.parametrize("step", [0.1, 0.4, 1.0, 4.5])
def test_a_rough_command_that_the_plant_receives_is_none(step):
    recorded = rough(SINE, step)
    lagging = np.concatenate([np.full(25, recorded[0]), recorded[:-25]])
    for received in (recorded, lowpass(recorded, 0.5), lowpass(recorded, 0.2), lagging, 0.7 * recorded):
        evidence, _, _ = seen(recorded, plant(received))
        assert evidence is not None and not not_received(evidence, POLICY)


@pytest.mark.parametrize("step", [0.05, 0.4])
def test_a_true_lattice_behind_a_smooth_command_is_none(step):
    evidence, _, _ = seen(SINE, plant(step * np.round(SINE / step)))
    assert evidence is None or not not_received(evidence, POLICY)


def test_clean_records_and_rich_commands_are_none():
    random = np.random.default_rng(5)
    steps = np.repeat(random.choice([2.0, 8.0], ROWS // 4), 4)
    lines = np.arange(1, 400)
    multisine = 5.0 + 0.1 * np.sum(np.cos(2 * np.pi * np.outer(TIME, lines / TIME[-1]) + np.pi * lines**2 / 400), axis=1)
    noise = random.uniform(1.0, 9.0, ROWS)
    sweep = 5.0 + 3.0 * np.sin(2 * np.pi * (0.2 + 4.0 * TIME) * TIME)
    for command in (SINE, TRIANGLE, STAIRS, steps, multisine, noise, sweep, np.round(SINE, 3)):
        for received in (command, lowpass(command, 0.3)):
            evidence, _, _ = seen(command, plant(received))
            assert evidence is None or not not_received(evidence, POLICY)


def test_a_command_that_is_read_in_normal_noise_is_not_rounded():
    recorded = SINE + 0.1 * np.random.default_rng(6).standard_normal(ROWS)
    evidence, _, _ = seen(recorded, plant(SINE))
    assert evidence.coefficient == pytest.approx(-1.0, abs=0.1)
    assert not not_received(evidence, POLICY)


def test_smoothing_keeps_steps():
    recorded = rough(STAIRS, 0.4)
    away = np.abs(smoothed(recorded) - STAIRS)
    assert np.max(away) < 0.35 and np.sqrt(np.mean(away**2)) < 0.5 * 0.4 / np.sqrt(12.0)


PLAIN = RecordEvidence(ROWS, 0.0, ROWS, 0.1, 0.0, False, 0.02)


@pytest.mark.parametrize(
    "new, usual, found", [(0.5, 0.01, True), (0.012, 0.01, False), (0.0, 0.0, False), (0.03, 0.0, True), (0.4, 0.35, False)]
)
def test_held_samples_are_named_where_they_clearly_exceed_those_of_clean_records(new, usual, found):
    evidence = replace(PLAIN, repeated=new, usual_repeated=usual)
    assert bool(detected((evidence,), {RecordCheck.REPEATED_VALUES}, POLICY)) is found


@pytest.mark.parametrize("new, usual, found", [(0.4, 0.01, True), (0.01, 0.01, False), (0.4, 0.0, True)])
def test_a_lattice_is_named_where_it_is_coarser_than_that_of_clean_records(new, usual, found):
    evidence = replace(PLAIN, step=new, usual_step=usual)
    assert bool(detected((evidence,), {RecordCheck.VALUE_LATTICE}, POLICY)) is found


def test_few_repeats_of_clean_records_are_the_usual_ones():
    """So few that chance explains them in numbers of three digits: they are usual all the same."""
    random = np.random.default_rng(8)
    measured = np.round(plant(SINE), 3)
    rows = np.arange(ROWS)
    rows[1:][random.random(ROWS - 1) < 0.03] = 0
    repeating = measured[np.maximum.accumulate(rows)]
    clean = Problem(MODEL, (Piece(SINE[:, None], repeating[:, None]),), STEP, "zoh", np.array([0.02]))
    (beside,) = _beside_usual((replace(PLAIN, repeated=0.035),), clean, CONFIGURATION)
    assert beside.usual_repeated == pytest.approx(0.03, abs=0.015)
    assert not detected((beside,), {RecordCheck.REPEATED_VALUES}, POLICY)
