# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects of the truth plants: absent they change no bit, they grow with their severity, act where and from when they are told."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from hyst_plant_sim.physics import EFFECTS, PLANTS, PlantError, load_plant

GROWING = {
    "dac_hold": [{"step": 0.2}, {"step": 1.0}, {"step": 4.0}],
    "clock_rate_mismatch": [{"share": s} for s in (1e-4, 1e-3, 1e-2)],
    "delay": [{"tau": s} for s in (1e-5, 7e-5, 3e-4)],
    "slew_limit": [{"rate": s} for s in (4e4, 1e4, 3e3)],
    "saturation": [{"upper": s} for s in (44.0, 38.0, 30.0)],
    "crossover_dead_band": [{"half_width": s} for s in (0.2, 1.0, 4.0)],
    "dead_zone": [{"half_width": s} for s in (0.2, 1.0, 4.0)],
    "amplifier_lowpass": [{"cutoff": s} for s in (2e4, 3e3, 300.0)],
    "hysteresis_width": [{"width": s} for s in (0.03, 0.1, 0.4)],
    "hysteresis_shape": [{"amount": s} for s in (0.003, 0.01, 0.04)],
    "hysteresis_rate": [{"factor": s} for s in (1.1, 1.5, 3.0)],
    "gain_scheduled_hysteresis": [{"amount": s} for s in (0.05, 0.2, 1.0)],
    "creep": [{"gamma": s} for s in (0.003, 0.01, 0.04)],
    "resonance": [{"gain": s} for s in (0.003, 0.01, 0.05)],
    "added_mass": [{"mass_ratio": s} for s in (0.03, 0.1, 0.4)],
    "duffing_stiffness": [{"share": s} for s in (0.01, 0.05, 0.2)],
    "guide_friction": [{"share": s} for s in (0.003, 0.01, 0.05)],
    "cubic_stiffness": [{"loss": s} for s in (0.05, 0.2, 0.8)],
    "dry_friction": [{"slack": s} for s in (0.01, 0.03, 0.1)],
    "clearance": [{"excess": s} for s in (0.02, 0.05, 0.2)],
    "wandering_mode": [{"change": s} for s in (0.02, 0.08, 0.2)],
    "backlash": [{"half_width": s} for s in (0.002, 0.01, 0.05)],
    "vibration": [{"amplitude": s} for s in (0.002, 0.01, 0.05)],
    "cross_coupling": [{"coupling": s} for s in (0.003, 0.01, 0.05)],
    "sensor_lowpass": [{"cutoff": s} for s in (2e4, 3e3, 300.0)],
    "sensor_nonlinearity": [{"second": s} for s in (0.003, 0.01, 0.05)],
    "output_saturation": [{"upper": s} for s in (0.8, 0.3, 0.1)],
    "gain": [{"gain": s} for s in (0.003, 0.01, 0.05)],
    "gain_drift": [{"change": s} for s in (0.003, 0.01, 0.05)],
    "offset": [{"offset": s} for s in (0.003, 0.01, 0.05)],
    "offset_drift": [{"change": s} for s in (0.003, 0.01, 0.05)],
    "mains_hum": [{"amplitude": s} for s in (0.003, 0.01, 0.05)],
    "sensor_noise": [{"rms": s} for s in (0.003, 0.01, 0.05)],
    "flicker_noise": [{"rms": s} for s in (0.003, 0.01, 0.05)],
    "outliers": [{"fraction": s} for s in (0.003, 0.02, 0.2)],
    "quantization": [{"step": s} for s in (0.01, 0.05, 0.2)],
    "held_samples": [{"fraction": s} for s in (0.02, 0.1, 0.5)],
}
"""Three severities of every effect, growing."""

RANDOM = ("sensor_noise", "flicker_noise", "outliers", "held_samples", "vibration", "quantization")
"""Drawn anew at another internal step, or a lattice of which a hair's breadth decides."""

STEPS = {"pea": 5e-5, "pea_published": 5e-5, "third": 5e-5, "fsm": 1e-4, "fsm_published": 1e-4}


def command(sample_time: float, axes: int, peak: float = 50.0, duration: float = 0.12) -> np.ndarray:
    """A jump that is held, then slow and fast swings; the second axis moves differently."""
    time = np.arange(int(duration / sample_time)) * sample_time
    first = np.where(time < 0.02, 0.0, 0.5 * peak)
    first = np.where(
        time > 0.05, 0.5 * peak * (1 + 0.6 * np.sin(2 * np.pi * 40 * time) + 0.3 * np.sin(2 * np.pi * 310 * time)), first
    )
    return np.stack([first, 0.5 * first[::-1]][:axes], axis=1)


def run(name: str, effects: list[dict], seed: int = 3, **changes) -> np.ndarray:
    document = {"plant": name, "rating": [0.0, 50.0], "effects": effects}
    plant = load_plant(document, seed=seed, sample_time=STEPS[name], **changes)
    rows = command(STEPS[name], len(plant.axes))
    return np.concatenate([plant.reset(rows[0])[None], plant.step(rows)[:-1]])


@cache
def without(name: str, noisy: bool = False) -> np.ndarray:
    """The record without any effect."""
    return run(name, [], **({} if noisy else {"noise": 0.0}))


def plant_for(effect: str) -> str:
    return "fsm_published" if effect == "cross_coupling" else "pea_published"


def test_every_effect_has_its_severities():
    assert set(GROWING) == set(EFFECTS)


@pytest.mark.parametrize("name", list(EFFECTS))
def test_an_effect_that_is_not_there_changes_no_bit(name):
    for plant in PLANTS:
        if name != "cross_coupling" or plant.startswith("fsm"):
            np.testing.assert_array_equal(run(plant, [{"name": name, **EFFECTS[name].absent}]), without(plant, True))


@pytest.mark.parametrize("name", list(EFFECTS))
def test_the_gap_grows_with_the_severity(name):
    for plant in PLANTS:
        if name != "cross_coupling" or plant.startswith("fsm"):
            gaps = [
                np.sqrt(np.mean((run(plant, [{"name": name, **values}], noise=0.0) - without(plant)) ** 2))
                for values in GROWING[name]
            ]
            assert 0 < gaps[0] < gaps[1] < gaps[2], plant


@pytest.mark.parametrize("name", [name for name in EFFECTS if name not in ("clock_rate_mismatch",)])
def test_an_effect_switched_on_in_mid_run_leaves_what_was_before(name):
    plant = plant_for(name)
    begin = 0.06
    found = run(plant, [{"name": name, **GROWING[name][2], "from": begin}], noise=0.0)
    bare = without(plant)
    tick = int(round(begin / STEPS[plant]))
    np.testing.assert_array_equal(found[:tick], bare[:tick])
    assert np.any(found[tick:] != bare[tick:])


@pytest.mark.parametrize("name", list(EFFECTS))
def test_an_effect_on_one_axis_leaves_the_other_alone(name):
    """Either axis; the second one, which is driven less, must meet a lower rail to clip."""
    values = {"upper": 20.0} if name == "saturation" else GROWING[name][1]
    for own, axis in enumerate("xy"):
        found = run("fsm_published", [{"name": name, **values, "axis": axis}])
        np.testing.assert_array_equal(found[:, 1 - own], without("fsm_published", True)[:, 1 - own])
        assert np.any(found[:, own] != without("fsm_published", True)[:, own])


def test_effects_act_together_whatever_their_order():
    one, other = {"name": "delay", "tau": 1e-4}, {"name": "creep", "gamma": 0.02}
    np.testing.assert_array_equal(run("pea", [one, other]), run("pea", [other, one]))
    assert np.any(run("pea", [one, other]) != run("pea", [one]))


@pytest.mark.parametrize("name", list(PLANTS))
def test_every_plant_is_the_same_however_it_is_cut_and_by_its_seed(name):
    effects = [{"name": "resonance", "gain": 0.01}, {"name": "held_samples", "fraction": 0.1}, {"name": "creep", "gamma": 0.01}]
    whole = run(name, effects)
    plant = load_plant({"plant": name, "rating": [0.0, 50.0], "effects": effects}, seed=3, sample_time=STEPS[name])
    rows = command(STEPS[name], len(plant.axes))
    pieces, begin = [plant.reset(rows[0])[None]], 0
    for size in (1, 7, 50, 333, 1, len(rows)):
        pieces.append(plant.step(rows[begin : begin + size]))
        begin += size
    np.testing.assert_array_equal(np.concatenate(pieces)[:-1], whole)
    assert np.any(run(name, effects, seed=4) != whole)


@pytest.mark.parametrize("name", [name for name in EFFECTS if name not in RANDOM and name != "clock_rate_mismatch"])
def test_halving_the_internal_step_changes_little_with_an_effect(name):
    """By less than 0.05 % of range, after jumps as well; a clock that drifts shares a command between two internal steps."""
    coarse, finer = (run(plant_for(name), [{"name": name, **GROWING[name][2]}], noise=0.0, refinement=r) for r in (1, 2))
    assert np.all(np.max(np.abs(finer - coarse), axis=0) < 5e-4 * np.ptp(coarse, axis=0))


@pytest.mark.parametrize("together", [False, True])
def test_a_delay_is_exact_whatever_its_share_of_an_internal_step(together):
    """A delay of a whole number of samples by way of fractions of a step, beside the plant's own, is the record of earlier."""
    step = STEPS["fsm_published"]
    shares = (1.3, 0.7) if together else (2.0,)
    effects = [{"name": "delay", "tau": share * step} for share in shares]
    found = run("fsm_published", effects, noise=0.0)
    np.testing.assert_allclose(found[2:], without("fsm_published")[:-2], rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "effects, words",
    [
        ([{"name": "dealy", "tau": 1e-4}], "'dealy' is unknown"),
        ([{"name": "delay", "time": 1e-4}], "delay: time: unknown parameter"),
        ([{"name": "delay", "tau": "long"}], "tau: must be a number, got 'long'"),
        ([{"name": "delay", "tau": 1e-4, "axis": "z"}], "axis: 'z'"),
        ("delay", "a list of"),
    ],
)
def test_effects_that_make_no_sense_are_named(effects, words):
    with pytest.raises(PlantError, match=words):
        load_plant({"plant": "pea", "effects": effects})


def test_a_fault_of_effects_that_the_caller_gives_is_not_told_of_the_file():
    with pytest.raises(PlantError, match="^effects: delay: time: unknown parameter"):
        load_plant("pea", effects=[{"name": "delay", "time": 1e-4}])
