# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Initial memory of a session: a machine that comes from elsewhere differs until the command has met both its extremes."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.model_error.baseline import with_baseline
from hyst_control.diagnose.model_error.unknown_initial_memory import has_whole_loop, is_new_ground, left_of_memory
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.run.diagnosis import diagnose
from hyst_control.diagnose.validate.cross_validation import held_out
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.model_file import Model
from hyst_control.records.record import Record, Signal

RATE, SPAN = 2000.0, 100.0
TIME = np.arange(2400) / RATE
COMMAND = np.interp((TIME * 5.0 + 0.45) % 1.0, [0.0, 0.5, 1.0], [0.0, SPAN, 0.0])
"""A triangle that begins on its way up, near its upper end."""
FILLED = int(np.flatnonzero(COMMAND == COMMAND.min())[0])


def machine(before: tuple[float, ...], seed: int, gain: float = 1.0, command: np.ndarray = COMMAND) -> np.ndarray:
    """Relays of Preisach's plane, which were led through the extremes `before` the record; a lag; noise. Of this test alone."""
    history = np.concatenate([np.interp(np.arange(0.0, len(before) - 1, 0.01), np.arange(len(before)), before), command])
    up, down = np.meshgrid(np.linspace(2.0, 98.0, 49), np.linspace(2.0, 98.0, 49))
    up, down = up[up >= down], down[up >= down]
    weight = np.exp(-(((up - down) / 40.0) ** 2))
    state, output = -np.ones(len(up)), np.empty(len(history))
    for row, u in enumerate(history):
        state[u >= up], state[u <= down] = 1.0, -1.0
        output[row] = weight @ state / weight.sum()
    return gain * 10.0 * output[-len(command) :] + 2e-3 * np.random.default_rng(seed).standard_normal(len(command))


def record(measurement: np.ndarray, source: str, command: np.ndarray = COMMAND) -> Record:
    signals = {
        "command": Signal(TIME, command[:, None], ("x",), "V"),
        "measurement": Signal(TIME, measurement[:, None], ("x",), "um"),
    }
    return Record(signals, source)


def test_what_is_left_of_the_memory_is_gone_when_the_command_has_met_both_extremes():
    half = np.array([0.05, 0.2, 0.45]) * SPAN
    left = left_of_memory(COMMAND, half)
    np.testing.assert_allclose(left[0], 2.0 * half)
    assert (np.diff(left, axis=0) <= 1e-12).all() and not left[FILLED:].any() and left[FILLED // 4].any()


def test_another_history_is_no_effect_and_hides_none():
    clean, new = machine((0.0, 100.0), 1), machine((20.0, 50.0), 2, gain=0.95)
    away = np.abs(new / 0.95 - clean)
    assert away[:FILLED].max() > 0.1 and away[FILLED:].max() < 0.02  # it is there, and only there
    report, *_ = diagnosed([record(new, "new")], None, cache=False, baseline=[record(clean, "clean")])
    assert report["verdict"] == "effect" and [effect["name"] for effect in report["effects"]] == ["gain"]
    assert abs(report["effects"][0]["parameters"]["gain"]["value"] + 0.05) < 2e-3
    same, *_ = diagnosed([record(machine((20.0, 50.0), 3), "new")], None, cache=False, baseline=[record(clean, "clean")])
    assert same["verdict"] == "no_gap"


LATE = 50.0 + (20.0 + 30.0 * (TIME > 0.8)) * np.sin(2.0 * np.pi * 5.0 * TIME)
"""A sine that grows when two thirds of the record are still to come: both extremes are met late, and seldom is anything new."""


def test_memory_changes_on_new_ground_alone():
    new = is_new_ground(LATE)
    assert 0.05 < new.mean() < 0.4
    clean = np.random.default_rng(1).standard_normal(len(LATE)), np.random.default_rng(2).standard_normal(len(LATE))
    difference = machine((20.0, 60.0), 2, command=LATE) - 2e-3 * clean[1] - machine((0.0, 100.0), 1, command=LATE) + 2e-3 * clean[0]
    steps = np.abs(np.diff(difference, prepend=difference[0]))
    assert steps[new].max() > 0.05 and steps[~new].max() < 1e-9


def test_an_extreme_that_is_met_late_is_no_effect_and_hides_none():
    clean = record(machine((0.0, 100.0), 1, command=LATE), "clean", LATE)
    same, *_ = diagnosed([record(machine((20.0, 60.0), 3, command=LATE), "new", LATE)], None, cache=False, baseline=[clean])
    assert same["verdict"] == "no_gap"
    report, *_ = diagnosed([record(machine((20.0, 60.0), 2, 0.95, LATE), "new", LATE)], None, cache=False, baseline=[clean])
    assert [effect["name"] for effect in report["effects"]] == ["gain"]
    assert abs(report["effects"][0]["parameters"]["gain"]["value"] + 0.05) < 2e-3
    assert report["effects"][0]["shrink"] > 0.9


def test_an_effect_of_no_size_takes_nothing_off():
    """Companions are free on held-out blocks with the effect and without it alike."""
    clean = record(machine((0.0, 100.0), 1, command=LATE), "clean", LATE)
    new = record(machine((20.0, 60.0), 3, command=LATE), "new", LATE)
    [part] = diagnose([new], None, cache=False, baseline=[clean]).parts
    absent = next(
        one for one in part.found.singles if one.solution.misfit == pytest.approx(part.found.none.solution.misfit, rel=1e-9)
    )
    [left] = held_out(part.linearized, [absent], part.found.none)[1]
    assert left.after.mean() == pytest.approx(left.before.mean(), rel=1e-6)


PLAYS, SLOPES = np.array([5.0, 15.0, 30.0]), np.array([0.02, 0.02, 0.03])


def plays(command: np.ndarray, side: float) -> np.ndarray:
    """Plays that begin at one end of their play (side -1, 1) or in its middle; noise. Of this test alone."""
    state, output = command[0] + side * PLAYS, np.empty(len(command))
    for row, u in enumerate(command):
        state = np.clip(state, u - PLAYS, u + PLAYS)
        output[row] = SLOPES @ state
    return output + 2e-3 * np.random.default_rng(int(len(command) + 10 * side)).standard_normal(len(command))


def of_plays(*records: tuple[np.ndarray, float]) -> Problem:
    chain = Chain((PrandtlIshlinskii(tuple(PLAYS), tuple(SLOPES), w0=0.0),))
    model = Model("plays", ("x",), {"command": "V", "measurement": "um"}, 1.0 / RATE, chain)
    pieces = tuple(Piece(command[:, None], plays(command, side)[:, None], TIME >= 0.2) for command, side in records)
    return Problem(model, pieces, 1.0 / RATE, "foh", np.array([2e-3]))


GROWING = 50.0 + (20.0 + 30.0 * (TIME > 0.5)) * np.sin(2.0 * np.pi * 5.0 * TIME)
STEADY = 50.0 + 45.0 * np.sin(2.0 * np.pi * 7.0 * TIME)


def test_what_the_time_before_left_in_a_clean_record_of_another_command_is_no_error_of_the_model():
    """The model is the machine but for the memory, which is wiped out in the middle of the baseline record."""
    clean = of_plays((GROWING, 1.0))
    [piece] = clean.pieces
    left = piece.counted(piece.measurement) - piece.counted(plays(GROWING, 0.0)[:, None])
    assert np.std(left) > 0.1  # fifty times the noise
    known = with_baseline(of_plays((STEADY, 1.0)), clean, CONFIGURATION.baseline)
    assert known.error[0] < 3e-3 and known.problem.own_spectrum is not None
    assert np.sqrt(known.problem.own_spectrum.power.sum() / len(TIME)) < 0.02
    # A new record that fills its memory itself is wrong by as much.
    filling = with_baseline(of_plays((STEADY * (0.6 + 0.4 * (TIME > 0.6)), 1.0)), clean, CONFIGURATION.baseline)
    assert filling.error[0] > 0.1


@pytest.mark.parametrize(("row", "whole"), [(0, True), (FILLED, True), (len(COMMAND) - 300, False)])
def test_a_whole_loop_goes_to_either_extreme_and_back(row, whole):
    assert has_whole_loop(COMMAND[:, None], row) is whole


def test_what_both_records_have_is_no_noise():
    """Relays switch in steps, which are as rough as noise: what is carried keeps them, as the new record has them too."""
    clean, new = machine((0.0, 100.0), 1, command=LATE), machine((20.0, 60.0), 3, command=LATE)
    [part] = diagnose([record(new, "new", LATE)], None, cache=False, baseline=[record(clean, "clean", LATE)]).parts
    problem = part.linearized.problem
    residual = problem.rows(part.found.none.solution.residual) * problem.sigma
    assert np.std(residual) < 2.0 * np.sqrt(2.0) * 2e-3
