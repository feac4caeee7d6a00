# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Modes that soften with amplitude: against the linear chain where they do not, against what softening means where they do."""

import numpy as np
import pytest

from evaluation.reproduction.softening_modes import stop_operators
from hyst_control.base.errors import InputError
from hyst_control.chain.chain import Chain
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.chain.hysteresis.softening_modal import SofteningModal
from hyst_control.chain.linear.linear_stages import StateSpace
from hyst_control.chain.stage import Sampling

SAMPLE_TIME = 1e-4
RNG = np.random.default_rng(0)
MODES = {
    "decay": [np.log(60.0), np.log(90.0), np.log(400.0)],
    "frequency": [2 * np.pi * 300, 2 * np.pi * 700, 0.0],
    "outputs": RNG.normal(size=(2, 3, 2)) * np.array([1.0, 1.0, 0.0])[None, :, None] + np.array([0, 0, 0.5])[None, :, None],
    "inputs": 300 * RNG.normal(size=(2, 3, 2)) * np.array([1.0, 1.0, 0.0])[None, :, None] + np.array([0, 0, 100.0])[None, :, None],
    "feedthrough": [[0.1, 0.0], [0.05, 0.2]],
    "amplitude": 1.0,
}
MODES["outputs"][1, 2] = MODES["inputs"][1, 2] = 0.0
SOFT = {
    "decay_change": [0.05, 0.1, 0.0],
    "frequency_change": [-40.0, -60.0, 0.0],
    "elongation": np.eye(2),
    "exponent": 0.5,
    "force_inputs": 20 * RNG.normal(size=(2, 3, 2)) * np.array([1.0, 1.0, 0.0])[None, :, None],
    "force_feedthrough": 0.01 * np.eye(2),
    "force_mean": [1.2, 1.1],
    "memory": 0.02,
}


def state_space() -> StateSpace:
    """The same modes as real matrices."""
    c, b = (np.array(MODES[name]) for name in ("outputs", "inputs"))
    a, bm, cm = np.zeros((5, 5)), np.zeros((5, 2)), np.zeros((2, 5))
    for i in range(2):
        decay, w = np.exp(MODES["decay"][i]), MODES["frequency"][i]
        rows = slice(2 * i, 2 * i + 2)
        a[rows, rows] = [[-decay, -w], [w, -decay]]
        bm[rows] = b[:, i]
        cm[:, rows] = np.stack([2 * c[0, i], -2 * c[1, i]], axis=1)
    a[4, 4], bm[4], cm[:, 4] = -np.exp(MODES["decay"][2]), b[0, 2], c[0, 2]
    return StateSpace(a, bm, cm, MODES["feedthrough"])


def run(stage, command: np.ndarray, hold: str = "zoh") -> np.ndarray:
    running = Chain((stage,)).filter(Sampling(SAMPLE_TIME, 2, hold))
    running.settle(command[0])
    return running.process(command)


def test_without_softening_it_is_the_state_space():
    command = np.random.default_rng(1).normal(size=(500, 2))
    assert np.allclose(run(SofteningModal(**MODES), command), run(state_space(), command), atol=1e-10)


def test_it_rests_where_it_settles():
    stage = SofteningModal(**MODES, **SOFT)
    for hold in ("zoh", "foh"):
        running = stage.filter(Sampling(SAMPLE_TIME, 2, hold))
        settled = running.settle(np.array([0.7, -0.4]))
        after = running.process(np.tile([0.7, -0.4], (200, 1)))
        assert np.allclose(after, settled, atol=1e-9)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_any_cut_gives_the_same_bits(hold):
    stage = SofteningModal(**MODES, **SOFT)
    command = np.random.default_rng(2).normal(size=(300, 2))
    whole = run(stage, command, hold)
    running = stage.filter(Sampling(SAMPLE_TIME, 2, hold))
    running.settle(command[0])
    pieces = [running.process(command[a:b]) for a, b in ((0, 1), (1, 8), (8, 150), (150, 300))]
    assert np.array_equal(np.concatenate(pieces), whole)


def test_harder_drive_lowers_the_resonance_by_what_is_stated():
    stage = SofteningModal(**MODES, decay_change=0.0, frequency_change=[-40.0, -60.0, 0.0], memory=0.02)
    rng = np.random.default_rng(3)
    period = 4000
    peaks = []
    for amplitude in (0.5, 1.0):
        command = amplitude * rng.normal(size=(period, 2))
        command *= amplitude / np.sqrt(np.mean(command**2))
        output = run(stage, np.tile(command, (4, 1)))[-period:]
        spectrum = np.fft.rfft(output, axis=0)
        drive = np.fft.rfft(command, axis=0)
        # The response to both axes at once is fitted around the first mode by its pole: the peak of the output per
        # drive.
        lines = np.arange(60, 180)
        frequency = lines / (period * SAMPLE_TIME)
        power = np.sum(np.abs(spectrum[lines]) ** 2, axis=1) / np.sum(np.abs(drive[lines]) ** 2, axis=1)
        smooth = np.convolve(power, np.ones(9) / 9, mode="same")
        near = smooth > 0.3 * smooth.max()
        peaks.append(np.sum(frequency[near] * smooth[near]) / np.sum(smooth[near]))
    # From half the amplitude to the full one g goes from -1 to 0: 40 rad/s down.
    assert peaks[0] - peaks[1] == pytest.approx(40.0 / (2 * np.pi), abs=3.0)


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="inputs: shape"):
        SofteningModal(**{**MODES, "inputs": np.zeros((2, 4, 2))})
    with pytest.raises(InputError, match="amplitude"):
        SofteningModal(**{**MODES, "amplitude": 0.0})


def test_two_terms_of_one_exponent_are_one_term_of_their_sum():
    command = np.random.default_rng(3).standard_normal((400, 2))
    h, d = np.array(SOFT["force_inputs"]), np.array(SOFT["force_feedthrough"])
    split = {
        **SOFT,
        "exponent": [SOFT.get("exponent", 0.5)] * 2,
        "force_inputs": np.concatenate([0.25 * h, 0.75 * h], axis=2),
        "force_feedthrough": np.concatenate([0.25 * d, 0.75 * d], axis=1),
        "force_mean": [*SOFT["force_mean"]] * 2,
    }
    one, two = SofteningModal(**MODES, **SOFT), SofteningModal(**MODES, **split)
    assert np.allclose(run(two, command), run(one, command), atol=1e-12)
    sampling = Sampling(1e-4, 2, "zoh")
    assert np.allclose(two.filter(sampling).settle(np.array([0.7, -0.4])), one.filter(sampling).settle(np.array([0.7, -0.4])))


def test_the_actuators_hysteresis_is_the_stop_operator_less_its_average():
    """Against play operators of the package: command less play; and what the force adds passes through the same modes as a command."""
    command = np.cumsum(np.random.default_rng(4).normal(size=(400, 2)), axis=0)
    stop = command - run(PrandtlIshlinskii([0.8], [1.0], w0=0.0), command)
    assert np.ptp(stop) == pytest.approx(1.6)
    expected = stop - 0.3 * command
    hysteretic = SofteningModal(
        **MODES, stop_threshold=0.8, stop_inputs=MODES["inputs"], stop_feedthrough=MODES["feedthrough"], stop_mean=0.3
    )
    assert np.allclose(run(hysteretic, command) - run(state_space(), command), run(state_space(), expected), atol=1e-9)


def test_stop_operators_of_a_period_are_those_of_the_stage_in_the_steady_state():
    period = np.random.default_rng(5).normal(size=(300, 2, 3))
    found = stop_operators(period, (0.2, 1.0))
    for record in range(3):
        twice = np.tile(period[:, :, record], (2, 1))
        for at, threshold in enumerate((0.2, 1.0)):
            play = run(PrandtlIshlinskii([threshold], [1.0], w0=0.0), twice)[300:]
            assert np.allclose(found[:, 2 * at : 2 * at + 2, record], period[:, :, record] - play, atol=1e-12)


def test_products_of_elongations_pass_through_the_same_modes_a_sample_late():
    """As inputs of a linear system: q1², q1 q2, q2² less their averages, held from the tick at which they were."""
    command = np.random.default_rng(6).normal(size=(400, 2))
    h, d = 15.0 * np.random.default_rng(7).normal(size=(2, 3, 3)), [[0.02, 0.01, -0.03], [0.0, 0.02, 0.01]]
    h[1, 2] = 0.0
    even = SofteningModal(
        **MODES, elongation=np.diag([0.5, 2.0]), product_inputs=h, product_feedthrough=d, product_mean=[0.3, 0.0, 0.1], memory=1e9
    )
    q = run(state_space(), command) * [0.5, 2.0]
    mean_square = np.mean(command[0] ** 2)  # of a memory that long it stays what it was at rest
    products = q[:, [0, 0, 1]] * q[:, [0, 1, 1]] - mean_square * np.array([0.3, 0.0, 0.1])
    late = np.concatenate([products[:1], products[:-1]])
    # Modes of the state space, driven by the products in place of the commands: two inputs at a time are enough of them.
    expected = np.zeros((400, 2))
    for pair in range(3):
        inputs = np.stack([h[:, :, pair], np.zeros((2, 3))], axis=2)
        driven = SofteningModal(**{**MODES, "inputs": inputs, "feedthrough": np.stack([np.array(d)[:, pair], np.zeros(2)], axis=1)})
        expected += run(driven, np.stack([late[:, pair], np.zeros(400)], axis=1))
    assert np.allclose(run(even, command) - run(state_space(), command), expected, atol=1e-9)
