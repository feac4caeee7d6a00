"""Rows of a fleet's diagnoses, drawn from a known law: what the page and the document say of them."""

from __future__ import annotations

import json
import time

import numpy as np

from hyst_control.fleet.overview import overview
from hyst_control.fleet.overview_page import write_overview

UNITS, NIGHTS = 200, 50


def rows(seed=3):
    """10,000 diagnoses; a delay that begins on eight units, and a gap that scatters."""
    rng = np.random.default_rng(seed)
    begins = {f"u{unit:03d}": int(rng.integers(5, 45)) for unit in rng.choice(UNITS, 8, replace=False)}
    found = []
    for unit in (f"u{index:03d}" for index in range(UNITS)):
        level = 0.1 + 0.01 * rng.standard_normal()
        for night in range(NIGHTS):
            delayed = night >= begins.get(unit, NIGHTS)
            tau = {"name": "tau", "value": 1e-4 * (1 + 0.05 * rng.standard_normal()), "low": 0.0, "high": 0.0, "unit": "s"}
            found.append(
                {
                    "unit": unit,
                    "time": str(night),
                    "moment": float(night),
                    "bag": f"{unit}_{night}",
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
    begin = time.process_time()
    found = overview("diagnose", records)
    write_overview(found, records, tmp_path)
    assert time.process_time() - begin < 120
    delays = {onset.unit: onset.moment for onset in found.onsets if onset.quantity == "delay.tau"}
    assert delays == {unit: float(night) for unit, night in begins.items()}
    document = json.loads((tmp_path / "fleet.json").read_text())
    assert document["units"] == UNITS and len(document["onsets"]) == len(found.onsets)
    page = (tmp_path / "fleet.html").read_text()
    assert len(page) < 10e6
    assert "<script>alert(1)" not in page and "&lt;script&gt;alert(1)" in page


def test_models_over_nights():
    rng = np.random.default_rng(0)
    records = [
        {
            "unit": f"u{unit}",
            "time": str(night),
            "moment": float(night),
            "status": "done",
            "parameters": [{"name": "0.gain.value", "value": 1.0 + 0.01 * rng.standard_normal() + 0.2 * (unit == 3 and night > 9)}],
        }
        for unit in range(12)
        for night in range(20)
    ]
    [onset] = overview("identify", records).onsets
    assert (onset.unit, onset.moment) == ("u3", 10.0) and abs(onset.size - 0.2) < 0.03
