# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Realizations of the plants' effects, each against a closed form: place, phase, rounding, law and direction."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from hyst_plant_sim.physics import load_plant
from hyst_plant_sim.physics.effects import EFFECTS
from hyst_plant_sim.physics.effects.effect import Context
from hyst_plant_sim.physics.signal_path import Frame

FRAME = Frame("bench", ("x",), {}, 1e-4, 10, (0.0, 50.0), 1e6, (0.0, 5.0), 7)


def part(name, **values):
    effect = EFFECTS[name]
    return effect.make({**effect.absent, **effect.others, **values}, Context(FRAME, effect.place, 0, 0.0))


def run(name, u, **values):
    """Output for u, whose first value the part has settled at, in blocks of different lengths."""
    made = part(name, **values)
    made.settle(float(u[0]))
    return np.concatenate([made.process(block) for block in np.split(u, [1, 7, 100]) if len(block)])


U = 25.0 + 20.0 * np.sin(np.arange(400) / 17.0) + 4.0 * np.cos(np.arange(400) / 3.1)


@pytest.mark.parametrize("phase", range(4))
def test_commands_are_taken_from_a_phase_on(phase):
    expected = [U[max(k - (k - phase) % 4, 0)] if k >= phase else U[0] for k in range(len(U))]
    np.testing.assert_array_equal(run("dac_hold", U, samples=4, phase=phase), expected)


@pytest.mark.parametrize("rounding, expected", [(0, np.round), (1, np.floor), (2, np.trunc), (3, lambda x: np.floor(x) + 0.5)])
def test_commands_are_rounded_in_a_manner(rounding, expected):
    u = U - 25.0
    np.testing.assert_allclose(run("dac_hold", u, step=1.3, rounding=rounding), 1.3 * expected(u / 1.3), rtol=1e-12)


def test_only_one_direction_is_slow():
    u = np.concatenate([np.zeros(3), np.full(30, 1.0), np.zeros(30)])
    rising, falling = (run("slew_limit", u, rate=1e4, direction=way) for way in (1, -1))
    np.testing.assert_allclose(rising[33:], 0.0, atol=1e-12)
    np.testing.assert_allclose(rising[3:13], 0.1 * np.arange(10) + 0.05, atol=1e-12)
    np.testing.assert_allclose(falling[3:33], 1.0)
    np.testing.assert_allclose(falling[33:43], 1.0 - 0.1 * np.arange(10) - 0.05, atol=1e-12)


def test_a_knee_is_a_hyperbola():
    y = run("saturation", U, upper=40.0, knee=2.0)
    np.testing.assert_allclose((40.0 - y) * (U - y), 4.0, rtol=1e-9)  # distances from both asymptotes
    assert y.max() < 40.0


def test_a_lowpass_with_a_damping_is_scipys():
    """Between the values the input runs straight, so that a step is a ramp: what follows is the mean of the step response."""
    fine = 20
    _, response = signal.step(
        signal.lti(*signal.butter(2, 2 * np.pi * 900.0, analog=True)), T=np.arange(500 * fine + 1) * FRAME.step / fine
    )
    expected = [np.trapezoid(response[k * fine : (k + 1) * fine + 1]) / fine for k in range(500)]
    found = run("sensor_lowpass", np.concatenate([np.zeros(2), np.ones(500)]), cutoff=900.0, damping=np.sqrt(0.5))
    np.testing.assert_allclose(found[2:], expected, atol=1e-5)


@pytest.mark.parametrize("law", [0, 1, 2])
def test_creep_follows_its_law(law):
    u = np.concatenate([np.zeros(1), np.ones(60000)])
    grown = run("creep", u, gamma=0.02, begin=0.05, law=law)[1:] - 1.0
    time = np.arange(1, 60001) * FRAME.step
    some = slice(20000, None, 5000) if law == 0 else slice(2000, None, 2000)
    expected = {
        0: 0.02 * (np.log10(time / 0.05) + np.euler_gamma / np.log(10.0)),
        1: 0.02 * np.log10(1.0 + time / 0.05),
        2: 0.02 * -np.expm1(-time / 0.05),
    }[law]
    np.testing.assert_allclose(grown[some], expected[some], atol=0.02 * (0.2 if law == 0 else 0.02))


@pytest.mark.parametrize(
    "law, share",
    [
        (0, lambda t: 1 - np.exp(-t / 0.01)),
        (1, lambda t: np.minimum(t / 0.01, 1)),
        (2, lambda t: np.log10(1 + 900 * t)),
        (3, lambda t: -np.exp(-t / 0.01)),
    ],
)
@pytest.mark.parametrize("name, size", [("offset_drift", 1.0), ("gain_drift", 3.0)])
def test_a_drift_follows_its_law(name, size, law, share):
    time = np.arange(1, 301) * FRAME.step
    np.testing.assert_allclose(
        run(name, np.full(300, 3.0), change=0.2, tau=0.01, law=law) - 3.0, 0.2 * size * share(time), rtol=1e-9
    )


@pytest.mark.parametrize("exponent", [0.7, 1.0, 1.4])
def test_noise_falls_with_its_exponent(exponent):
    noise = run("flicker_noise", np.zeros(400000), rms=1.0, exponent=exponent)
    frequency, power = signal.welch(noise, 1e4, nperseg=1 << 15)
    some = (frequency > 2.0) & (frequency < 500.0)
    slope = np.polyfit(np.log(frequency[some]), np.log(power[some]), 1, w=frequency[some] ** -0.5)[0]
    assert slope == pytest.approx(-exponent, abs=0.15)


def test_samples_are_held_in_runs():
    y = run("held_samples", np.arange(40000.0), fraction=0.2, run=4)
    repeated = np.diff(y, prepend=-1.0) == 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], repeated.astype(int), [0]])))
    assert np.mean(repeated) == pytest.approx(0.2, abs=0.02)
    assert set((edges[1::2] - edges[::2])[:-1] % 4) == {0}


@pytest.mark.parametrize("side", [-1, 1])
def test_a_play_begins_at_a_side(side):
    u = np.concatenate([np.full(3, 2.0), np.linspace(2.0, 9.0, 50)])
    np.testing.assert_allclose(run("backlash", u, half_width=0.5, side=side), np.maximum(2.0 + 0.5 * side, u - 0.5))


@pytest.mark.parametrize("curve, odd", [(0, False), (1, True), (2, True), (3, False)])
def test_a_curve_is_even_or_odd_about_the_middle(curve, odd):
    """Of the plant at rest, reached from 0 V: what a curve adds there."""
    volts = np.array([5.0, 15.0, 25.0, 35.0, 45.0])

    def at_rest(effects):
        document = {"plant": "pea_published", "rating": [0.0, 50.0], "stroke": [0.0, 5.0], "effects": effects}
        plant = load_plant(document, noise=0.0)
        return np.array([plant.reset(np.array([v]))[0] for v in volts])

    added = at_rest([{"name": "hysteresis_shape", "amount": 0.03, "curve": curve}]) - at_rest([])
    np.testing.assert_allclose(added[::-1], -added if odd else added, atol=1e-9)
    assert np.abs(added).max() > 0.05
