"""Linear stages and delays against brute force: scipy on a fine grid, and the identities of an arranged chain."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import StateSpace as ScipyStateSpace
from scipy.signal import TransferFunction as ScipyTransferFunction
from scipy.signal import lsim

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Parallel, Sampling
from hyst_control.chain.chain import arrange
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PlayOperator
from hyst_control.chain.linear.linear_kernels import advance_linear
from hyst_control.chain.linear.linear_stages import (
    CrossCoupling,
    Delay,
    Discretised,
    LinearFilter,
    RateCorrection,
    StateSpace,
    TransferFunction,
)
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.effects.sensor_lowpass import SensorLowpass

TS = 1e-4
FINE = 200
"""Fine steps per sample; delays in these tests are multiples of one."""
HAMPI = ([-340.48, 4249823.6928, 34616124.928], [1.0, 8609.942, 59888317.084, 475090440.0])
"""G(s) of the HAMPI paper, Eq. 7."""
MODE = ([2e5, 4e7], [1.0, 900.0, 4e7])
PLAY = (PlayOperator([4.0, 8.0]), Gain([1.5, 0.7]))


def command(rows: int = 120, axes: int = 1, seed: int = 3) -> np.ndarray:
    """A rough command (rows, axes) that starts at rest at its first value."""
    u = 40.0 + np.cumsum(np.random.default_rng(seed).normal(0, 5.0, (rows, axes)), axis=0)
    u[:3] = u[0]
    return u


def run(stages, u: np.ndarray, hold: str) -> np.ndarray:
    """Output (N, A) of a chain settled at u[0], aligned with the command: y[k] at t_k."""
    running = Chain(tuple(stages)).filter(Sampling(TS, u.shape[1], hold))
    first = running.settle(u[0])
    y = running.process(u)
    return y if hold == "foh" else np.concatenate([first[None], y[:-1]])


def fine(u: np.ndarray, hold: str, tau: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """One axis of the held command (N,), late by tau, on the fine grid from sample 0 to N - 1: times and values."""
    late = round(tau / TS * FINE)
    at = np.arange((len(u) - 1) * FINE + 1)
    position = np.maximum(at - late, 0) / FINE
    values = u[np.floor(position).astype(int)] if hold == "zoh" else np.interp(position, np.arange(len(u)), u)
    return at * TS / FINE, values


def simulated(num, den, u: np.ndarray, hold: str, tau: float = 0.0) -> np.ndarray:
    """The same by scipy's lsim, from rest at u[0], at the samples; zoh sees the value before the step at t_k."""
    time, values = fine(u, hold, tau)
    if hold == "zoh":
        gain = num[-1] / den[-1]
        _, y, _ = lsim(ScipyTransferFunction(num, den), values - u[0], time, interp=False)
        if len(num) == len(den):  # the left limit at t_k: the direct part still sees the interval before
            jump = np.diff(values, prepend=values[0])
            y = y - num[0] / den[0] * jump
        return (y + gain * u[0])[::FINE]
    _, y, _ = lsim(ScipyTransferFunction(num, den), values - u[0], time)
    return (y + num[-1] / den[-1] * u[0])[::FINE]


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("num, den", [HAMPI, MODE, ([3.0, 5e3], [1.0, 8e3]), ([2.0], [3.0])])
def test_a_transfer_function_is_that_of_scipy(num, den, hold):
    u = command()
    np.testing.assert_allclose(run([TransferFunction(num, den)], u, hold)[:, 0], simulated(num, den, u[:, 0], hold), rtol=1e-8)


@pytest.mark.parametrize("tau", [0.0, 0.35 * TS, TS, 2.8 * TS])
@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_a_delay_is_exact_between_the_samples(hold, tau):
    u = command()
    expected = simulated(*MODE, u[:, 0], hold, tau)
    for stages in ([Delay(tau), TransferFunction(*MODE)], [TransferFunction(*MODE), Delay(tau)]):
        np.testing.assert_allclose(run(stages, u, hold)[:, 0], expected, rtol=1e-8)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_a_delay_alone_returns_what_was_held_then(hold):
    u, tau = command(), 1.7 * TS
    _, values = fine(u[:, 0], hold, tau)
    expected = values[::FINE]
    np.testing.assert_allclose(run([Delay(tau)], u, hold)[:, 0], expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_a_delay_passes_static_stages_to_the_linear_one(hold):
    """Delay, hysteresis, G(s) in any order: hysteresis of the delayed held command is the delayed, held hysteresis."""
    u, taus = command(axes=2), [0.35 * TS, 2.6 * TS]
    hysteresis = run(PLAY, u, "foh")
    delay, dynamics = Delay(taus), TransferFunction([MODE[0], [5e7]], [MODE[1], [1.0, 700.0, 5e7]])
    orders = ([delay, *PLAY, dynamics], [*PLAY, delay, dynamics], [*PLAY, dynamics, delay], [PLAY[0], delay, PLAY[1], dynamics])
    outputs = [run(stages, u, hold) for stages in orders]
    for output in outputs:
        np.testing.assert_array_equal(output, outputs[0])
    for axis, (num, den) in enumerate(zip(dynamics.num, dynamics.den)):
        np.testing.assert_allclose(outputs[0][:, axis], simulated(num, den, hysteresis[:, axis], hold, taus[axis]), rtol=1e-8)


def coupled_by_hand(u: np.ndarray, hold: str, taus_in, taus_out) -> np.ndarray:
    """y_i = Σ_j G_ij u_j with a delay per input and per output."""
    num, den = COUPLED.num, COUPLED.den
    return np.stack(
        [sum(simulated(num[i][j], den, u[:, j], hold, taus_in[j] + taus_out[i]) for j in range(2)) for i in range(2)], axis=1
    )


COUPLED = TransferFunction([[[4e7], [1e3, 4e6]], [[-3e6], [2e3, 5e7]]], [1.0, 900.0, 4e7], coupled=True)
TAUS = [0.35 * TS, 1.6 * TS]


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_a_coupled_transfer_function_with_delays_at_its_inputs(hold):
    u = command(axes=2)
    np.testing.assert_allclose(run([Delay(TAUS), COUPLED], u, hold), coupled_by_hand(u, hold, TAUS, [0, 0]), rtol=1e-8)
    np.testing.assert_allclose(run([COUPLED, Delay(TAUS[0])], u, hold), coupled_by_hand(u, hold, [0, 0], 2 * TAUS[:1]), rtol=1e-8)


@pytest.mark.parametrize("wrap", [lambda stage: [stage], lambda stage: [Parallel(((stage,),))]])
def test_a_delay_that_differs_between_the_axes_stays_behind_what_mixes_them(wrap):
    """Whole samples, so that the delay on its own is exact too."""
    u, taus = command(axes=2), [TS, 3 * TS]
    expected = coupled_by_hand(u, "zoh", [0, 0], taus)
    np.testing.assert_allclose(run([*wrap(COUPLED), Delay(taus)], u, "zoh"), expected, rtol=1e-8)
    np.testing.assert_allclose(run([*wrap(COUPLED), Delay(taus), Gain(2.0)], u, "zoh"), 2 * expected, rtol=1e-8)
    unity = TransferFunction([1.0], [1.0])
    np.testing.assert_allclose(run([*wrap(COUPLED), Delay(taus), unity], u, "zoh"), expected, rtol=1e-8)


def test_a_discrete_state_space_keeps_uneven_delays_on_their_side():
    mixing = StateSpace(A=[[0.5]], B=[[1.0, 2.0]], C=[[1.0], [-1.0]], D=[[0.1, 0.2], [0.3, 0.4]], sample_time=TS)
    u, taus = command(axes=2), [TS, 4 * TS]
    before, late = run([mixing], u, "foh"), np.array([1, 4])
    rows = np.maximum(np.arange(len(u))[:, None] - late, 0)
    np.testing.assert_allclose(run([mixing, Delay(taus)], u, "foh"), np.take_along_axis(before, rows, axis=0), rtol=1e-12)
    delayed = np.take_along_axis(u, rows, axis=0)
    np.testing.assert_allclose(run([Delay(taus), mixing], u, "foh"), run([mixing], delayed, "foh"), rtol=1e-12)
    # The recursion itself, by hand.
    x = np.linalg.solve(np.eye(1) - mixing.A, np.array(mixing.B) @ u[0])
    for k in range(1, 20):
        x = np.array(mixing.A) @ x + np.array(mixing.B) @ u[k - 1]
        np.testing.assert_allclose(before[k], np.array(mixing.C) @ x + np.array(mixing.D) @ u[k], rtol=1e-12)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_a_state_space_is_that_of_scipy(hold):
    matrices = ([[-500.0, 2e3], [-1e3, -300.0]], [[1e3, 0.0], [200.0, 800.0]], [[1.0, 0.5], [0.0, 2.0]], [[0.1, 0.0], [0.3, 0.2]])
    u = command(axes=2)
    time = np.arange((len(u) - 1) * FINE + 1) * TS / FINE
    values = np.stack([fine(u[:, j], hold)[1] for j in range(2)], axis=1)
    a, b, c, d = map(np.array, matrices)
    rest = np.linalg.solve(-a, b @ u[0])
    _, y, _ = lsim(ScipyStateSpace(a, b, c, d), values, time, X0=rest, interp=hold == "foh")
    if hold == "zoh":
        y -= np.diff(values, axis=0, prepend=values[:1]) @ d.T
    np.testing.assert_allclose(run([StateSpace(*matrices)], u, hold), y[::FINE], rtol=1e-8)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_the_rate_correction_is_a_high_pass_of_the_command(hold):
    """k1 s / (k2 s + b2) + b1 / b2, MHL paper Eq. 4."""
    k1, k2, b1, b2 = -1.265e-3, 7e-4, 0.2, 1.3
    u = command()
    expected = simulated([k1, 0.0], [k2, b2], u[:, 0], hold) + b1 / b2
    np.testing.assert_allclose(run([RateCorrection(k1=k1, k2=k2, b1=b1, b2=b2)], u, hold)[:, 0], expected, atol=1e-9)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_cross_coupling_low_passes_the_other_axis(hold):
    u, w = command(axes=2), 2 * np.pi * 300.0
    y = run([CrossCoupling([[1.0, 0.05], [-0.02, 0.9]], corner=300.0)], u, hold)
    other = [simulated([w], [1.0, w], u[:, j], hold) for j in range(2)]
    own = u if hold == "foh" else np.concatenate([u[:1], u[:-1]])
    np.testing.assert_allclose(y, np.stack([own[:, 0] + 0.05 * other[1], 0.9 * own[:, 1] - 0.02 * other[0]], axis=1), rtol=1e-9)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_a_run_of_linear_stages_is_one_system(hold):
    """Cutting a run in two samples what lies between; the merged run equals the product of the transfer functions."""
    u = command()
    first, second = ([3.0, 5e3], [1.0, 8e3]), MODE
    product = np.polymul(first[0], second[0]), np.polymul(first[1], second[1])
    merged = run([TransferFunction(*first), RateCorrection(k1=1e-3, k2=7e-4, b1=0.4), TransferFunction(*second)], u, hold)
    whole = np.polymul(product[0], [1e-3, 0.0]), np.polymul(product[1], [7e-4, 1.0])
    constant = 0.4 * second[0][-1] / second[1][-1]
    np.testing.assert_allclose(merged[:, 0], simulated(*whole, u[:, 0], hold) + constant, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_parallel_adds_its_branches(hold):
    u = command(axes=2)
    branches = (PLAY, (TransferFunction(*MODE), Offset(0.3)), (Delay(2 * TS), Gain(0.1)))
    np.testing.assert_allclose(run([Parallel(branches)], u, hold), sum(run(branch, u, hold) for branch in branches), rtol=1e-12)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_linear_stages_and_delays_distribute_over_parallel_branches(hold):
    """MHL's form: delay, (hysteresis + rate correction), G(s), against the two paths on the fine grid."""
    u, tau = command(), 0.65 * TS
    hysteresis = run([PlayOperator(4.0)], u, "foh")
    rate = RateCorrection(k1=-1e-3, k2=7e-4)
    product = np.polymul([-1e-3, 0.0], MODE[0]), np.polymul([7e-4, 1.0], MODE[1])
    expected = simulated(*MODE, hysteresis[:, 0], hold, tau) + simulated(*product, u[:, 0], hold, tau)
    both = Parallel(((PlayOperator(4.0),), (rate,)))
    for stages in (
        [Delay(tau), both, TransferFunction(*MODE)],
        [both, Delay(tau), TransferFunction(*MODE)],
        [both, TransferFunction(*MODE), Delay(tau)],
    ):
        np.testing.assert_allclose(run(stages, u, hold)[:, 0], expected, rtol=1e-8, atol=1e-8)


def test_arranging_leaves_nothing_linear_behind_a_parallel():
    chain = arrange([Delay(1e-5), Parallel(((Gain(1.0),), (RateCorrection(k1=1.0, k2=1.0),))), TransferFunction(*MODE)])
    assert [stage.name for stage in chain] == ["parallel"]
    assert [[stage.name for stage in branch] for branch in chain[0].branches] == [
        ["delay", "gain", "transfer_function"],
        ["delay", "rate_correction", "transfer_function"],
    ]


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_an_offset_does_not_part_dynamics_from_a_low_pass_behind_it(hold):
    """The product of both, and the offset."""
    u, corner = command(), 2 * np.pi * 2500.0
    product = corner * np.asarray(MODE[0]), np.polymul([1.0, corner], MODE[1])
    np.testing.assert_allclose(
        run([TransferFunction(*MODE), Offset(0.3), SensorLowpass(2500.0)], u, hold)[:, 0],
        simulated(*product, u[:, 0], hold, 0.0) + 0.3,
        rtol=1e-8,
        atol=1e-8,
    )


def test_a_madelung_stage_between_dynamics_keeps_the_delay_exact():
    """A delay between a linear stage and the hysteresis belongs to the linear stage in front when nothing linear follows."""
    u, tau = command(), 0.35 * TS
    curve = Madelung([0.5, 0.5], [-0.5, 1.5], 100.0, 10.0)
    late = simulated(*MODE, u[:, 0], "zoh", tau)
    np.testing.assert_allclose(
        run([TransferFunction(*MODE), Delay(tau), curve], u, "zoh"), run([curve], late[:, None], "foh"), rtol=1e-8
    )


@pytest.mark.parametrize(
    "make, word",
    [
        (lambda: TransferFunction([1.0, 0.0, 0.0], [1.0, 1.0]), "improper"),
        (lambda: TransferFunction([1.0], [1.0, 0.0]), "integrates"),
        (lambda: TransferFunction([1.0], [0.0, 0.0]), "den"),
        (lambda: StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]]), "integrates"),
        (lambda: StateSpace([[1.0]], [[1.0]], [[1.0]], [[0.0]], sample_time=1e-3), "integrates"),
        (lambda: StateSpace([[1.0, 2.0]], [[1.0]], [[1.0]], [[0.0]]), "shapes"),
        (lambda: Delay(-1e-5), "tau"),
        (lambda: RateCorrection(k1=1.0, k2=0.0), "k2"),
        (lambda: CrossCoupling([[1.0, 0.0]]), "matrix"),
    ],
)
def test_a_system_that_makes_no_sense_is_refused_by_name(make, word):
    with pytest.raises(InputError, match=word):
        make()


def test_time_constants_out_of_proportion_are_refused():
    with pytest.raises(InputError, match="check their units"):
        Chain((RateCorrection(k1=1.0, k2=1e300),)).filter(Sampling(TS, 1))


def test_states_that_decay_reach_zero():
    """Subnormal numbers would slow the kernel down a hundredfold."""
    running = Chain((TransferFunction([1e4], [1.0, 1e4]),)).filter(Sampling(TS, 1))
    running.settle(np.ones(1))
    y = running.process(np.zeros((1200, 1)))
    assert 0 < y[100, 0] < 1e-40 and np.all(y[400:] == 0.0)


@pytest.mark.parametrize("order", [0, 1, 3, 9])
@pytest.mark.parametrize("late", [0, 1])
def test_systems_of_one_input_are_advanced_to_the_same_bits_as_coupled_ones(order, late):
    """Both kernels, two systems with delays of their own, in blocks of any length; 9 states leave empty columns out."""
    random = np.random.default_rng(order)

    def started() -> LinearFilter:
        draw = np.random.default_rng(7)
        systems = []
        for _ in range(2):
            a = np.triu(0.4 * draw.normal(size=(order, order)) / max(order, 1))
            b, d = draw.normal(size=(3, order, 1)), draw.normal(size=(2, 1, 1))
            b[1:] *= late
            systems.append(Discretised(a, b, draw.normal(size=(1, order)), d, draw.normal(size=1)))
        return LinearFilter(systems, np.array([0.0, 5.0]))

    one, other = started(), started()
    for length in (1, 7, 300):
        block = random.normal(size=(length, 2))
        expected = np.empty_like(block)
        other.position = advance_linear(
            block,
            other.a,
            other.reach,
            other.b,
            other.late,
            other.c,
            other.d,
            other.bias,
            other.whole,
            other.state,
            other.scratch,
            other.taps,
            other.history,
            other.position,
            expected,
        )
        np.testing.assert_array_equal(one.process(block), expected)
        np.testing.assert_array_equal(one.state, other.state)
