# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Center and scatter of a fleet: recovered from drawn fleets whose scatter is known, and used by a diagnosis."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

pytest.importorskip("pyarrow")

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain
from hyst_control.chain.coordinates import chain_coordinates, with_coordinates
from hyst_control.cli import main
from hyst_control.effects import EFFECTS
from hyst_control.fleet.population import find_population
from hyst_control.fleet.population_model import population_model
from hyst_control.model_file import load_model, save_model, simulate
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag

MODEL = Path(__file__).resolve().parents[2] / "config" / "models" / "pea_hampi.yaml"
CENTER = np.array([1.0, 1000.0, 0.02, 3e-4])
SIZE = 0.03 * CENTER
CORRELATION = np.array([[1.0, 0.8, 0.0, 0.0], [0.8, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -0.6], [0.0, 0.0, -0.6, 1.0]])
RUN = 0.5
"""Standard deviation of the difference of successive runs, in that of the units."""


def drawn(units=150, runs=6, walk=0.0, seed=1):
    """Units, moments and coefficients of a fleet, and the units' levels in the last run."""
    rng = np.random.default_rng(seed)
    level = CENTER + rng.multivariate_normal(np.zeros(4), CORRELATION * np.outer(SIZE, SIZE), units)
    found = []
    for run in range(runs):
        if run:
            level = level + np.sqrt(walk) * RUN * SIZE * rng.standard_normal(level.shape)
        found.append(level + np.sqrt(0.5 * (1.0 - walk)) * RUN * SIZE * rng.standard_normal(level.shape))
    names = [f"u{unit:03d}" for unit in range(units)]
    return names * runs, np.repeat(np.arange(float(runs)), units), np.concatenate(found), level


def without_errors(values):
    return np.zeros((len(values), 4, 4))


@pytest.mark.parametrize("faulty", [0, 7])
def test_center_and_scatter_are_those_that_were_drawn(faulty):
    """Also where one unit of twenty is ten standard deviations off."""
    units, moments, values, _ = drawn()
    values[np.isin(units, [f"u{unit:03d}" for unit in range(faulty)])] += 10.0 * SIZE
    found = find_population(units, moments, values, without_errors(values))
    scaled = found.between / np.outer(SIZE, SIZE)
    np.testing.assert_allclose((found.center - CENTER) / SIZE, 0.0, atol=0.35)
    np.testing.assert_allclose(np.diag(scaled), 1.0, atol=0.4 if faulty else 0.3)
    np.testing.assert_allclose(scaled, CORRELATION, atol=0.5 if faulty else 0.3)
    np.testing.assert_allclose(np.sqrt(np.diag(found.between_runs)), RUN * SIZE, rtol=0.1)


@pytest.mark.parametrize("walk", [0.0, 0.3, 0.8])
def test_walks_are_told_from_the_scatter_of_runs(walk):
    units, moments, values, _ = drawn(walk=walk, runs=10)
    assert find_population(units, moments, values, without_errors(values)).walk == pytest.approx(walk, abs=0.12)


def test_a_unit_is_known_better_by_all_of_them():
    """The level is nearer than the mean of its own two runs (Stein), and the stated covariance is that of the coming run."""
    units, moments, values, level = drawn(runs=2)
    found = find_population(units, moments, values, without_errors(values))
    rng = np.random.default_rng(2)
    coming = level + np.sqrt(0.5) * RUN * SIZE * rng.standard_normal(level.shape)
    pooled, within = [], 0
    for index, unit in enumerate(found.units):
        mean, covariance = found.of_unit(unit)
        pooled.append(mean)
        within += int(np.sum(np.abs(coming[index] - mean) < 1.645 * np.sqrt(np.diag(covariance))))
    own = values.reshape(2, -1, 4).mean(axis=0)
    assert np.mean(((pooled - level) / SIZE) ** 2) < 0.95 * np.mean(((own - level) / SIZE) ** 2)
    low, high = binom.interval(0.999, level.size, 0.9)
    assert low <= within <= high


def test_errors_of_the_identification_are_not_taken_for_the_units():
    units, moments, values, _ = drawn(units=300, runs=1)
    rng = np.random.default_rng(3)
    noisy = values + SIZE * rng.standard_normal(values.shape)
    errors = np.broadcast_to(np.diag(SIZE**2), (len(values), 4, 4))
    found = find_population(units, moments, noisy, np.asarray(errors))
    spread = np.sqrt(np.diag(found.usual()[1])) / SIZE
    np.testing.assert_allclose(spread, np.sqrt(1.0 + 0.5 * RUN**2), rtol=0.2)  # 1.5 with the errors


def test_with_one_run_a_unit_the_scatter_of_runs_is_not_known(tmp_path):
    """Stated errors beyond the scatter of all models take nothing off it: no healthy unit may be a gap to the fleet's model."""
    gains = 1.0 + 0.03 * np.random.default_rng(4).standard_normal(12)
    models = [unit_model(gain, error=0.2) for gain in gains]
    found = population_model(models, [f"u{index}" for index in range(12)], np.zeros(12), tmp_path / "fleet.yaml")
    [row] = found.document()["parameters"]
    assert row["deviation"] == row["between_units"] == pytest.approx(abs(row["value"]) * gains.std() / gains.mean(), rel=0.15)
    assert row["between_runs"] is None and "runs not known" in found.text() and "one run a unit" in found.text()
    with pytest.raises(InputError, match="has one run"):
        population_model(models, [f"u{index}" for index in range(12)], np.zeros(12), tmp_path / "fleet.yaml", "u3")


def unit_model(gain, error=0.002):
    """The published model with all weights and dynamics of another gain, as an identification would state it."""
    model = load_model(MODEL)
    known = {name: each.value for name, each in chain_coordinates(model.chain.stages, model.axes).items()}
    name = "transfer_function.gain"
    assert name in known
    stages = with_coordinates(model.chain.stages, {name: gain * known[name]}, model.axes)
    uncertainty = {"parameters": [name], "factor": [[abs(error * known[name])]]}
    return replace(model, chain=Chain(stages), tolerance={}, uncertainty=uncertainty)


def test_models_of_another_structure_are_left_out(tmp_path):
    models = [unit_model(gain) for gain in (0.98, 1.0, 1.01, 1.03)]
    other = replace(models[0], chain=Chain(models[0].chain.stages[1:]), uncertainty={})
    found = population_model([*models, other], list("abcde"), np.zeros(5), tmp_path / "fleet.yaml")
    assert found.left_out == 1 and found.names == ("transfer_function.gain",) and found.model.name == "fleet"
    with pytest.raises(InputError, match="3 at least"):
        population_model(models[:2], list("ab"), np.zeros(2), tmp_path / "fleet.yaml")
    with pytest.raises(InputError, match="no such unit"):
        population_model(models, list("abcd"), np.zeros(4), tmp_path / "fleet.yaml", "z")


RIVALS = {"gain", "delay", "hysteresis_width", "creep", "amplifier_lowpass", "sensor_lowpass", "backlash", "offset"}
"""Effects that are looked for where a gain is off: every other only costs time."""


def test_a_diagnosis_knows_what_is_usual(tmp_path):
    """A new unit 4 % off is a gap to one unit's model and none to the fleet's, to which only one far out is."""
    rng = np.random.default_rng(4)
    gains = 1.0 + 0.03 * rng.standard_normal(12)
    fleet = population_model(
        [unit_model(gain) for gain in gains], [f"u{index}" for index in range(12)], np.zeros(12), tmp_path / "fleet.yaml"
    )
    save_model(fleet.model, tmp_path / "fleet.yaml")
    save_model(unit_model(1.0), tmp_path / "unit.yaml")
    time = 1e-4 * np.arange(1000)
    command = 25.0 - 25.0 * np.cos(2 * np.pi * 40.0 * time)[:, None]

    without = [word for name in EFFECTS if name not in RIVALS for word in ("--without", name)]

    def verdict(gain, model):
        measured = simulate(unit_model(gain), command, 1e-4) + 3e-3 * rng.standard_normal(command.shape)
        signals = {"command": Signal(time, command, ("x",), "V"), "measurement": Signal(time, measured, ("x",), "um")}
        bag = tmp_path / f"{gain}_{model}"
        write_bag(bag, Record(signals, "made"))
        report = tmp_path / "gap.json"
        assert (
            main(["diagnose", str(bag), "--model", str(tmp_path / f"{model}.yaml"), "--json", str(report), "--quiet", *without])
            == 0
        )
        return json.loads(report.read_text())["verdict"]

    assert verdict(1.04, "unit") != "no_gap"
    assert verdict(1.04, "fleet") == "no_gap"
    assert verdict(1.2, "fleet") != "no_gap"
