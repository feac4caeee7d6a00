# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A slow error of the model is no drift of the sensor, though the error as a whole is fast; a larger drift is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import idct

from hyst_control.diagnose.workflow import diagnosed
from hyst_control.identify.workflow import identified
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record, Signal, sampled_record
from test.diagnose.conftest import all_but
from test.diagnose.test_line_below_own_error import NOISE, RATE, TIME, loops, machine

SLOW, SIZE = 1.0, 30.0  # Frequency (Hz) below which the error's power is raised, and how much
COMMAND = loops(2.0, 90.0, 0.4)


@pytest.fixture(scope="module")
def model() -> Model:
    """A model whose error, by its file, is mostly fast: 5 ms long, but with much power below 1 Hz."""
    clean = loops(1.0, 100.0)
    record = sampled_record("clean", clean[:, None], machine(clean, 0)[:, None], 1.0 / RATE, ("x",), "um", start="settled")
    found = identified([record], "pi", operators=8).model
    [stated] = found.discrepancy["spectrum"]
    slow = np.array(stated["frequencies"]) < SLOW
    raised = {**stated, "error": np.where(slow, SIZE * np.array(stated["error"]), stated["error"]).tolist()}
    return replace(found, discrepancy={**found.discrepancy, "spectrum": [raised], "correlation": 0.005})


def report(model: Model, added: np.ndarray) -> dict:
    answer = simulate(model, COMMAND[:, None], 1.0 / RATE, model.hold)[:, 0]
    measured = answer + added + NOISE * np.random.default_rng(5).standard_normal(len(TIME))
    signals = {
        "command": Signal(TIME, COMMAND[:, None], ("x",), "V"),
        "measurement": Signal(TIME, measured[:, None], ("x",), "um"),
    }
    return diagnosed([Record(signals, "new")], model, without=all_but("offset_drift", "gain", "delay", "hysteresis_width"))[0]


def drawn(model: Model, seed: int) -> np.ndarray:
    """An error of the stated spectrum, of its slow part."""
    stated = model.discrepancy["spectrum"][0]
    frequencies = 0.5 * RATE * np.arange(len(TIME)) / len(TIME)
    power = np.array(stated["error"])[np.searchsorted(stated["frequencies"], frequencies, side="right") - 1]
    power[frequencies >= SLOW] = 0.0
    return idct(np.sqrt(power) * np.random.default_rng(seed).standard_normal(len(TIME)), norm="ortho")


@pytest.mark.parametrize("seed", [2, 3, 5])
def test_a_slow_error_that_the_spectrum_states_is_no_drift(model, seed):
    assert report(model, drawn(model, seed))["verdict"] == "no_gap"


def test_a_drift_beyond_it_is_one(model):
    change = 10.0 * model.discrepancy["rms"][0]
    found = report(model, change * np.clip((TIME - 1.0) / 0.2, 0.0, 1.0))
    assert [one["name"] for one in found["effects"]] == ["offset_drift"]
    assert found["effects"][0]["parameters"]["change"]["value"] == pytest.approx(change, rel=0.2)
