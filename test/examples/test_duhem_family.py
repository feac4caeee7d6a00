# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Duhem hysteresis on the plant `third`, whose truth is integrated by another program: loops that no play operator closes."""

from __future__ import annotations

import numpy as np

from hyst_control.identify import identify
from hyst_control.model_file import simulate
from hyst_control.records.excitation.excitation import build
from hyst_control.records.record import Record, sampled_record
from hyst_plant_sim.physics import load_plant

SAMPLE_TIME, TOP = 5e-5, 100.0


def test_the_third_plant_is_identified_within_half_a_per_cent_of_its_stroke():
    """From one diagnostic record and the loops for play operators, on a record of another seed; noise is 0.01 % of the stroke."""
    plant = load_plant({"plant": "third", "rating": [0.0, TOP]}, seed=1, sample_time=SAMPLE_TIME, noise=1e-3)

    def record(spec: dict) -> Record:
        rows = build(spec, SAMPLE_TIME, 1)
        measured = np.concatenate([plant.reset(rows[0])[None], plant.step(rows)[:-1]])
        return sampled_record(spec["signal"], rows, measured, SAMPLE_TIME, ("x",), "um", start="auto")

    diagnostic = {"signal": "diagnostic", "lowest": 0.0, "highest": TOP}
    taught = [record({"signal": "hampi_identification", "peak": TOP}), record({**diagnostic, "seed": 5000})]
    fit = identify(taught, "duhem", structure="modes=1,delay", creep=True)
    fresh = record({**diagnostic, "seed": 6000})
    error = simulate(fit.model, fresh.command) - fresh.measurement
    stroke = float(np.ptp(fresh.measurement))
    assert np.sqrt(np.mean(error**2)) < 0.005 * stroke
    assert {row["assumed"] for row in fit.report["beginnings"]} == {"at rest at 0 V, on the initial loading curve"}
    found = {row["name"]: row["value"] for row in fit.report["parameters"]}
    assert abs(found["exponent"] - 1.3) < 0.1 and abs(found["alpha"] + 0.026) < 0.002
