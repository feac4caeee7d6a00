"""Any drive, any beginning, any zero: what every family promises on records as laboratories have them.

Records of a bipolar drive begin amid a motion, with a sensor's zero of 5 % of the range, a drift of 2 % and 12-bit rounding; each
record has a zero and a drift of its own. The truth is a chain of the family's own stages, behind a drive of 5 V ± 40 V.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.chain import Chain, Parallel, Stage
from hyst_control.identify import Dataset, Fit, identify
from hyst_control.identify.fit_report import record_rows
from hyst_control.identify.initial_memory import (
    ESTIMATED,
    FILLED,
    PERIODIC,
    VIRGIN,
    beginning_rows,
    estimated_memory,
    with_beginning,
)
from hyst_control.model_file import Model, simulate
from test.identify.test_estimators import CURVES, EXAMPLES, FAMILIES

pytestmark = pytest.mark.long_file

MIDDLE, SWING = 5.0, 40.0
SPACED = ("degree", "order", "delay", "direct", "thresholds", "creep")
"""Options of the examples that say where the family is right; the structure of G(s) is left to the fit."""


def sines(sample_time: float, *cycles: tuple[float, float]) -> np.ndarray:
    """Whole sines (N, 1) about the middle of the drive, each of a frequency in Hz and an amplitude in V, a short rest behind each."""
    parts = []
    for frequency, amplitude in cycles:
        count = max(round(0.2 * frequency), 2)
        time = np.arange(round(count / frequency / sample_time)) * sample_time
        parts += [MIDDLE + amplitude * np.sin(2 * np.pi * frequency * time), np.full(round(0.02 / sample_time), MIDDLE)]
    return np.concatenate(parts)[:, None]


def bipolar(stage: Stage) -> Stage:
    """The stage of an example for a bipolar drive: curves have to begin below it."""
    wide = replace(CURVES, input_scale=90.0, input_offset=-40.0)
    if isinstance(stage, Parallel):
        return Parallel(((wide,), *stage.branches[1:]))
    return wide if stage == CURVES else stage


def plant(name: str) -> Model:
    example = EXAMPLES[name]
    stages = tuple(bipolar(stage) for stage in example.stages)
    return Model("plant", ("x",), {"command": "V", "measurement": "um"}, example.sample_time, Chain(stages))


def record(name: str, label: str, zero: float, drift: float, *cycles: tuple[float, float]) -> Dataset:
    """A record of `cycles` from amid the first of them, as a laboratory has it; zero and drift are shares of the range."""
    sample_time = EXAMPLES[name].sample_time
    pace = 1.0 if sample_time >= 1e-3 else 20.0  # families with dynamics are excited faster
    warm = sines(sample_time, (2.0 * pace, SWING), (3.0 * pace, 25.0))
    command = np.concatenate([warm, sines(sample_time, *((frequency * pace, amplitude) for frequency, amplitude in cycles))])
    measurement = simulate(plant(name), command)
    cut = len(warm) + round(0.13 / cycles[0][0] / pace / sample_time)
    command, measurement = command[cut:], measurement[cut:]
    span = float(np.ptp(measurement))
    measurement = measurement + span * (zero + drift * np.linspace(0.0, 1.0, len(measurement))[:, None])
    step = 1.25 * span / 2**12
    return Dataset(label, command, step * np.rint(measurement / step), sample_time, ("x",), "um", start="auto")


def teacher(name: str) -> Dataset:
    return record(
        name, "fitted", 0.05, 0.02, (1.0, 30.0), (2.0, 40.0), (2.0, 25.0), (4.0, 15.0), (4.0, 40.0), (20.0, 32.0), (1.0, 10.0)
    )


def examiner(name: str) -> Dataset:
    return record(name, "held out", -0.04, -0.015, (1.5, 20.0), (3.0, 38.0), (2.5, 28.0), (12.0, 30.0), (5.0, 33.0))


@pytest.fixture(scope="module")
def fits() -> dict[str, Fit]:
    """Every family identified from one such record."""
    found = {}
    for name in FAMILIES:
        options = {key: value for key, value in EXAMPLES[name].options.items() if key in SPACED}
        found[name] = identify([teacher(name)], name, **options)
    return found


OSCILLATORS = {"bouc_wen", "duhem_oscillator"}
"""Families whose records are taken to begin at rest: what they remember from before stays in the error."""


@pytest.mark.parametrize("name", FAMILIES)
def test_a_record_of_another_session_is_predicted(name, fits):
    """Held-out NRMSE of at most 0.5 % of the range, the record's own zero removed; 12 bits alone leave 0.01 %."""
    row = record_rows(fits[name].model, [with_beginning(examiner(name))])[0][0]
    assert row["nrmse_own_zero"] < (0.5 if name in OSCILLATORS else 0.1)
    assert row["nrmse"] > 1.0, "the zero is not the model's"


@pytest.mark.parametrize("name", FAMILIES)
def test_drift_and_beginning_are_reported(name, fits):
    """The drift of 2 % of the range is half of it in each direction; beginnings are told in words."""
    data, report = teacher(name), fits[name].report
    share = 1.0 - report["beginnings"][0]["first_row"] / len(data.command)
    assert report["records"][0]["drift"] / data.range[0] == pytest.approx(0.01 * share, rel=0.1)
    assert report["beginnings"][0]["assumed"] == FILLED and 0.3 < share < 1.0
    lower, upper = fits[name].model.valid["command"]
    assert (lower, upper) == (pytest.approx(MIDDLE - SWING, abs=0.1), pytest.approx(MIDDLE + SWING, abs=0.1))


def growing(start: str = "auto", rows: slice = slice(None), before: float = 0.0) -> Dataset:
    """Loops of play operators about 0 V whose amplitude grows from 3 to 30 V; `before` (V): the drive has been there and back."""
    time = np.arange(6000) * 1e-3
    way = np.concatenate([np.linspace(0.0, before, 50), np.linspace(before, 0.0, 50)])
    command = np.concatenate([way, (3.0 + 4.5 * time) * np.sin(2 * np.pi * time)])[:, None]
    measurement = simulate(plant("pi"), command) + 1e-4 * np.random.default_rng(4).normal(size=command.shape)
    return Dataset("growing", command[100:][rows], measurement[100:][rows], 1e-3, ("x",), "um", start=start)


@pytest.mark.parametrize("before, assumed", [(0.0, [VIRGIN]), (35.0, [ESTIMATED]), (-35.0, [ESTIMATED, PERIODIC])])
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
    assert not memory.virgin and (memory.turns[-2] - memory.turns[-1]) * before > 0.0


def test_a_periodic_record_is_preceded_by_itself():
    """One period of a steady state, cut amid a motion."""
    time = np.arange(3000) * 1e-3
    command = (MIDDLE + 30.0 * np.sin(2 * np.pi * time + 1.0))[:, None]
    measurement = simulate(plant("pi"), command)
    data = Dataset("loop", command[1000:2000], measurement[1000:2000], 1e-3, ("x",), "um", start="auto")
    assert beginning_rows([with_beginning(data)])[0]["assumed"] == PERIODIC
    fit = identify([data], "pi", **EXAMPLES["pi"].options | {"nuisance": "offset"})
    assert fit.report["records"][0]["samples"] == 1000 and fit.report["records"][0]["nrmse_own_zero"] < 0.01


def test_a_start_that_is_given_is_believed():
    for start, assumed in (("settled", VIRGIN), ("unknown", FILLED)):
        assert beginning_rows([with_beginning(growing(start=start))])[0]["assumed"] == assumed
