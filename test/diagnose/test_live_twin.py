"""The live twin and its alarm: thresholds against exact and simulated quantiles, the rate of false alarms against its promise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from hyst_control.base.config_files import config_path
from hyst_control.diagnose.live.live_twin import GapAlarm, LiveTwin, energy_quantile
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.model_file import load_model, simulate

STEP = 5e-5


def test_quantile_without_uncertain_coefficients_is_chi_squares():
    assert energy_quantile(np.zeros(0), 500, 1e-6) == pytest.approx(chi2.isf(1e-6, 500), rel=1e-12)
    assert energy_quantile(np.zeros(7), 500, 1e-6) == pytest.approx(chi2.isf(1e-6, 500), rel=1e-12)


@pytest.mark.parametrize("weights", [[300.0], [40.0, 20.0, 10.0], np.full(20, 5.0)])
def test_quantile_is_that_of_simulated_energies(weights):
    weights, count, share = np.asarray(weights), 100, 1e-3
    random = np.random.default_rng(1)
    energies = random.chisquare(1, (200_000, len(weights))) @ (1 + weights) + random.chisquare(count - len(weights), 200_000)
    assert np.mean(energies > energy_quantile(weights, count, share)) == pytest.approx(share, rel=0.5)


def command(count, size=1.0):
    time = np.arange(count) * STEP
    return (size * (20 - 20 * np.exp(-20 * time) + 10 * np.sin(2 * np.pi * 20 * time) + 6 * np.sin(2 * np.pi * 137 * time)))[
        :, None
    ]


def judged(model, commands, measured, rate, window=400, block=1000):
    """The windows of a record, streamed in blocks."""
    twin = LiveTwin(model, STEP)
    alarm = GapAlarm(STEP, window, 2000, np.array([model.noise["sigma"]]), rate, 1)
    twin.settle(commands[0])
    found = []
    for begin in range(0, len(commands), block):
        predicted, slopes = twin.follow(commands[begin : begin + block])
        rows = measured[begin : begin + block]
        found += alarm.add(rows, rows - predicted, slopes)
    return alarm, found


def test_no_more_windows_exceed_than_promised_and_the_threshold_is_not_far_above():
    """30 plants scattered within tolerance, 15 windows each, of which 2 % may exceed."""
    model, share = load_model(config_path("models/pea_hampi.yaml")), 0.02
    scatter, commands = scatter_of(model), command(8000)
    random = np.random.default_rng(7)
    excess = []
    for _ in range(30):
        plant = model.with_stages(scatter.at(random.standard_normal(len(scatter.coefficients))))
        measured = simulate(plant, commands, STEP) + model.noise["sigma"] * random.standard_normal((len(commands), 1))
        alarm, windows = judged(model, commands, measured, share * 3600 / (400 * STEP))
        assert alarm.share == pytest.approx(share)
        excess += [window.excess for window in windows if not np.isnan(window.excess)]
    excess = np.array(excess)
    assert len(excess) == 30 * 15
    assert np.mean(excess > 1.0) <= share + 3 * np.sqrt(share / len(excess))
    assert np.quantile(excess, 0.95) > 0.7


def test_a_larger_command_than_the_one_learned_from_alarms_nobody_but_a_delay_does():
    model = load_model(config_path("models/pea_hampi.yaml"))
    scatter, random = scatter_of(model), np.random.default_rng(11)
    commands = np.concatenate([command(4000, 0.2), command(4000, 0.2)[-1] + command(6000)])
    plant = model.with_stages(scatter.at(random.standard_normal(len(scatter.coefficients))))
    clean = simulate(plant, commands, STEP)
    noise = model.noise["sigma"] * random.standard_normal(clean.shape)
    assert not judged(model, commands, clean + noise, 0.1)[0].alarm
    late = clean.copy()
    late[10000:] = clean[9999:-1]  # one sample late
    windows = judged(model, commands, late + noise, 0.1)[1]
    assert not any(window.alarm for window in windows[:25]) and all(window.alarm for window in windows[26:])


@pytest.mark.parametrize("block", [1, 7, 3000])
def test_prediction_is_the_simulation_in_blocks_of_any_length(block):
    model, commands = load_model(config_path("models/pea_hampi.yaml")), command(300)
    twin = LiveTwin(model, STEP)
    twin.settle(commands[0])
    predicted = np.concatenate([twin.follow(commands[begin : begin + block])[0] for begin in range(0, 300, block)])
    np.testing.assert_allclose(predicted, simulate(model, commands, STEP), atol=1e-12)
