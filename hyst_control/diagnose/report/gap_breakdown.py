# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Gap budget: energy of the gap by kind, frequency band, amplitude, axis and time span, each share with a 90 % interval."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.signals import lagging, low_passed
from hyst_control.diagnose.configuration import BudgetSettings
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.report.attribution import Attribution
from hyst_control.diagnose.run.diagnosis import AxisDiagnosis, Diagnosis
from hyst_control.effects import EFFECTS

THIRDS = ("lower third", "middle third", "upper third")
SESSION = "session"  # Name of what differs from session to session: zero, drift, initial memory

Rows = list[dict[str, Any]]


def budget(diagnosis: Diagnosis) -> dict[str, Rows]:
    """Split the gap of the nominal model by kind, band, amplitude, axis and time."""
    settings = diagnosis.configuration.budget
    blocks = settings.blocks
    residuals = [part.gap() for part in diagnosis.parts]
    pairs = list(zip(diagnosis.parts, residuals, strict=True))
    by_axis = {
        diagnosis.model.axes[axis]: _blocks(residual[:, i] ** 2, blocks)
        for part, residual in pairs
        for i, axis in enumerate(part.axes)
    }
    energies = {
        "kind": [_kinds(part, residual, blocks) for part, residual in pairs],
        "band": [_bands(part, residual, settings) for part, residual in pairs],
        "amplitude": [_amplitudes(part, residual, blocks) for part, residual in pairs],
        "axis": [by_axis],
        "time": [_spans(part, residual, settings) for part, residual in pairs],
    }
    return {name: _added(parts, diagnosis.seed, settings) for name, parts in energies.items()}


def stages(diagnosis: Diagnosis, attribution: Attribution, unfaithful: Sequence[str] = ()) -> Rows:
    """Split the gap by place in the signal chain: the plant's places, what differs between sessions (zero, drift, initial memory), the
    model's own coefficients, noise, what is unexplained.
    """
    settings = diagnosis.configuration.budget
    blocks = settings.blocks
    energies: dict[str, Array] = dict.fromkeys(unfaithful, np.zeros(blocks))
    session = effects = coefficients = noise = unexplained = np.zeros(blocks)
    for part in diagnosis.parts:
        problem, linearized, solution = part.problem, part.linearized, part.chosen.solution
        unknowns = part.chosen.candidate.unknowns() if part.chosen.candidate else None
        companions = linearized.companions(solution.z)
        whole = _energy(problem, linearized.measured - linearized.simulate(np.zeros(linearized.count)), blocks)
        given = np.minimum(_energy(problem, linearized.measured - linearized.simulate(companions), blocks), whole)
        session = session + whole - given
        left = np.minimum(_energy(problem, solution.residual, blocks), given)
        # What the effects leave with the coefficients as given is the coefficients' part.
        with_effects = _energy(problem, linearized.measured - linearized.simulate(companions, unknowns, solution.x), blocks)
        fitted = np.clip(with_effects - left, 0.0, given - left)
        floor = np.minimum(float(np.sum(problem.sigma**2)) * len(linearized.measured) / len(problem.sigma) / blocks, left)
        effects, coefficients = effects + given - left - fitted, coefficients + fitted
        noise, unexplained = noise + floor, unexplained + left - floor
    named = [effect for effect in attribution.effects if effect.shrink is not None]
    for effect in named:
        place = EFFECTS[effect.name].place
        energies[place] = energies.get(place, np.zeros(blocks)) + effects * effect.share
    energies |= {SESSION: session} if any(part.linearized.scatter.companions.any() for part in diagnosis.parts) else {}
    energies |= {"coefficients": coefficients if named else coefficients + effects, "noise": noise, "unexplained": unexplained}
    return _shares_with_intervals(energies, diagnosis.seed, settings.resamples)


def _energy(problem: Problem, error: Array, blocks: int) -> Array:
    """Squared error of all axes in the measurement's unit, summed over each of equal stretches."""
    return _blocks((problem.rows(error) ** 2).sum(axis=1), blocks)


def _shares_with_intervals(energies: Mapping[str, Array], seed: int, resamples: int) -> Rows:
    """Rows of shares from energies (blocks,) by name: resampled over blocks."""
    names = list(energies)
    table = np.stack([np.maximum(energies[name], 0.0) for name in names])
    if table.sum() <= 0:
        return [{"name": name, "share": 1.0 / len(names), "ci90": [0.0, 1.0]} for name in names]
    shares = table.sum(axis=1) / table.sum()
    random = np.random.default_rng(seed)
    drawn = table[:, random.integers(0, table.shape[1], (resamples, table.shape[1]))].sum(axis=2)
    drawn = drawn / np.maximum(drawn.sum(axis=0), 1e-300)
    low, high = np.quantile(drawn, [0.05, 0.95], axis=1)
    return [
        {"name": name, "share": float(share), "ci90": [float(min(a, share)), float(max(b, share))]}
        for name, share, a, b in zip(names, shares, low, high, strict=True)
    ]


def _added(parts: Sequence[Mapping[str, Array]], seed: int, settings: BudgetSettings) -> Rows:
    total: dict[str, Array] = defaultdict(lambda: np.zeros(settings.blocks))
    for part in parts:
        for name, energy in part.items():
            total[name] += energy
    return _shares_with_intervals(total, seed, settings.resamples)


def _blocks(energy: Array, count: int) -> Array:
    """Sums (count,) of an energy (M,) over equal stretches."""
    edges = np.linspace(0, len(energy), count + 1).astype(int)
    return np.diff(np.concatenate([[0.0], np.cumsum(energy)])[edges])


def _bands(part: AxisDiagnosis, residual: Array, settings: BudgetSettings) -> dict[str, Array]:
    nyquist = 0.5 / part.problem.sample_time
    found: dict[str, Array] = {}
    low = residual * 0.0
    for lower, upper in zip((0.0, *settings.bands), (*settings.bands, np.inf), strict=True):
        if lower >= nyquist:
            break
        last = upper >= 0.95 * nyquist
        up_to = residual if last else low_passed(residual, upper / nyquist)
        found[f"above {lower:g} Hz" if last else f"{lower:g}-{upper:g} Hz"] = _blocks(
            ((up_to - low) ** 2).sum(axis=1), settings.blocks
        )
        low = up_to
        if last:
            break
    return found


def _amplitudes(part: AxisDiagnosis, residual: Array, blocks: int) -> dict[str, Array]:
    measured = part.problem.rows(part.linearized.measured)
    level = (measured - measured.min(axis=0)) / np.maximum(np.ptp(measured, axis=0), 1e-300)
    which = np.minimum((3 * level).astype(int), 2)
    return {name: _blocks((residual**2 * (which == i)).sum(axis=1), blocks) for i, name in enumerate(THIRDS)}


def _spans(part: AxisDiagnosis, residual: Array, settings: BudgetSettings) -> dict[str, Array]:
    """Equal spans; their interval is that of the energy's own scatter within the span."""
    energy = (residual**2).sum(axis=1)
    edges = np.linspace(0, len(energy), settings.spans + 1).astype(int)
    period = part.problem.sample_time
    return {
        f"{a * period:.3g}-{b * period:.3g} s": np.resize(_blocks(energy[a:b], settings.blocks), settings.blocks)
        for a, b in zip(edges[:-1], edges[1:], strict=True)
    }


def _kinds(part: AxisDiagnosis, residual: Array, blocks: int) -> dict[str, Array]:
    """Energy that linear regressions take off one after the other, fitted on every other block and counted on the rest."""
    found: dict[str, Array] = defaultdict(lambda: np.zeros(blocks))
    for axis in range(residual.shape[1]):
        left = residual[:, axis]
        whole, columns, solution = left, part.linearized.columns, part.chosen.solution
        if not part.chosen.inflated and part.linearized.count:
            free = part.linearized.companions(solution.z)
            for name, taken in ((SESSION, columns @ free), ("like coefficients", columns @ (solution.z - free))):
                energy = _blocks(left**2, blocks)
                left = left - part.problem.rows(taken)[:, axis]
                if name != SESSION or free.any():
                    found[name] += np.maximum(energy - _blocks(left**2, blocks), 0.0)
        target = left
        fold = (np.arange(len(left)) * blocks // len(left)) % 2
        known = np.zeros((len(left), 0))
        before = np.minimum(_blocks(left**2, blocks), _blocks(whole**2, blocks))
        for name, features in _features(part, axis):
            known = np.concatenate([known, features], axis=1)
            scale = np.sqrt(np.mean(known**2, axis=0)) + 1e-300
            left = np.empty(len(residual))
            for held in (0, 1):
                rows = fold == held
                design = known[~rows] / scale
                ridge = 1e-6 * len(design) * np.eye(design.shape[1])
                weights = np.linalg.solve(design.T @ design + ridge, design.T @ target[~rows])
                left[rows] = target[rows] - known[rows] / scale @ weights
            after = np.minimum(_blocks(left**2, blocks), before)
            found[name] = found[name] + before - after
            before = after
        noise = np.minimum(np.full(blocks, part.problem.sigma[axis] ** 2 * len(left) / blocks), before)
        found["noise"] += noise
        found["none of these"] = found["none of these"] + before - noise
    return found


def _features(part: AxisDiagnosis, axis: int) -> list[tuple[str, Array]]:
    """Groups of regressors (M, n), what is simplest first."""
    problem, linearized = part.problem, part.linearized
    axes = len(problem.model.axes)
    command = np.concatenate([piece.counted(piece.command) for piece in problem.pieces])[:, axis]
    simulated = problem.rows(linearized.nominal)[:, axis]
    count = len(simulated)
    time = np.linspace(-1.0, 1.0, count)
    u, y = _normalised(command), _normalised(simulated)
    rate = np.gradient(y)
    rate /= np.sqrt(np.mean(rate**2)) + 1e-300
    delayed = [np.concatenate([np.full(n, y[0]), y[:-n]]) for n in (1, 2, 4, 8)]
    slow = [lagging(y, float(a), 0.0, float(1.0 - a)) for a in (np.exp(-1.0 / n) for n in (20, 100, 500, 2500))]
    turned = np.sign(np.gradient(command))
    turned = turned[np.maximum.accumulate(np.where(turned != 0, np.arange(count), 0))]  # at rest that of the motion before
    groups = [
        ("offset and drift", np.stack([np.ones(count), time, time**2, time**3], axis=1)),
        ("linear dynamics", np.stack([y, rate, np.gradient(rate), *delayed, *slow], axis=1)),
        ("static, even", np.stack([y**2, y**4], axis=1)),
        ("static, odd", np.stack([y**3, y**5], axis=1)),
        ("velocity sign", np.stack([turned, turned * u, turned * u**2, np.abs(u) * turned], axis=1)),
        ("rate and amplitude", np.stack([np.abs(rate), rate * y, rate * np.abs(rate), rate * y**2], axis=1)),
    ]
    if axes > 1:
        groups.append(("cross-axis", np.delete(problem.rows(linearized.nominal), axis, axis=1)))
    else:
        others = [piece.counted(piece.others) for piece in problem.pieces if piece.others is not None and piece.others.shape[1]]
        if others:
            groups.append(("cross-axis", np.concatenate(others)))
    return groups


def _normalised(values: Array) -> Array:
    least = float(values.min())
    return 2.0 * (values - least) / max(float(np.ptp(values)), 1e-300) - 1.0
