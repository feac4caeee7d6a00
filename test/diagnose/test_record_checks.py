# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Checks without a fit, each beside what it must not take for its finding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import StateSpace
from hyst_control.diagnose.noise.flicker import flicker
from hyst_control.diagnose.record_checks.summary import (
    outliers,
)
from hyst_control.diagnose.report.document import sentence
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.effects import EFFECTS
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record, Signal

STEP = 5e-3
TIME = STEP * np.arange(6000)


def coupled(measured, noise=2e-3):
    """A plant with two axes whose modes both of them share, its command, and a record: `measured` of model and command, with noise."""
    w = 2 * np.pi * 300.0
    a = w * np.array([[-0.2, -1.0, 0.0, 0.0], [1.0, -0.2, 0.0, 0.0], [0.0, 0.0, -0.3, -1.3], [0.0, 0.0, 1.3, -0.3]])
    b, c = w * np.array([[1.0, 0.2], [0.0, 0.1], [0.3, 1.0], [0.1, 0.0]]), np.array([[0.2, 1.0, 0.1, 0.3], [0.1, 0.2, 0.0, 1.0]])
    plant = StateSpace(a, b, c, np.zeros((2, 2)))
    model = Model("coupled", ("x", "y"), {"command": "V", "measurement": "mrad"}, 2e-4, Chain((plant,)), noise={"sigma": noise})
    random = np.random.default_rng(3)
    command = np.repeat(random.uniform(0.0, 1.0, (250, 2)), 16, axis=0)
    command[:300] = 0.0
    values = measured(model, command) + noise * random.standard_normal(command.shape)
    time = 2e-4 * np.arange(len(command))
    signals = {"command": Signal(time, command, ("x", "y"), "V"), "measurement": Signal(time, values, ("x", "y"), "mrad")}
    return model, command, Record(signals, "coupled")


def test_a_gain_of_all_coupled_axes_is_one_effect():
    """Both axes of a coupled plant are 4 % weak: one value on both, not an effect per axis."""

    def weak(model, command):
        (plant,) = model.chain.stages
        return simulate(replace(model, chain=Chain((replace(plant, C=0.96 * np.array(plant.C)),))), command)

    model, command, record = coupled(weak)
    others = [name for name in EFFECTS if name not in ("gain", "gain_drift", "delay", "cross_coupling", "creep")]
    report, _, better = diagnosed([record], model, without=others)
    first = report["effects"][0]
    assert (first["name"], first["axis"]) == ("gain", ["x", "y"])
    low, high = first["parameters"]["gain"]["ci90"]
    assert low < -0.04 < high and high - low < 0.02
    left = record.signal("measurement").values - simulate(better, command)
    assert np.sqrt(np.mean(left**2)) < 1.1 * 2e-3


def test_an_effect_on_each_of_two_coupled_axes_and_another_on_one_are_two_effects():
    """Hum on both axes and a vibration on one: three sizes, but no more than two effects on an axis."""

    def disturbed(model, command):
        time = 2e-4 * np.arange(len(command))
        hum = np.column_stack([0.02 * np.sin(2 * np.pi * 50.0 * time), 0.03 * np.sin(2 * np.pi * 50.0 * time + 1.0)])
        return simulate(model, command) + hum + np.column_stack([np.zeros(len(time)), 0.025 * np.sin(2 * np.pi * 87.3 * time)])

    model, _, record = coupled(disturbed)
    others = [name for name in EFFECTS if name not in ("mains_hum", "vibration", "gain", "offset")]
    report, _, _ = diagnosed([record], model, without=others)
    assert report["verdict"] == "effect"
    assert {row["name"]: row["axis"] for row in report["effects"]} == {"mains_hum": ["x", "y"], "vibration": ["y"]}


def test_outliers_are_told_from_noise_of_any_colour():
    random = np.random.default_rng(5)
    white = random.normal(size=30000)
    for noise in (
        white,
        np.cumsum(white),
        np.convolve(white, np.ones(10) / 10, "same"),
        np.sin(np.arange(30000) * 0.3) * 50 + white,
    ):
        assert outliers(noise)[0] == 0
    spiked = white.copy()
    at = random.choice(30000, 60, replace=False)
    spiked[at] += random.choice([-1, 1], 60) * random.uniform(20, 40, 60)
    count, rms = outliers(spiked)
    assert 55 <= count <= 60 and rms == pytest.approx(np.sqrt(np.mean((spiked - white) ** 2)), rel=0.1)
    assert outliers(np.round(white, 0))[0] == 0


def test_a_sensor_that_flips_between_two_values_has_no_outliers():
    white = np.random.default_rng(5).normal(size=6000)
    truth = np.repeat([3.45, 7.02, 1.48], 2000)
    left = np.round(truth + 0.02 * white) - truth
    assert outliers(left)[0] > 100 and outliers(left, step=1.0)[0] == 0
    left[[500, 3000]] += 5.0
    assert outliers(left, step=1.0)[0] == 2


def test_no_gap_is_not_said_to_lie_within_tolerances_that_the_fit_leaves_far_behind():
    report = {
        "verdict": "no_gap",
        "gap": {"rms": 0.2, "nrmse": 2.0, "unit": "um", "floor_rms": 0.1},
        "effects": [],
        "baseline": {"repeatability": [0.14], "unit": "um", "same_command": False},
        "parameters": [{"name": "frequency[0]", "z": -20.0}],
    }
    far = sentence(report)
    assert far.startswith("No gap beyond the 0.14 um rms that the model leaves on baseline records and the noise")
    assert far.endswith("The best fit moves the model's coefficients by 20 σ together, which the model discrepancy can cause.")
    assert "by 12 σ together" in sentence(report | {"parameters": [], "strain": 12.0})
    named = sentence(report | {"baseline": report["baseline"] | {"of_model": True}})
    assert "leaves on the records it was identified from" in named
    near = sentence(report | {"parameters": [{"name": "frequency[0]", "z": -2.0}]})
    assert near.startswith("No gap beyond the model's tolerances, the 0.14 um rms") and "best fit" not in near


def test_the_sentence_says_why_nothing_known_explains_a_gap():
    report = {
        "verdict": "unknown",
        "gap": {"rms": 1.0, "nrmse": 2.0, "unit": "um", "floor_rms": 0.1},
        "effects": [{"name": name} for name in ("offset", "gain_drift", "softening_modes")],
        "unexplained_share": 0.5,
    }
    assert "offset and gain drift and softening modes, leaves 50 % of it" in sentence(report)
    told = sentence(report | {"unexplained_share": 0.001, "reasons": ["too_many_effects"]})
    assert "it would take offset and gain drift and softening modes at once" in told and "leaves" not in told
    told = sentence(report | {"unexplained_share": 0.01, "reasons": ["at_bound"]})
    assert "would, with a size at the end of its range" in told and "leaves" not in told
    told = sentence(report | {"reasons": ["distortion_level"]})
    assert "stays on one level" in told and "gain drift" not in told
    both = sentence(report | {"reasons": ["energy_left", "too_many_effects"]})
    assert "leaves 50 % of it" in both and "at once" not in both
    assert sentence(report | {"effects": []}).endswith("noise floor 0.1 um).")
    fitted = [{"name": "offset", "shrink": 0.5, "shrink_reidentified": 0.82}]
    told = sentence(report | {"unexplained_share": 1.0, "effects": fitted})  # the one number of the effects' lines
    assert "offset, explains 82 % of it after re-fitting the model" in told and "100 %" not in told
    assert "explains nothing of it" in sentence(report | {"effects": [fitted[0] | {"shrink_reidentified": -0.1}]})
    far = {"reasons": ["unexplained_share"], "parameters": [{"name": "num[0]", "z": 31.2}, {"name": "k", "z": 5.5}]}
    assert "would, but only with coefficients 31 σ from the model's." in sentence(report | far)


@pytest.mark.parametrize(
    "shrink, told",
    [
        (0.4, "It explains 40 % of the gap, and 90 % after re-fitting the model."),
        (-9.0, "It explains nothing of the gap itself, but 90 % after re-fitting the model."),
    ],
)
def test_the_sentence_says_how_much_of_the_gap_is_explained(shrink, told):
    """The report's shrink ends at -10: as a per cent it would mean nothing."""
    effect = {"name": "offset", "shrink": shrink, "shrink_reidentified": 0.9, "parameters": {}}
    gap = {"rms": 1.0, "nrmse": 2.0, "unit": "um", "floor_rms": 0.1}
    assert told in sentence({"verdict": "effect", "gap": gap, "effects": [effect], "unexplained_share": 0.0})


def test_the_sentence_says_what_is_no_gap_and_what_a_session_has():
    report = {
        "verdict": "no_gap",
        "gap": {"rms": 1.0, "nrmse": 2.0, "unit": "um", "floor_rms": 0.1},
        "effects": [],
        "where": {"stage": [{"name": "session", "share": 0.75}]},
    }
    left = {"same_command": False, "repeatability": [0.2, 0.3], "unit": "um"}
    assert "tolerances and the noise" in sentence(report)
    assert "tolerances, the 0.3 um rms that the model leaves on baseline records, and the noise" in sentence(
        report | {"baseline": left}
    )
    differ = sentence(report | {"baseline": left | {"same_command": True}})
    assert (
        "that baseline records differ by" in differ and "differ by 0.5 um rms" in differ and "; 1 um with the session's" in differ
    )
    offset = {"name": "offset", "shrink": None, "shrink_reidentified": None}
    named = sentence(report | {"verdict": "effect", "effects": [offset]})
    assert named.startswith("The gap of 1 um rms") and "with the session's" not in named


def test_a_gain_that_comes_and_goes_is_no_flicker_noise():
    """Between the lines of the command its spectrum falls as that of 1/f noise does, but it jumps."""
    rows = np.arange(1200)
    angle = 2 * np.pi * 6.0 * rows / 1200
    switched = 3.0 * (1.0 + np.sin(angle)) * (np.sin(40.0 * (rows + 400) / 1600) > 0)
    found = []
    for seed in range(20):
        seen = flicker(switched + 0.1 * np.random.default_rng(seed).standard_normal(1200), 50.0 + 20.0 * np.sin(angle))
        found.append(seen.plausible and seen.gain > 10.0)
    assert not any(found)


@pytest.mark.parametrize(("exponent", "least", "most"), [(1.0, 36, 40), (0.0, 0, 1)])
def test_flicker_noise_is_told_between_the_lines_of_what_the_model_leaves(exponent, least, most):
    """Of 40 draws beside an error that repeats six times: 1/f noise is found in nearly all, and white noise is none."""
    rows = 1200
    angle = 2 * np.pi * 6.0 * np.arange(rows) / rows
    own = 2.0 * sum(np.sin(k * angle + k) / k**1.5 for k in range(1, 8))

    def noise(seed: int) -> np.ndarray:
        spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(rows))
        spectrum[1:] /= np.arange(1, len(spectrum)) ** (0.5 * exponent)
        drawn = np.fft.irfft(spectrum, rows)
        return drawn / drawn.std()

    seen = [flicker(noise(seed) + own, 50.0 + 20.0 * np.sin(angle)) for seed in range(40)]
    assert least <= sum(one.plausible and one.gain > 10.0 for one in seen) <= most


@pytest.mark.parametrize(("exponent", "size"), [(1.0, 3.0), (0.8, 8.0)])
def test_flicker_noise_has_its_shape_in_most_draws(exponent, size):
    """1/f^p noise of several times the white noise's rms, made in the spectrum: its few lowest lines scatter widely."""
    rows = 16950
    lines = np.arange(1, rows // 2)

    def drawn(seed: int) -> np.ndarray:
        random = np.random.default_rng(seed)
        spectrum = np.zeros(rows // 2 + 1, complex)
        spectrum[1 : rows // 2] = (random.normal(size=len(lines)) + 1j * random.normal(size=len(lines))) / lines ** (0.5 * exponent)
        noise = np.fft.irfft(spectrum, rows)
        return size * noise / noise.std() + random.normal(size=rows)

    seen = [flicker(drawn(seed), np.ones(rows)) for seed in range(40)]
    assert sum(one.plausible for one in seen) >= 36
    assert np.median([one.rms for one in seen]) == pytest.approx(size, rel=0.05)
