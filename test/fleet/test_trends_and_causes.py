# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Drifts, forecasts, covariates and common causes in fleets drawn by numpy from known laws."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.fleet.change_points import Trend, find_changes, forecast
from hyst_control.fleet.common_causes import find_common_causes, shared_columns
from hyst_control.fleet.covariates import take_out

UNITS, RUNS = 100, 40
NAMES = [f"u{index}" for index in range(UNITS)]
MOMENTS = np.arange(RUNS, dtype=float)


def levels(rng, noise=0.3):
    return rng.standard_normal((UNITS, 1)) + noise * rng.standard_normal((UNITS, RUNS))


def test_drifts_are_told_from_shifts():
    rng = np.random.default_rng(4)
    values = levels(rng)
    values[:5] += 0.05 * MOMENTS
    values[5:10, 20:] += 2.0
    onsets, trends = find_changes("gain", NAMES, MOMENTS, values)
    assert {trend.unit for trend in trends} == set(NAMES[:5])
    assert {onset.unit for onset in onsets} == set(NAMES[5:10])
    assert all(abs(trend.slope - 0.05) < 4.0 * trend.slope_error for trend in trends)
    assert all(abs(trend.level - values[NAMES.index(trend.unit), -8:].mean() - 0.05 * 3.5) < 0.5 for trend in trends)


def test_a_forecast_holds_as_many_crossings_as_it_says():
    """Futures drawn from the stated law: 90 % of them are beyond the limit between the interval's ends."""
    rng = np.random.default_rng(1)
    trend = Trend("u", "gain", 1.0, -0.1, 0.01, 5.0, 40.0, 0.2)
    found = forecast(trend, {"gain": 0.0})
    assert found.crossing == pytest.approx(90.0)
    beyond = []
    for moment in (found.earliest, found.latest):
        ahead = moment - trend.last
        values = 5.0 + (-0.1 + 0.01 * rng.standard_normal(200_000)) * ahead + 0.2 * np.sqrt(ahead) * rng.standard_normal(200_000)
        beyond.append(np.mean(values < 0.0))
    assert beyond == pytest.approx([0.05, 0.95], abs=0.005)


def test_forecasts_without_an_end():
    trend = Trend("u", "gain", 1.0, 0.1, 0.08, 5.0, 40.0, 0.0)
    found = forecast(trend, {"gain": 6.0})
    assert found.crossing == pytest.approx(50.0) and found.latest is None, "the slope may be zero"
    assert forecast(trend, {"gain": 4.0}) == trend, "it moves away from the limit"
    assert forecast(trend, {"creep": 6.0}) == trend
    sure = forecast(Trend("u", "gain", 1.0, 0.1, 0.0, 5.0, 40.0, 0.0), {"gain": 6.0})
    assert (sure.earliest, sure.latest) == pytest.approx((50.0, 50.0))


def test_temperature_is_taken_out_and_shifts_stay():
    rng = np.random.default_rng(2)
    temperature = np.tile(20.0 + 3.0 * rng.standard_normal(RUNS), (UNITS, 1))
    values = levels(rng)
    values[:6, 15:] += 0.8
    shifted = values + 0.5 * temperature
    before = {onset.unit for onset in find_changes("gain", NAMES, MOMENTS, shifted)[0]}
    left, [effect] = take_out("gain", shifted, {"temperature": temperature})
    assert abs(effect.slope - 0.5) < 4.0 * effect.slope_error < 0.1
    assert {onset.unit for onset in find_changes("gain", NAMES, MOMENTS, left)[0]} == set(NAMES[:6]) != before
    assert take_out("gain", values, {"temperature": temperature})[1] == []


def test_units_with_times_of_their_own_are_looked_at_as_those_with_common_ones():
    """No two units have a run at the same time: neighbors in the union of all times are never of one unit."""
    rng = np.random.default_rng(6)
    temperature = 20.0 + 3.0 * rng.standard_normal((UNITS, RUNS))
    values = levels(rng) + 0.5 * temperature
    values[:6, 15:] += 1.5

    def apart(each):
        found = np.full((UNITS, RUNS, UNITS), np.nan)
        found[np.arange(UNITS), :, np.arange(UNITS)] = each
        return found.reshape(UNITS, -1)

    times = (MOMENTS[:, None] + np.arange(UNITS) / UNITS).ravel()
    left, [effect] = take_out("gain", apart(values), {"temperature": apart(temperature)})
    assert effect.slope == pytest.approx(take_out("gain", values, {"temperature": temperature})[1][0].slope, rel=1e-12)
    onsets, _ = find_changes("gain", NAMES, times, left)
    assert {onset.unit: int(onset.moment) for onset in onsets} == dict.fromkeys(NAMES[:6], 15)


def test_the_driver_and_the_run_that_units_share():
    rng = np.random.default_rng(3)
    rows = [{"unit": unit, "driver": f"d{index // 10}", "firmware": "1.0", "run": run, "serial": unit}
            for index, unit in enumerate(NAMES) for run in range(3)]  # fmt: skip
    columns = shared_columns(rows, ["driver", "firmware", "run", "serial"])
    assert list(columns) == ["driver"], "one value for all, one for each unit, and what differs within a unit group nothing"
    begins = dict.fromkeys(NAMES[30:38], 17.0) | {str(unit): float(rng.integers(RUNS)) for unit in rng.choice(NAMES[50:], 8)}
    causes = find_common_causes({"delay.tau": begins}, columns, UNITS, RUNS)
    assert {(cause.column, cause.value) for cause in causes} == {("driver", "d3"), ("first run", "17")}
    assert all(cause.probability < 1e-3 for cause in causes)


def test_chance_is_no_cause():
    """Changes drawn at random over units and runs: of 100 fleets hardly one has a cause."""
    rng = np.random.default_rng(5)
    columns = {"driver": {unit: f"d{index // 10}" for index, unit in enumerate(NAMES)}}
    named = 0
    for _ in range(100):
        chosen = rng.choice(NAMES, 15, replace=False)
        begins = {str(unit): float(rng.integers(RUNS)) for unit in chosen}
        named += bool(find_common_causes({"gain": begins}, columns, UNITS, RUNS))
    assert named <= 4
