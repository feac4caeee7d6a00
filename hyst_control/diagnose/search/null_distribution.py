# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Null distribution: the best candidate's score on records without a gap, and the threshold for any claim.

With tens of thousands of samples, an information criterion alone accepts almost any effect. Records without a gap are therefore
drawn: from the nominal model with scattered coefficients, the user's own command and noise. Each is searched with linearized
candidates; the threshold is a quantile of the best scores. It is cached; the key contains all that it depends on: model, command,
sample time, rows that count, noise, the catalogue's ranges and priors, the configuration and the version of this package.

Close to the coefficients z that a record was drawn with, its output is linear in them. So a record is taken as its noise v plus J z,
where J holds the columns of the coefficients. With derivatives D of all candidates, S = I + w J Jᵀ and w the weight of a sample, what
a candidate's fit gains depends on g = Dᵀ S⁻¹ (v + J z) alone, which is drawn from N(0, Dᵀ S⁻¹ D / w): no record is simulated. Only where
a measurement is rounded in coarse steps, whose error follows the signal, is that error computed row by row.
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
from hyst_control.diagnose.configuration import CONFIGURATION, Configuration, NullSettings
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.search.candidate import Member
from hyst_control.diagnose.search.fit import Linearized
from hyst_control.diagnose.search.tangents import Tangent, Tangents, summed, tangents_of
from hyst_control.effects.effect import Surroundings
from hyst_control.model_file import model_to_document

MAX_NULL_PARAMETERS = 20
"""Parameters from which an effect's gain by chance is what its evidence takes off for their number (half a logarithm of the information
of each, never less than its expected gain): as part of the threshold it would hide all effects of few parameters."""


def threshold(
    linearized: Linearized,
    members: Sequence[Member],
    seed: int = 0,
    cache: bool = True,
    configuration: Configuration = CONFIGURATION,
    tangents: Tangents | None = None,
) -> float:
    """Score that the best candidate stays under in nearly all simulated records without a gap."""
    file = _cache_file(cache_key(linearized, members, seed, configuration)) if cache else None
    if file is not None and (known := _read(file)) is not None:
        return known
    scores = null_scores(tangents or tangents_of(linearized, members), seed, configuration.null_distribution)
    found = float(np.quantile(scores, configuration.null_distribution.quantile)) if len(scores) else 0.0
    if linearized.problem.own_spectrum is not None:
        # As a ratio to a variance that few records estimate, a score has the wider tail of F instead of chi-square's.
        found *= configuration.null_distribution.estimated_spectrum
    if file is not None:
        _write(file, found)
    return found


def null_scores(tangents: Tangents, seed: int, settings: NullSettings = CONFIGURATION.null_distribution) -> Array:
    """Gain of the best candidate on every record that is drawn without a gap."""
    used = [one for one in _thinned(tangents, settings.starts) if one.fitted]
    if not used:
        return np.zeros(settings.records)
    weight = tangents.linearized.problem.weight
    flat = np.hstack([one.signals[:, 1:] for one in used])
    products = tangents.products(flat)
    edges = np.cumsum([0, *(len(one.fitted) for one in used)])
    if _is_rounded(tangents.linearized.problem):
        right = _rounded_products(tangents, flat, seed, settings.records)
    else:
        values, vectors = np.linalg.eigh(products / weight)
        drawn = np.random.default_rng(seed).standard_normal((len(values), settings.records))
        right = vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * drawn)
    gains = []
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        inverse = np.linalg.inv(products[a:b, a:b] + np.eye(b - a) / weight)
        gains.append(0.5 * weight * np.sum(right[a:b] * (inverse @ right[a:b]), axis=0))
    return np.asarray(np.max(gains, axis=0), dtype=np.float64)


def _thinned(tangents: Tangents, count: int) -> list[Tangent]:
    """Tangents of about so many starts of every effect that has a small first step, and few enough parameters."""
    found = []
    for member in tangents.members:
        if member.size and not member.is_suggested and member.size <= MAX_NULL_PARAMETERS:
            every = tangents.of(member)
            found += every[:: max(len(every) // count, 1)]
    return found


def _rounded_products(tangents: Tangents, flat: Array, seed: int, records: int) -> Array:
    """Products of signals (m, C) with simulated records of coefficients that make a valid model, rounded like the measurement."""
    linearized, found = tangents.linearized, []
    for index in range(records):
        random = np.random.default_rng([seed, index])
        z = random.standard_normal(linearized.count)
        noise = random.standard_normal(len(linearized.measured))
        try:
            noise = _rounded(linearized.problem, linearized.simulate(z), noise)
        except InputError:
            continue
        left = linearized.unexplained(noise + linearized.columns @ z)
        found.append(flat.T @ summed(left, tangents.together))
    return np.transpose(found) if found else np.zeros((flat.shape[1], 1))


def _is_rounded(problem: Problem) -> bool:
    """True where the measurement is rounded in steps so coarse that their error is part of the noise."""
    return any(problem.steps) and problem.weight >= 1.0 and problem.own_spectrum is None


def _rounded(problem: Problem, simulated: Array, noise: Array) -> Array:
    """Noise (M,) of a simulated record, in units of the noise, of which a part is what rounding makes of the record.

    The error of rounding in coarse steps follows the signal, so that effects gain more by it than by white noise.
    """
    step = np.array(problem.steps) / problem.sigma
    rest = np.sqrt(np.maximum(1.0 - step**2 / 12.0, 0.0))
    exact, rows = simulated.reshape(-1, len(step)), noise.reshape(-1, len(step)).copy()
    for axis in np.flatnonzero(step):
        met = exact[:, axis] + rest[axis] * rows[:, axis]
        rows[:, axis] = step[axis] * np.rint(met / step[axis]) - exact[:, axis]
    return np.asarray(rows.reshape(-1), dtype=np.float64)


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
        "weight": float(f"{problem.weight:.1g}"),  # of the model's own error
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
