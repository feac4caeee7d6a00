# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of a fleet's diagnoses, drawn from a known law: what the page and the document say of them."""

from __future__ import annotations

import json
from datetime import datetime, timedelta

import browser as browsers
import numpy as np
import pytest

from hyst_control.fleet.change_points import Trend
from hyst_control.fleet.overview import overview
from hyst_control.fleet.overview_page import _Links, _trend_row, _verdict_map, write_overview

UNITS, RUNS = 200, 50


def rows(seed=3, units=UNITS, runs=RUNS):
    """Diagnoses; a delay that begins on eight units, and a gap that scatters."""
    rng = np.random.default_rng(seed)
    begins = {f"u{unit:03d}": int(rng.integers(5, runs - 5)) for unit in rng.choice(units, 8, replace=False)}
    found = []
    for unit in (f"u{index:03d}" for index in range(units)):
        level = 0.1 + 0.01 * rng.standard_normal()
        for run in range(runs):
            delayed = run >= begins.get(unit, runs)
            tau = {"name": "tau", "value": 1e-4 * (1 + 0.05 * rng.standard_normal()), "low": 0.0, "high": 0.0, "unit": "s"}
            found.append(
                {
                    "unit": unit,
                    "time": str(run),
                    "moment": float(run),
                    "bag": f"{unit}_{run}",
                    "status": "done",
                    "reason": "",
                    "verdict": "effect" if delayed else "no_gap",
                    "gap_rms": level + 0.02 * rng.standard_normal(),
                    "effects": [{"name": "delay", "probability": 1.0, "shrink": 0.9, "parameters": [tau]}] if delayed else [],
                }
            )
    found[7] = {**found[7], "status": "failed", "reason": "<script>alert(1)</script>"}
    return found, begins


def test_a_page_of_ten_thousand_records(tmp_path):
    records, begins = rows()
    found = overview("diagnose", records)
    write_overview(found, records, tmp_path)
    delays = {onset.unit: onset.moment for onset in found.onsets if onset.quantity == "delay.tau"}
    assert delays == {unit: float(run) for unit, run in begins.items()}
    document = json.loads((tmp_path / "fleet.json").read_text())
    assert document["units"] == UNITS and len(document["onsets"]) == len(found.onsets)
    page = (tmp_path / "fleet.html").read_text()
    assert len(page) < 10e6
    assert "<script>alert(1)" not in page and "&lt;script&gt;alert(1)" in page


def test_a_page_of_ten_thousand_records_stays_small_in_a_browser(tmp_path):
    """Elements of the document and points drawn as vectors are counted: they make a page slow, and a clock would time the machine."""
    if reason := browsers.missing():
        pytest.skip(reason)
    records, _ = rows()
    write_overview(overview("diagnose", records), records, tmp_path)
    with browsers.chromium() as running:
        page = running.new_page(viewport={"width": 1200, "height": 1400})
        page.set_default_timeout(browsers.PATIENCE)
        page.goto((tmp_path / "fleet.html").as_uri())
        page.wait_for_selector("body[data-drawn]")
        cells = page.evaluate("document.querySelector('figure.chart .js-plotly-plot').data[0].y.length")
        elements = page.evaluate("document.querySelectorAll('*').length")
        points = page.evaluate(
            "[...document.querySelectorAll('.js-plotly-plot')].flatMap(one => one._fullData)"
            ".filter(trace => trace.type === 'scatter').reduce((sum, trace) => sum + trace.x.length, 0)"
        )
        (tmp_path / "page.png").write_bytes(page.screenshot())
    assert cells == UNITS and (tmp_path / "page.png").stat().st_size > 20_000
    assert elements < 5000 and points < 10_000


def seen_page(folder, width):
    if reason := browsers.missing():
        pytest.skip(reason)
    with browsers.chromium() as running:
        return browsers.look_at(running, folder / "fleet.html", width)


@pytest.mark.parametrize("width", [420, 1400])
def test_a_browser_shows_the_page(width, tmp_path):
    records, _ = rows(units=20, runs=15)
    write_overview(overview("diagnose", records), records, tmp_path)
    seen = seen_page(tmp_path, width)
    assert seen.figures >= 2 and "Changes" in seen.text and "Records that failed" in seen.text
    assert not seen.complaints and not seen.overlaps and not seen.empty_axes and not seen.empty_tables and not seen.too_wide
    assert "15 runs" in seen.text and "night" not in seen.text


def test_a_fleet_without_changes_has_no_empty_table(tmp_path):
    records = [{**row, "verdict": "no_gap", "effects": [], "status": "done"} for row in rows(units=8, runs=11)[0]]
    write_overview(overview("diagnose", records), records, tmp_path)
    seen = seen_page(tmp_path, 800)
    assert not seen.empty_tables and "Changes" not in seen.text and "0 changes" in seen.text


def test_the_map_has_a_color_for_each_verdict_and_none_between(tmp_path):
    records, _ = rows(units=20, runs=15)
    figure = _verdict_map(found := overview("diagnose", records), _Links(found, tmp_path))
    (map_,) = figure.data
    assert list(map_.colorbar.ticktext) == ["effect", "no gap"] and (map_.zmin, map_.zmax) == (-0.5, 1.5)
    (low, first), (end, same), (begin, second), (high, last) = map_.colorscale
    assert (low, end, begin, high) == (0.0, 0.5, 0.5, 1.0) and first == same != second == last


def test_models_over_runs():
    rng = np.random.default_rng(0)
    records = [
        {
            "unit": f"u{unit}",
            "time": str(run),
            "moment": float(run),
            "status": "done",
            "parameters": [{"name": "0.gain.value", "value": 1.0 + 0.01 * rng.standard_normal() + 0.2 * (unit == 3 and run > 9)}],
        }
        for unit in range(12)
        for run in range(20)
    ]
    [onset] = overview("identify", records).onsets
    assert (onset.unit, onset.moment) == ("u3", 10.0) and abs(onset.size - 0.2) < 0.03


def test_a_click_opens_the_page_of_a_record(tmp_path):
    """In a real browser: a cell of the map, and a unit's name in the table, lead to the record's own page."""
    if reason := browsers.missing():
        pytest.skip(reason)
    records, begins = rows(units=20, runs=15)
    unit, run = next(iter(begins.items()))
    (tmp_path / "reports").mkdir()
    own = tmp_path / "reports" / f"{unit} 1.html"
    own.write_text("<title>own page</title>")
    for record in records:
        if record["unit"] == unit and record["moment"] == run:
            record["page_file"] = str(own)
    write_overview(overview("diagnose", records), records, tmp_path)
    place = """([unit, run]) => {
        const chart = document.querySelector("figure.chart .js-plotly-plot");
        const box = chart.querySelector(".nsewdrag").getBoundingClientRect(), axes = chart._fullLayout;
        return [box.x + axes.xaxis.d2p(run), box.y + axes.yaxis.d2p(unit)];
    }"""
    with browsers.chromium() as running:
        page = running.new_page(viewport={"width": 1200, "height": 1400})
        page.set_default_timeout(browsers.PATIENCE)
        page.goto((tmp_path / "fleet.html").as_uri())
        page.wait_for_selector("body[data-drawn]")
        page.mouse.click(*page.evaluate(place, [unit, run]))
        page.wait_for_url("**/reports/*")
        assert page.title() == "own page"
        page.go_back()
        page.wait_for_selector("body[data-drawn]")
        page.get_by_role("link", name=unit).first.click()
        page.wait_for_url("**/reports/*")
        assert page.title() == "own page"


def test_a_gap_that_grows_with_the_distance_from_the_clean_runs_is_no_change():
    """Temperature: a gap to baseline records at 20 degrees grows as it gets warmer and as it gets colder."""
    rng = np.random.default_rng(8)
    temperature = 20.0 + np.concatenate([np.zeros(2), 3.0 * rng.standard_normal(24), np.full(4, -4.0)])
    records = [
        {
            "unit": f"u{unit:02d}",
            "time": str(run),
            "moment": float(run),
            "status": "done",
            "verdict": "not_diagnosed",
            "baseline": [] if run < 2 else [f"u{unit:02d}_0"],
            "temperature": str(degrees),
            "gap_rms": 0.5
            if run < 2
            else 0.01 + 0.002 * abs(degrees - 20.0) + 5e-4 * rng.standard_normal() + 0.05 * (unit == 5 and run > 14),
            "effects": [],
        }
        for unit in range(20)
        for run, degrees in enumerate(temperature)
    ]  # fmt: skip
    found = overview("diagnose", records, ["temperature"])
    assert [(onset.unit, onset.moment) for onset in found.onsets] == [("u05", 15.0)] and not found.trends
    assert [effect.covariate for effect in found.covariates] == ["temperature, distance from the baseline records"]


def test_a_temperature_is_a_covariate_where_units_have_times_of_their_own():
    rng = np.random.default_rng(9)
    records = [
        {
            "unit": f"u{unit:02d}",
            "time": str(run + unit / 20),
            "moment": run + unit / 20,
            "status": "done",
            "temperature": str(degrees),
            "parameters": [{"name": "0.gain.value", "value": 1.0 + 0.02 * degrees + 1e-3 * rng.standard_normal()}],
        }
        for unit in range(20)
        for run, degrees in enumerate(20.0 + rng.standard_normal(12))
    ]
    [effect] = overview("identify", records, ["temperature"]).covariates
    assert effect.covariate == "temperature" and effect.slope == pytest.approx(0.02, abs=1e-3)


def dated(records, day):
    """The same records with a date for each run."""
    dates = [datetime(2026, 1, 1) + timedelta(days=day * int(row["time"])) for row in records]
    return [{**row, "time": f"{date:%Y-%m-%d}", "moment": date.timestamp()} for row, date in zip(records, dates, strict=True)]


def test_runs_with_dates_are_shown_with_dates(tmp_path):
    records, begins = rows(units=20, runs=15)
    records = dated(records, day=7)
    found = overview("diagnose", records)
    write_overview(found, records, tmp_path)
    page = (tmp_path / "fleet.html").read_text()
    for run in begins.values():
        assert f"<td>{datetime(2026, 1, 1) + timedelta(days=7 * run):%Y-%m-%d}</td>" in page
    assert "e+09</td>" not in page
    (map_,) = _verdict_map(found, _Links(found, tmp_path)).data
    assert map_.x[1] == datetime(2026, 1, 8)
    drift = Trend("u001", "gap_rms", 1.0, 1e-6, 1e-7, 0.2, found.moments[-1], 0.0, 1e300, found.moments[-1], None)
    told = _trend_row(drift, found, _Links(found, tmp_path))
    assert told[3] == "0.0864 ± 0.0086" and told[4].startswith("98") and told[5] == "2026-04-09 to never"


def test_an_effect_that_is_one_of_two_alternatives_begins_where_it_is_first_named():
    """Whichever of them a report happens to name first."""
    rng, records = np.random.default_rng(2), []
    for unit in range(6):
        for run in range(15):
            there = unit == 2 and run >= 4
            share = rng.uniform(0.3, 0.9) if run > 5 else 0.2  # the first reports believe the other one
            effects = [
                {"name": name, "probability": chance, "parameters": [{"name": size, "value": value + 1e-3 * rng.standard_normal()}]}
                for name, size, value, chance in (("offset", "offset", 0.28, share), ("creep", "gamma", 0.03, 1.0 - share))
            ]
            records.append(
                {
                    "unit": f"u{unit}",
                    "time": str(run),
                    "moment": float(run),
                    "status": "done",
                    "verdict": "ambiguous" if there else "no_gap",
                    "gap_rms": 0.1 + 0.01 * rng.standard_normal(),
                    "effects": sorted(effects, key=lambda effect: -effect["probability"]) if there else [],
                }
            )
    onsets = {(onset.unit, onset.quantity): onset.moment for onset in overview("diagnose", records).onsets}
    assert onsets == {("u2", "offset.offset"): 4.0}
