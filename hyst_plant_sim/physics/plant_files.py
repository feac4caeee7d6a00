# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Running plants from a plant file, a name in config/plants, or a case."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from hyst_plant_sim.physics.effects import insert_effects, read_effects
from hyst_plant_sim.physics.fsm import FsmParameters
from hyst_plant_sim.physics.parts import WhiteNoise
from hyst_plant_sim.physics.pea import PeaParameters
from hyst_plant_sim.physics.plant_text import read_plant_text
from hyst_plant_sim.physics.published_fsm import PublishedFsmParameters
from hyst_plant_sim.physics.published_pea import PublishedPeaParameters
from hyst_plant_sim.physics.signal_path import PLACES, Frame, Line, Plant, PlantError
from hyst_plant_sim.physics.viscoelastic_bouc_wen import ViscoelasticBoucWenParameters

PLANTS: dict[str, type] = {
    "pea": PeaParameters,
    "pea_published": PublishedPeaParameters,
    "fsm": FsmParameters,
    "fsm_published": PublishedFsmParameters,
    "third": ViscoelasticBoucWenParameters,
}
"""Parameters, and with them the physics, of every kind of plant."""

KEYS = ("plant", "name", "rating", "slew_limit", "sample_time", "stroke", "parameters", "effects", "seed")


def load_plant(
    source: str | Path | Mapping[str, Any],
    seed: int | None = None,
    sample_time: float | None = None,
    refinement: int = 1,
    effects: Any = None,
    parameters: Mapping[str, Any] | None = None,
    **changes: Any,
) -> Plant:
    """Construct a running plant from a YAML file, the name of a shipped one, or a mapping of the same form.

    A mapping without `parameters` is a case: {plant: NAME, effects: [{name: delay, tau: 1e-4, axis: x, from: 0.5}, …], seed: 7} on
    top of the shipped file of that name (see `effects` for their meaning).
    """
    where = "plant" if isinstance(source, Mapping) else str(source)
    try:
        document = source if isinstance(source, Mapping) else _read(Path(source))
        if isinstance(document, Mapping) and "parameters" not in document and document.get("plant") in PLANTS:
            document = {**_read(Path(document["plant"])), **document}
        if effects is not None and isinstance(document, Mapping):
            document = {**document, "effects": effects}
        return _built(document, seed, sample_time, refinement, {**(parameters or {}), **changes})
    except PlantError as error:
        beside = effects is not None and str(error).startswith("effects:")  # the caller's, of which the file knows nothing
        raise PlantError(str(error) if beside else f"{where}: {error}") from None


def shipped(name: str) -> Path | None:
    """Find the file of a plant in config/plants: in the source tree, otherwise in an installed package."""
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    folders = [Path(__file__).resolve().parents[2], *(Path(prefix) / "share" / "hyst_control" for prefix in prefixes)]
    return next((path for folder in folders if (path := folder / "config" / "plants" / f"{name}.yaml").is_file()), None)


def _read(path: Path) -> Any:
    known = shipped(str(path)) if str(path) in PLANTS and not path.exists() else None
    try:
        return read_plant_text(known or path)
    except OSError as error:
        raise PlantError(f"{error.strerror}: give the path of a plant file, or one of {', '.join(PLANTS)}") from None


def _built(document: Any, seed: int | None, sample_time: float | None, refinement: int, changes: Mapping[str, Any]) -> Plant:
    if not isinstance(document, Mapping):
        raise PlantError("must be a mapping with plant, rating, parameters, …")
    for key in document:
        if key not in KEYS:
            raise PlantError(f"{key}: unknown key: choose one of {', '.join(KEYS)}")
    kind = document.get("plant")
    if kind not in PLANTS:
        raise PlantError(f"plant: {kind!r} is unknown: choose one of {', '.join(PLANTS)}")
    parameters = _described(PLANTS[kind], {**dict(document.get("parameters") or {}), **changes})
    step = sample_time or document.get("sample_time")
    if isinstance(step, bool) or not isinstance(step, (int, float)) or not 0 < step < 1:
        raise PlantError(f"sample_time: must be a time in s between 0 and 1, got {step!r}")
    substeps = int(np.ceil(step * parameters.internal_rate - 1e-9)) * refinement
    frame = Frame(
        str(document.get("name", kind)),
        parameters.axes,
        {"command": "V", "measurement": parameters.unit},
        float(step),
        substeps,
        _range(document, "rating", "V"),
        float(document.get("slew_limit", 0.0)),
        _range(document, "stroke", parameters.unit),
        int(document.get("seed", 0) if seed is None else seed),
    )
    return Plant(frame, _line(parameters, frame, document.get("effects") or []))


def _described(described: type, given: Mapping[str, Any]) -> Any:
    known = {field.name for field in fields(described)}
    for key in given:
        if key not in known:
            raise PlantError(f"parameters.{key}: unknown parameter: choose one of {', '.join(sorted(known))}")
    try:
        return described(**given)
    except TypeError as error:
        raise PlantError(f"parameters: {error}") from None


def _range(document: Mapping[str, Any], key: str, unit: str) -> tuple[float, float]:
    given = document.get(key)
    if not isinstance(given, (list, tuple)) or len(given) != 2 or not given[0] < given[1]:
        raise PlantError(f"{key}: must be [lower, upper] in {unit}, got {given!r}")
    return float(given[0]), float(given[1])


def _line(parameters: Any, frame: Frame, effects: Any) -> Line:
    line: Line = {place: [] for place in PLACES}
    present = read_effects(effects, frame)
    for axis in range(len(frame.axes)):

        def parts(hysteresis: Mapping[str, float], mechanics: Mapping[str, float], axis: int = axis) -> Any:
            return parameters.parts(axis, frame, hysteresis, mechanics)

        for place, found in parts({}, {}).items():
            line[place] += [(axis, part) for part in found]
        insert_effects(line, axis, parts, present, frame)
    if mixing := getattr(parameters, "mixing", lambda: None)():
        line["motion"].append((None, mixing))
    insert_effects(line, None, None, present, frame)
    line["adc"].insert(0, (None, WhiteNoise(np.full(len(frame.axes), parameters.noise), frame.seed)))
    return line
