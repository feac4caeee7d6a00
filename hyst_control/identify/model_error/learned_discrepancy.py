# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Learned discrepancy: what a model leaves on baseline records, as a function of the command.

The error e of one axis, each record's own zero and drift taken off, is regressed on features Φ of the command,

    e = Φ w + r,    w ~ N(0, α² I),    r: the rest, n samples of which count as one,

and the posterior N(mean, factor factorᵀ) of w is kept. α and the size of r are those of the largest evidence (MacKay, Neural Computation
4, 1992, p. 415). On a command that excites what the baseline records did not, the posterior is as wide as the prior, and so says that
nothing is known there. The records of every command are also predicted from those of the others: where they lie further off than
foreseen, rest and factor are multiplied by as much, and where the prediction is worth nothing, none is kept. Records of a single command
do not tell what holds on another one; there the size of the error alone is known.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from scipy.linalg import eigh

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.command_features import CommandFeatures, rate_quantile
from hyst_control.identify.model_error.stated_spectrum import StatedSpectrum, rounded
from hyst_control.model_file import DISCREPANCY_VERSION
from hyst_control.records.correlation import correlation_length
from hyst_control.records.quantization_step import quantization_step
from hyst_control.records.session_zero import basis, usual_zero, without_zero, zero_of
from hyst_control.records.stream.row_store import mean_square, spread_parts

SIZES = np.geomspace(0.01, 0.5, 15)
"""Standard deviations of the prior weights that are tried, in error rms of a feature of rms 1: no feature alone is much larger than the
error, for large weights that cancel on the baseline records do not cancel on other commands."""
ROUNDS = 4  # Rounds in which rest and prior are found in turn
WORTH = 0.1  # Least share of the error's energy that must be predicted on commands that were not learned from
ALIKE = 0.05  # Relative difference of range and rate up to which two commands are the same
ROWS = 4000  # Most rows per record that are learned from; of a longer one every few rows
LONGEST, SHORTEST_PART, PARTS = 2**20, 2**16, 16
"""Rows of all records together up to which they are kept whole; fewest rows of a record that are kept of more, and parts that these
are."""


@dataclass(frozen=True)
class LearnedDiscrepancy:
    """Learned error of one axis."""

    features: CommandFeatures  # Scales of the features
    mean: Annotated[Array, "F"]  # Mean of the weights, measurement unit
    factor: Annotated[Array, "F K"]  # Factor of the weights' covariance, measurement unit
    rest: float  # Rms of what the features leave on the record where that is most, measurement unit
    correlation: float  # Time of that rest per independent sample, s

    def document(self) -> dict[str, Any]:
        """Convert to the form in a model file."""
        return {
            "features": {name: rounded(value, 6) for name, value in self.features.document().items()},
            "mean": rounded(self.mean, 6),
            "factor": rounded(self.factor, 6),
            "rest": rounded(self.rest, 6),
            "correlation": rounded(self.correlation, 6),
        }

    def predicted(self, command: Annotated[Array, "N"], sample_time: float) -> Annotated[Array, "N"]:
        """Predict the error on a command."""
        return np.concatenate([block @ self.mean for _, block in self.features.blocks(command, sample_time)])

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> LearnedDiscrepancy:
        """Read the form in a model file."""
        try:
            features = CommandFeatures.from_document(document["features"])
            mean, factor = (np.asarray(document[name], dtype=float) for name in ("mean", "factor"))
            rest, correlation = float(document["rest"]), float(document["correlation"])
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                f"discrepancy.learned: is not what hyst identify writes ({error!r}): identify the model again"
            ) from None
        count = features.rows(np.linspace(0.0, 1.0, 10), 1.0).shape[1]
        if mean.shape != (count,) or factor.ndim != 2 or len(factor) != count or not (rest > 0 and correlation > 0):
            raise InputError(
                f"discrepancy.learned: must have {count} features, a rest and a correlation > 0: identify the model again"
            )
        return cls(features, mean, factor, rest, correlation)


def learn(commands: Sequence[Array], errors: Sequence[Array], sample_time: float) -> LearnedDiscrepancy | None:
    """Learn what a model leaves on baseline records of one axis."""
    groups = _groups(commands, sample_time)
    if len(groups) < 2:
        return None  # records of one command do not tell what holds on another
    features = CommandFeatures.of(commands, sample_time)
    most = max(LONGEST // len(commands), SHORTEST_PART) if sum(map(len, errors)) > LONGEST else LONGEST
    pairs = [_regression(features, command, error, sample_time, most) for command, error in zip(commands, errors, strict=True)]
    designs, targets, counts = [design for design, _ in pairs], [target for _, target in pairs], list(map(len, errors))
    rows = sum(map(len, targets))
    scale = np.sqrt(np.sum([np.einsum("ij,ij->j", design, design) for design in designs], axis=0) / rows)
    scale = np.where(scale > 1e-9, scale, np.inf)
    for design in designs:
        design /= scale
    size = float(np.sqrt(sum(float(target @ target) for target in targets) / rows))
    if not size > 0:
        return None
    grams = [_gram(design, target, count) for design, target, count in zip(designs, targets, counts, strict=True)]
    whole = np.sum(grams, axis=0)
    length, rest, alpha = 1.0, size, size
    for _ in range(ROUNDS):
        alpha = max((share * size for share in SIZES), key=lambda value: _evidence(whole, value, rest, length))
        mean, _ = _posterior(whole, alpha, rest, length)
        left = [target - design @ mean for design, target in zip(designs, targets, strict=True)]
        length = max(_mean_length(rows, count) for rows, count in zip(left, counts, strict=True))
        rest = max(*(float(np.sqrt(np.mean(rows**2))) for rows in left), 1e-6 * size)
    energy, further = _crossed(designs, targets, grams, groups, alpha, rest, length)
    if energy > (1.0 - WORTH) * size**2:
        return None
    mean, covariance = _posterior(whole, alpha, rest, length)
    values, vectors = eigh(covariance)
    factor = further * vectors * np.sqrt(np.maximum(values, 0.0))
    found = LearnedDiscrepancy(features, mean / scale, factor / scale[:, None], further * rest, length * sample_time)
    return replace(found, factor=found.factor[:, np.argsort(-values)])


def discrepancy_of(
    commands: Sequence[Array], errors: Sequence[Array], sample_time: float, measurements: Sequence[Array] | None = None
) -> dict[str, Any]:
    """Describe a model's errors on baseline records, in the form of a model file."""
    rest = [without_zero(error)[0] for error in errors]
    learned = [
        learn([command[:, axis] for command in commands], [error[:, axis] for error in errors], sample_time)
        for axis in range(errors[0].shape[1])
    ]
    found: dict[str, Any] = {
        "version": DISCREPANCY_VERSION,
        "rms": np.max([[np.sqrt(mean_square(each)) for each in rows.T] for rows in rest], axis=0).tolist(),
        "correlation": sample_time * max(correlation_length(rows) for rows in rest),
    }
    found |= session_zeros(errors)
    if any(learned):
        found["learned"] = [None if one is None else one.document() for one in learned]
    if measurements is not None:
        found["spectrum"] = [
            _spectrum(_column(commands, axis), _column(errors, axis), _column(measurements, axis), one, sample_time)
            for axis, one in enumerate(learned)
        ]
        steps = [min(quantization_step(rows[:LONGEST]) for rows in _column(measurements, axis)) for axis in range(len(learned))]
        if any(steps):
            found["step"] = steps
    return found


def _column(series: Sequence[Array], axis: int) -> list[Array]:
    return [rows[:, axis] for rows in series]


def _spectrum(
    commands: Sequence[Array],
    errors: Sequence[Array],
    measurements: Sequence[Array],
    learned: LearnedDiscrepancy | None,
    sample_time: float,
) -> dict[str, Any]:
    """Spectrum of one axis' errors (M,), and of what the learned part leaves of them, in the form of a model file."""
    rests = errors
    if learned is not None:
        rests = [error - learned.predicted(u, sample_time)[-len(error) :] for u, error in zip(commands, errors, strict=True)]
    return StatedSpectrum.of(commands, errors, rests, measurements, sample_time).document()


def session_zeros(errors: Sequence[Array]) -> dict[str, Any]:
    """Describe the zeros of baseline sessions, in the form of a model file."""
    zeros = np.array([without_zero(error)[1] for error in errors])
    found: dict[str, Any] = {"zero_mean": np.mean(zeros, axis=0).tolist()}
    return found | ({"zero": usual_zero(zeros).tolist()} if len(zeros) > 1 else {})


def _regression(features: CommandFeatures, command: Array, error: Array, sample_time: float, most: int) -> tuple[Array, Array]:
    """Features (n, F) and errors (n,) of one record without its zero and drift: of all N rows, or of `PARTS` parts of `most` rows."""
    count = len(error)
    target = without_zero(error[:, None])[0][:, 0]
    if count <= most:
        return without_zero(features.rows(command, sample_time)[len(command) - count :])[0], target
    kept = spread_parts(count, most, PARTS)
    rows: list[list[Array]] = [[] for _ in kept]

    def streamed() -> Iterator[tuple[slice, Array]]:
        for part, block in features.blocks(command, sample_time):
            begin, stop = part.start - (len(command) - count), part.stop - (len(command) - count)
            if stop <= 0:
                continue
            block, begin = block[max(-begin, 0) :], max(begin, 0)
            for of_part, piece in zip(rows, kept, strict=True):
                inside = block[max(piece.start - begin, 0) : max(piece.stop - begin, 0)]
                of_part += [inside.copy()] * (len(inside) > 0)
            yield slice(begin, stop), block

    coefficients = zero_of(streamed(), count)
    designs = [np.concatenate(of_part) - basis(piece, count) @ coefficients for of_part, piece in zip(rows, kept, strict=True)]
    return np.concatenate(designs), np.concatenate([target[piece] for piece in kept])


def _mean_length(rows: Array, count: int) -> float:
    """Samples per independent one of what is left of a record of `count` rows: the mean over the parts where it is kept in parts."""
    pieces = [rows] if len(rows) == count else np.split(rows, PARTS)
    return float(np.mean([correlation_length(piece[:, None]) for piece in pieces]))


def _gram(design: Array, target: Array, count: int) -> Array:
    """Gram matrix of [Φ, e] over some rows (n, F) and (n,) that stand for `count`; of many every few are taken."""
    step = max(len(target) // ROWS, 1)
    rows = np.column_stack([design[::step], target[::step]])
    return np.asarray(step * count / len(target) * (rows.T @ rows), dtype=np.float64)


def _posterior(gram: Array, alpha: float, rest: float, length: float) -> tuple[Array, Array]:
    weight = 1.0 / (length * rest**2)
    covariance = np.linalg.inv(weight * gram[:-1, :-1] + np.eye(len(gram) - 1) / alpha**2)
    return weight * (covariance @ gram[:-1, -1]), np.asarray(covariance, dtype=np.float64)


def _evidence(gram: Array, alpha: float, rest: float, length: float) -> float:
    mean, covariance = _posterior(gram, alpha, rest, length)
    determinant = -np.linalg.slogdet(covariance)[1] + 2.0 * len(mean) * np.log(alpha)
    return 0.5 * float(gram[:-1, -1] @ mean / (length * rest**2) - determinant)


def _groups(commands: Sequence[Array], sample_time: float) -> list[list[int]]:
    """Indices of the records by their command: equal in range and rate within `ALIKE` are the same one."""
    found: list[list[int]] = []
    sizes = [(float(np.ptp(u)), rate_quantile(u, sample_time, 0.9)) for u in commands]
    for index, size in enumerate(sizes):
        for group in found:
            if all(abs(a - b) <= ALIKE * max(a, b) for a, b in zip(size, sizes[group[0]], strict=True)):
                group.append(index)
                break
        else:
            found.append([index])
    return found


def _crossed(
    designs: Sequence[Array],
    targets: Sequence[Array],
    grams: Sequence[Array],
    groups: Sequence[Sequence[int]],
    alpha: float,
    rest: float,
    length: float,
) -> tuple[float, float]:
    """Predict the records of every command from those of the others."""
    sums = [np.sum([grams[i] for i in group], axis=0) for group in groups]
    energy, foreseen, count = 0.0, 0.0, 0
    for index, group in enumerate(groups):
        mean, covariance = _posterior(np.sum(sums[:index] + sums[index + 1 :], axis=0), alpha, rest, length)
        for i in group:
            energy += float(np.sum((targets[i] - designs[i] @ mean) ** 2))
            foreseen += float(np.sum((designs[i] @ covariance) * designs[i])) + rest**2 * len(targets[i])
            count += len(targets[i])
    return energy / count, float(np.sqrt(max(1.0, energy / foreseen)))
