# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A model file whose coefficients are a fleet's, from the models of its healthy units: `hyst diagnose` then knows what is usual."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain
from hyst_control.chain.coordinates import chain_coordinates, with_coordinates
from hyst_control.fleet.population import Population, find_population
from hyst_control.fleet.results import DONE, Results
from hyst_control.model_file import DISCREPANCY_VERSION, Model, load_model, save_model

USUAL_ZERO = 0.9  # Quantile over the records of the zero, drift and curvature up to which a session is usual
SMALLEST = 1e-6  # Share of the largest standard deviation below which a direction of the scatter is left out


@dataclass(frozen=True)
class PopulationModel:
    """Result of `hyst fleet population`."""

    model: Model  # The model; its `uncertainty` is the fleet's scatter
    path: Path  # File that it was written to
    names: tuple[str, ...]  # Names of the coefficients (K,), as in `chain.coordinates`
    population: Population  # The fleet's
    records: int  # Number of models that it was made from
    left_out: int  # Number of models of another structure
    unit: str | None  # Unit whose coefficients are the model's; None: the fleet's center

    def document(self) -> dict[str, Any]:
        """Convert to JSON types."""
        center, covariance = _chosen(self.population, self.unit)
        deviations = [_deviations(each) for each in (covariance, self.population.between, 0.5 * self.population.between_runs)]
        keys = ("value", "deviation", "between_units", "between_runs")
        rows = zip(self.names, np.transpose([center, *deviations]).tolist())
        unknown = {} if self.population.repeated else {"between_runs": None}
        return {
            "schema": "hyst_control/population",
            "version": 1,
            "model": str(self.path),
            "of": self.unit,
            "units": len(self.population.units),
            "records": self.records,
            "left_out": self.left_out,
            "walk": self.population.walk,
            "parameters": [{"name": name, **dict(zip(keys, numbers)), **unknown} for name, numbers in rows],
        }

    def text(self) -> str:
        """Summary in lines."""
        document = self.document()
        of = f"unit {self.unit}" if self.unit else "any unit"
        lines = [f"{document['units']} units, {self.records} models: what is usual of {of}"]
        if self.left_out:
            lines.append(f"{self.left_out} models of another structure were left out: identify with --family")
        if not self.population.repeated:
            lines.append("one run a unit: how runs differ is not known, and is a part of what units differ by")
        width = max(map(len, self.names))
        for row in document["parameters"]:
            runs = f"{row['between_runs']:.2g}" if self.population.repeated else "not known"
            lines.append(
                f"  {row['name']:{width}s}  {row['value']:.5g} ± {row['deviation']:.2g}"
                f"  (units {row['between_units']:.2g}, runs {runs})"
            )
        return "\n".join([*lines, f"written: {self.path}"])


def population_of_study(folder: str | Path, output: str | Path, unit: str | None = None) -> PopulationModel:
    """Make a model of a fleet from a study of identifications, and write it."""
    folder = Path(folder)
    if not (folder / "records.parquet").exists():
        raise InputError(f"{folder}: holds no finished study: run hyst fleet identify first")
    rows = [row for row in Results(folder, "identify", ()).rows() if row["status"] == DONE]
    if not rows or not all(isinstance(row.get("model_file"), str) for row in rows):
        raise InputError(f"{folder}: holds no study of identifications: give the folder that hyst fleet identify wrote")
    models = [load_model(row["model_file"]) for row in rows]
    found = population_model(models, [row["unit"] for row in rows], np.array([row["moment"] for row in rows]), Path(output), unit)
    save_model(found.model, output)
    return found


def population_model(
    models: Sequence[Model], units: Sequence[str], moments: Array, path: Path, unit: str | None = None
) -> PopulationModel:
    """Make a model of a fleet from the models of its records."""
    forms = [(tuple(chain_coordinates(model.chain.stages, model.axes)), model.axes) for model in models]
    form = Counter(forms).most_common(1)[0][0]
    chosen = [index for index, each in enumerate(forms) if each == form]
    same = [models[index] for index in chosen]
    values = np.array([_values(model) for model in same])
    free = np.flatnonzero(np.ptp(values, axis=0) > 1e-9 * np.abs(values).max(axis=0))
    if not free.size:
        raise InputError("all models have the same coefficients: a population needs models that were identified one by one")
    names = tuple(form[0][index] for index in free)
    errors = np.array([_error(model, names) for model in same])
    population = find_population([units[index] for index in chosen], moments[chosen], values[:, free], errors)
    center, covariance = _chosen(population, unit)
    nearest = same[int(np.argmin(np.sum(((values[:, free] - center) / _deviations(covariance)) ** 2, axis=1)))]
    all_values = dict(zip(form[0], np.median(values, axis=0).tolist())) | dict(zip(names, center.tolist()))
    model = replace(
        nearest,
        name=path.stem,
        chain=Chain(with_coordinates(nearest.chain.stages, all_values, nearest.axes)),
        tolerance={},
        uncertainty={"parameters": list(names), "factor": _factor(covariance).tolist()},
        noise=_noise(same) or nearest.noise,
        discrepancy=_discrepancy(same),
    )
    return PopulationModel(model, path, names, population, len(same), len(models) - len(same), unit)


def _chosen(population: Population, unit: str | None) -> tuple[Array, Array]:
    return population.of_unit(unit) if unit is not None else population.usual()


def _values(model: Model) -> list[float]:
    return [float(each.value) for each in chain_coordinates(model.chain.stages, model.axes).values()]


def _error(model: Model, names: Sequence[str]) -> Array:
    """Covariance of a model's coefficients by its identification alone (K, K)."""
    stated = model.uncertainty.get("parameters", [])
    found = np.zeros((len(names), len(names)))
    rows = [(place, stated.index(name)) for place, name in enumerate(names) if name in stated]
    if rows:
        factor = np.array(model.uncertainty["factor"], dtype=float)[[row for _, row in rows]]
        places = [place for place, _ in rows]
        found[np.ix_(places, places)] = factor @ factor.T
    return found


def _deviations(covariance: Array) -> Array:
    deviations = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return np.asarray(np.maximum(deviations, 1e-300))


def _factor(covariance: Array) -> Array:
    """Columns whose products make the covariance (K, R); each coefficient counts by its own size."""
    size = _deviations(covariance)
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    kept = values > SMALLEST**2 * values.max()
    return np.asarray(size[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


def _noise(models: Sequence[Model]) -> dict[str, Any]:
    stated = [np.broadcast_to(np.asarray(m.noise["sigma"], dtype=float), len(m.axes)) for m in models if "sigma" in m.noise]
    return {"sigma": np.median(stated, axis=0).tolist()} if stated else {}


def _discrepancy(models: Sequence[Model]) -> dict[str, Any]:
    """Errors of the units' models: the median of their errors, and the zero that most sessions stay below."""
    stated: list[Mapping[str, Any]] = [model.discrepancy for model in models if model.discrepancy]
    if not stated:
        return {}
    found: dict[str, Any] = {"version": DISCREPANCY_VERSION, "rms": np.median([each["rms"] for each in stated], axis=0).tolist()}
    times = [each["correlation"] for each in stated if "correlation" in each]
    if times:
        found["correlation"] = float(np.median(times))
    zeros = [each["zero"] for each in stated if "zero" in each]
    if zeros:
        found["zero"] = np.quantile(zeros, USUAL_ZERO, axis=0).tolist()
    return found
