# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Remainder of a gap that no known effect explains: its share that follows the command, where, and the stage that adds it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling
from hyst_control.chain.command_features import FEATURES, CommandFeatures, FeatureFilter
from hyst_control.chain.memoryless import Gain
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.report import unknown_remainder
from hyst_control.diagnose.validate.predictability import learn_residual, predictability
from hyst_control.diagnose.verdict import Verdict
from hyst_control.effects.learned_residual import LearnedResidual
from hyst_control.model_file import Model, load_model, model_to_document, save_model, simulate

STEP, NOISE = 1e-3, 0.01
TIME = STEP * np.arange(8000)
COMMAND = (40.0 * np.sin(2 * np.pi * 1.0 * TIME) * (0.3 + 0.7 * np.sin(2 * np.pi * 0.11 * TIME) ** 2))[:, None]


def problem(left: np.ndarray, hold: str = "foh") -> Problem:
    """Record whose model, u, leaves `left` (N, 1), with white noise."""
    noise = NOISE * np.random.default_rng(3).standard_normal(left.shape)
    model = Model("m", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((Gain(1.0),)), hold)
    simulated = simulate(model, COMMAND, STEP, hold)
    return Problem(model, (Piece(COMMAND, simulated + left + noise),), STEP, hold, np.array([NOISE]))


def residual(seen: Problem) -> np.ndarray:
    return seen.rows(seen.measured() - seen.simulate(seen.model.chain.stages))


def test_the_part_that_follows_the_command_is_found_by_level_branch_and_band():
    rate = np.gradient(COMMAND[:, 0])
    follows = (0.2 * (COMMAND[:, 0] / 40.0) ** 2 * np.clip(rate / rate.max(), 0.0, 1.0))[:, None]
    walk = np.cumsum(np.random.default_rng(1).standard_normal(len(TIME)))
    seen = problem(follows)
    found = predictability(seen, residual(seen), (0.5, 10.0, 100.0), 10)
    assert found.share > 0.9
    assert {row.name: row.share for row in found.branch}["rising"] > 0.9
    assert sum(row.share for row in found.level) == pytest.approx(1.0, abs=0.05)
    assert max(found.band, key=lambda row: row.share).name == "0.5 to 10 Hz"
    other = problem((0.1 * walk / walk.std())[:, None])
    assert predictability(other, residual(other), (0.5, 10.0, 100.0), 10).share < 0.4


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_the_learned_stage_takes_off_on_the_record_what_it_says_on_blocks_held_out(hold, tmp_path):
    seen = problem(0.3 * np.tanh(COMMAND / 15.0) ** 2, hold)
    left = residual(seen)
    stage, shrink = learn_residual(seen, left, 10)
    assert shrink > 0.9
    save_model(seen.model.with_stages((*seen.model.chain.stages, stage)), tmp_path / "better.yaml")
    better = load_model(tmp_path / "better.yaml")
    after = seen.pieces[0].measurement - simulate(better, COMMAND, STEP, hold)
    taken_off = 1.0 - (np.mean(after**2) - NOISE**2) / (np.mean(left**2) - NOISE**2)
    assert taken_off == pytest.approx(shrink, abs=0.1) and taken_off >= shrink


def test_what_does_not_follow_the_command_is_not_said_to_shrink():
    walk = np.cumsum(np.random.default_rng(2).standard_normal(len(TIME)))
    seen = problem((0.1 * walk / walk.std())[:, None])
    assert learn_residual(seen, residual(seen), 10)[1] < 0.4


def test_features_are_the_same_however_the_command_is_cut_and_those_of_the_past_alone():
    features = CommandFeatures.of([COMMAND[:, 0]], STEP)
    whole = features.rows(COMMAND[:, 0], STEP, causal=True)
    running = FeatureFilter(features, STEP)
    running.settle(COMMAND[0, 0])
    assert (np.concatenate([running.process(part) for part in np.split(COMMAND[:, 0], [1, 2, 700])]) == whole).all()
    changed = np.where(TIME < 4.0, COMMAND[:, 0], 0.0)
    assert (features.rows(changed, STEP, causal=True)[TIME < 4.0] == whole[TIME < 4.0]).all()
    assert whole.shape == (len(TIME), FEATURES)


def test_a_stage_without_weights_changes_nothing_and_one_with_too_few_is_refused():
    features = CommandFeatures.of([COMMAND[:, 0]], STEP).document()
    chain = Chain((Gain(2.0), LearnedResidual(**features, weights=(0.0,) * FEATURES)))
    running, plain = chain.filter(Sampling(STEP, 1)), Chain((Gain(2.0),)).filter(Sampling(STEP, 1))
    assert running.settle(COMMAND[0]) == plain.settle(COMMAND[0])
    assert (running.process(COMMAND) == plain.process(COMMAND)).all()
    with pytest.raises(InputError, match="learn the residual again"):
        Chain((LearnedResidual(**features, weights=(1.0,)),)).filter(Sampling(STEP, 1))


def test_the_model_file_keeps_every_number_of_the_stage():
    seen = problem(0.3 * (COMMAND / 40.0) ** 2)
    stage, _ = learn_residual(seen, residual(seen), 10)
    written = model_to_document(seen.model.with_stages((stage,)))["chain"][0]
    assert written["stage"] == "learned_residual" and len(written["weights"]) == FEATURES


@pytest.mark.parametrize("shrink, added", [(0.4, True), (-0.2, False)])
def test_a_learned_stage_that_widens_the_gap_on_blocks_held_out_is_not_added(monkeypatch, shrink, added):
    """It was added at -20 %: the model left thrice as much of its own record."""
    left = problem(0.3 * np.tanh(COMMAND / 15.0) ** 2)
    stage, _ = learn_residual(left, residual(left), 10)
    monkeypatch.setattr(unknown_remainder, "learn_residual", lambda *given: (stage, shrink))
    monkeypatch.setattr(unknown_remainder, "_as_given", lambda diagnosis, part: residual(left))
    part = SimpleNamespace(
        decision=SimpleNamespace(verdict=Verdict.UNKNOWN, remainder=1.0),
        axes=(0,),
        problem=left,
        chosen=SimpleNamespace(solution=SimpleNamespace(residual=residual(left))),
    )
    settings = SimpleNamespace(budget=SimpleNamespace(bands=(0.5, 10.0, 100.0)), baseline=SimpleNamespace(blocks=10))
    found = unknown_remainder.remainder_of(SimpleNamespace(parts=(part,), configuration=settings))
    assert found is not None and bool(found.stages) == added and found.shrink == shrink
