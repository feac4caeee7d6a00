# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A Python function as a stage: clock and holds, blocks, and what is said of a function that fails."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete, lfilter

import hyst_control as hc
from hyst_control.base import parallel
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling
from hyst_control.chain.coordinates import chain_coordinates, with_coordinates
from hyst_control.chain.external_simulator import ALIKE, SAME, external_simulator
from hyst_control.chain.linear.linear_stages import Delay, TransferFunction
from hyst_control.chain.memoryless import Gain
from hyst_control.diagnose.simulator import named_simulator, read_parameters, simulator_model
from hyst_control.model_file import Model, model_to_document, simulate

COMMAND = 20.0 * np.random.default_rng(0).normal(size=60)
STEP = 1e-3


def lag(command, sample_time, tau=5e-3, gain=2.0):
    """First-order lag of a held command, from rest at 0, by its exact recursion."""
    measurement = np.zeros(command.shape)
    for k in range(len(command) - 1):
        measurement[k + 1] = measurement[k] + (1 - np.exp(-sample_time / tau)) * (gain * command[k] - measurement[k])
    return measurement


def lag_of_samples(command, sample_time, tau=5e-3, gain=2.0):
    """The same of a command that runs straight between samples, by 1000 steps of Euler between them."""
    at, rows = 0.0, [0.0]
    for before, now in zip(command[:-1], command[1:]):
        for share in (np.arange(1000) + 0.5) / 1000:
            at += sample_time / 1000 / tau * (gain * (before + share * (now - before)) - at)
        rows.append(at)
    return np.array(rows)


def model_of(stages, axes=1, hold="zoh"):
    return Model("plant", tuple("xyz"[:axes]), {"command": "V", "measurement": "um"}, STEP, Chain(tuple(stages)), hold)


def begun_at_rest(axes=1):
    rows = np.column_stack([COMMAND, -0.5 * COMMAND][:axes])
    rows[0] = 0.0
    return rows


@pytest.mark.parametrize(("hold", "function"), [("zoh", lag), ("foh", lag_of_samples)])
def test_it_is_the_stage_with_the_same_equation(hold, function):
    stage, _ = external_simulator(function, {"tau": (8e-3, 1e-4, "s")})
    own = model_of([TransferFunction([2.0], [8e-3, 1.0])], hold=hold)
    expected = simulate(own, begun_at_rest())
    np.testing.assert_allclose(simulate(model_of([stage], hold=hold), begun_at_rest()), expected, atol=2e-3)


def test_a_continuous_signal_before_it_is_held_at_its_means():
    stage, _ = external_simulator(lag, {})
    slow = TransferFunction([1.0], [2e-2, 1.0])
    expected = simulate(model_of([slow, TransferFunction([2.0], [5e-3, 1.0])]), begun_at_rest())
    found = simulate(model_of([slow, Gain(1.0), stage]), begun_at_rest())
    assert np.max(np.abs(found - expected)) < 5e-3 * np.ptp(expected)


@pytest.mark.parametrize("late", [(1.5, 0.0), (0.0, 0.25), (2.0, 3.75)])
def test_a_delay_of_one_axis_moves_a_part_of_a_sample(late):
    """The mean of a held command that comes late, over each interval between samples: a share of one value and the rest of the next."""

    def mixed(command, sample_time):
        return command @ np.array([[1.0, 0.5], [-0.5, 1.0]])

    stage, _ = external_simulator(mixed, {})
    rows = begun_at_rest(2)
    found = simulate(model_of([Delay([rate * STEP for rate in late]), stage], axes=2), rows)
    means = np.empty_like(rows)
    for axis, samples in enumerate(late):
        whole, share = int(samples), samples % 1.0
        padded = np.concatenate([np.zeros(whole + 1), rows[:, axis]])
        means[:, axis] = (1.0 - share) * padded[1:][: len(rows)] + share * padded[: len(rows)]
    np.testing.assert_allclose(found, mixed(means, STEP), atol=1e-9)


def tank(command, sample_time):
    """Level from 100 mm, which an inflow of 5 keeps."""
    level, rows = 100.0, []
    for inflow in command:
        rows.append(level)
        for _ in range(10):
            level += sample_time * (20.0 * inflow - 10.0 * np.sqrt(level))
    return np.array(rows)


@pytest.mark.parametrize(
    ("function", "first", "rest"),
    [
        (lag, 20.0, 0.0),
        (tank, 6.0, 5.0),
        (tank, 5.0, 5.0),
        (lambda command, sample_time: command[0] + lag(command - command[0], sample_time), 20.0, None),
    ],
)
def test_what_was_before_keeps_the_function_where_it_begins(function, first, rest):
    command = np.concatenate([np.full(20, first), np.full(40, 8.0)])[:, None]
    stage, _ = external_simulator(function, {})
    found = stage.begun(command, STEP).rest
    assert found is None if rest is None else found == pytest.approx((rest,), abs=1e-3)


def two_lags(taus, command):
    """Two first-order lags in a row of a held command, from rest at 0, exactly."""
    slow, fast = taus
    num, den, _ = cont2discrete(([1.0], np.polymul([slow, 1.0], [fast, 1.0])), STEP, "zoh")
    return lfilter(num[0], den, command, axis=0)


@pytest.mark.parametrize("behind", [False, True])
def test_a_record_that_begins_with_a_step_is_the_same_in_both_orders(behind):
    command = np.concatenate([np.full((30, 1), 20.0), np.full((30, 1), -5.0)])
    stage, _ = external_simulator(lag, {"gain": (1.0, 0.1)})
    stage, slow = stage.stepped(command, STEP).begun(command, STEP), TransferFunction([1.0], [2e-2, 1.0])
    expected = two_lags((2e-2, 5e-3), command)
    found = simulate(model_of([stage, slow] if behind else [slow, stage]), command)
    assert np.max(np.abs(found - expected)) < 2e-3 * np.ptp(expected)


def mode(command, sample_time, frequency=300.0):
    """A mode that swings within a tick, exactly for a held command."""
    rate = 2.0 * np.pi * frequency
    num, den, _ = cont2discrete(([rate**2], [1.0, 0.2 * rate, rate**2]), sample_time)
    return lfilter(num[0], den, command)


def by_ticks(command, sample_time):
    """Euler steps of a tenth of each tick, whatever that is."""
    at, rows = 0.0, []
    for value in command:
        rows.append(at)
        for _ in range(10):
            at += 0.1 * sample_time / 5e-3 * (value - at)
    return np.array(rows)


@pytest.mark.parametrize(
    ("function", "steps", "differs"),
    [
        (mode, 4, (0.0, 1e-9)),
        (by_ticks, 4, (SAME, ALIKE)),
        (lambda command, sample_time: np.append(0.0, command[:-1]), 1, (0.0, 0.0)),  # of the last step alone
        (lambda command, sample_time: command, 1, (0.0, 0.0)),
        (lambda command, sample_time: np.concatenate([np.zeros(2), command[:-2]]), 1, (ALIKE, 2.0)),  # a delay of two calls
    ],
)
def test_finer_steps_are_for_functions_that_have_the_same_samples_at_these(function, steps, differs):
    stage = external_simulator(function, {})[0].stepped(COMMAND[:, None], STEP)
    assert stage.steps == steps and differs[0] <= stage.differs <= differs[1]


@pytest.mark.parametrize("function", [mode, by_ticks])
def test_a_lag_without_length_changes_nothing_at_finer_steps(function):
    """Integration errors that follow the step would look like an effect of the lag: 0.4 % of the range."""
    stage = external_simulator(function, {})[0].stepped(COMMAND[:, None], STEP)
    alone = simulate(model_of([stage]), begun_at_rest())
    short = simulate(model_of([stage, TransferFunction([1.0], [1e-9, 1.0])]), begun_at_rest())
    np.testing.assert_allclose(short, alone, atol=1e-4 * np.ptp(alone))


def test_a_smooth_command_is_held_at_its_means():
    """Of 20 V at 10 Hz, sampled: a held command comes half a tick late."""
    time = np.arange(200) * STEP
    fine = np.arange(200 * 50) * STEP / 50
    expected = lag(20.0 * np.sin(2.0 * np.pi * 10.0 * (fine + 0.5 * STEP / 50)), STEP / 50)[::50, None]
    command = 20.0 * np.sin(2.0 * np.pi * 10.0 * time)[:, None]
    stage = external_simulator(lag, {})[0].stepped(command, STEP)
    late, found = (
        np.max(np.abs(simulate(model_of([one], hold="foh"), command) - expected)) for one in (stage, stage.held(command, STEP))
    )
    assert found < 0.002 * np.ptp(expected) and late > 0.01 * np.ptp(expected)
    assert not external_simulator(lag_of_samples, {})[0].held(command[:20], STEP).holds_command


@given(st.lists(st.integers(0, 60), max_size=4), st.sampled_from(["zoh", "foh"]), st.sampled_from([0, 1]))
def test_blocks_are_cut_anywhere(cuts, hold, ahead):
    stage, _ = external_simulator(lag, {})
    rows = begun_at_rest(2)
    results = []
    for edges in ([], sorted(cuts)):
        running = stage.filter(Sampling(STEP, 2, hold, ahead))
        running.settle(rows[0])
        results.append(np.concatenate([running.process(part) for part in np.split(rows, edges)]))
    np.testing.assert_array_equal(*results)


def test_its_parameters_are_coordinates_of_the_chain():
    stage, deviations = external_simulator(lag, {"tau": (8e-3, 1e-4, "s"), "gain": (0.0, 0.5)})
    assert deviations == (1e-4, 0.5)
    known = chain_coordinates((stage,), ["x"])
    assert [(name, each.value, each.unit) for name, each in known.items()] == [
        ("external_simulator.tau", 8e-3, "s"),
        ("external_simulator.gain", 0.0, ""),
    ]
    (moved,) = with_coordinates((stage,), {"external_simulator.gain": 0.3}, ["x"])
    assert moved.values == (8e-3, 0.3)


def failing(command, sample_time, gain=1.0):
    raise RuntimeError("the solver\nstopped")


def infinite(command, sample_time, gain=1.0):
    return np.where(np.arange(len(command)) == 7, np.inf, command)


SEEDLESS = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (failing, r"simulator failing: RuntimeError: the solver stopped: mend it, and try failing\(command, 0.001, gain=1\)"),
        (infinite, "simulator infinite: is not finite at sample 7 with gain = 1: check its dynamics"),
        (lambda command, sample_time, gain: command[1:], r"gives values of shape \(59,\) for a command of 60 samples and 1 axes"),
        (lambda command, sample_time: command, "unexpected keyword argument 'gain'"),
        (lambda command, sample_time, gain: "no", "ValueError: could not convert string"),
        (lambda command, sample_time, gain: SEEDLESS.normal(size=len(command)), "a second call gives other values"),
        (3, "simulator: 3 cannot be called"),
    ],
)
def test_what_fails_is_said_in_one_line(function, said):
    with pytest.raises(InputError, match=said) as raised:
        simulator_model(function, {"gain": (1.0, 0.1)}, [record()])
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    "given_", [(1.0,), (1.0, -0.1), 1.0, (1.0, 0.1, "V", 3), (0, 1, 0.002), ("one", 0.1), (np.nan, 1.0), (1.0, np.inf)]
)
def test_a_parameter_without_value_and_deviation_is_refused(given_):
    with pytest.raises(InputError, match=r"parameters: gain: .*must be value, standard deviation and a unit"):
        external_simulator(lag, {"gain": given_})


def record():
    return hc.from_arrays(COMMAND, COMMAND, rate=1.0 / STEP)


def test_it_is_no_model_file():
    with pytest.raises(InputError, match="simulator lag: a Python function is no model file"):
        model_to_document(simulator_model(lag, {}, [record()]))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("math", "module:function"),
        ("math:nothing", "has no attribute 'nothing'"),
        ("no_such:f", "No module"),
        ("math:pi", "no function"),
    ],
)
def test_a_name_that_is_no_function_is_refused(name, said):
    with pytest.raises(InputError, match=said):
        named_simulator(name)


def test_a_file_of_parameters_is_a_mapping(tmp_path):
    path = tmp_path / "prior.yaml"
    path.write_text("stiffness: [1.2, 0.1, N/um]\n")
    assert read_parameters(path) == {"stiffness": [1.2, 0.1, "N/um"]}
    path.write_text("- 3\n")
    with pytest.raises(InputError, match="must be a mapping"):
        read_parameters(path)


def test_a_vectorized_simulator_has_the_same_verdict_by_fewer_calls(monkeypatch):
    """A lag by scipy for sets of parameters at once, and set by set."""
    monkeypatch.setattr(parallel, "cores", lambda: 1)  # so that every call is seen
    calls = []

    def lags(command, sample_time, gain, time):
        keep, gain = np.exp(-sample_time / np.asarray(time)), np.asarray(gain)
        rows = [
            lfilter([0.0, share * (1.0 - left)], [1.0, -left], command, zi=[share * command[0]])[0]
            for share, left in np.broadcast(gain, keep)
        ]
        calls.append(len(rows))
        return np.reshape(rows, (*np.shape(gain), len(command)))

    steps = np.repeat([0.0, 30.0, 10.0, 50.0, 20.0, 0.0, 40.0, 5.0], 40)
    record = hc.from_arrays(steps, lags(steps, 1e-3, 0.11, 6e-3) + 0.01 * np.random.default_rng(0).standard_normal(320), 1000.0)
    found = {}
    for vectorized in (False, True):
        lags.vectorized = vectorized
        calls.clear()
        gap = hc.diagnose(record, lags, parameters={"gain": (0.1, 0.01), "time": (5e-3, 1e-3)}, verbose=False)
        found[vectorized] = gap.document, len(calls), max(calls)
    assert found[True][0] == found[False][0]
    assert found[True][0]["verdict"] == "parameters"
    assert found[True][1] < found[False][1] and (found[False][2], found[True][2]) == (1, 5)


def test_a_vectorized_simulator_that_mixes_up_its_sets_is_one_line():
    def amiss(command, sample_time, gain):
        return (np.asarray(gain)[..., None] * command)[::-1] if np.ndim(gain) else gain * command

    amiss.vectorized = True
    steps = np.repeat([0.0, 30.0, 10.0, 50.0, 20.0, 0.0], 50)
    with pytest.raises(hc.InputError, match="return the sets in their order"):
        hc.diagnose(hc.from_arrays(steps, 0.1 * steps, 1000.0), amiss, parameters={"gain": (0.1, 0.01)}, verbose=False)


def test_a_vectorized_simulator_of_another_shape_is_one_line():
    def amiss(command, sample_time, gain):
        return 0.1 * command

    amiss.vectorized = True
    steps = np.repeat([0.0, 30.0, 10.0, 50.0, 20.0, 0.0], 50)
    with pytest.raises(hc.InputError, match="samples and 1 axes and 2 sets of parameters: return one row per sample"):
        hc.diagnose(hc.from_arrays(steps, 0.1 * steps, 1000.0), amiss, parameters={"gain": (0.1, 0.01)}, verbose=False)
