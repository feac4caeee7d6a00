# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records of truth plants, which share no code with the models, and their diagnoses: each made once for all tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation.blind_test.plant_setups import scatter
from hyst_control.base.config_files import config_path
from hyst_control.diagnose.run.diagnosis import Diagnosis
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.effects import EFFECTS
from hyst_control.model_file import Model, load_model
from hyst_control.records.excitation.excitation import build
from hyst_control.records.record import Record, Signal
from hyst_plant_sim.physics import load_plant

MODELS = {"pea_published": "models/pea_hampi.yaml", "fsm_published": "models/fsm_mhl.yaml"}
Answer = tuple[dict[str, Any], Diagnosis, Model | None]


@pytest.fixture(scope="session", autouse=True)
def own_cache(run_folder: Path) -> Iterator[Path]:
    """The null's thresholds of these tests, away from the user's."""
    folder = run_folder / "null_cache"
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield folder


def record_of(
    plant: str, effects: Sequence[Mapping[str, Any]], seed: int = 3, duration: float | None = None, **changes: Any
) -> Record:
    """A diagnostic record of `duration` in s (0.3), and rests.

    changes: parameters of the plant that differ from the shipped ones.
    """
    mirror = plant.startswith("fsm")
    step, top, axes = (1e-4, 100.0, ("x", "y")) if mirror else (5e-5, 50.0, ("x",))
    duration = duration or 0.3
    command = build({"signal": "diagnostic", "lowest": 0.0, "highest": top, "duration": duration}, step, len(axes))
    changes = {**(scatter(plant, seed, 0.0) if mirror else {}), **changes}  # the shipped mirror's axes differ, its model's do not
    truth = load_plant(
        {"plant": plant, "rating": [0.0, top], "effects": [dict(effect) for effect in effects]},
        seed=seed,
        sample_time=step,
        **changes,
    )
    measured = np.concatenate([truth.reset(command[0])[None], truth.step(command)[:-1]])
    time = np.arange(len(command)) * step
    return Record(
        {"command": Signal(time, command, axes, "V"), "measurement": Signal(time, measured, axes, "mrad" if mirror else "um")},
        "record",
    )


def all_but(*names: str) -> tuple[str, ...]:
    """All effects but these, for `without`: a diagnosis of a few is faster, and other tests name an effect among all of them."""
    assert set(names) <= set(EFFECTS)
    return tuple(name for name in EFFECTS if name not in names)


def nominal(plant: str) -> Model:
    """The shipped model of a plant."""
    return load_model(config_path(MODELS[plant]))


@pytest.fixture(scope="session")
def answer() -> Callable[..., Answer]:
    """Report, diagnosis and augmented model of a plant with effects: name, tuple of (parameter, value), …"""

    @cache
    def found(plant: str, *effects: tuple[tuple[str, Any], ...], without: tuple[str, ...] = ()) -> Answer:
        return diagnosed([record_of(plant, [dict(effect) for effect in effects])], nominal(plant), without=without)

    return found
