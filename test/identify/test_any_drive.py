# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Any drive, any beginning, any zero: what every family promises on records as laboratories have them (`benchmarks.round_trips`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from evaluation.benchmarks.round_trips import MIDDLE, PLANTS, SWING, fresh, identified, taught
from hyst_control.identify import Fit, estimators, identify
from hyst_control.identify.assess.fit_report import record_rows
from hyst_control.identify.data.initial_memory import (
    ESTIMATED,
    FILLED,
    PERIODIC,
    REST,
    beginning_rows,
    estimated_memory,
    with_beginning,
)
from hyst_control.model_file import simulate
from hyst_control.records.record import Record, sampled_record
from test.identify.test_estimators import EXAMPLES

pytestmark = pytest.mark.long_file

OSCILLATORS = {"bouc_wen", "duhem_oscillator"}
"""Families whose records are taken to begin at rest: what they remember from before stays in the error."""
FAMILIES = sorted(set(PLANTS) - {"duhem_oscillator"})
"""All but one of the two oscillators, whose records and fit are the same code; `hyst bench --only round_trips` measures both."""


def test_every_family_has_a_round_trip():
    assert set(PLANTS) == set(estimators())


@pytest.fixture(scope="module", autouse=True)
def brief() -> Iterator[None]:
    """Records half as long as those of `hyst bench`; of oscillators, whose memory fades slower, two thirds."""
    with pytest.MonkeyPatch.context() as patch:
        for name, plant in PLANTS.items():
            if plant.pace > 1.0:
                patch.setitem(PLANTS, name, replace(plant, seconds=plant.seconds * (0.67 if name in OSCILLATORS else 0.5)))
        yield


@pytest.fixture(scope="module")
def fits() -> dict[str, Fit]:
    """Every family identified from one such record."""
    return {name: identified(name) for name in FAMILIES}


@pytest.mark.parametrize("name", FAMILIES)
def test_a_record_of_another_session_is_predicted(name, fits):
    """Held-out NRMSE of at most 0.5 % of the range, the record's own zero removed; 12 bits alone leave 0.01 %."""
    row = record_rows(fits[name].model, [with_beginning(fresh(name))])[0][0]
    assert row["nrmse_own_zero"] < (0.5 if name in OSCILLATORS else 0.1)
    assert row["nrmse"] > 1.0, "the zero is not the model's"


@pytest.mark.parametrize("name", FAMILIES)
def test_drift_and_beginning_are_reported(name, fits):
    """The drift of 2 % of the range is half of it in each direction; beginnings are told in words."""
    data, report = taught(name), fits[name].report
    share = 1.0 - report["beginnings"][0]["first_row"] / len(data.command)
    assert report["records"][0]["drift"] / data.span[0] == pytest.approx(0.01 * share, rel=0.1)
    if name == "linear":  # has no memory
        assert share == 1.0
    else:
        assert report["beginnings"][0]["assumed"] == FILLED and 0.3 < share < 1.0
    lower, upper = fits[name].model.valid["command"]
    assert (lower, upper) == (pytest.approx(MIDDLE - SWING, abs=0.1), pytest.approx(MIDDLE + SWING, abs=0.1))


def growing(start: str = "auto", rows: slice = slice(None), before: float = 0.0) -> Record:
    """Loops of play operators about 0 V whose amplitude grows from 3 to 30 V; `before` (V): the drive has been there and back."""
    time = np.arange(6000) * 1e-3
    way = np.concatenate([np.linspace(0.0, before, 50), np.linspace(before, 0.0, 50)])
    command = np.concatenate([way, (3.0 + 4.5 * time) * np.sin(2 * np.pi * time)])[:, None]
    measurement = simulate(PLANTS["pi"].model, command) + 1e-4 * np.random.default_rng(4).normal(size=command.shape)
    return sampled_record("growing", command[100:][rows], measurement[100:][rows], 1e-3, ("x",), "um", start=start)


@pytest.mark.parametrize("before, assumed", [(0.0, [REST]), (35.0, [ESTIMATED]), (-35.0, [ESTIMATED, PERIODIC])])
def test_loops_that_grow_have_their_memory_estimated(before, assumed):
    """No row but the last ones lies behind both extremes: with the wrong memory the first loops would be 6 % of the range off.

    A plant that comes from -35 V is as one that comes from the record's own last loop.
    """
    fit = identify([growing(before=before)], "pi", **EXAMPLES["pi"].options | {"nuisance": "linear"})
    (row,) = fit.report["beginnings"]
    assert row["assumed"] in assumed and row["first_row"] == 0
    assert fit.report["records"][0]["nrmse_own_zero"] < 0.2
    wrong = identify([replace(growing(before=before), start="settled")], "pi", **EXAMPLES["pi"].options | {"nuisance": "linear"})
    assert before == 0.0 or wrong.report["records"][0]["nrmse_own_zero"] > 3.0 * fit.report["records"][0]["nrmse_own_zero"]


@pytest.mark.parametrize("before", [35.0, -35.0, 20.0])
def test_the_estimated_memory_is_that_of_the_plant(before):
    """The last turning point before the record, of a plant that had been at -50 V and 50 V before, on the right side of its beginning."""
    data = growing(before=before)
    memory = estimated_memory(data.command[:, 0], data.measurement[:, 0])
    assert not memory.at_zero and (memory.turns[-2] - memory.turns[-1]) * before > 0.0


def test_a_periodic_record_is_preceded_by_itself():
    """One period of a steady state, cut amid a motion."""
    time = np.arange(3000) * 1e-3
    command = (MIDDLE + 30.0 * np.sin(2 * np.pi * time + 1.0))[:, None]
    measurement = simulate(PLANTS["pi"].model, command)
    data = sampled_record("loop", command[1000:2000], measurement[1000:2000], 1e-3, ("x",), "um", start="auto")
    assert beginning_rows([with_beginning(data)])[0]["assumed"] == PERIODIC
    fit = identify([data], "pi", **EXAMPLES["pi"].options | {"nuisance": "offset"})
    assert fit.report["records"][0]["samples"] == 1000 and fit.report["records"][0]["nrmse_own_zero"] < 0.01


def test_a_start_that_is_given_is_believed():
    for start, assumed in (("settled", REST), ("unknown", FILLED)):
        assert beginning_rows([with_beginning(growing(start=start))])[0]["assumed"] == assumed
