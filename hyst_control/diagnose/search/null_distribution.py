# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Null distribution: the best candidate's score on records without a gap, and the threshold for any claim.

With tens of thousands of samples, an information criterion alone accepts almost any effect. Records without a gap are therefore
drawn: from the nominal model with scattered coefficients, the user's own command and noise. The threshold is a quantile of the best scores.

Close to the coefficients z that a record was drawn with, its output is linear in them. So a record is taken as its noise v plus J z,
where J holds the columns of the coefficients. With candidate d, S = I + w J Jᵀ and w the weight of a sample, fitting z alone and
z with x differ by ½ w² (dᵀS⁻¹y)² / (w dᵀS⁻¹d + 1) for y = v + J z: no record has to be simulated and fitted.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from platformdirs import user_cache_path

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.installed import installed_version
from hyst_control.base.parallel import map_forked
from hyst_control.diagnose.configuration import Configuration, NullSettings
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.search.candidate import Candidate, Member
from hyst_control.diagnose.search.fit import Linearized, effect_columns, is_bounded
from hyst_control.effects.effect import Surroundings
from hyst_control.model_file import model_to_document

MAX_NULL_PARAMETERS = 20
"""Parameters from which an effect's gain by chance is what its evidence takes off for their number (half a logarithm of the information
of each, never less than its expected gain): as part of the threshold it would hide all effects of few parameters."""

TOGETHER = 10
"""Simulated records whose gains are computed at once: the tangents of all candidates are read from memory once for all of them."""


def threshold(
    linearized: Linearized, members: Sequence[Member], seed: int = 0, cache: bool = True, *, configuration: Configuration
) -> float:
    """Score that the best candidate stays under in nearly all simulated records without a gap."""
    file = _cache_file(cache_key(linearized, members, seed, configuration)) if cache else None
    if file is not None and (known := _read(file)) is not None:
        return known
    scores = null_scores(linearized, members, seed, configuration.null_distribution)
    found = float(np.quantile(scores, configuration.null_distribution.quantile)) if len(scores) else 0.0
    if linearized.problem.own_spectrum is not None:
        # As a ratio to a variance that few records estimate, a score has the wider tail of F instead of chi-square's.
        found *= configuration.null_distribution.estimated_spectrum
    if file is not None:
        _write(file, found)
    return found


def null_scores(linearized: Linearized, members: Sequence[Member], seed: int, settings: NullSettings) -> Array:
    """Gain of the best candidate on every record that is drawn without a gap."""
    designs = tangents(linearized, members, settings.starts)
    if not designs:
        return np.zeros(settings.records)
    known = [linearized.unexplained(design) for design in designs]
    weight = linearized.problem.weight
    inverses = [
        np.linalg.inv(design.T @ left + np.eye(design.shape[1]) / weight) for design, left in zip(designs, known, strict=True)
    ]
    flat = np.concatenate(known, axis=1)
    edges = np.cumsum([0, *(left.shape[1] for left in known)])
    of_coefficients = flat.T @ linearized.columns

    def record(index: int) -> tuple[Array, Array] | None:
        """Draw noise (M,) and coefficients (K,) of a record, or None if these make no valid model."""
        random = np.random.default_rng([seed, index])
        z = random.standard_normal(linearized.count)
        noise = np.asarray(random.standard_normal(len(flat)) / np.sqrt(weight), dtype=np.float64)
        if not _is_rounded(linearized.problem):
            return noise, z
        try:
            return _rounded(linearized.problem, linearized.simulate(z), noise), z
        except InputError:
            return None

    def best(block: int) -> list[float]:
        indices = range(TOGETHER * block, min(TOGETHER * (block + 1), settings.records))
        drawn = [found for found in map(record, indices) if found is not None]
        if not drawn:
            return []
        noise, z = (np.column_stack(part) for part in zip(*drawn))
        right = flat.T @ noise + of_coefficients @ z
        gains = [
            0.5 * weight * np.sum(right[a:b] * (inverse @ right[a:b]), axis=0)
            for a, b, inverse in zip(edges[:-1], edges[1:], inverses, strict=True)
        ]
        return [float(gain) for gain in np.max(gains, axis=0)]

    return np.array([score for block in map_forked(best, -(-settings.records // TOGETHER)) for score in block])


def _is_rounded(problem: Problem) -> bool:
    """True where the measurement is rounded in steps so coarse that their error is part of the noise."""
    return any(problem.steps) and problem.weight >= 1.0 and problem.own_spectrum is None


def _rounded(problem: Problem, simulated: Array, noise: Array) -> Array:
    """Noise (M,) of a simulated record, in units of the noise, of which a part is what rounding makes of the record."""
    step = np.array(problem.steps) / problem.sigma
    rest = np.sqrt(np.maximum(1.0 - step**2 / 12.0, 0.0))
    exact, rows = simulated.reshape(-1, len(step)), noise.reshape(-1, len(step)).copy()
    for axis in np.flatnonzero(step):
        met = exact[:, axis] + rest[axis] * rows[:, axis]
        rows[:, axis] = step[axis] * np.rint(met / step[axis]) - exact[:, axis]
    return np.asarray(rows.reshape(-1), dtype=np.float64)


def tangents(linearized: Linearized, members: Sequence[Member], count: int) -> list[Array]:
    """Derivatives ∂ŷ/∂x of every candidate at its starts, at the nominal model."""
    found = []
    z = np.zeros(linearized.count)
    for member in members:
        if not member.size or member.is_suggested or member.size > MAX_NULL_PARAMETERS:
            continue  # there or not, with no small first step; or more than chance may gain is taken off by the evidence
        unknowns, starts = Candidate((member,)).unknowns(), member.starts()
        for x in starts[:: max(len(starts) // count, 1)]:
            try:
                design = effect_columns(linearized, unknowns, z, x, linearized.simulate(z, unknowns, x))
            except InputError:
                continue
            if is_bounded(design):
                found.append(design)
    return found


def cache_key(linearized: Linearized, members: Sequence[Member], seed: int, configuration: Configuration) -> str:
    """Key of a threshold: everything that it depends on but for a single measurement.

    The ranges and priors of an effect are those that it has around the simulated record, not the measured one: so records of one
    command share a threshold, though each measurement has another range.
    """
    problem = linearized.problem
    digest = hashlib.sha256()
    for piece in problem.pieces:
        digest.update(np.ascontiguousarray(piece.command).tobytes())
        digest.update(b"all rows" if piece.keep is None else np.packbits(piece.keep).tobytes())
    simulated = problem.rows(linearized.nominal)
    span = float(f"{simulated.min():.6g}"), float(f"{simulated.max():.6g}")
    around = replace(problem.surroundings, measurement=span)
    document = {
        "version": installed_version(""),
        "configuration": configuration.digest(),
        "model": model_to_document(problem.model),
        "sample_time": problem.sample_time,
        "weight": float(f"{problem.weight:.1g}"),  # of the model discrepancy
        "own_error": None if problem.own_spectrum is None else problem.own_spectrum.digest(),
        "hold": problem.hold,
        # A noise that is a little different has the same threshold.
        "noise": [float(f"{value:.1g}") for value in problem.sigma],
        "steps": [float(f"{value:.2g}") for value in problem.steps],
        "seed": seed,
        "members": [_member(member, around) for member in members if not member.is_suggested],
    }
    digest.update(json.dumps(document, sort_keys=True, default=str).encode())
    return digest.hexdigest()


def _member(member: Member, around: Surroundings) -> list[object]:
    """An effect of the catalogue as it is used, with its ranges and priors."""
    effect = member.effect
    makers = [effect.parameters, *([effect.coupled_parameters] if effect.coupled_parameters else [])]
    parameters = [asdict(parameter) for maker in makers for parameter in maker(around)]
    return [member.name, member.axis, member.place, round(member.frequency), member.fixed, member.separate_sizes, parameters]


def _cache_file(key: str) -> Path | None:
    folder = user_cache_path("hyst_control") / "null"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder / f"{key}.json"


def _read(file: Path) -> float | None:
    try:
        found = float(json.loads(file.read_text())["threshold"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError, OverflowError):
        return None
    return found if math.isfinite(found) and found >= 0.0 else None  # every verdict would follow from NaN or infinity


def _write(file: Path, value: float) -> None:
    try:
        temporary = file.with_suffix(f".{os.getpid()}.part")
        temporary.write_text(json.dumps({"threshold": value}))
        os.replace(temporary, file)
    except OSError:
        pass  # a cache that cannot be written costs time only
