# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A line that is smaller than the model discrepancy, and many times what the model leaves at its frequency, without a baseline record."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from hyst_control.diagnose.workflow import diagnosed
from hyst_control.identify.workflow import identified
from hyst_control.model_file import Model
from hyst_control.records.record import Record, Signal, sampled_record
from test.diagnose.conftest import all_but
from test.diagnose.test_baseline import bouc_wen

RATE, SECONDS, NOISE = 1000.0, 4.0, 0.004
TIME = np.arange(int(RATE * SECONDS)) / RATE


def machine(command: np.ndarray, seed: int) -> np.ndarray:
    """Bouc-Wen hysteresis with a creep of 0.3 s: a play model leaves slow errors of some hundredths of a micrometre."""
    hysteresis = bouc_wen(command)
    keep = np.exp(-1.0 / RATE / 0.3)
    creeping = hysteresis + 0.03 * lfilter([1.0 - keep], [1.0, -keep], hysteresis)
    return creeping + NOISE * np.random.default_rng(seed).standard_normal(len(command))


def loops(frequency: float, amplitude: float, fall: float = 0.2) -> np.ndarray:
    """Sine about the middle of 0 to 100 V, from 0 V on, whose amplitude falls."""
    envelope = amplitude * (1.0 - fall * TIME / SECONDS)
    return envelope * 0.5 * (1.0 - np.cos(2 * np.pi * frequency * TIME))


@pytest.fixture(scope="module")
def model() -> Model:
    commands = [loops(1.0, 100.0), loops(0.5, 80.0, 0.6), loops(3.0, 60.0)]
    clean = [
        sampled_record(f"clean {seed}", u[:, None], machine(u, seed)[:, None], 1.0 / RATE, ("x",), "um", start="settled")
        for seed, u in enumerate(commands)
    ]
    return identified(clean, "pi", operators=8).model


def report(model: Model, added: np.ndarray) -> dict:
    command = loops(2.0, 90.0, 0.4)
    measured = machine(command, 77) + added
    signals = {
        "command": Signal(TIME, command[:, None], ("x",), "V"),
        "measurement": Signal(TIME, measured[:, None], ("x",), "um"),
    }
    without = all_but(
        "vibration", "mains_hum", "resonance", "flicker_noise", "offset_drift", "gain", "delay", "creep", "hysteresis_width"
    )
    return diagnosed([Record(signals, "new")], model, without=without)[0]


def line(model: Model, frequency: float) -> tuple[float, np.ndarray]:
    """A line of half the rms that the model states of its error."""
    amplitude = 0.5 * np.sqrt(2.0) * model.discrepancy["rms"][0]
    return amplitude, amplitude * np.sin(2 * np.pi * frequency * TIME + 0.7)


def test_the_own_error_is_above_the_noise(model):
    assert model.discrepancy["rms"][0] > 3.0 * NOISE


@pytest.mark.parametrize(("frequency", "name"), [(50.0, "mains_hum"), (137.0, "vibration")])
def test_it_is_named_with_its_size(model, frequency, name):
    amplitude, added = line(model, frequency)
    found = report(model, added)
    assert found["verdict"] == "effect"
    assert [one["name"] for one in found["effects"]] == [name]
    assert found["effects"][0]["parameters"]["amplitude"]["value"] == pytest.approx(amplitude, rel=0.1)


def test_the_size_alone_hides_it(model):
    """The same record beside the same model, whose file does not state the spectrum."""
    without = {name: value for name, value in model.discrepancy.items() if name != "spectrum"}
    assert report(replace(model, discrepancy=without), line(model, 50.0)[1])["verdict"] == "no_gap"


def test_a_clean_record_has_no_gap(model):
    assert report(model, np.zeros(len(TIME)))["verdict"] == "no_gap"
