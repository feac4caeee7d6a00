# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated fleets: units drawn from a population, recorded in several runs; on some of them an effect begins in one of the runs.

Coefficients scatter between units, a little between runs; the run's temperature changes every gain. On all units of one driver its
low-pass becomes slower in one run: a cause that they share. Nothing has begun in the first runs: they are the baseline records.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.blind_test.case_records import respond, truth
from evaluation.blind_test.effect_sizes import SEVERITIES, draw_effect
from evaluation.blind_test.nominal_models import nominal
from evaluation.blind_test.plant_setups import SCATTER, SETUPS, scatter
from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.files import write_json, write_text
from hyst_control.base.parallel import map_spawned
from hyst_control.model_file import save_model
from hyst_control.records.excitation.excitation import build
from hyst_control.records.record import sampled_record
from hyst_control.records.tables.importing import write_bag

PLANT = "pea_published"
NOISE = 5e-4
"""Noise of the sensor, rms / stroke."""
RUN_SCATTER = 5e-4
"""Relative standard deviation of a coefficient of a run about the unit's."""
EXPANSION = 1e-3
"""Change of every gain, 1/K."""
CLEAN_RUNS = 2
UNITS_PER_DRIVER = 16
EFFECTS = (
    "gain", "delay", "amplifier_lowpass", "sensor_lowpass", "hysteresis_width", "creep", "backlash", "sensor_nonlinearity",
    "added_mass", "resonance",
)  # fmt: skip
"""Effects that begin on single units."""
SHARED = "amplifier_lowpass"
"""Effect that begins on all units of a driver."""
TIMES_SCATTER = (3.0, 10.0)
"""Range of an effect's gap, in unit-to-unit scatters of the measurement."""
SIZED_BY = {"resonance": "gain"}
"""Parameter that sizes an effect, where it is not the first of its severities."""
EXCITATION = {"signal": "multisine", "period": 0.1, "lower_frequency": 10.0, "upper_frequency": 600.0, "periods": 3}


@dataclass(frozen=True)
class Unit:
    """One unit of a simulated fleet."""

    name: str  # Its name
    driver: str  # Driver that it hangs on
    seed: int  # Seed of its coefficients and noise
    effect: Mapping[str, Any]  # Effect that begins on it; empty for none
    begins: int  # First run of the effect
    gap_rms: float = 0.0  # Rms of what the effect changes, in the measurement unit


def make_fleet(
    folder: Path, seed: int, units: int, runs: int, changed: float = 0.1, note: Callable[[str], None] = lambda line: None
) -> Path:
    """Draw a fleet, record its runs, and write manifest and labels."""
    if units < 1 or runs < CLEAN_RUNS + 3:  # a run without effect follows the clean ones, and an effect lasts two runs at least
        raise InputError(f"--fleet: must be at least 1 unit and {CLEAN_RUNS + 3} runs, got {units} and {runs}")
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder}: holds files already: choose another folder")
    (folder / "bags").mkdir(parents=True, exist_ok=True)
    random = np.random.default_rng([seed, 7])
    temperatures = 20.0 + 3.0 * np.sin(2.0 * np.pi * np.arange(runs) / 30.0) + random.standard_normal(runs)
    save_model(nominal(PLANT, NOISE), folder / "model.yaml")
    drawn = _draw(random, seed, units, runs, changed)
    jobs = [(unit, temperatures, str(folder / "bags")) for unit in drawn]
    for done, _ in enumerate(map_spawned(_record_unit, jobs), 1):
        note(f"{done}/{units} units recorded")
    _write_manifest(folder, drawn, temperatures)
    labels, units_drawn = folder / "labels.json", [asdict(unit) for unit in drawn]
    shared = next((unit for unit in drawn if unit.effect.get("shared")), None)
    driver = None if shared is None else {"driver": shared.driver, "effect": SHARED, "begins": shared.begins}
    head = {"seed": seed, "runs": runs, "scatter_rms": unit_scatter()}
    write_json(labels, {**head, "units": units_drawn, "driver": driver})
    return labels


def command() -> Array:
    """Command (N, 1) of every run, V."""
    setup = SETUPS[PLANT]
    low, high = setup.command
    rows = build({**EXCITATION, "rms": 0.13 * (high - low), "offset": 0.5 * (high + low), "seed": 1}, setup.sample_time, 1)
    return np.clip(rows, low, high)


def unit_scatter(draws: int = 8) -> float:
    """Unit-to-unit scatter of the measurement under the command of a run, rms."""
    measured = np.array([_measured({}, scatter(PLANT, index, SCATTER), index, 0.0) for index in range(draws)])
    return float(np.sqrt(np.mean(measured.var(axis=0, ddof=1))))


def _draw(random: np.random.Generator, seed: int, units: int, runs: int, changed: float) -> list[Unit]:
    """Draw the units with their effects, sized in unit-to-unit scatters."""
    drivers = max(1, -(-units // UNITS_PER_DRIVER))
    weak = int(random.integers(drivers)) if drivers > 1 else -1
    shared_run = _first_run(random, runs)
    least = unit_scatter()
    shared = _sized({**draw_effect(SHARED, PLANT, NOISE, random), "shared": True}, least, random)
    own = set(random.choice(units, int(round(changed * units)), replace=False).tolist())
    found: list[Unit] = []
    for index in range(units):
        driver = index % drivers
        effect: dict[str, Any] = {}
        begins = runs
        if driver == weak:
            effect, begins = shared, shared_run
        elif index in own:
            effect = _sized(draw_effect(EFFECTS[len(found) % len(EFFECTS)], PLANT, NOISE, random), least, random)
            begins = _first_run(random, runs)
        gap = _gap(effect) if effect else 0.0
        found.append(Unit(f"u{index:04d}", f"d{driver:02d}", int(random.integers(1 << 31)), effect, begins, gap))
    return found


def _first_run(random: np.random.Generator, runs: int) -> int:
    return int(random.integers(CLEAN_RUNS + 1, runs - 1))


def _sized(effect: dict[str, Any], scatter_rms: float, random: np.random.Generator) -> dict[str, Any]:
    """Effect whose gap is so many scatters as drawn: the parameter that sizes it is changed until it is."""
    wanted = scatter_rms * float(np.exp(random.uniform(*np.log(TIMES_SCATTER))))
    name = SIZED_BY.get(effect["name"]) or next(iter(SEVERITIES[effect["name"]])).partition(" ")[0]
    power = -1.0 if name == "cutoff" else 1.0
    for _ in range(4):
        ratio = wanted / max(_gap(effect), 1e-3 * wanted)
        effect = {**effect, name: effect[name] * min(max(ratio, 0.2), 5.0) ** power}
    return effect


def _gap(effect: Mapping[str, Any]) -> float:
    """Rms of what an effect changes in the nominal plant's measurement."""
    changed, whole = (_measured(each, {}, 0, 0.0) for each in (effect, {}))
    return float(np.sqrt(np.mean((changed - whole) ** 2)))


def _measured(effect: Mapping[str, Any], coefficients: Mapping[str, Any], seed: int, noise: float) -> Array:
    """Measurement (N,) of a run."""
    own = {name: value for name, value in effect.items() if name != "shared"}
    return respond(truth(PLANT, [own] if own else [], coefficients, seed, noise), command())[:, 0]


def _moved(value: Any, random: np.random.Generator) -> Any:
    if isinstance(value, list):
        return [_moved(each, random) for each in value]
    return value * (1.0 + RUN_SCATTER * random.standard_normal())


def _record_unit(job: tuple[Unit, Array, str]) -> str:
    """Record all runs of a unit."""
    unit, temperatures, folder = job
    coefficients = scatter(PLANT, unit.seed, SCATTER)
    for run, temperature in enumerate(temperatures):
        random = np.random.default_rng([unit.seed, run])
        of_run = {name: _moved(value, random) for name, value in coefficients.items()}
        effect = unit.effect if run >= unit.begins else {}
        measured = _measured(effect, of_run, int(random.integers(1 << 31)), NOISE)
        measured = measured * (1.0 + EXPANSION * (temperature - 20.0))
        record = sampled_record(unit.name, command(), measured[:, None], SETUPS[PLANT].sample_time, ("x",), "um")
        write_bag(Path(folder) / f"{unit.name}_{run:03d}", record)
    return unit.name


def _write_manifest(folder: Path, units: list[Unit], temperatures: Array) -> None:
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("bag", "unit", "time", "model", "baseline", "driver", "temperature"))
    for unit in units:
        clean = ";".join(f"bags/{unit.name}_{run:03d}" for run in range(CLEAN_RUNS))
        for run, temperature in enumerate(temperatures):
            own = "" if run < CLEAN_RUNS else clean
            bag = f"bags/{unit.name}_{run:03d}"
            table.writerow((bag, unit.name, run, "model.yaml", own, unit.driver, f"{temperature:.2f}"))
    write_text(folder / "manifest.csv", text.getvalue())
