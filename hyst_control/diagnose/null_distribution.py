"""What the best candidate scores when there is no gap: the threshold for any claim.

With tens of thousands of samples an information criterion is certain of everything. So records without a gap are simulated
from the nominal model with scattered coefficients, the user's own command and noise; each is searched in the linearised way,
and the threshold is a quantile of the best score found in them. Kept in a cache per model, command and noise.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from platformdirs import user_cache_path

from hyst_control.chain.stage import Array
from hyst_control.diagnose.hypothesis import Candidate, Member
from hyst_control.diagnose.hypothesis_fit import Linearised, fit
from hyst_control.errors import InputError
from hyst_control.model_file import model_to_document
from hyst_control.parallel import forked

ROUNDS = 4
"""Most steps of the coefficients' fit: what their scatter leaves beyond its linear part is not to count as an effect."""

STARTS = 6
COUNT = 200
QUANTILE = 0.99


def threshold(
    linearised: Linearised,
    members: Sequence[Member],
    seed: int = 0,
    count: int = COUNT,
    progress: Callable[[int], None] = lambda _: None,
    cache: bool = True,
) -> float:
    """The score (nats) that the best candidate stays under in 99 % of simulated records without a gap."""
    file = _cache_file(linearised, members, seed, count) if cache else None
    if file is not None and (known := _read(file)) is not None:
        return known
    scores = null_scores(linearised, members, seed, count, progress)
    found = float(np.quantile(scores, QUANTILE)) if len(scores) else 0.0
    if file is not None:
        _write(file, found)
    return found


def null_scores(
    linearised: Linearised, members: Sequence[Member], seed: int, count: int, progress: Callable[[int], None] = lambda _: None
) -> Array:
    """The best candidate's gain (nats) on every simulated record without a gap."""
    designs = tangents(linearised, members)
    known = [linearised.unexplained(design) for design in designs]
    inverses = [np.linalg.inv(design.T @ left + np.eye(design.shape[1])) for design, left in zip(designs, known, strict=True)]
    flat = np.concatenate(known, axis=1) if known else np.zeros((len(linearised.measured), 0))
    edges = np.cumsum([0, *(left.shape[1] for left in known)])

    def best(index: int) -> float | None:
        random = np.random.default_rng([seed, index])
        z = random.standard_normal(linearised.count)
        try:
            record = linearised.simulate(z) + random.standard_normal(len(linearised.measured))
            solution = fit(linearised, measured=record, rounds=ROUNDS)
        except InputError:
            return None  # these coefficients make no model
        # What the coefficients could still explain is projected out: as good as one more step.
        right = flat.T @ solution.residual
        return max(
            (0.5 * float(right[a:b] @ inverse @ right[a:b]) for a, b, inverse in zip(edges[:-1], edges[1:], inverses, strict=True)),
            default=0.0,
        )

    scores = []
    for i, score in enumerate(forked(best, count)):
        progress(i + 1)
        if score is not None:
            scores.append(score)
    return np.array(scores)


def tangents(linearised: Linearised, members: Sequence[Member]) -> list[Array]:
    """∂ŷ/∂x (M, P) of every candidate at its starts (`STARTS` of them where there are many), at the nominal model."""
    found = []
    z = np.zeros(linearised.count)
    for member in members:
        if not member.size:
            continue  # a count: there or not, with no small first step
        unknowns, starts = Candidate((member,)).unknowns(), member.starts()
        for x in starts[:: max(len(starts) // STARTS, 1)]:
            try:
                base = linearised.simulate(z, unknowns, x)
                columns = []
                for p in range(len(x)):
                    moved = x.copy()
                    moved[p] += unknowns.step if x[p] + unknowns.step <= unknowns.upper[p] else -unknowns.step
                    columns.append((linearised.simulate(z, unknowns, moved) - base) / (moved[p] - x[p]))
            except InputError:
                continue
            found.append(np.stack(columns, axis=1))
    return found


def _cache_file(linearised: Linearised, members: Sequence[Member], seed: int, count: int) -> Path | None:
    folder = user_cache_path("hyst_control") / "null"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    digest = hashlib.sha256()
    problem = linearised.problem
    document = model_to_document(problem.model)
    digest.update(json.dumps(document, sort_keys=True, default=str).encode())
    for piece in problem.pieces:
        digest.update(np.ascontiguousarray(piece.command).tobytes())
    sigma = [float(f"{value:.1g}") for value in problem.sigma]  # a noise that is a little different has the same threshold
    names = [(member.name, member.axis, round(member.frequency)) for member in members]
    digest.update(json.dumps([sigma, problem.hold, seed, count, ROUNDS, STARTS, QUANTILE, 3, names]).encode())
    return folder / f"{digest.hexdigest()}.json"


def _read(file: Path) -> float | None:
    try:
        return float(json.loads(file.read_text())["threshold"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _write(file: Path, value: float) -> None:
    try:
        temporary = file.with_suffix(f".{os.getpid()}.part")
        temporary.write_text(json.dumps({"threshold": value}))
        os.replace(temporary, file)
    except OSError:
        pass  # a cache that cannot be written costs time only
