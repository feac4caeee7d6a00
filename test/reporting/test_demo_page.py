# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The demo's report as a browser shows it: errors on a scale on which the controllers differ, PI alone, grouped headers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hyst_control.demo.figures import Tracked, report_page
from hyst_control.demo.workflow import CONTROLLERS, FREQUENCIES, SAMPLE_TIME, Stretch, score

ROWS = 2000
SIZE = {"static gain": 0.5, "HAPI": 0.1, "HAMPI": 0.01, "PI feedback": 0.3, "HAMPI + PI": 0.005}
"""um, amplitude of each controller's error."""
GAP = {
    "verdict": "effect",
    "gap": {"rms": 0.1, "nrmse": 3.0, "floor_rms": 0.005, "unit": "um"},
    "withheld": {"name": "slew_limit", "rate": 3e4},
    "effects": [
        {
            "name": "slew_limit",
            "probability": 1.0,
            "equivalent": [],
            "axis": ["x"],
            "shrink": 0.99,
            "shrink_reidentified": 0.99,
            "parameters": {"rate": {"value": 3e4, "ci90": [2.9e4, 3.1e4], "unit": "V/s"}},
        }
    ],
}


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    time = np.arange(4 * ROWS)[:, None] * SAMPLE_TIME
    reference = 3.0 - 2.0 * np.cos(2 * np.pi * 50.0 * time)
    measured = {
        name: {"measurement": reference + SIZE[name] * np.sin(2 * np.pi * 50.0 * time), "command": 10.0 * reference}
        for name in CONTROLLERS
    }
    stretches = [Stretch(frequency, i * ROWS, (i + 1) * ROWS) for i, frequency in enumerate(FREQUENCIES)]
    table = score(measured, reference, stretches)
    loop = {
        "measured": (reference[:ROWS, 0] * 10, reference[:ROWS, 0]),
        "HAMPI": (reference[:ROWS, 0] * 10, reference[:ROWS, 0] + 0.01),
    }
    fit = SimpleNamespace(report={"structure": ["1 mode"], "records": [{"nrmse": 0.3}], "held_out_nrmse": [0.4]})
    path = tmp_path_factory.mktemp("report") / "report.html"
    places = [(each.frequency, each.begin, each.end) for each in stretches]
    tracked = Tracked(SAMPLE_TIME, reference, measured, places)
    report_page({1.0: loop, 50.0: loop}, {"hampi": fit}, tracked, table, GAP, []).write(path)
    return path


@pytest.mark.parametrize("width", [420, 1400])
def test_a_browser_shows_the_report(page, width, browser):
    seen = browser(page, width)
    assert seen.figures == 3 and "simulated actuator" in seen.text and "published, another actuator" in seen.text
    assert not seen.complaints and not seen.overlaps and not seen.empty_axes and not seen.empty_tables and not seen.too_wide


def test_every_controller_is_compared_on_a_scale_on_which_they_differ(page):
    text = page.read_text(encoding="utf-8")
    assert "<th>PI feedback</th>" in text
    assert text.count('"title":{"text":"NRMSE [%]"},"type":"log"') == 1
    assert text.count('"dtick":1') == 1 + len(FREQUENCIES), "the error of every frequency"
    groups = [int(part.split("'")[0]) for part in text.split("<th colspan='")[1:]]
    assert groups == [1, len(CONTROLLERS), 2] and sum(groups) == text.partition("</thead>")[0].count("<th>")
