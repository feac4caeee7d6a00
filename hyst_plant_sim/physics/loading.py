"""From a plant file, or a name in config/plants, to a running plant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from hyst_plant_sim.physics.pea import Pea, PeaParameters, PlantError
from hyst_plant_sim.physics.published_pea import PublishedPea, PublishedPeaParameters

PLANTS: dict[str, tuple[type, type]] = {"pea": (Pea, PeaParameters), "pea_published": (PublishedPea, PublishedPeaParameters)}
"""Running class and parameters of every kind of plant."""

KEYS = ("plant", "name", "rating", "slew_limit", "sample_time", "parameters")


def load_plant(source: str | Path | Mapping[str, Any], seed: int = 0, sample_time: float | None = None, **changes: Any) -> Any:
    """A running plant from a YAML file, a mapping of the same form, or the path of one; `changes` replace single parameters.

    Raises `PlantError` naming file, field and remedy.
    """
    where = "plant"
    if isinstance(source, Mapping):
        document: Any = source
    else:
        where = str(source)
        try:
            document = yaml.safe_load(Path(source).read_text(encoding="utf-8"))
        except OSError as error:
            raise PlantError(f"{where}: {error.strerror}: give the path of a plant file") from None
        except (yaml.YAMLError, UnicodeDecodeError):
            raise PlantError(f"{where}: is not valid YAML") from None
    try:
        return _built(document, seed, sample_time, changes)
    except PlantError as error:
        raise PlantError(f"{where}: {error}") from None


def _built(document: Any, seed: int, sample_time: float | None, changes: Mapping[str, Any]) -> Any:
    if not isinstance(document, Mapping):
        raise PlantError("a mapping with plant, rating, parameters, … is due")
    for key in document:
        if key not in KEYS:
            raise PlantError(f"{key}: no such key, one of {', '.join(KEYS)} is due")
    kind = document.get("plant")
    if kind not in PLANTS:
        raise PlantError(f"plant: {kind!r} is not known, one of {', '.join(PLANTS)} is due")
    running, described = PLANTS[kind]
    given = {**dict(document.get("parameters") or {}), **changes}
    known = {field.name for field in fields(described)}
    for key in given:
        if key not in known:
            raise PlantError(f"parameters.{key}: no such parameter, one of {', '.join(sorted(known))} is due")
    try:
        parameters = described(**given)
    except TypeError as error:
        raise PlantError(f"parameters: {error}") from None
    rating = document.get("rating")
    if not isinstance(rating, (list, tuple)) or len(rating) != 2 or not rating[0] < rating[1]:
        raise PlantError(f"rating: {rating!r}, [lower, upper] in V is due")
    step = sample_time or document.get("sample_time")
    if isinstance(step, bool) or not isinstance(step, (int, float)) or not 0 < step < 1:
        raise PlantError(f"sample_time: {step!r}, a time in s is due")
    return running(parameters, float(step), seed, (float(rating[0]), float(rating[1])), float(document.get("slew_limit", 0.0)),
                   str(document.get("name", kind)))
