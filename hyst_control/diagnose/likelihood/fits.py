# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Fits of the hypotheses on one problem, as sums of products by octave: all that the evidence needs, and nothing of the simulator.

The columns of a fit are, in this order: coefficients of the model and session effects; parameters of the effects; the effects' change,
multiplied by time, level, rate and direction of the command; and, for some, features of the command. The latter two are what only
"something else" has (`hypotheses`).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.command_features import CommandFeatures
from hyst_control.diagnose.likelihood.evidence import Fit
from hyst_control.diagnose.likelihood.octaves import Octaves, cosine, octaves_of
from hyst_control.diagnose.likelihood.variables import variables_of
from hyst_control.diagnose.search.beam_search import FittedHypothesis, Found
from hyst_control.diagnose.search.fit import Linearized, effect_columns, is_bounded

FEATURE_SIZE = 0.01  # Size of a feature of the command at weight 1, in the measurement's range


@dataclass(frozen=True)
class Hypothesis:
    """A hypothesis of the search with its sums of products."""

    index: int  # Among the hypotheses of the search: no effect, single ones, combinations, coefficients alone
    names: tuple[str, ...]  # Effects
    coefficients_alone: bool  # Coefficients may leave their tolerance, with no effect
    realizations: float  # Number of realizations of these effects
    at_bound: bool  # A size is at the end of its range
    fit: Fit
    coefficients: int  # Number of its first columns, which are coefficients and session effects
    parameters: int  # Number of the next ones, which are parameters of effects
    modulations: int  # Number of the next ones; the others are features
    change: Array  # By octave, energy of what its effects, or coefficients alone, change
    reduction: float  # Rms that it takes off what the coefficients leave, in units of noise and discrepancy


@dataclass(frozen=True)
class Fits:
    """Hypotheses of a problem, "no effect" first, and the octaves that they are weighed by."""

    octaves: Octaves
    hypotheses: tuple[Hypothesis, ...]
    effects: int  # Number of effects that were tried
    motion: Array  # By octave, energy of the nominal model's motion
    noise: Array  # By octave, share of the white noise in the variance


def fits_of(found: Found, kept: int, freedom: float) -> Fits:
    """Sum the products of the hypotheses that come closest to the record, at most `kept` single ones and as many combinations."""
    linearized = found.linearized
    problem = linearized.problem
    octaves = octaves_of(problem, freedom)
    every = found.hypotheses
    chosen = [0, len(every) - 1]
    begin = 1
    for some in (found.singles, found.combinations):
        best = sorted(range(len(some)), key=lambda i: some[i].solution.misfit)[:kept]
        chosen += [begin + i for i in best]
        begin += len(some)
    realizations = Counter(one.names[0] for one in found.singles)
    coefficient_columns = cosine(problem, linearized.columns)
    variables = variables_of(linearized)
    features = _features(linearized)
    none = cosine(problem, found.none.solution.residual)
    hypotheses = []
    for index in chosen:
        one = every[index]
        try:
            columns = _effect_columns(linearized, one)
        except InputError:
            continue  # next to these values the chain cannot be simulated
        # The change is that of the effects alone, or of coefficients beyond their tolerance, to first order in these.
        change = np.zeros(len(linearized.measured))
        if one.candidate is not None:
            change = linearized.measured - linearized.nominal - linearized.columns @ one.solution.z - one.solution.residual
        elif one.inflated:
            alone = np.where(linearized.scatter.companions > 0.0, 0.0, one.tolerances * one.solution.z)
            change = linearized.columns @ alone
        modulations = np.zeros((len(change), 0))
        if one.candidate is not None and is_bounded(change):
            plain = problem.in_noise(change)
            modulations = np.column_stack([problem.whitened(variable * plain) for variable in variables.values()])
        wider = np.where(linearized.scatter.companions > 0.0, 1.0, one.tolerances) if linearized.count else np.ones(0)
        design = np.hstack([coefficient_columns * wider, cosine(problem, columns), cosine(problem, modulations), features])
        residual = cosine(problem, one.solution.residual)
        k, p, m, f = linearized.count, columns.shape[1], modulations.shape[1], features.shape[1]
        unbounded = np.full(m + f, np.inf)
        lower, upper, centre = (np.zeros(0),) * 3
        if one.candidate is not None:
            unknowns = one.candidate.unknowns()
            lower, upper, centre = unknowns.lower, unknowns.upper, unknowns.centre
        value = np.concatenate([one.solution.z, one.solution.x - centre, np.zeros(m + f)])
        bounds = (
            np.concatenate([np.full(k, -np.inf), lower - centre, -unbounded]),
            np.concatenate([np.full(k, np.inf), upper - centre, unbounded]),
        )
        heavy = np.arange(len(value))
        fit = Fit.of(octaves, residual, design, value, (heavy >= k) & (heavy < k + p), bounds)
        change_energy = octaves.energies(cosine(problem, change))
        reduction = float(np.sqrt(max(float(np.mean(none**2) - np.mean(residual**2)), 0.0)))
        count = float(np.prod([realizations[name] for name in one.names]))
        at_bound = one.candidate is not None and one.candidate.is_at_bound(one.solution.x)
        hypotheses.append(Hypothesis(index, one.names, one.inflated, count, at_bound, fit, k, p, m, change_energy, reduction))
    motion = octaves.energies(cosine(problem, linearized.nominal))
    return Fits(octaves, tuple(hypotheses), len(realizations), motion, 1.0 - octaves.own)


def _effect_columns(linearized: Linearized, one: FittedHypothesis) -> Array:
    """Derivatives (M, P) by the effects' parameters at the fit."""
    if one.candidate is None or not len(one.solution.x):
        return np.zeros((len(linearized.measured), 0))
    simulated = linearized.measured - one.solution.residual
    return effect_columns(linearized, one.candidate.unknowns(), one.solution.z, one.solution.x, simulated)


def _features(linearized: Linearized) -> Array:
    """Features of the command (M, F), and what a clock of another rate changes, as cosine coefficients; none of several axes."""
    problem = linearized.problem
    if len(problem.model.axes) > 1:
        return np.zeros((len(linearized.measured), 0))
    scales = CommandFeatures.of([piece.command[:, 0] for piece in problem.pieces], problem.sample_time)
    rows = []
    for piece, simulated in zip(problem.pieces, problem.by_piece(problem.in_noise(linearized.nominal)), strict=True):
        features = scales.rows(np.ascontiguousarray(piece.command[:, 0]), problem.sample_time)
        late = np.linspace(0.0, 1.0, len(simulated)) * np.gradient(simulated[:, 0])
        rows.append(np.column_stack([piece.counted(features), late]))
    design = np.concatenate([part - part.mean(axis=0) for part in rows])
    size = np.sqrt(np.mean(design**2, axis=0))
    span = max(float(np.ptp(piece.measurement)) for piece in problem.pieces)
    design *= FEATURE_SIZE * span / float(problem.sigma[0]) / np.where(size > 1e-9, size, np.inf)
    return cosine(problem, np.column_stack([problem.whitened(column) for column in design.T]))
