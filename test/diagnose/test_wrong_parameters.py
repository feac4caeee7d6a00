# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Wrong parameters of a simulator are named: the fit ends at the minimum, and neither rounding nor an effect takes their place."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.run.diagnosis import diagnose, with_clean
from hyst_control.diagnose.run.prepare import prepare
from hyst_control.diagnose.search.beam_search import settled
from hyst_control.diagnose.simulator import simulator_model
from hyst_control.diagnose.verdict import Verdict
from hyst_control.records.record import Record, Signal

VOICE_COIL = {"force": [12.0, 0.2], "mass": [0.15, 0.003], "damping": [8.0, 0.8], "stiffness": [2.0e4, 400.0]}
SERVO = {"gain": [1.0, 0.02], "frequency": [30.0, 0.5]}


def second_order(command, sample_time, drive, mass, damping, stiffness):
    num, den, _ = cont2discrete(([drive], [mass, damping, stiffness]), sample_time, "zoh")
    return lfilter(num[0], den, np.asarray(command).ravel())


def voice_coil(command, sample_time, force, mass, damping, stiffness):
    """Position in micrometers. All four parameters by one factor change nothing."""
    return second_order(command, sample_time, 1e6 * force, mass, damping, stiffness)


def servo(command, sample_time, gain, frequency):
    rate = 2.0 * np.pi * frequency
    return second_order(command, sample_time, gain * rate**2, 1.0, 0.4 * rate, rate**2)


def steps(seed, size, shortest, longest, rows):
    random = np.random.default_rng(seed)
    values = random.uniform(-size, size, 60)
    command = np.repeat(values, random.integers(shortest, longest + 1, 60))[:rows]
    command[:20] = 0.0
    return command


def record_of(simulate, command, noise, sample_time, step=0.0, **values):
    time = sample_time * np.arange(len(command))
    measured = simulate(command, sample_time, **values) + noise * np.random.default_rng(7).standard_normal(len(command))
    measured = step * np.round(measured / step) if step else measured
    signals = {"command": (command, "V"), "measurement": (measured, "um")}
    return Record({name: Signal(time, rows[:, None], ("x",), unit) for name, (rows, unit) in signals.items()}, "record", hold="zoh")


def diagnosis_of(record, simulate, prior):
    return diagnose([record], simulator_model(simulate, prior, [record]), cache=False).parts[0]


@pytest.mark.parametrize(("name", "value"), [("mass", 0.18), ("damping", 16.0)])
def test_a_fit_of_parameters_ends_at_its_minimum(name, value):
    """By columns of the nominal parameters it slid along the direction in which all of them scale together, 49 tolerances away."""
    command = steps(1, 1.5, 30, 150, 2000)
    truth = {key: prior[0] for key, prior in VOICE_COIL.items()} | {name: value}
    record = record_of(voice_coil, command, 1.0, 1 / 20e3, **truth)
    model = simulator_model(voice_coil, VOICE_COIL, [record])
    linearized = prepare(*with_clean([record], model, 0.0, CONFIGURATION, ())[3][0][:2], (), CONFIGURATION).linearized
    middle, spread = np.transpose(list(VOICE_COIL.values()))
    measured = record.signal("measurement").values[:, 0]

    def misfits(z):
        left = measured - voice_coil(command, 1 / 20e3, *(middle + spread * z))
        return np.concatenate([left / linearized.problem.sigma[0], z])

    best = least_squares(misfits, np.zeros(4), diff_step=1e-3)
    found = settled(linearized)
    assert found.misfit < best.cost + 0.5
    np.testing.assert_allclose(found.z, best.x, atol=0.3)


def test_a_wrong_parameter_is_named_beside_the_steps_of_a_sensor():
    """The steps make 0.006 um of a gap of nearly 1 um, and all of the noise floor."""
    command = steps(1, 8.0, 20, 60, 1500)
    wrong = diagnosis_of(record_of(servo, command, 0.003, 1e-3, 0.02, gain=1.01, frequency=33.0), servo, SERVO)
    assert wrong.decision.verdict is Verdict.PARAMETERS
    np.testing.assert_allclose(wrong.coefficients, [0.5, 6.0], atol=0.1)
    right = diagnosis_of(record_of(servo, command, 0.003, 1e-3, 0.02, gain=1.01, frequency=30.2), servo, SERVO)
    assert right.decision.verdict is Verdict.NO_GAP and not right.decision.findings


def test_a_wrong_parameter_is_no_resonance():
    """A mode beside the machine's own, of a size, a frequency and a damping of its own, does the same as one parameter."""
    command = steps(1, 1.5, 30, 150, 2000)
    truth = {key: prior[0] for key, prior in VOICE_COIL.items()} | {"damping": 16.0}
    found = diagnosis_of(record_of(voice_coil, command, 1.0, 1 / 20e3, **truth), voice_coil, VOICE_COIL)
    assert found.decision.verdict is Verdict.PARAMETERS
    assert np.argmax(np.abs(found.coefficients)) == list(VOICE_COIL).index("damping")


def test_hysteresis_is_named_where_a_linear_simulator_has_none():
    """A stack of ten play operators with thresholds up to 40 V, before a mode at 420 Hz that its simulator knows."""
    rate, angular, random = 5e3, 2.0 * np.pi * 420.0, np.random.default_rng(1)
    command = np.repeat(random.uniform(5.0, 75.0, 20), 200)
    states, driven, thresholds = np.full(10, command[0]), np.empty(len(command)), np.linspace(2.0, 40.0, 10)
    for row, value in enumerate(command):
        states = np.clip(states, value - thresholds, value + thresholds)
        driven[row] = 0.85 * value + 0.15 * states.mean()

    def stage(command, sample_time, gain):
        moved = second_order(command - command[0], sample_time, gain * angular**2, 1.0, 0.06 * angular, angular**2)
        return moved + gain * command[0]

    time, noise = np.arange(len(command)) / rate, 0.01 * random.standard_normal(len(command))
    signals = {"command": (command, "V"), "measurement": (stage(driven, 1.0 / rate, 0.1) + noise, "um")}
    record = Record(
        {name: Signal(time, rows[:, None], ("x",), unit) for name, (rows, unit) in signals.items()}, "record", hold="zoh"
    )
    found = diagnosis_of(record, stage, {"gain": [0.1, 0.005]})
    assert found.decision.verdict is Verdict.EFFECT and "hysteresis_width" in found.chosen.names
