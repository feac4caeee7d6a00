# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Realizations of the catalogue's effects: place, phase, rounding, law and shape, each against a closed form or another implementation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal
from scipy.integrate import solve_ivp

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Parallel, Sampling
from hyst_control.chain.hysteresis.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PlayOperator, PrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.chain.memoryless import Gain, Saturation
from hyst_control.effects import EFFECTS
from hyst_control.effects.added_mass import AddedMass
from hyst_control.effects.amplifier_lowpass import AmplifierLowpass
from hyst_control.effects.backlash import Backlash
from hyst_control.effects.creep import Creep
from hyst_control.effects.dac_hold import ROUNDINGS, DacHold
from hyst_control.effects.effect import Surroundings
from hyst_control.effects.gain_drift import GainDrift
from hyst_control.effects.hysteresis_rate import HysteresisRate
from hyst_control.effects.hysteresis_shape import HysteresisShape
from hyst_control.effects.hysteresis_width import HysteresisWidth
from hyst_control.effects.offset_drift import OffsetDrift
from hyst_control.effects.resonance import Resonance
from hyst_control.effects.sensor_lowpass import SensorLowpass
from hyst_control.effects.sensor_nonlinearity import SensorNonlinearity
from hyst_control.effects.slew_limit import SlewLimit

STEP = 1e-4
AROUND = Surroundings(STEP, 1.0, (-20.0, 30.0), 1e4, (-1.0, 2.0), 1)


def run(stages, u, hold="zoh", step=STEP):
    """Values at the end of every interval."""
    running = Chain(tuple(stages)).filter(Sampling(step, 1, hold))
    running.settle(u[:1])
    return running.process(u[:, None])[:, 0]


def walk(count=600, low=-20.0, high=30.0, seed=3):
    steps = np.random.default_rng(seed).standard_normal(count).cumsum()
    return low + (high - low) * (steps - steps.min()) / np.ptp(steps)


@pytest.mark.parametrize("samples, phase", [(2, 1), (8, 0), (8, 1), (8, 7), (5, 3)])
def test_a_hold_takes_the_command_of_its_phase(samples, phase):
    u = walk(101)
    taken = [k for k in range(len(u)) if k % samples == phase]
    expected = np.array([u[max([0, *(t for t in taken if t <= k)])] for k in range(len(u))])
    np.testing.assert_array_equal(run([DacHold(samples, phase=phase)], u), expected)


@pytest.mark.parametrize("manner", ROUNDINGS)
def test_a_lattice_is_rounded_to_in_its_manner(manner):
    u, step = walk(500), 1.7
    expected = {
        "nearest": np.round(u / step),
        "down": np.floor(u / step),
        "up": np.ceil(u / step),
        "toward zero": np.sign(u) * np.floor(np.abs(u) / step),
        "midway": np.floor(u / step) + 0.5,
    }
    np.testing.assert_allclose(run([DacHold(1, step, rounding=ROUNDINGS[manner])], u), step * expected[manner], rtol=1e-12)


def test_holds_that_the_record_speaks_for_and_every_manner_are_tried():
    variants = EFFECTS["dac_hold"].variants(replace(AROUND, holds=((8, 3), (57, 0))))
    assert {v["rounding"] for v in variants if "step" not in v} == set(ROUNDINGS.values())
    assert [(v["samples"], v["phase"]) for v in variants if v["samples"] > 1.0] == [(8.0, 3.0), (57.0, 0.0)]
    positive = EFFECTS["dac_hold"].variants(Surroundings(STEP, 1.0, (0.0, 30.0), 1e4, (0.0, 2.0), 1))
    assert ROUNDINGS["toward zero"] not in {v["rounding"] for v in positive}  # there it is rounding down


@pytest.mark.parametrize("kind", [AmplifierLowpass, SensorLowpass])
def test_a_butterworth_lowpass_is_scipys(kind):
    u = walk()
    filter_ = signal.lti(*signal.butter(2, 2 * np.pi * 700.0, analog=True))
    _, expected, _ = signal.lsim(filter_, np.append(u - u[0], 0.0), np.arange(len(u) + 1) * STEP, interp=False)
    np.testing.assert_allclose(run([kind(700.0, 2, np.sqrt(0.5))], u), u[0] + expected[1:], atol=1e-7)


def test_a_damping_belongs_to_the_second_order():
    with pytest.raises(InputError, match="damping"):
        SensorLowpass(700.0, 1, 0.7)


@pytest.mark.parametrize("begin, decades", [(0.01, 3.0), (0.2, 0.6)])
def test_creep_grows_as_its_time_constants_say(begin, decades):
    """Of evenly spread time constants the growth is an integral over their logarithms."""
    time = np.geomspace(2 * STEP, 2.0, 30)
    u = np.concatenate([np.zeros(10), np.ones(20010)])
    grown = run([Creep(0.02, begin, decades)], u)[10 + np.rint(time / STEP).astype(int) - 1] - 1.0
    logs = np.linspace(0.0, decades, 20001)
    expected = [0.02 * np.trapezoid(1.0 - np.exp(-t / (begin * 10.0**logs)), logs) for t in np.rint(time / STEP) * STEP]
    np.testing.assert_allclose(grown, expected, atol=0.02 * decades * 2e-3)


def test_a_drift_of_several_time_constants_may_settle_at_the_nominal_value():
    time = np.arange(1, 2001) * STEP
    for stage, parts in ((OffsetDrift(0.3, 0.05, 2.0, -1.0), (1.0, 0.0)), (GainDrift(0.3, 0.05, 2.0, -1.0), (0.0, 1.0))):
        found = run([stage], np.full(2000, 2.0)) - 2.0
        taus = 0.05 * 10.0 ** (2.0 * (np.arange(6) - 2.5) / 6.0)
        expected = -0.3 * np.mean([np.exp(-time / tau) for tau in taus], axis=0)
        np.testing.assert_allclose(found, (parts[0] + 2.0 * parts[1]) * expected, rtol=1e-9)


def test_a_single_valued_curve_is_bent_oddly_or_tilted():
    u = np.array([0.0, 0.0, 12.5, 25.0, 37.5, 50.0])
    plain = run([PlayOperator(0.0)], u)
    odd = run([PlayOperator(0.0), HysteresisShape(0.0, 0.0, 50.0, odd=0.1)], u) - plain
    np.testing.assert_allclose(odd[1:], [0.0, -odd[4], 0.0, odd[4], 0.0], atol=1e-12)
    x = np.linspace(0.0, 50.0, 5001)
    bent = run([PlayOperator(0.0), HysteresisShape(0.0, 0.0, 50.0, odd=0.1)], x) - x
    assert np.abs(bent).max() == pytest.approx(0.1 * 50.0, rel=1e-6)
    tilt = run([PlayOperator(0.0), HysteresisShape(0.0, 0.0, 50.0, tilt=0.1)], u) - plain
    np.testing.assert_allclose(tilt, 0.1 * (u - 25.0), atol=1e-12)


def test_a_curve_behind_the_hysteresis_is_one_of_its_output():
    hysteresis, u = PrandtlIshlinskii([0.0, 6.0], [0.6, 0.4]), walk(low=0.0, high=50.0)
    y, bent = run([hysteresis], u), run([hysteresis, HysteresisShape(0.05, 0.0, 50.0, behind=1)], u)
    top = 0.6 * 50.0 + 0.4 * 44.0
    np.testing.assert_allclose(bent, y + 0.05 * top * 4.0 * (y / top) * (1.0 - y / top), rtol=1e-9)


def test_the_amount_of_a_curve_is_its_greatest_distance():
    summary = EFFECTS["hysteresis_shape"].summary
    assert summary({"even": -0.02, "odd": 0.0, "tilt": 0.0}) == {"amount": pytest.approx(-0.02)}
    assert abs(summary({"even": 0.0, "odd": 0.03, "tilt": 0.0})["amount"]) == pytest.approx(0.03, rel=1e-3)
    assert abs(summary({"even": 0.0, "odd": 0.0, "tilt": 0.04})["amount"]) == pytest.approx(0.02)


def test_width_scales_thresholds_or_weights_of_operators():
    u, operators = walk(), PrandtlIshlinskii([0.0, 3.0, 9.0], [0.5, 0.3, 0.2])
    thresholds = run([operators, HysteresisWidth(0.2, scaled=1)], u)
    np.testing.assert_allclose(thresholds, run([PrandtlIshlinskii([0.0, 3.6, 10.8], [0.5, 0.3, 0.2])], u), rtol=1e-12)
    weights = run([operators, HysteresisWidth(0.2, scaled=2)], u)
    np.testing.assert_allclose(weights, run([PrandtlIshlinskii([0.0, 3.0, 9.0], [0.5, 0.36, 0.24])], u), rtol=1e-12)


@pytest.mark.parametrize("threshold, scaled, width", [(3.0, 1.0, 0.2), (20.0, 1.0, 0.2), (20.0, 1.0, -0.2), (20.0, 2.0, 0.2)])
def test_the_report_has_the_growth_of_the_loop_whatever_is_scaled(threshold, scaled, width):
    """A play operator's loop over an amplitude A has the area 4 r (A - r)."""
    around = Surroundings(1e-3, 1.0, (0.0, 50.0), 1.0, (0.0, 5.0), 1)
    operators = PrandtlIshlinskii([0.0, threshold], [0.5, 0.3])
    told = EFFECTS["hysteresis_width"].reported({"width": width, "scaled": scaled}, around, [operators])
    factor = 1.0 + width
    areas = [r * (25.0 - r) for r in (threshold, factor * threshold)]
    assert told["width"] == pytest.approx(areas[1] / areas[0] - 1.0 if scaled == 1.0 else width, abs=5e-3)


def test_only_operators_have_thresholds_to_scale():
    with pytest.raises(InputError, match="scaled"):
        run([Gain(2.0), HysteresisWidth(0.2, scaled=1)], walk())


def test_the_rate_part_of_one_direction_is_scaled():
    u = walk()
    one, other = (ModifiedPrandtlIshlinskii([0.0, 3.0], [0.5, 0.3], m1=m1, m2=1e-6) for m1 in (1e-6, 3e-6))
    np.testing.assert_allclose(run([one, HysteresisRate(2.0, 1.0)], u), run([other], u), rtol=1e-12)


def test_a_rate_part_is_added_with_its_own_lag():
    u, lag = walk(), 4e-3
    operators = ModifiedPrandtlIshlinskii([0.0, 3.0], [0.5, 0.3], m1=1e-6, m2=1e-6)
    late = TransferFunction([-0.5 * 0.1 * 0.8 * lag, 0.0], [lag, 1.0])
    expected = run([Parallel(((operators,), (late,)))], u)
    np.testing.assert_allclose(run([operators, HysteresisRate(1.5, lag=lag)], u), expected, rtol=1e-9)


def test_a_driver_may_be_slow_in_one_direction():
    u = np.concatenate([np.zeros(10), np.full(50, 5.0), np.zeros(50)])
    found = run([SlewLimit(1e3, np.inf)], u, "foh")
    np.testing.assert_allclose(found[:60], np.minimum(np.maximum(np.arange(60) - 9, 0) * 0.1, 5.0), atol=1e-12)
    np.testing.assert_allclose(found[60:], 0.0, atol=1e-12)
    other = run([EFFECTS["slew_limit"].stage({"rate": 1e3, "sides": 2.0, "ratio": 1.0}, AROUND)], u, "foh")
    np.testing.assert_allclose(other[10:60], 5.0)
    np.testing.assert_allclose(other[60:], np.maximum(5.0 - 0.1 * np.arange(1, 51), 0.0), atol=1e-12)


def test_a_limit_with_a_knee_is_reached_gradually():
    u = np.linspace(-20.0, 30.0, 501)
    found = run([Saturation(-np.inf, 20.0, 2.0)], u)
    assert np.all(np.diff(found) > 0) and found.max() < 20.0
    np.testing.assert_allclose(found, -2.0 * np.log(np.exp(-u / 2.0) + np.exp(-10.0)), rtol=1e-9)
    np.testing.assert_allclose(run([Saturation(-10.0, 20.0, 1e-6)], u), np.clip(u, -10.0, 20.0), atol=1e-5)


@pytest.mark.parametrize("start", [-1.0, 0.4, 1.0])
def test_a_play_begins_where_it_was_left(start):
    u = np.concatenate([np.zeros(5), np.linspace(0.0, 10.0, 100)])
    found = run([Backlash(0.5, start)], u, "foh")
    np.testing.assert_allclose(found[:5], 0.5 * start)
    np.testing.assert_allclose(found, np.maximum(0.5 * start, u - 0.5))


def test_added_mass_may_come_with_damping():
    mass, damping, stiffness = 2.0, 300.0, 8e6
    plain, other = (TransferFunction([stiffness], [m, d, stiffness]) for m, d in ((mass, damping), (1.2 * mass, 1.5 * damping)))
    u = walk()
    np.testing.assert_allclose(run([plain, AddedMass(0.2, 0.5)], u), run([other], u), rtol=1e-9)


def test_a_mode_in_quadrature_without_static_deflection():
    w, u = 2 * np.pi * 700.0, walk()
    base = TransferFunction([6e6], [1.0, 300.0, 3e6])
    mode = TransferFunction([0.2 * w, 0.1 * w**2], [1.0, 0.04 * w, w**2])
    expected = run([Parallel(((base,), (Gain(2.0), mode), (Gain(-0.2),)))], u)
    np.testing.assert_allclose(run([base, Resonance(700.0, 0.02, 0.1, 0.2, -0.1)], u), expected, rtol=1e-8, atol=1e-8)


def test_a_sensors_bend_has_five_legendre_terms():
    u = np.linspace(-1.0, 3.0, 101)
    stage = SensorNonlinearity(0.02, -0.01, -1.0, 3.0, 0.005, 0.004, -0.003, 0.007)
    expected = np.polynomial.legendre.legval((u - 1.0) / 2.0, [0.005, 0.007, 0.02, -0.01, 0.004, -0.003])
    np.testing.assert_allclose(run([stage], u, "foh") - u, expected, atol=1e-12)


def test_a_lowpass_of_order_two_is_an_ordinary_differential_equation():
    """With the damping between those of a row of two and a resonance, against an integrator of scipy's."""
    w, z = 2 * np.pi * 300.0, 0.6
    steps = np.concatenate([np.zeros(5), np.ones(200)])
    rise = solve_ivp(lambda t, x: [x[1], w * w * (1.0 - x[0]) - 2 * z * w * x[1]], (0, 0.02), [0, 0], rtol=1e-10, atol=1e-12,
                     t_eval=np.arange(1, 201) * STEP)  # fmt: skip
    np.testing.assert_allclose(run([SensorLowpass(300.0, 2, z)], steps)[5:], rise.y[0], atol=1e-7)


def test_axes_may_have_realizations_of_their_own():
    """Of width, rate and shape: each axis of a plant as if it were alone."""
    u = np.stack([walk(low=0.0, high=50.0), walk(low=0.0, high=50.0, seed=8)], axis=1)
    operators = ModifiedPrandtlIshlinskii([0.0, 3.0], [0.5, 0.3], m1=1e-5, m2=1e-5)
    realizations = {
        HysteresisWidth: ({"width": 0.2, "scaled": 0}, {"width": 0.3, "scaled": 1}),
        HysteresisRate: ({"factor": 2.0, "lag": 0.0}, {"factor": 1.5, "lag": 3e-3}),
        HysteresisShape: (
            {"amount": 0.02, "lower": 0.0, "upper": 50.0, "behind": 0},
            {"amount": 0.03, "lower": 0.0, "upper": 50.0, "behind": 1},
        ),
    }
    for kind, each in realizations.items():
        both = {name: [one[name] for one in each] for name in each[0]}
        running = Chain((operators, kind(**both))).filter(Sampling(STEP, 2))
        running.settle(u[0])
        found = running.process(u)
        for axis, values in enumerate(each):
            np.testing.assert_allclose(found[:, axis], run([operators, kind(**values)], u[:, axis]), rtol=1e-9)


@pytest.mark.parametrize("name", ["gain_drift", "offset_drift"])
def test_a_drift_has_not_settled_before_the_first_sample_that_is_compared(name):
    parameters = {p.name: p for p in EFFECTS[name].parameters(replace(AROUND, duration=2.0, begin=1.0))}
    tau = parameters["tau"]
    assert tau.lower == 1.0 and all(tau.lower <= start <= tau.upper for start in tau.starts)
    assert {p.name: p for p in EFFECTS[name].parameters(AROUND)}["tau"].lower == pytest.approx(0.05)


def test_a_straight_gain_drift_is_one_number_of_the_usual_size():
    around = replace(AROUND, duration=2.0, lowest_frequency=3.0)
    straight = next(one for one in EFFECTS["gain_drift"].variants(around) if "tau" in one)
    free = [p.name for p in EFFECTS["gain_drift"].parameters(around) if p.name not in straight]
    assert free == ["change"]
    values = {"change": 0.05, **straight}
    values |= EFFECTS["gain_drift"].summary(values)
    time = np.arange(0.0, 2.0, STEP)
    found = run([EFFECTS["gain_drift"].stage(values, around)], np.ones(len(time)))
    np.testing.assert_allclose(found, 1.0 + 0.05 * time / 2.0, atol=0.002)
    assert EFFECTS["gain_drift"].summary({"change": 0.05, "tau": 0.2}) == {}


@pytest.mark.parametrize("name", ["gain_drift", "offset_drift"])
def test_a_drift_that_goes_ever_faster_is_told_over_the_record(name):
    """An exponential that grows, by its closed form: it has no end, and half of the record brings less than half of the change."""
    around, change, growth = replace(AROUND, duration=2.0), 0.05, 1.6
    faster = next(one for one in EFFECTS[name].variants(around) if "growth" not in one)
    values = {"change": change, "growth": growth, **faster}
    values |= EFFECTS[name].summary(values)
    assert values["change"] == change
    time = STEP * np.arange(1, round(2.0 / STEP) + 1)  # behind the value at which the stage was settled
    found = run([EFFECTS[name].stage(values, around)], np.ones(len(time)))
    expected = change * np.expm1(growth * time / 2.0) / np.expm1(growth)
    np.testing.assert_allclose(found, 1.0 + expected, atol=1e-12)
    assert found[len(time) // 2] - 1.0 < 0.4 * change


@pytest.mark.parametrize("name", ["gain_drift", "offset_drift"])
@pytest.mark.parametrize("onset, lasts, come", [(0.5, 1.0, 1.0), (0.0, 0.3, 1.0), (1.2, 2.0, 0.4)])
def test_a_drift_within_the_record_is_a_ramp_between_two_times(name, onset, lasts, come):
    """By its closed form; told is what comes over the record, which ends before the last of these drifts does."""
    around = replace(AROUND, duration=2.0)
    ramp = next(one for one in EFFECTS[name].variants(around) if "onset" not in one)
    values = {"change": 0.05, "onset": onset, "lasts": lasts, "smooth": 0.0, **ramp}
    values |= EFFECTS[name].summary(values)
    assert values["change"] == 0.05
    time = STEP * np.arange(1, round(2.0 / STEP) + 1)
    found = run([EFFECTS[name].stage(values, around)], np.ones(len(time)))
    expected = 0.05 * np.clip((time - onset) / lasts, 0.0, 1.0) / come
    np.testing.assert_allclose(found, 1.0 + expected, atol=0.01 * 0.05 / come)


@pytest.mark.parametrize("name", ["gain_drift", "offset_drift"])
def test_a_smooth_drift_within_the_record_is_near_a_logistic_curve(name):
    """As of a stage that warms up and settles: within 3 % of what comes, at every time."""
    around = replace(AROUND, duration=2.0)
    ramp = next(one for one in EFFECTS[name].variants(around) if "onset" not in one)
    values = {"change": 0.05, "onset": 0.6375, "lasts": 0.725, "smooth": 1.0, **ramp}
    time = STEP * np.arange(1, round(2.0 / STEP) + 1)
    found = run([EFFECTS[name].stage(values, around)], np.ones(len(time)))
    np.testing.assert_allclose(found, 1.0 + 0.05 / (1.0 + np.exp(-(time - 1.0) / 0.1)), atol=0.035 * 0.05)


def test_a_drift_needs_a_time_constant():
    for name in ("gain_drift", "offset_drift"):
        with pytest.raises(InputError, match="tau: must not be 0 s"):
            EFFECTS[name].stage({"change": 0.1, "tau": 0.0, "span": 1.0}, AROUND)
