"""What holds for every truth plant: cutting, seeds, dissipation, memory; and the published ones against records and the chain."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.bag_reader import read_bag
from hyst_control.model_file import load_model, simulate
from hyst_control.share import config_path
from hyst_plant_sim.physics import PLANTS, Plant, PlantError, load_plant

MEMORY_OF_TURNS = {
    "pea": {"slow_share": 0.0},
    "fsm": {"relaxation_share": 0.0, "notch_frequency": 4150.0, "notch_damping": 0.6},  # no notch: it overshoots
    "pea_published": {"num": [5.982e7], "den": [1.0, 8602.0, 5.982e7]},
    "fsm_published": {},
}
"""Plants whose memory is that of turning points alone, and what to change so that nothing comes late or overshoots."""


@cache
def described(name: str) -> dict:
    return yaml.safe_load(config_path(f"plants/{name}.yaml").read_text(encoding="utf-8"))


def plant(name: str, **changes) -> Plant:
    return load_plant(config_path(f"plants/{name}.yaml"), **{"seed": 3, "noise": 0.0, **changes})


def run(truth: Plant, command: np.ndarray) -> np.ndarray:
    """measurement (N, A) for a command (N,) on every axis, or (N, A)."""
    rows = np.broadcast_to(command.reshape(len(command), -1), (len(command), len(truth.axes)))
    return np.concatenate([truth.reset(rows[0])[None], truth.step(rows)[:-1]])


def loop(name: str, frequency: float, share: float, cycles: int) -> np.ndarray:
    """Whole cycles from 0 V up to a share of the rating and back."""
    file = described(name)
    count = int(round(1.0 / frequency / file["sample_time"]))
    return 0.5 * share * file["rating"][1] * (1.0 - np.cos(2 * np.pi * np.arange(cycles * count) / count))


@pytest.mark.parametrize("name", PLANTS)
@settings(max_examples=10, deadline=None)
@given(cuts=st.lists(st.integers(1, 399), max_size=6))
def test_cutting_the_command_changes_no_bit(name, cuts):
    command = np.concatenate([loop(name, 100.0, 0.6, 2), loop(name, 250.0, 0.3, 8)])[:400, None]
    whole, pieces = plant(name, noise=0.01), plant(name, noise=0.01)
    command = command * np.linspace(1.0, 0.8, len(whole.axes))
    np.testing.assert_array_equal(whole.reset(command[0]), pieces.reset(command[0]))
    edges = np.unique([0, *cuts, len(command)])
    found = np.concatenate([pieces.step(command[a:b]) for a, b in zip(edges[:-1], edges[1:], strict=True)])
    np.testing.assert_array_equal(found, whole.step(command))


@pytest.mark.parametrize("name", PLANTS)
def test_the_seed_decides_the_noise_and_nothing_else(name):
    command = loop(name, 50.0, 0.5, 5)
    one, again, other, clean = (run(plant(name, seed=seed, noise=noise), command) for seed, noise in
                                ((3, 0.01), (3, 0.01), (4, 0.01), (3, 0.0)))
    np.testing.assert_array_equal(one, again)
    assert np.std(one - clean) == pytest.approx(0.01, rel=0.1)
    assert np.std(other - one) == pytest.approx(0.01 * np.sqrt(2), rel=0.1)


@pytest.mark.parametrize("name", PLANTS)
def test_a_reset_plant_is_a_new_one(name):
    command, used = loop(name, 70.0, 0.7, 2), plant(name, noise=0.01)
    first = run(used, command)
    np.testing.assert_array_equal(run(used, command), first)


@pytest.mark.parametrize("frequency", [2.0, 100.0, 500.0])
@pytest.mark.parametrize("name", PLANTS)
def test_loops_dissipate(name, frequency):
    """The motion lags the drive: counted along the drive's way up and back the loop encloses a positive area."""
    command = loop(name, frequency, 0.6, 3)
    count = len(command) // 3
    u = command[-count:, None]
    y = run(plant(name), command)[-count:]
    area = 0.5 * np.sum(u * np.roll(y, -1, axis=0) - y * np.roll(u, -1, axis=0), axis=0)
    assert np.all(area > 0.03 * np.ptp(u) * np.ptp(y, axis=0))


@pytest.mark.parametrize("name", MEMORY_OF_TURNS)
def test_loops_within_loops_are_forgotten(name):
    """Return-point memory: once an inner loop is closed the outer curve goes on as if it had not been."""
    truth, settle, full = plant(name, **MEMORY_OF_TURNS[name]), 400, described(name)["rating"][1]

    def staircase(levels):
        return run(truth, np.repeat(full * np.array(levels), settle))[settle - 1::settle]

    direct = staircase([0, 0.55, 0.15, 0.4, 0.6])
    detour = staircase([0, 0.55, 0.15, 0.4, 0.25, 0.4, 0.6])
    np.testing.assert_allclose(detour[5:], direct[3:], rtol=0, atol=1e-6 * np.ptp(direct))


@pytest.mark.parametrize("name", ["pea_multisine", "pea_staircase", "fsm_multisine", "fsm_staircase"])
def test_the_published_plants_reproduce_the_conformance_records(conformance, name):
    record = read_bag(conformance / name / "real")
    measured = record.signals["measurement"].values
    found = run(plant(f"{name[:3]}_published"), record.signals["command"].values)
    assert np.all(np.max(np.abs(found - measured), axis=0) < 1e-4 * np.ptp(measured, axis=0))


@pytest.mark.parametrize("name, model, share, refinement", [("pea_published", "pea_hampi", 0.33, 1), ("fsm_published", "fsm_mhl", 0.9, 5)])
def test_the_published_plants_and_the_chain_agree(name, model, share, refinement):
    """Two codes of one published model: within 0.1 % of range, every sample, on a record of steps, slow and fast loops.

    HAMPI's coefficients hold up to 50 V only. The mirror's delay is a whole number of the finer steps: otherwise the plant shares
    a jump of half the rating between two steps, which shows in one sample after it.
    """
    file = described(name)
    # The model has one set of numbers for both axes.
    first = {key: [value[0]] * 2 for key, value in file["parameters"].items() if isinstance(value, list)} if name[0] == "f" else {}
    truth = plant(name, refinement=refinement, **first)
    command = np.concatenate([np.zeros(50), np.full(500, 0.6 * share * file["rating"][1]), loop(name, 20.0, share, 1),
                              loop(name, 300.0, 0.8 * share, 6)])
    found = run(truth, command)
    simulated = simulate(load_model(config_path(f"models/{model}.yaml")), np.tile(command[:, None], len(truth.axes)),
                         file["sample_time"], "zoh")
    assert np.all(np.max(np.abs(found - simulated), axis=0) < 1e-3 * np.ptp(found, axis=0))


@pytest.mark.parametrize("name, change, words", [
    ("fsm", {"mode_frequency": [1930.0]}, "mode_frequency"),
    ("fsm_published", {"k1": -7.9e-6}, "k1: .* a list of 2 entries"),
    ("fsm_published", {"descending": [[1.0], [1.0]]}, "descending: axis x ends at"),
    ("pea_published", {"weights": [1.0]}, "weights: 1 for"),
    ("third", {"ladder_times": [1.0]}, "ladder_times: 1 for 4"),
    ("third", {"elastic": 1.0}, "parameters.elastic: no such parameter"),
])
def test_unusable_plants_are_named(name, change, words):
    with pytest.raises(PlantError, match=words):
        plant(name, **change)
