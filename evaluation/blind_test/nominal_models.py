# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Models against which the cases of the blind test are diagnosed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from evaluation.blind_test.case_records import respond
from evaluation.blind_test.plant_setups import IDENTIFICATION, SCATTER, SETUPS, TOLERANCE
from hyst_control.base.arrays import Array
from hyst_control.base.config_files import config_path
from hyst_control.identify import identify
from hyst_control.identify.data.initial_memory import with_beginning
from hyst_control.identify.workflow import discrepancy
from hyst_control.model_file import Model, load_model, simulate
from hyst_control.records.excitation.excitation import build
from hyst_control.records.record import sampled_record
from hyst_plant_sim.physics import load_plant

CLEAN_SEEDS = (5000, 5001, 5002, 5003)
"""Of the diagnostic records that an identified model states its error on; it is fitted to the first of them."""


@cache
def nominal(plant: str, noise: float) -> Model:
    """Return the model against which a case is diagnosed.

    It is the published model, or one identified from baseline records of the nominal plant, which says what it leaves on such records. Its
    tolerance is the scatter of the plants; its noise is that of the sensor.
    """
    setup = SETUPS[plant]
    sigma = noise * setup.stroke
    model = load_model(config_path(setup.model)) if setup.model is not None else _identified(plant)[0]
    return replace(
        model,
        sample_time=setup.sample_time,
        noise={"sigma": sigma},
        tolerance={name: SCATTER for name in TOLERANCE},
        uncertainty={},  # that of one unit, smaller than the scatter between units
        valid={**model.valid, "command": list(setup.command)},
    )


@cache
def _identified(plant: str) -> tuple[Model, float]:
    """Identified model of the nominal plant, and its residual (rms) on a record that was not used to identify it."""
    setup, (family, spec) = SETUPS[plant], IDENTIFICATION[plant]
    low, high = setup.command
    truth = load_plant({"plant": plant, "rating": [low, high]}, seed=1, sample_time=setup.sample_time, noise=1e-4 * setup.stroke)

    def clean(spec: Mapping[str, Any]) -> tuple[Array, Array]:
        rows = build(spec, setup.sample_time, len(truth.axes))
        return rows, respond(truth, rows)

    diagnostic = {"signal": "diagnostic", "lowest": low, "highest": high}
    runs = [clean({**spec, "peak": high}), *(clean({**diagnostic, "seed": seed}) for seed in CLEAN_SEEDS)]
    records = [
        sampled_record(f"clean {index}", *record, setup.sample_time, truth.axes, truth.units["measurement"], start="settled")
        for index, record in enumerate(runs)
    ]
    model = identify(records[:2], family).model
    model = replace(model, discrepancy=discrepancy(model, [with_beginning(data) for data in records]))
    rows, measured = clean({**diagnostic, "seed": 6000})
    return model, float(np.sqrt(np.mean((measured - simulate(model, rows, setup.sample_time)) ** 2)))


def stated_noise(plant: str, noise: float) -> float:
    """Noise that the nominal model of a plant states, with what an identified model leaves on a record that it was not fitted to."""
    sigma = float(np.max(nominal(plant, noise).noise["sigma"]))
    return sigma if SETUPS[plant].model is not None else float(np.hypot(sigma, _identified(plant)[1]))
