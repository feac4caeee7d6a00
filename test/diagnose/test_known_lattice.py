# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The lattice of a sensor, which a model knows from the records that it was identified from."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hyst_control.diagnose.workflow import diagnosed
from hyst_control.identify.workflow import identify_records
from hyst_control.model_file import load_model, save_model
from hyst_control.records.record import Record, Signal
from test.diagnose.conftest import all_but

SAMPLE_TIME, ROWS, NOISE = 1e-3, 4000, 0.005


def record(seed: int, step: float) -> Record:
    """A lag of 60 Hz seen by a sensor that rounds."""
    random, time = np.random.default_rng(seed), SAMPLE_TIME * np.arange(ROWS)
    waves = sum(np.sin(2 * np.pi * f * time + random.uniform(0.0, 6.28)) for f in np.arange(0.5, 20.0, 0.5))
    command = 20.0 + 8.0 * waves / np.max(np.abs(waves))
    keep = np.exp(-SAMPLE_TIME * 2 * np.pi * 60.0)
    moved, _ = lfilter([0.0, 1.0 - keep], [1.0, -keep], command, zi=[keep * command[0]])
    measured = step * np.rint((moved + NOISE * random.standard_normal(ROWS)) / step)
    signals = {"command": Signal(time, command[:, None], ("x",), "V"), "measurement": Signal(time, measured[:, None], ("x",), "um")}
    return Record(signals, "record")


@pytest.mark.parametrize("seed", [1, 2])
def test_the_lattice_of_before_is_no_gap_and_a_coarser_one_is(seed, tmp_path):
    save_model(identify_records([record(0, NOISE)], "linear").model, tmp_path / "lag.yaml")
    model = load_model(tmp_path / "lag.yaml")
    assert model.discrepancy["step"] == [pytest.approx(NOISE)]
    without = all_but("quantization", "gain", "delay", "offset")
    same, _, _ = diagnosed([record(seed, NOISE)], model, cache=False, without=without)
    assert same["verdict"] == "no_gap" and not same["effects"]
    coarser, _, _ = diagnosed([record(seed, 4.0 * NOISE)], model, cache=False, without=without)
    assert [effect["name"] for effect in coarser["effects"]] == ["quantization"]
