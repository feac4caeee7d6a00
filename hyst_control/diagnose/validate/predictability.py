# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Predictable part of a residual: the part of its energy that the command determines, and not the run.

The residual is regressed on features of the command's past, fitted on some blocks of the record and judged on the others. What comes back
with every period of a command follows it as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.command_features import CommandFeatures
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.effects.learned_residual import LearnedResidual
from hyst_control.records.repeated_periods import period_of
from hyst_control.records.session_zero import without_zero

RIDGE = 1e-6  # Ridge of the regression, as a share of the features' energy
LEVELS = ("lower third", "middle third", "upper third")
BRANCHES = ("rising", "falling", "resting")
RESTING = 0.02  # Share of the command's largest rate under which it counts as resting
MIN_EXCESS = 0.02  # Least share of the residual's energy beyond the noise that a part of it must have to be listed


@dataclass(frozen=True)
class PartOfResidual:
    """Part of a residual: a band, a level or a branch."""

    name: str  # What it is
    share: float  # Its share of the residual's energy beyond the noise
    predictable: float  # Part of this that follows the command, on blocks not used for the fit


@dataclass(frozen=True)
class Predictability:
    """Part of a residual that follows the command."""

    share: float  # Of its energy beyond the noise, on blocks not used for the fit; 0 to 1
    # band, level, branch: The same by frequency, by level of the command and by its direction
    band: tuple[PartOfResidual, ...]
    level: tuple[PartOfResidual, ...]
    branch: tuple[PartOfResidual, ...]


def predictable_share(commands: Sequence[Array], residuals: Sequence[Array], blocks: int) -> float:
    """Compute the share of a residual's energy that features of the command predict on other blocks, or that its periods share."""
    target = np.concatenate(residuals)
    left = _held_out(np.concatenate(_designs(commands, 1.0)), target, blocks)
    total = float(np.sum((target - target.mean(axis=0)) ** 2))
    return max(float(np.clip(1.0 - np.sum(left**2) / total, 0.0, 1.0)), recurring_share(commands, residuals)) if total > 0 else 0.0


def recurring_share(commands: Sequence[Array], residuals: Sequence[Array]) -> float:
    """Share of a residual's energy that comes back after a period of the command; 0 where a command has none."""
    product = energy = 0.0
    for command, rows in zip(commands, residuals, strict=True):
        period = period_of(command)
        if period is None or (count := len(rows) // period) < 2:
            return 0.0
        whole = rows[: count * period]
        # What is slower than a period is alike from one to the next, and does not come back.
        periods = np.stack([without_zero(one)[0] for one in np.split(whole, count)])
        product += float(np.sum(periods[1:] * periods[:-1])) * count / (count - 1)
        energy += float(np.sum((whole - whole.mean(axis=0)) ** 2))
    return float(np.clip(product / max(energy, 1e-300), 0.0, 1.0))


def predictability(problem: Problem, residual: Annotated[Array, "M A"], bands: Sequence[float], blocks: int) -> Predictability:
    """Find which part of a residual follows the command, and where."""
    pieces = problem.pieces
    designs = _designs([piece.command for piece in pieces], problem.sample_time)
    left = _held_out(np.concatenate([piece.counted(one) for piece, one in zip(pieces, designs, strict=True)]), residual, blocks)
    groups = {
        "level": (LEVELS, np.concatenate([piece.counted(_levels(piece.command)) for piece in pieces])),
        "branch": (BRANCHES, np.concatenate([piece.counted(_branches(piece.command)) for piece in pieces])),
    }
    noise = problem.sigma**2
    split = {
        name: [
            (label, _energy(residual, at == i), _energy(left, at == i), float(np.sum(at == i, axis=0) @ noise))
            for i, label in enumerate(labels)
        ]
        for name, (labels, at) in groups.items()
    }
    before, after = _excess(residual, noise), _excess(left, noise)
    commands = [piece.counted(piece.command) for piece in pieces]
    recurs = recurring_share(commands, np.split(residual, problem.edges)) * float(np.sum(residual**2))
    return Predictability(
        max(_ratio(before, after), min(recurs / max(before, 1e-300), 1.0)),
        _parts(_by_band(problem, residual, left, bands), before),
        _parts(split["level"], before),
        _parts(split["branch"], before),
    )


def learn_residual(problem: Problem, residual: Annotated[Array, "M 1"], blocks: int) -> tuple[LearnedResidual, float]:
    """Learn the part of a residual that follows the command, as a stage of a model of one axis."""
    commands = [np.ascontiguousarray(piece.command[:, 0]) for piece in problem.pieces]
    features = CommandFeatures.of(commands, problem.sample_time)
    designs = []
    for command, piece in zip(commands, problem.pieces, strict=True):
        rows = features.rows(command, problem.sample_time, causal=True)
        if problem.hold == "zoh":  # a measurement follows the command of the tick before
            rows = np.concatenate([rows[:1], rows[:-1]])
        designs.append(piece.counted(np.column_stack([np.ones(len(rows)), rows])))
    design = np.concatenate(designs)
    left = _held_out(design, residual, blocks)
    gram, right = design.T @ design, design.T @ residual[:, 0]
    weights: Array = np.asarray(np.linalg.solve(gram + _ridge(gram), right), dtype=np.float64)
    stage = LearnedResidual.of(features, weights[1:], float(weights[0]))
    return stage, _ratio(_excess(residual, problem.sigma**2), _excess(left, problem.sigma**2), -10.0)


def _designs(commands: Sequence[Array], sample_time: float) -> list[Array]:
    """Features (N, F) of the commands of every record: a constant, then those of every axis."""
    scales = [
        CommandFeatures.of([np.ascontiguousarray(u[:, axis]) for u in commands], sample_time)
        for axis in range(commands[0].shape[1])
    ]
    return [
        np.column_stack(
            [np.ones(len(u)), *(one.rows(np.ascontiguousarray(u[:, axis]), sample_time) for axis, one in enumerate(scales))]
        )
        for u in commands
    ]


def _held_out(design: Array, target: Array, blocks: int) -> Array:
    """Rest (M, A) of a target after a regression, each block predicted from all others."""
    fold = np.arange(len(target)) * blocks // max(len(target), 1)
    left = np.zeros(target.shape)
    grams = [design[fold == block].T @ design[fold == block] for block in range(blocks)]
    rights = [design[fold == block].T @ target[fold == block] for block in range(blocks)]
    gram, right = sum(grams, np.zeros_like(grams[0])), sum(rights, np.zeros_like(rights[0]))
    for block in range(blocks):
        weights = np.linalg.solve(gram - grams[block] + _ridge(gram), right - rights[block])
        left[fold == block] = target[fold == block] - design[fold == block] @ weights
    return left


def _ridge(gram: Array) -> Array:
    return np.asarray(RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram)), dtype=np.float64)


def _levels(command: Array) -> Array:
    """Third of its range (N, A) in which a command is, 0 to 2."""
    low, high = command.min(axis=0), command.max(axis=0)
    place = (command - low) / np.maximum(high - low, 1e-300)
    return np.asarray(np.clip(np.floor(3.0 * place), 0.0, 2.0))


def _branches(command: Array) -> Array:
    """Direction (N, A) of a command, as its place in `BRANCHES`."""
    rate = np.gradient(command, axis=0)
    least = RESTING * np.max(np.abs(rate), axis=0)
    return np.asarray(np.where(np.abs(rate) <= least, 2.0, np.where(rate > 0, 0.0, 1.0)))


def _by_band(problem: Problem, residual: Array, left: Array, bands: Sequence[float]) -> list[tuple[str, float, float, float]]:
    """Name, energy before and after, and the noise's energy of every frequency band."""
    nyquist = 0.5 / problem.sample_time
    edges = [0.0, *(edge for edge in bands if edge < nyquist), nyquist]
    found = np.zeros((len(edges) - 1, 2))
    for column, whole in enumerate((residual, left)):
        for rows in np.split(whole, problem.edges):
            count = len(rows)
            at = np.clip(np.searchsorted(edges, np.fft.rfftfreq(count, problem.sample_time), side="right") - 1, 0, len(edges) - 2)
            power = np.abs(np.fft.rfft(rows, axis=0)) ** 2
            power[1 : (count + 1) // 2] *= 2.0  # the bins of negative frequencies
            found[:, column] += np.bincount(at, power.sum(axis=1) / count, minlength=len(edges) - 1)
    noise = len(residual) * float(np.sum(problem.sigma**2)) / nyquist
    names = [f"{low:g} to {high:g} Hz" for low, high in zip(edges[:-1], edges[1:], strict=True)]
    return [
        (name, before, after, noise * (high - low))
        for name, (before, after), low, high in zip(names, found.tolist(), edges[:-1], edges[1:], strict=True)
    ]


def _parts(rows: Sequence[tuple[str, float, float, float]], whole: float) -> tuple[PartOfResidual, ...]:
    """Parts with a share of the energy beyond the noise."""
    return tuple(
        PartOfResidual(name, (before - noise) / whole, _ratio(before - noise, after - noise))
        for name, before, after, noise in rows
        if whole > 0 and before - noise > MIN_EXCESS * whole
    )


def _energy(rows: Array, where: Array) -> float:
    return float(np.sum(rows[where] ** 2))


def _excess(rows: Array, noise: Array) -> float:
    """Energy beyond the noise's."""
    return float(np.sum(rows**2) - len(rows) * np.sum(noise))


def _ratio(before: float, after: float, least: float = 0.0) -> float:
    return float(np.clip(1.0 - after / before, least, 1.0)) if before > 0 else 0.0
