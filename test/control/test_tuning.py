# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Tuning against closed-form loops, simulated responses, and the nonlinear models with their spread."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from hyst_control.base.errors import InputError
from hyst_control.base.yaml_files import read_yaml
from hyst_control.chain import Chain
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PlayOperator
from hyst_control.chain.linear.linear_stages import Delay, StateSpace, TransferFunction
from hyst_control.chain.memoryless import Gain
from hyst_control.control.feedback.loop import run_loop
from hyst_control.control.feedback.pi import PI
from hyst_control.control.linear_step import linear_step
from hyst_control.control.linearization import hysteresis_slopes, linearized, sampled_response
from hyst_control.control.loop_margins import margins
from hyst_control.control.moving_modes import with_modes
from hyst_control.control.plant_cases import Plants
from hyst_control.control.tuning import _largest_scale, controller_response, tune
from hyst_control.model_file import Model, Simulator, load_model
from hyst_plant_sim.physics import load_plant

MODELS = Path(__file__).resolve().parents[2] / "config" / "models"
HAMPI, MHL = load_model(MODELS / "pea_hampi.yaml"), load_model(MODELS / "fsm_mhl.yaml")
SAMPLE_TIME = 1e-3


def plain(*stages) -> Model:
    return Model(
        name="plain", axes=("x",), units={"command": "V", "measurement": "um"}, sample_time=SAMPLE_TIME, chain=Chain(stages)
    )


@pytest.mark.parametrize("k", [0.2, 0.5, 1.0, 1.4])
def test_margins_of_an_integrator_with_one_sample_of_delay(k):
    """L = k / (z - 1): gain margin 2 / k, crossover where 2 sin(w / 2) = k with margin 90 - w / 2, peak 2 / (2 - k)."""
    z = np.exp(1j * np.geomspace(1e-5, 1.0, 6000) * np.pi)
    found = margins(k / (z - 1.0), z, SAMPLE_TIME)
    crossover = 2 * np.arcsin(k / 2)
    assert found.gain_margin == pytest.approx(20 * np.log10(2 / k), abs=1e-6)
    assert found.phase_margin == pytest.approx(90 - np.degrees(crossover / 2), abs=0.02)
    assert found.peak_sensitivity == pytest.approx(2 / (2 - k), rel=1e-6)
    assert found.crossover == pytest.approx(crossover / (2 * np.pi * SAMPLE_TIME), rel=2e-3)


def test_static_plant_gets_at_least_the_integrator_that_its_margins_allow():
    """For a pure gain g the integrator k = g ki T = 1 meets 6 dB, 60 degrees and a peak of 2; a proportional part may add to it."""
    result = tune(plain(Gain(0.1)), gain_margin=20 * np.log10(2), gain_spread=0.0, mode_spread=0.0, model_error=0.0)
    assert 0.1 * result.ki * SAMPLE_TIME >= 0.99
    assert result.worst.gain_margin >= 6.02 and result.worst.phase_margin >= 45.0 and result.worst.peak_sensitivity <= 2.001


@pytest.mark.parametrize("model", [HAMPI, MHL], ids=["pea", "fsm"])
@pytest.mark.parametrize("sample_time", [5e-5, 2e-4])
def test_sampled_response_is_the_spectrum_of_the_simulated_impulse_response(model, sample_time):
    axes = len(model.axes)
    stages = linearized(model, np.full(axes, 0.7))
    simulator = Simulator(model.with_stages(stages), sample_time)
    rest = simulator.reset(np.zeros(axes))
    n = 1 << 15
    impulse = np.zeros((n, axes))
    impulse[0] = 1.0
    measured = np.concatenate([rest[None], simulator.step(impulse)[:-1]])
    lines = np.array([3, 50, 700, n // 5])
    spectrum = np.fft.fft(measured, axis=0)[lines]
    response = sampled_response(stages, axes, sample_time, np.exp(2j * np.pi * lines / n))
    np.testing.assert_allclose(response[:, np.arange(axes), np.arange(axes)], spectrum, rtol=3e-3)


def test_first_mode_moves_and_stiffness_stays():
    stages = (Delay(1e-4), TransferFunction([3e6], [1.0, 200.0, 1e6]), TransferFunction([4e8], [1.0, 9000.0, 4e8]))
    w = 2 * np.pi * np.linspace(20.0, 400.0, 2000) * SAMPLE_TIME
    before, after = (
        np.abs(sampled_response(each, 1, SAMPLE_TIME, np.exp(1j * w)))[:, 0, 0] for each in (stages, with_modes(stages, 1, 1.2))
    )
    assert w[np.argmax(after)] / w[np.argmax(before)] == pytest.approx(1.2, abs=0.01)
    assert after[0] == pytest.approx(before[0], rel=0.02)
    assert after.max() == pytest.approx(before.max(), rel=0.05), "the damping ratio stays"


def test_hysteresis_slopes_of_a_classical_model():
    stage = HAMPI.chain.stages[0].__class__([0.0, 10.0, 20.0], [0.5, 0.3, 0.2])
    model = Model(
        name="m",
        axes=("x",),
        units={"command": "V", "measurement": "um"},
        sample_time=1e-3,
        chain=Chain((stage,)),
        valid={"command": [0.0, 100.0]},
    )
    mean, greatest = hysteresis_slopes(model)
    assert greatest[0] == pytest.approx(1.0, rel=1e-6)
    assert 0.85 < mean[0] <= 1.0


def test_hysteresis_besides_the_first_has_its_own_mean_slope():
    first, *rest = HAMPI.chain.stages
    play, slope = HAMPI.with_stages((first, PlayOperator(0.05), *rest)), hysteresis_slopes(HAMPI)[0]
    found, expected = (sampled_response(linearized(model, slope), 1, 1e-4, np.exp([0.1j, 1j])) for model in (play, HAMPI))
    np.testing.assert_allclose(found, expected)


@pytest.mark.parametrize(("model", "sample_time", "stroke"), [(HAMPI, 1e-4, 2.0), (MHL, 2e-4, 0.5)], ids=["pea", "fsm"])
def test_margins_hold_on_the_nonlinear_model_with_its_spread(model, sample_time, stroke):
    """With 10 % of gain and 20 % of the first mode either way, the loop settles, and still does at twice the gain (6 dB)."""
    axes = len(model.axes)
    result = tune(model, sample_time=sample_time)
    assert result.worst.gain_margin >= 6.0 and result.worst.phase_margin >= 45.0
    reference = np.full((int(0.06 / sample_time), axes), stroke)
    before = next(i for i, stage in enumerate(model.chain.stages) if isinstance(stage, TransferFunction))
    for gain in (0.9, 1.1):
        for mode in (0.8, 1.2):
            linear = with_modes(model.chain.stages[before:], axes, mode)
            spread = model.with_stages([*model.chain.stages[:before], *linear, Gain(gain)])
            for factor, tolerance in ((1.0, 0.005), (1.95, 0.05)):
                controller = PI(factor * result.kp, factor * result.ki, sample_time, 0.0, 100.0).start(axes)
                signals = run_loop(reference, None, controller, Simulator(spread, sample_time))
                tail = signals["measurement"][-50:] - stroke
                assert np.abs(tail).max() < tolerance * stroke, (gain, mode, factor)


@pytest.fixture(scope="module")
def rolled():
    return {0.0: tune(MHL, sample_time=2e-4), "auto": tune(MHL, sample_time=2e-4, roll_off="auto")}


def test_roll_off_gains_at_the_same_margins(rolled):
    """Less error at 100 Hz and a shorter step; no margin is given up."""
    without, found = rolled[0.0], rolled["auto"]
    assert found.roll_off > 0.0 == without.roll_off
    for each in rolled.values():
        assert each.worst.gain_margin >= 6.0 and each.worst.phase_margin >= 45.0 and each.worst.peak_sensitivity <= 2.0 + 1e-6
    assert found.sensitivity(MHL, [100.0])[0] < 0.75 * without.sensitivity(MHL, [100.0])[0]
    assert found.settling_time < without.settling_time and found.nominal.bandwidth > without.nominal.bandwidth


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("gain", [0.9, 1.1])
@pytest.mark.parametrize("mode", [0.8, 1.2])
def test_margins_with_roll_off_from_impulse_responses(rolled, axis, gain, mode):
    """L by the transforms of what plant and controller answer to an impulse, each run by itself; no formula of the tuner is used."""
    found, count = rolled["auto"], 1 << 13
    impulse = np.zeros((count, 2))
    impulse[0, axis] = 1.0
    _, greatest = hysteresis_slopes(MHL)
    stages = with_modes(linearized(MHL, gain * greatest), 2, mode)
    plant = Simulator(MHL.with_stages(stages), found.sample_time)
    plant.reset(np.zeros(2))
    answer = np.concatenate([np.zeros((1, 2)), plant.step(impulse)[:-1]])[:, axis]
    rest = np.zeros((count, 2))
    _, feedback = found.controller(-1e9, 1e9).start(2).step(impulse, rest, rest)
    integral = feedback[-1, axis]  # what stays of it for ever: its transform is that of a step
    turn = np.exp(-2j * np.pi * np.arange(1, count // 2) / count)
    correction = np.fft.fft(feedback[:, axis] - integral)[1 : count // 2] + integral / (1.0 - turn)
    loop = np.fft.fft(answer)[1 : count // 2] * correction
    inside, phase = np.abs(loop), np.unwrap(np.angle(loop))
    crossings = np.flatnonzero(np.diff(np.sign(inside - 1.0)))
    assert len(crossings) and np.degrees(np.abs(np.mod(phase[crossings], 2 * np.pi) - np.pi)).min() > 45.0
    crossings = np.flatnonzero((np.diff(np.sign(loop.imag)) != 0) & (loop.real[:-1] < 0))
    assert inside[crossings].max(initial=0.0) < 0.5
    assert np.abs(1.0 / (1.0 + loop)).max() <= 2.0


def test_a_loop_with_roll_off_settles_at_all_corners_of_the_spread_and_at_twice_the_gain(rolled):
    found = rolled["auto"]
    for gain in (0.9, 1.1):
        for mode in (0.8, 1.2):
            stages = with_modes(linearized(MHL, gain * hysteresis_slopes(MHL)[1]), 2, mode)
            for factor, ticks in ((1.0, 80), (1.95, 800)):
                controller = PI(factor * found.kp, factor * found.ki, 2e-4, -1e9, 1e9, roll_off=found.roll_off).start(2)
                output = run_loop(np.ones((ticks, 2)), None, controller, Simulator(MHL.with_stages(stages), 2e-4))["measurement"]
                assert np.abs(output[-10:] - 1.0).max() < 0.05, (gain, mode, factor)


def test_the_roll_off_helps_on_the_truth_mirror(rolled):
    """Its physics is not the model's: 100 Hz by feedback alone, after two periods."""
    time = np.arange(500) * 2e-4
    reference = np.repeat((1.0 - 0.5 * np.cos(200 * np.pi * time))[:, None], 2, axis=1)
    errors = []
    for each in rolled.values():
        signals = run_loop(reference, None, each.controller(0.0, 100.0).start(2), load_plant("fsm", sample_time=2e-4))
        errors.append(np.sqrt(np.mean((signals["measurement"] - reference)[100:] ** 2)))
    assert errors[1] < 0.8 * errors[0]


@pytest.mark.parametrize("error", [0.1, 0.3])
def test_margins_hold_for_every_plant_within_the_model_error(error):
    """L = k / (z - 1) times 1 + d for errors d all round the circle: none has less margin than the worst that is reported."""
    z = np.exp(1j * np.geomspace(1e-4, 1.0, 3000) * np.pi)
    worst = margins(0.6 / (z - 1.0), z, SAMPLE_TIME, error)
    found = [
        margins(0.6 * (1.0 + error * np.exp(1j * turn)) / (z - 1.0), z, SAMPLE_TIME) for turn in np.linspace(-np.pi, np.pi, 61)
    ]
    assert min(each.phase_margin for each in found) >= worst.phase_margin - 1e-6
    assert max(each.peak_sensitivity for each in found) == pytest.approx(worst.peak_sensitivity, rel=0.02)
    assert margins(0.6 * (1.0 + error) / (z - 1.0), z, SAMPLE_TIME).gain_margin == pytest.approx(worst.gain_margin, abs=1e-6)


def test_more_delay_costs_bandwidth():
    fast, slow = (tune(MHL, loop_delay=ticks) for ticks in (0, 2))
    assert slow.ki < fast.ki and slow.nominal.crossover < fast.nominal.crossover
    assert slow.worst.gain_margin >= 6.0 and slow.worst.phase_margin >= 45.0


def test_settling_time_is_that_of_the_simulated_step():
    """First-order closed loop: for a pure gain, k = g ki T, the error falls by 1 - k a tick."""
    found = linear_step([TransferFunction([0.1], [1.0])], 1, PI(0.0, 0.25 / 0.1 / SAMPLE_TIME, SAMPLE_TIME, -1e9, 1e9))
    ticks = int(np.ceil(np.log(0.02) / np.log(0.75)))
    assert found.settling_ticks() == ticks
    assert found.overshoot == 0.0


@pytest.mark.parametrize(
    ("model", "options", "word"),
    [
        (plain(Gain(-0.1)), {}, "falls"),
        (plain(TransferFunction([4e5], [1.0, -40.0, 4e6])), {}, "is not stable"),
        (plain(Gain(0.1)), {"phase_margin": 95.0}, "phase_margin: must be a number > 0 and < 90 degrees, got 95"),
        (plain(Gain(0.1)), {"roll_off": -1.0}, "roll_off: must be a number >= 0 Hz or auto, got -1"),
        (load_model(MODELS / "fsm_mhl_inverse.yaml"), {}, "is an inverse model, from mrad to V"),
        (plain(Gain(0.1)), {"structure": "p"}, "structure: must be one of pi, pid, notch, damping, auto"),
    ],
)
def test_what_cannot_be_tuned_is_refused(model, options, word):
    with pytest.raises(InputError, match=word):
        tune(model, **options)


def test_command_line_prints_and_writes_the_table(tmp_path, capsys):
    from hyst_control.cli import main

    assert main(["tune", str(MODELS / "fsm_mhl.yaml"), "--json", str(tmp_path / "out.json")]) == 0
    assert (
        "roll_off" not in (text := capsys.readouterr().out)
        and "phase_margin" in text
        and (tmp_path / "out.json").stat().st_size > 100
    )
    assert main(["tune", str(MODELS / "fsm_mhl.yaml"), "--roll-off", "800", "--at", "100"]) == 0
    printed = capsys.readouterr().out
    assert "roll_off" in printed and "sensitivity" in printed
    assert main(["tune", str(MODELS / "fsm_mhl.yaml"), "--roll-off", "fast"]) == 2
    assert "--roll-off" in capsys.readouterr().err.splitlines()[-1]
    assert main(["tune", str(tmp_path / "absent.yaml")]) == 2
    gains = tmp_path / "gains.yaml"
    assert main(["tune", str(MODELS / "pea_hampi.yaml"), "--structure", "notch", "--output", str(gains)]) == 0
    assert f"written: {gains}" in capsys.readouterr().out
    due = tune(HAMPI, structure="notch").parameters
    assert read_yaml(gains) == {"/**/pi_feedback": {"ros__parameters": due}} and due["notch_frequency"]


def test_a_loop_whose_gain_margin_is_no_limit_is_scaled_to_its_phase_margin():
    """k / (s (s + 1)), s = (z - 1) / (z + 1): -180 degrees at |L| = 0 alone; 45 degrees are left at w = 1, where k = √2."""
    z = np.exp(1j * np.geomspace(1e-5, 1.0, 4000)[:-1] * np.pi)  # s is infinite at half the sampling rate
    s = (z - 1.0) / (z + 1.0)
    plant = Plants(z, (1.0 / (s * (s + 1.0)))[None, :, None, None], np.zeros(len(z), bool))
    found = _largest_scale(plant, np.ones_like(z), (2.0, np.pi / 4, 2.0, 0.0), 0.0, None)
    assert found == pytest.approx(np.sqrt(2.0), rel=2e-3)


def sum_of(*modes: tuple[float, float, float]) -> Model:
    """Modes of a frequency (Hz), damping ratio and gain at rest, added in one stage, behind 0.13 ms of delay, at 10 kHz."""
    num, den = np.zeros(1), np.ones(1)
    for w, damping, gain in angular(*modes):
        own = np.array([1.0, 2 * damping * w, w**2])
        num, den = np.polyadd(np.polymul(num, own), gain * w**2 * den), np.polymul(den, own)
    return replace(plain(Delay(1.3e-4), TransferFunction(num.tolist(), den.tolist())), sample_time=1e-4)


def angular(*modes):
    return [(2 * np.pi * frequency, damping, gain) for frequency, damping, gain in modes]


def peak_of(found, *modes) -> float:
    """Greatest |S| of a tuned loop around a sum of modes behind 0.13 ms, sampled by scipy: 0.1 ms as a tick, 0.03 ms by superposition."""
    step, fine = (
        1e-4,
        1e-5,
    )  # the command changes at 0.03 ms of a tick: at every tenth step of a plant that is sampled ten times as fast
    near = [f * (1.0 + np.linspace(-10.0, 10.0, 401) * zeta) for f, zeta, _ in modes]
    frequency = np.concatenate([np.geomspace(1.0, 4999.0, 4000), *near])
    z = np.exp(2j * np.pi * frequency * step)
    plant = np.zeros(len(z), complex)
    for w, damping, gain in angular(*modes):
        parts = [[0.0, 1.0], [-w * w, -2 * damping * w]], [[0.0], [gain * w * w]], [[1.0, 0.0]], [[0.0]]
        a, b, c, *_ = cont2discrete(tuple(map(np.array, parts)), fine)
        power = [np.linalg.matrix_power(a, n) for n in range(11)]
        early, late = sum(power[n] @ b for n in range(7)), sum(power[n] @ b for n in range(7, 10))
        plant += np.array([(c @ np.linalg.solve(each * np.eye(2) - power[10], early + late / each))[0, 0] / each for each in z])
    return float(np.abs(1.0 / (1.0 + plant * controller_response(found.law, z))).max())


def test_a_weak_mode_beside_its_zeros_costs_nothing():
    """0.5 % of the motion rings at 700 Hz: wherever it moves to, it remains 0.5 %."""
    main, weak = (2200.0, 0.05, 0.1), (700.0, 0.005, 0.0005)
    with_it, without = tune(sum_of(main, weak)), tune(sum_of(main))
    assert with_it.ki == pytest.approx(without.ki, rel=0.01)
    assert all(peak_of(with_it, main, (share * 700.0, *weak[1:])) < 2.0 for share in (0.8, 0.9, 1.0, 1.1, 1.2))


@pytest.mark.parametrize("structure", ["pi", "notch"])
def test_the_margins_hold_where_modes_move_together_and_each_by_itself(structure):
    modes = [(600.0, 0.02, 0.06), (850.0, 0.005, 0.04)]
    found = tune(sum_of(*modes), structure=structure)
    peaks = {}
    for first in (0.8, 1.0, 1.2):
        for second in (0.8, 1.0, 1.2):
            moved = [(factor * f, zeta, 1.1 * gain) for factor, (f, zeta, gain) in zip((first, second), modes, strict=True)]
            peaks[first, second] = peak_of(found, *moved)
    promised = [peak for (first, second), peak in peaks.items() if first == second or 1.0 in (first, second)]
    assert max(promised) <= found.worst.peak_sensitivity <= 2.0 + 1e-6


def test_the_notch_lies_at_the_resonance_and_not_at_a_slower_filter():
    w = 2 * np.pi * 293.0
    amplifier, slow = TransferFunction([1.0], [w**-2, 1.4 / w, 1.0]), TransferFunction([1.0, 53.9, 764.0], [1.0, 53.6, 764.0])
    stages = (*sum_of((850.0, 0.02, 0.08), (2200.0, 0.015, 0.02)).chain.stages, amplifier, slow)
    found = tune(replace(plain(*stages), sample_time=1e-4), structure="notch")
    assert found.filters.notch_frequency == pytest.approx((850.0,))


def test_a_resonance_without_which_the_loop_would_be_much_faster_is_named():
    """Of two modes the one at 300 Hz limits; where its damping is that of no peak the loop is as fast as the sentence says."""
    light, damped, other = (300.0, 0.03, 0.09), (300.0, np.sqrt(0.5), 0.09), (1500.0, 0.3, 0.01)
    found, without = tune(sum_of(light, other)), tune(sum_of(damped, other))
    (note,) = found.notes
    assert note.startswith("The resonance at 300 Hz (damping ratio 0.03) limits") and "the structure auto" in note
    reached = float(re.search(r"would reach about ([\d.]+) Hz", note)[1])
    assert reached == pytest.approx(without.nominal.bandwidth, rel=0.2) and reached > 2.0 * found.nominal.bandwidth
    assert without.notes == ()


def test_two_axes_of_which_each_has_a_resonance_name_both():
    """Without one of them the loop, which is the same for both axes, is no faster."""
    num, den = zip(*([[0.1], [1.0 / w**2, 0.04 / w, 1.0]] for w, _, _ in angular((850.0, 0, 0), (920.0, 0, 0))), strict=True)
    model = Model("m", ("x", "y"), {"command": "V", "measurement": "um"}, 1e-4, Chain((TransferFunction(list(num), list(den)),)))
    (note,) = tune(model).notes
    assert note.startswith("The resonances at 850 Hz (damping ratio 0.02), 920 Hz (damping ratio 0.02) limit the loop")


def test_where_no_damping_helps_the_gains_are_those_of_pi_alone():
    """A late loop around a light mode: a low-passed positive feedback only shakes it. What violates which margin is said."""
    w = 2 * np.pi * 700.0
    model = replace(plain(Delay(4e-4), TransferFunction([0.1], [1.0 / w**2, 0.02 / w, 1.0])), sample_time=1e-4)
    found, pi = tune(model, structure="damping"), tune(model)
    assert (found.kp, found.ki) == pytest.approx((pi.kp, pi.ki), rel=0.05) and not found.filters.damping_gain
    where = re.search(r"those of PI alone \(the least damping tried: .* at ([\d.]+) Hz\)", found.notes[-1])
    assert 0.8 * 700.0 <= float(where[1]) <= 1.25 * 700.0


STRUCTURES = ("pi", "pid", "notch", "damping")


@pytest.fixture(scope="module")
def structures():
    return {structure: tune(HAMPI, sample_time=5e-5, structure=structure) for structure in STRUCTURES}


@pytest.mark.parametrize("gain", [0.9, 1.1])
@pytest.mark.parametrize("mode", [0.8, 1.2])
@pytest.mark.parametrize("structure", STRUCTURES)
def test_margins_of_every_structure_from_impulse_responses(structures, structure, gain, mode):
    """As for the roll-off: what plant and controller answer to an impulse, each simulated by itself."""
    found, count = structures[structure], 1 << 15
    impulse, rest = np.zeros((count, 1)), np.zeros((count, 1))
    impulse[0] = 1.0
    stages = with_modes(linearized(HAMPI, gain * hysteresis_slopes(HAMPI)[1]), 1, mode)
    plant = Simulator(HAMPI.with_stages(stages), found.sample_time)
    plant.reset(np.zeros(1))
    answer = np.concatenate([np.zeros((1, 1)), plant.step(impulse)[:-1]])[:, 0]
    feedback = found.controller(-1e9, 1e9).start(1).step(impulse, rest, rest)[1][:, 0]
    integral = feedback[-1]
    turn = np.exp(-2j * np.pi * np.arange(1, count // 2) / count)
    loop = np.fft.fft(answer)[1 : count // 2] * (np.fft.fft(feedback - integral)[1 : count // 2] + integral / (1.0 - turn))
    inside, phase = np.abs(loop), np.unwrap(np.angle(loop))
    crossings = np.flatnonzero(np.diff(np.sign(inside - 1.0)))
    margin = np.degrees(np.abs(np.mod(phase[crossings], 2 * np.pi) - np.pi)).min()
    assert len(crossings) and margin > 45.0 and margin >= found.worst.phase_margin
    crossings = np.flatnonzero((np.diff(np.sign(loop.imag)) != 0) & (loop.real[:-1] < 0))
    assert -20 * np.log10(inside[crossings].max(initial=1e-9)) >= found.worst.gain_margin
    assert np.abs(1.0 / (1.0 + loop)).max() <= found.worst.peak_sensitivity


@pytest.mark.parametrize("structure", STRUCTURES)
def test_every_structure_settles_as_it_says_and_stays_stable_at_twice_its_gain(structures, structure):
    found = structures[structure]
    ticks = round(found.settling_time / found.sample_time)
    output = found.step(HAMPI, 3 * ticks)
    assert np.abs(output[ticks:] - 1.0).max() <= 0.02 < abs(output[ticks - 1, 0] - 1.0)
    assert 100 * max(output.max() - 1.0, 0.0) == pytest.approx(found.overshoot, abs=1e-3)
    law = found.law
    filters = replace(law.filters, kd=1.95 * law.filters.kd, damping_gain=1.95 * law.filters.damping_gain)
    for gain in (0.9, 1.1):
        for mode in (0.8, 1.2):
            stages = with_modes(linearized(HAMPI, gain * hysteresis_slopes(HAMPI)[1]), 1, mode)
            controller = replace(law, kp=1.95 * law.kp, ki=1.95 * law.ki, filters=filters).start(1)
            output = run_loop(np.ones((6000, 1)), None, controller, Simulator(HAMPI.with_stages(stages), found.sample_time))
            assert np.abs(output["measurement"][-10:] - 1.0).max() < 0.05, (gain, mode)


def test_notch_and_damping_settle_sooner_than_pi_and_auto_takes_the_best(structures):
    best = min(("pi", "notch", "damping"), key=lambda name: structures[name].settling_time)
    assert best == "damping" and structures["damping"].settling_time < 0.7 * structures["pi"].settling_time
    assert structures["notch"].settling_time < 0.8 * structures["pi"].settling_time
    assert tune(HAMPI, sample_time=5e-5, structure="auto") == structures["damping"]


def test_a_damped_resonance_rings_no_more():
    """A lightly damped mode, driven by a step of load on its command, with the damping alone and without any feedback."""
    w, time = 2 * np.pi * 200.0, 5e-5
    model = replace(plain(TransferFunction([w**2], [1.0, 0.02 * w, w**2])), sample_time=time)
    found = tune(model, structure="damping")
    damping = replace(found.law, kp=0.0, ki=0.0).start(1)
    measured = []
    for controller in (PI(0.0, 0.0, time, -1e9, 1e9).start(1), damping):
        plant, sample, rows = Simulator(model, time), np.zeros(1), []
        plant.reset(np.zeros(1))
        for _ in range(4000):
            command, _ = controller.step(np.zeros(1), sample, np.ones(1))
            sample = plant.step(command[None])[0]
            rows.append(sample[0])
        measured.append(np.ptp(rows[2000:]))
    assert measured[0] > 0.2 and measured[1] < 0.01 * measured[0]


def growth(found, plants) -> float:
    """Greatest |eigenvalue| of the PI loop around plants by (output, input): gain, frequency (Hz) and damping of a mode each."""
    axes = 1 + max(max(place) for place in plants)
    a = np.zeros((2 * len(plants), 2 * len(plants)))
    b, c = np.zeros((len(a), axes)), np.zeros((axes, len(a)))
    for k, ((output, entry), (gain, frequency, damping)) in enumerate(plants.items()):
        w, own = 2 * np.pi * frequency, slice(2 * k, 2 * k + 2)
        parts = [[0.0, 1.0], [-w * w, -2 * damping * w]], [[0.0], [gain * w * w]], [[1.0, 0.0]], [[0.0]]
        continuous = tuple(map(np.array, parts))
        a[own, own], pushed, *_ = cont2discrete(continuous, found.sample_time)
        b[own, entry], c[output, 2 * k] = pushed[:, 0], 1.0
    step = found.ki * found.sample_time
    loop = np.block([[a - (found.kp + step) * b @ c, b], [-step * c, np.eye(axes)]])
    return float(np.abs(np.linalg.eigvals(loop)).max())


@settings(max_examples=4, deadline=None)
@given(st.floats(-4.0, -0.5), st.floats(150.0, 900.0))
def test_a_loop_around_a_light_mode_is_stable_wherever_the_spread_has_it(damping, frequency):
    """However narrow the peak is beside the distance of the frequencies that margins are computed at."""
    w, zeta = 2 * np.pi * frequency, 10.0**damping
    found = tune(replace(plain(TransferFunction([0.1 * w * w], [1.0, 2 * zeta * w, w * w])), sample_time=1e-4))
    for gain in (0.09, 0.1, 0.11):
        for place in (0.8, 1.0, 1.2):
            up = 1.15 * 10.0 ** (5.9 / 20.0)  # the model error and the gain margin
            for more in (1.0, up):
                scaled = replace(found, kp=more * found.kp, ki=more * found.ki)
                assert growth(scaled, {(0, 0): (gain, place * frequency, zeta)}) < 1.0


@pytest.mark.parametrize("share, frequency, damping, sign", [(0.3, 60.0, 0.02, 1), (0.1, 100.0, 0.02, -1)])
def test_a_mode_that_only_couples_the_axes_counts(share, frequency, damping, sign):
    def mode(gain, frequency, damping):
        w = 2 * np.pi * frequency
        return [gain * w * w], [1.0, 2 * damping * w, w * w]

    direct, beside = (0.1, 20.0, 0.6), (0.1 * share, frequency, damping)
    back = (sign * beside[0], *beside[1:])
    plants = {(0, 0): direct, (0, 1): beside, (1, 0): back, (1, 1): direct}
    num, den = ([[mode(*plants[i, j])[part] for j in range(2)] for i in range(2)] for part in range(2))
    units = {"command": "V", "measurement": "mrad"}
    found = tune(Model("coupled", ("x", "y"), units, 2e-4, Chain((TransferFunction(num, den, coupled=True),))))
    assert growth(found, plants) < 1.0
    twice = replace(found, kp=1.99 * found.kp, ki=1.99 * found.ki)
    assert growth(twice, plants) < 1.0 and np.isfinite(found.settling_time)


@pytest.mark.parametrize("structure", ["notch", "damping"])
def test_without_a_resonance_there_is_none_to_damp(structure):
    with pytest.raises(InputError, match="the model has none"):
        tune(plain(Gain(0.1)), structure=structure)


def test_a_step_of_40_million_ticks_settles_when_its_closed_form_does():
    slow = linear_step([TransferFunction([0.1], [1.0])], 1, PI(0.0, 1e-7 / 0.1 / SAMPLE_TIME, SAMPLE_TIME, -1e9, 1e9))
    assert slow.settling_ticks() == pytest.approx(np.log(0.02) / np.log1p(-1e-7), rel=3e-3)


@pytest.mark.parametrize("loop_delay", [0, 3])
def test_the_step_is_that_of_the_simulated_loop(loop_delay, rolled):
    found = tune(MHL, sample_time=2e-4, loop_delay=loop_delay) if loop_delay else rolled[0.0]
    stages = [Delay(loop_delay * 2e-4), *linearized(MHL, hysteresis_slopes(MHL)[0])]
    simulated = run_loop(np.ones((400, 2)), None, found.law.start(2), Simulator(MHL.with_stages(stages), 2e-4))["measurement"]
    step = linear_step(stages[1:], 2, found.law, loop_delay)
    np.testing.assert_allclose(step.measurement[:400], simulated, atol=1e-9)
    outside = np.flatnonzero(np.any(np.abs(simulated - 1.0) > 0.02, axis=1))
    assert found.settling_time == pytest.approx((outside[-1] + 1) * 2e-4)


def test_many_light_resonances_settle_in_a_finite_time():
    count, damping = 25, 0.001
    a, b, c = np.zeros((2 * count, 2 * count)), np.zeros((2 * count, 1)), np.zeros((1, 2 * count))
    for i, w in enumerate(2 * np.pi * np.linspace(100.0, 2000.0, count)):
        a[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0.0, w], [-w, -2 * damping * w]]
        b[2 * i + 1], c[0, 2 * i] = w, 0.1 / (i + 1)
    stage = StateSpace(a.tolist(), b.tolist(), c.tolist(), [[0.0]])
    found = tune(Model("light", ("x",), {"command": "V", "measurement": "um"}, 2e-4, Chain((stage,))))
    assert 0.0 < found.settling_time < np.inf and found.worst.peak_sensitivity < 2.001


def test_a_model_with_many_poles_is_tuned():
    """Responses of 1500 frequencies for nine plants: without a system of as many equations as there are poles for each of them."""
    frequencies = 2 * np.pi * np.linspace(100.0, 2000.0, 40)
    stages = tuple(TransferFunction([w**2], [1.0, 1.6 * w, w**2]) for w in frequencies)
    model = Model("long", ("x",), {"command": "V", "measurement": "um"}, 2e-4, Chain(stages))
    found = tune(model)
    assert found.ki > 0.0 and found.worst.phase_margin > 44.9 and np.isfinite(found.settling_time)


SKEW = np.array([[0.5, 2.0], [0.02, 0.5]])  # Axes of which one drives the other much: far from normal


def skew_loop(found, frequency, gain=SKEW, error=None):
    """L (F, 2, 2) of a mode at 600 Hz that drives both axes through a gain, sampled at 10 kHz, from its sampled state space."""
    w, z = 2 * np.pi * 600.0, np.exp(2j * np.pi * np.asarray(frequency) * 1e-4)
    parts = [[0.0, 1.0], [-w * w, -0.1 * w]], [[0.0], [w * w]], [[1.0, 0.0]], [[0.0]]
    a, b, c, *_ = cont2discrete(tuple(map(np.array, parts)), 1e-4)
    mode = np.array([(c @ np.linalg.solve(each * np.eye(2) - a, b))[0, 0] for each in z])
    pi = found.kp + found.ki * 1e-4 * z / (z - 1.0)
    return (mode * pi)[:, None, None] * (gain if error is None else (np.eye(2) + error) @ gain)


@pytest.fixture(scope="module")
def skew():
    w = 2 * np.pi * 600.0
    each = [[0.0, 1.0], [-w * w, -0.1 * w]], [[0.0], [w * w]], [[1.0, 0.0]]
    a, b, c = (np.kron(np.eye(2), part) for part in each)
    stage = StateSpace(a.tolist(), b.tolist(), (SKEW @ c).tolist(), np.zeros((2, 2)).tolist())
    return Model("skew", ("x", "y"), {"command": "V", "measurement": "mrad"}, 1e-4, Chain((stage,)))


@pytest.fixture(scope="module")
def tuned_skew(skew):
    return tune(skew, peak_sensitivity=4.0, mode_spread=0.0)


def test_sensitivities_of_mixed_axes_are_singular_values_and_hold_for_every_error_of_the_motion(skew, tuned_skew):
    """Errors (I + E) P with a greatest singular value of E of 15 %, and with the spread of the gain."""
    found = tuned_skew
    frequency = np.union1d(np.geomspace(0.05, 5000.0, 300), np.linspace(560.0, 640.0, 200))

    def greatest(loops):
        return np.linalg.norm(np.linalg.inv(np.eye(2) + loops), 2, axis=(1, 2))

    np.testing.assert_allclose(found.sensitivity(skew, [1.0, 5.0]), greatest(skew_loop(found, [1.0, 5.0])), rtol=1e-6)
    assert found.sensitivity(skew, [5.0])[0] > 1.2, "it grows, where the eigenvalues say that it falls"
    assert found.nominal.peak_sensitivity == pytest.approx(greatest(skew_loop(found, frequency)).max(), rel=1e-3)
    random, worst = np.random.default_rng(3), 0.0
    for _ in range(150):
        error = random.normal(size=(2, 2)) + 1j * random.normal(size=(2, 2))
        error *= 0.15 / np.linalg.norm(error, 2)
        worst = max(worst, greatest(skew_loop(found, frequency, random.choice([0.9, 1.1]) * SKEW, error)).max())
    assert 0.75 * found.worst.peak_sensitivity < worst <= found.worst.peak_sensitivity
    assert found.worst.peak_sensitivity <= 4.0


def test_a_plant_whose_weak_direction_is_within_the_error_is_noted_or_refused(skew, tuned_skew):
    """A refusal names the margin and its frequency."""
    least, greatest = np.linalg.svd(SKEW, compute_uv=False)[[1, 0]]
    assert f"have {least / greatest:.2g} of their greatest gain" in tuned_skew.notes[0]
    with pytest.raises(InputError, match=r"\(peak sensitivity [\d.]+ at [\d.e-]+ Hz at any gain\)") as refused:
        tune(skew, mode_spread=0.0)
    assert "decouple the axes" in str(refused.value)


def test_a_loop_of_a_millionth_of_its_rate_crosses_over_where_its_integral_says():
    """Far below a mode at 50 Hz with damping 0.002, sampled at 50 kHz, L is ki g / s."""
    w = 2 * np.pi * 50.0
    found = tune(replace(plain(TransferFunction([0.5], [1.0 / w**2, 0.004 / w, 1.0])), sample_time=2e-5))
    crossover = 0.5 * found.ki / (2 * np.pi)
    assert crossover < 0.1
    assert found.nominal.crossover == pytest.approx(crossover, rel=0.01)
    assert found.nominal.bandwidth == pytest.approx(crossover, rel=0.02)
    assert found.nominal.phase_margin == pytest.approx(90.0, abs=0.2) and found.worst.phase_margin < 82.0


@pytest.mark.parametrize("rate", [5e3, 1e5])
def test_a_model_without_dynamics_is_tuned_for_the_band_that_it_is_known_in(rate):
    """The loop stays stable at twice its gain around a stage with a resonance beyond the band, whatever the rate is."""
    model = replace(plain(Gain(0.1), Delay(3e-5)), sample_time=2e-4, valid={"frequency": [0.0, 190.0]})
    found = tune(model, sample_time=1.0 / rate)
    assert 0.5 < 0.1 * 1.1 * found.ki / (2 * np.pi * 190.0) / 0.1 <= 1.01, "a tenth at 190 Hz"
    twice = replace(found, kp=1.99 * found.kp, ki=1.99 * found.ki)
    assert growth(twice, {(0, 0): (0.11, 200.0, 0.1)}) < 1.0
    assert "no dynamics" in found.notes[0] and "190 Hz" in found.notes[0] and found.notes[0] in found.table(model).text()


def test_margins_that_rest_on_a_response_nobody_has_seen_are_noted(rolled):
    """At 100 kHz the loop of a model of 5 kHz has half its gain, and more, beyond 2.5 kHz."""
    assert rolled[0.0].notes == ()
    assert "above 2500 Hz" in tune(MHL, sample_time=1e-5).notes[0]


def test_a_notch_of_the_drive_fitted_in_one_stage_with_its_mode_stays_where_it_is():
    """The mode moves by 20 %, the notch against it does not: the loop keeps its margins on that plant, too."""
    w, factor = 2 * np.pi * 800.0, 1.2

    def plant(mode: float) -> Model:
        num = np.array([w**-2, 2 * 0.02 / w, 1.0])
        den = np.polymul([mode**-2, 2 * 0.02 / mode, 1.0], [w**-2, 2 * 0.5 / w, 1.0])
        return replace(plain(TransferFunction((0.1 * num).tolist(), den.tolist())), sample_time=1e-4)

    found = tune(plant(w))
    z = np.exp(2j * np.pi * np.geomspace(1e-4, 0.5, 20000))
    for moved in (w / factor, factor * w):
        stages = plant(moved).chain.stages
        loop = sampled_response(stages, 1, 1e-4, z)[:, 0, 0] * controller_response(found.law, z)
        assert np.abs(1.0 / (1.0 + loop)).max() < 2.1
