"""What holds for every truth plant: cutting, seeds, dissipation, memory; and the published ones against records and the chain."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.base.config_files import config_path
from hyst_control.model_file import load_model, simulate
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.excitation.excitation import build
from hyst_plant_sim.physics import PLANTS, Plant, PlantError, load_plant
from hyst_plant_sim.physics.signal_path import PLACES, _through

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


RECORDS = {"pea": 140.0, "pea_published": 50.0, "fsm": 100.0, "fsm_published": 100.0, "third": 140.0}
"""Every plant, and the highest voltage (V) of its records; HAMPI's coefficients hold up to 50 V only."""

EXCITATIONS = {
    "jumps": {"signal": "staircase", "levels": [0.0, 1.0, 0.0, 0.54, 0.1, 1.0, 0.3, 0.0], "hold": 0.003},
    "steps": {"signal": "steps", "lowest": 0.0, "highest": 1.0, "hold": 0.002, "count": 30, "seed": 3},
    "multisine": {
        "signal": "multisine",
        "period": 0.05,
        "lower_frequency": 20.0,
        "upper_frequency": 1000.0,
        "rms": 0.13,
        "offset": 0.5,
        "periods": 2,
    },
    "triangle": {"signal": "triangle", "frequency": 50.0, "amplitude": 0.5, "offset": 0.5, "duration": 0.06},
    "sine": {"signal": "sine", "frequency": 200.0, "amplitude": 0.5, "offset": 0.5, "duration": 0.03},
    "diagnostic": {"signal": "diagnostic", "lowest": 0.0, "highest": 1.0, "duration": 0.4},
}
"""Over a range of 1."""


def record(name: str, excitation: str) -> np.ndarray:
    """Commands (N, A) in V over the whole range of a plant's records."""
    rows = build(EXCITATIONS[excitation], described(name)["sample_time"], 2 if name.startswith("fsm") else 1)
    return RECORDS[name] * np.clip(rows, 0.0, 1.0)


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
    one, again, other, clean = (
        run(plant(name, seed=seed, noise=noise), command) for seed, noise in ((3, 0.01), (3, 0.01), (4, 0.01), (3, 0.0))
    )
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
        return run(truth, np.repeat(full * np.array(levels), settle))[settle - 1 :: settle]

    direct = staircase([0, 0.55, 0.15, 0.4, 0.6])
    detour = staircase([0, 0.55, 0.15, 0.4, 0.25, 0.4, 0.6])
    np.testing.assert_allclose(detour[5:], direct[3:], rtol=0, atol=1e-6 * np.ptp(direct))


def at_hysteresis(truth: Plant, command: np.ndarray) -> np.ndarray:
    """What the hysteresis of every axis gets (A, M), internal step by internal step, for a command (N,) held over each sample."""
    first = next(index for index, place in enumerate(PLACES) if place == "hysteresis")
    entries = [entry for place in PLACES[:first] for entry in truth._line.get(place, [])]
    block = np.repeat(np.repeat(command[None], len(truth.axes), axis=0), truth.frame.substeps, axis=1)
    return _through(entries, block)


@pytest.mark.parametrize("frequency", [20.0, 100.0])
@pytest.mark.parametrize("name", ["fsm", "pea"])
def test_a_held_sine_turns_the_hysteresis_twice_a_cycle_and_stays_within_the_rating(name, frequency):
    """A driver of first order makes a staircase of 5 kHz into no more than it is: no overshoot, and nothing beyond the rating."""
    top, cycles, sample_time = described(name)["rating"][1], 4, 2e-4
    count = int(round(1.0 / frequency / sample_time))
    command = 0.5 * top * (1.0 - np.cos(2 * np.pi * np.arange(cycles * count) / count))
    truth = plant(name, sample_time=sample_time)
    truth.reset(command[:1])
    for drive in at_hysteresis(truth, command):
        moving = np.diff(drive)
        moving = moving[np.abs(moving) > 1e-9 * top]
        assert np.count_nonzero(np.diff(np.sign(moving))) == 2 * cycles - 1
        assert drive.min() >= -1e-3 * top and drive.max() <= (1 + 1e-3) * top


@pytest.mark.parametrize("name", RECORDS)
@pytest.mark.parametrize("excitation", EXCITATIONS)
def test_halving_the_internal_step_changes_little(name, excitation):
    """By less than 0.05 % of range, every sample, right after jumps of the whole rating as well."""
    command = record(name, excitation)
    coarse, finer = (run(plant(name, refinement=refinement), command) for refinement in (1, 2))
    assert np.all(np.max(np.abs(finer - coarse), axis=0) < 5e-4 * np.ptp(coarse, axis=0))


@pytest.mark.parametrize(
    "name, most", [("pea_multisine", 1e-4), ("pea_staircase", 1e-4), ("fsm_multisine", 2e-4), ("fsm_staircase", 1e-4)]
)
def test_the_published_plants_reproduce_the_conformance_records(conformance, name, most):
    """The mirror's multisine record shares its delay's fraction of an internal step between two commands.

    The chain, which takes it exactly, is off that record by 0.0143 % of range in a sample, and so is the plant however finely stepped.
    """
    real = read_bag(conformance / name / "real")
    measured = real.signals["measurement"].values
    found = run(plant(f"{name[:3]}_published"), real.signals["command"].values)
    assert np.all(np.max(np.abs(found - measured), axis=0) < most * np.ptp(measured, axis=0))
    assert np.all(np.std(found - measured, axis=0) < 2e-5 * np.ptp(measured, axis=0))


@pytest.mark.parametrize("name, model", [("pea_published", "pea_hampi"), ("fsm_published", "fsm_mhl")])
@pytest.mark.parametrize("excitation", EXCITATIONS)
def test_the_published_plants_and_the_chain_agree(name, model, excitation):
    """Two codes of one published model at their own internal steps: within 0.02 % of range, every sample."""
    file = described(name)
    # The model has one set of numbers for both axes.
    first = {key: [value[0]] * 2 for key, value in file["parameters"].items() if isinstance(value, list)} if name[0] == "f" else {}
    truth, command = plant(name, **first), record(name, excitation)
    found, simulated = (
        run(truth, command),
        simulate(load_model(config_path(f"models/{model}.yaml")), command, file["sample_time"], "zoh"),
    )
    assert np.all(np.max(np.abs(found - simulated), axis=0) < 2e-4 * np.ptp(found, axis=0))


@pytest.mark.parametrize(
    "name, change, words",
    [
        ("fsm", {"mode_frequency": [1930.0]}, "mode_frequency"),
        ("fsm_published", {"k1": -7.9e-6}, "k1: .* a list of 2 entries"),
        ("fsm_published", {"descending": [[1.0], [1.0]]}, "descending: axis x ends at"),
        ("pea_published", {"weights": [1.0]}, "weights: 1 for"),
        ("third", {"ladder_times": [1.0]}, "ladder_times: 1 for 4"),
        ("third", {"elastic": 1.0}, "parameters.elastic: unknown parameter"),
    ],
)
def test_unusable_plants_are_named(name, change, words):
    with pytest.raises(PlantError, match=words):
        plant(name, **change)
