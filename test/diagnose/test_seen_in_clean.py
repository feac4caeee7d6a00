# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A mode that the model lacks is in the baseline records too, so it is not named as a change."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.effects import EFFECTS
from hyst_control.model_file import Model
from hyst_control.records.record import Record, Signal

RATE, COUNT = 5000.0, 5000
RIVALS = {"resonance", "vibration", "gain", "delay", "added_mass", "creep", "sensor_lowpass", "amplifier_lowpass"}
"""Effects that are looked for: all that change a linear response, and a line."""
UNITS = {"command": "V", "measurement": "um"}


def modal(frequency: float, damping: float, gain: float) -> TransferFunction:
    rate = 2 * np.pi * frequency
    return TransferFunction([gain * rate**2], [1.0, 2 * damping * rate, rate**2])


MODEL = Model("one mode", ("x",), UNITS, 1 / RATE, Chain((modal(300.0, 0.05, 0.1),)), "foh")


def noise(fast: float, seed: int) -> np.ndarray:
    """Noise of 20 V rms up to 400 Hz, of `fast` (V rms) from there to 1500 Hz, from rest."""
    random, frequency, rows = np.random.default_rng(seed), np.fft.rfftfreq(COUNT, 1 / RATE), np.zeros(COUNT)
    for low, high, size in ((0.0, 400.0, 20.0), (400.0, 1500.0, fast)):
        spectrum = np.fft.rfft(random.normal(size=COUNT))
        spectrum[(frequency < low) | (frequency >= high)] = 0.0
        band = np.fft.irfft(spectrum, COUNT)
        rows += size * band / band.std()
    return rows * np.clip(np.arange(COUNT) / 500.0, 0.0, 1.0)


def record(command: np.ndarray, seed: int) -> Record:
    """A machine with a second mode at 1150 Hz that the model has not, by scipy."""
    time, measured = np.arange(COUNT) / RATE, np.zeros(COUNT)
    for frequency, damping, size in ((300.0, 0.05, 0.1), (1150.0, 0.02, 0.006)):
        rate = 2 * np.pi * frequency
        system = StateSpace([[0.0, 1.0], [-(rate**2), -2 * damping * rate]], [[0.0], [rate**2]], [[size, 0.0]], [[0.0]])
        measured = measured + lsim(system, command, time)[1]
    measured = measured + 1e-3 * np.random.default_rng(seed).normal(size=COUNT)
    signals = {"command": Signal(time, command[:, None], ("x",), "V"), "measurement": Signal(time, measured[:, None], ("x",), "um")}
    return Record(signals, f"seed {seed}", hold="foh")


def test_a_mode_that_the_model_never_had_is_no_change():
    """The new command excites it ten times as much as those of the baseline records did."""
    clean = [record(noise(2.0, seed), seed) for seed in (1, 2)]
    others = [name for name in EFFECTS if name not in RIVALS]
    report, *_ = diagnosed([record(noise(20.0, 3), 3)], MODEL, cache=False, baseline=clean, without=others)
    assert report["verdict"] in ("no_gap", "parameters")


def test_a_change_beside_such_a_mode_is_named():
    """A gain that falls by 6 % over the record, with a mode that the model never had."""
    clean, new = [record(noise(5.0, seed), seed) for seed in (1, 2)], record(noise(10.0, 3), 3)
    measured = new.signals["measurement"]
    fallen = measured.values * (1.0 - 0.06 * measured.time / measured.time[-1])[:, None]
    new = Record({**new.signals, "measurement": Signal(measured.time, fallen, ("x",), "um")}, "new", hold="foh")
    others = [name for name in EFFECTS if name not in RIVALS | {"gain_drift"}]
    report, *_ = diagnosed([new], MODEL, cache=False, baseline=clean, without=others)
    assert [one["name"] for one in report["effects"]] == ["gain_drift"]
    assert report["effects"][0]["parameters"]["change"]["value"] == pytest.approx(-0.06, rel=0.1)
