# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Hold of a record that states none, and the sensor's offset as a stage of a model of play operators."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from hyst_control.api.record import from_arrays, read_bag
from hyst_control.identify import identify
from hyst_control.identify.data.hold_choice import hold_errors
from hyst_control.identify.validation import validate_record
from hyst_control.identify.workflow import MAX_NOTES, Result, gapless_records, identify_records, with_one_hold
from hyst_control.records.record import Record, Signal, sampled_record


def plays(command: np.ndarray) -> np.ndarray:
    """Five play operators, written out."""
    thresholds, states = np.array([0.0, 5.0, 10.0, 18.0, 30.0]), np.zeros(5)
    found = np.empty(len(command))
    for k, u in enumerate(command):
        states = np.clip(states, u - thresholds, u + thresholds)
        found[k] = states @ [0.06, 0.02, 0.015, 0.01, 0.01]
    return found


LEVELS = [0, 100, 8, 92, 20, 78, 34, 64, 0]
COMMAND = np.concatenate([np.linspace(a, b, 51)[:-1] for a, b in zip(LEVELS, LEVELS[1:], strict=False)] + [[0.0]])


def pairs(offset: float = 0.0, late: int = 0) -> Record:
    """Rows of voltage and settled position, or samples that are late by some rows."""
    answers = np.concatenate([np.zeros(late), plays(COMMAND)])[: len(COMMAND)] + offset
    answers += 5e-4 * np.ptp(answers) * np.random.default_rng(0).normal(size=len(COMMAND))
    time = np.arange(len(COMMAND)) * 1.0
    return Record(
        {"command": Signal(time, COMMAND[:, None], ("x",), "V"), "measurement": Signal(time, answers[:, None], ("x",), "um")}, "p"
    )


def test_rows_of_pairs_are_recognized_and_told():
    notes: list[str] = []
    [data] = with_one_hold(gapless_records(pairs()), notes)
    assert data.hold == "foh" and "hold foh" in notes[0] and "--hold zoh" in notes[0]
    assert with_one_hold(gapless_records(pairs(), "zoh"))[0].hold == "zoh"


@pytest.mark.parametrize("late", [1, 2, 5])
def test_samples_of_a_held_command_stay_so(late):
    assert with_one_hold(gapless_records(pairs(late=late)))[0].hold == "zoh"


def held_modes(seed: int) -> Record:
    """Three modes under a held command, 1.25 samples late: more than few poles make without the delay."""
    random, step = np.random.default_rng(seed), 1e-4
    command = np.repeat(random.uniform(10.0, 90.0, 500), 20)
    fine = np.repeat(command, 4)  # a quarter of a sample is a row
    answer = np.zeros(len(fine))
    for frequency, share in ((180.0, 0.1), (520.0, 0.03), (1350.0, 0.01)):
        omega = 2 * np.pi * frequency
        top, bottom, _ = signal.cont2discrete(([share * omega**2], [1.0, 0.04 * omega, omega**2]), step / 4, "zoh")
        answer += signal.lfilter(np.ravel(top), bottom, np.concatenate([np.zeros(5), fine[:-5]]))
    measurement = answer[::4] + 1e-3 * random.normal(size=len(command))
    return sampled_record(f"held {seed}", command[:, None], measurement[:, None], step, ("x",), "um")


def test_a_delay_beside_many_modes_is_no_answer_to_the_own_row():
    for seed in range(6):
        errors = hold_errors(held_modes(seed))
        assert not errors.own_row


def test_a_stated_hold_is_that_of_the_record_in_every_command(tmp_path):
    stated = from_arrays(COMMAND, pairs().measurement, rate=1.0, hold="zoh")
    stated.save(tmp_path / "stated")
    pairs_unstated = from_arrays(COMMAND, pairs().measurement, rate=1.0)
    pairs_unstated.save(tmp_path / "unstated")
    read = [read_bag(tmp_path / name) for name in ("stated", "unstated")]
    assert [record.states_hold for record in read] == [True, False]
    assert with_one_hold(gapless_records(read[0]))[0].hold == "zoh"
    assert {record.hold for record in with_one_hold([*gapless_records(read[0]), *gapless_records(read[1])])} == {"zoh"}
    fit = identify_records([read[1]], "pi")
    assert fit.model.hold == "foh"
    errors = [validate_record({"m": fit.model}, record).value(record.name, "m", "nrmse_own_zero") for record in read]
    assert errors[0] > 3.0 * errors[1]  # the stated hold is kept; of the other record the model knows it


def test_noise_does_not_decide():
    random = np.random.default_rng(1)
    for seed in range(20):
        command = np.cumsum(np.random.default_rng(seed).normal(size=(400, 1)), axis=0)
        record = sampled_record("n", command, random.normal(size=(400, 1)), 1.0, ("x",), "um", start="settled")
        assert not hold_errors(record).own_row


def test_the_sensors_offset_is_a_stage_of_the_model():
    """A zero of 12 um beside a stroke of 11: the error of the model as it is written is that of a record without it."""
    fits = [identify(with_one_hold(gapless_records(pairs(offset))), "pi") for offset in (0.0, 12.0)]
    assert all(fit.report["records"][0]["nrmse"] < 0.2 for fit in fits)
    stage = fits[1].model.chain.stages[-1]
    assert stage.name == "offset" and stage.parameters()["offset"] == pytest.approx(12.0, abs=0.05)


def test_the_terminal_shows_five_notes():
    fit = identify(with_one_hold(gapless_records(pairs())), "pi")
    fit.report["notes"][:] = [f"number {k}" for k in range(9)]
    lines = [line for line in Result(fit, None).text().splitlines() if line.startswith("  note:")]
    assert len(lines) == MAX_NOTES and lines[-1] == "  note: 5 more are in the report (--json)"


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_the_hold_of_axes_that_drive_each_other_is_told(hold):
    """Two lags; the other axis makes a fifth of each motion, many times what the holds differ by."""
    random, step = np.random.default_rng(3), 2e-3
    top, bottom, _ = signal.cont2discrete(([1.0], [0.012, 1.0]), step, hold)
    command = signal.lfilter([0.3], [1.0, -0.7], random.normal(size=(3000, 2)), axis=0)
    answers = signal.lfilter(top.ravel(), bottom, command @ [[1.0, 0.2], [-0.2, 1.0]], axis=0)
    measured = answers + 1e-3 * np.ptp(answers) * random.normal(size=answers.shape)
    errors = hold_errors(sampled_record("two", command, measured, step, ("x", "y"), "um", start="settled"))
    assert errors.own_row == (hold == "foh")
    assert errors.same < 1.1 * np.sqrt(2) * 1e-3 or hold == "zoh"
