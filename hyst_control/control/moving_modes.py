# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Resonances of a linear chain, and the chain with some of them at another frequency or damping.

A stage is a sum of its modes. A mode that moves keeps what it adds at rest, and with it its share of the motion: the zeros, which lie
where modes cancel, follow from the sum. A weak mode beside its close pair of zeros remains weak. Broad poles and zeros beside narrow
modes of an axis are filters in series with that sum, as those of an amplifier, and shape a mode where it moves to. Axes that a single
state space couples have modes alone. The zeros of other stages, such as a notch filter of the drive, stay where they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import eig, eigvals

from hyst_control.base.arrays import Array, Complex, Mask
from hyst_control.chain import Stage
from hyst_control.chain.linear.linear_stages import (
    MAX_SKEW,
    LinearStage,
    LinearSystem,
    StateSpace,
    stacked,
    transfer_function_system,
)

WELL_DAMPED = float(np.sqrt(0.5))
"""Damping ratio from which the response of a pair of poles has no peak above its value at rest."""
NOTCH_WIDTH = 0.15  # Relative distance in frequency up to which a pair of zeros may be a notch against a mode
NOTCH_DAMPING = 0.15  # Min. damping ratio of a notch's own poles, also if they are fitted to a record
FAR = 1e5
"""Distance of zeros, relative to the farthest pole, from which they are at infinity but for rounding errors."""


class Resonances(NamedTuple):
    """Resonances of a linear chain, one pole of each pair."""

    poles: Complex  # (N,), rad/s
    peaks: Array  # (N,), height of each above the same mode well damped, over the response of its stage there


def resonances(stages: Sequence[Stage], axes: int) -> Resonances:
    """Resonances of a linear chain and of its branches, the slowest first: the narrow pairs that peak or, without any, the broad ones."""
    found = [pair for stage in _linear(stages) for pair in _ringing(stage, axes)]
    found = [pair for pair in found if not _broad(np.array(pair[0]))] or found
    found.sort(key=lambda pair: abs(pair[0]))
    return Resonances(np.array([pole for pole, _ in found], complex), np.array([peak for _, peak in found], float))


def first_mode(stages: Sequence[Stage], axes: int) -> complex | None:
    """Pole (rad/s) of the slowest resonance of a linear chain; None without one."""
    poles = resonances(stages, axes).poles
    return complex(poles[0]) if len(poles) else None


def with_modes(stages: Sequence[Stage], axes: int, factor: float, only: Complex | None = None) -> tuple[Stage, ...]:
    """The same linear chain with its resonances, `only` those of some poles (rad/s), at `factor` times their frequency.

    Damping ratio and stiffness of each are kept.
    """
    chosen = resonances(stages, axes).poles if only is None else only
    return _moved(stages, axes, lambda poles: np.where(_among(poles, chosen), factor * poles, poles))


def with_fixed_zeros(stages: Sequence[Stage], axes: int, factor: float) -> tuple[Stage, ...]:
    """The same linear chain with its slowest resonance at `factor` times its frequency, and close zeros at theirs.

    Zeros close to a mode belong to a weak mode, and move with it, or to a notch of the drive, and stay. If damped poles are there too,
    which a notch has, a model cannot separate the two.
    """
    first = first_mode(stages, axes)
    chosen = np.array([] if first is None else [first], complex)

    def moved(system: LinearSystem, step: float | None) -> LinearSystem:
        if step or system.B.shape[1] != 1 or system.C.shape[0] != 1 or not len(system.A):
            return system
        poles = np.linalg.eigvals(system.A).astype(complex)
        if np.count_nonzero(-poles.real >= NOTCH_DAMPING * np.abs(poles)) < 2:
            return system  # a notch has a pair of poles of its own
        for pole in poles[_among(poles, chosen) & (poles.imag > 0.0)]:
            if np.any(_close(_zeros(system), pole)):
                before = np.array([1.0, -2.0 * pole.real, abs(pole) ** 2])
                after = before * np.array([1.0, factor, factor**2])
                return system.then(transfer_function_system(factor**2 * before, after))
        return system

    return _with_systems(stages, axes, moved)


def well_damped(stages: Sequence[Stage], axes: int, only: Complex) -> tuple[Stage, ...]:
    """The same linear chain with the resonances of some poles (rad/s) damped until they have no peak."""
    quiet = complex(-WELL_DAMPED, np.sqrt(1.0 - WELL_DAMPED**2))

    def moved(poles: Complex) -> Complex:
        damped = np.abs(poles) * np.where(poles.imag > 0.0, quiet, quiet.conjugate())
        return np.where(_among(poles, only), damped, poles)

    return _moved(stages, axes, moved)


def _rings(poles: Complex) -> Mask:
    return (np.abs(poles.imag) > 1e-6 * np.abs(poles)) & (-poles.real < (1.0 - 1e-9) * WELL_DAMPED * np.abs(poles))


def _broad(roots: Complex) -> Mask:
    """Poles or zeros with a damping ratio of at least a half: those of a filter rather than of a mode."""
    return np.asarray(-2.0 * roots.real >= np.abs(roots))


def _among(poles: Complex, pairs: Complex) -> Mask:
    """Poles that belong to one of the given pairs, each of which is given by its upper pole."""
    upper = poles.real + 1j * np.abs(poles.imag)
    return np.asarray(np.isclose(upper[:, None], pairs, rtol=1e-6, atol=0.0).any(axis=1))


def _close(zeros: Complex, pole: complex) -> Mask:
    """Complex zeros close enough to a pole to be a notch against its mode."""
    return np.asarray((np.abs(zeros.imag) > 0.5 * abs(pole)) & (np.abs(np.abs(zeros) / abs(pole) - 1.0) < NOTCH_WIDTH))


def _linear(stages: Sequence[Stage]) -> Iterator[LinearStage]:
    for stage in stages:
        for chain in stage.inner_chains:
            yield from _linear(chain)
        if isinstance(stage, LinearStage):
            yield stage


def _moved(stages: Sequence[Stage], axes: int, move: Callable[[Complex], Complex]) -> tuple[Stage, ...]:
    """The chain with all poles (rad/s) where `move` has them."""
    return _with_systems(stages, axes, lambda system, step: _system_moved(system, step, move))


def _with_systems(
    stages: Sequence[Stage], axes: int, change: Callable[[LinearSystem, float | None], LinearSystem]
) -> tuple[Stage, ...]:
    """The chain with all its linear systems changed, each given with its sample time, None for a continuous one."""
    found: list[Stage] = []
    for stage in stages:
        if stage.inner_chains:
            stage = stage.with_inner_chains([_with_systems(chain, axes, change) for chain in stage.inner_chains])
        elif isinstance(stage, LinearStage):
            step = stage.sample_time if isinstance(stage, StateSpace) else None
            systems = stage.systems(axes)
            moved = [change(system, step) for system in systems]
            if any(one is not other for one, other in zip(moved, systems, strict=True)):
                whole = moved[0] if len(moved) == 1 else stacked(moved)
                stage = StateSpace(whole.A.tolist(), whole.B.tolist(), whole.C.tolist(), whole.D.tolist(), step)
        found.append(stage)
    return tuple(found)


def _system_moved(system: LinearSystem, step: float | None, move: Callable[[Complex], Complex]) -> LinearSystem:
    values, right, left = _modal(system.A)
    poles = _rates(values, step)
    goal = move(poles)
    chosen = goal != poles
    if not chosen.any():
        return system
    placed = goal if step is None else np.asarray(np.exp(goal * step), dtype=np.complex128)
    scale: Complex = np.ones(len(poles), complex)
    if step is None:  # the numerator of the mode's own fraction is scaled with the square of its frequency
        scale[chosen] = np.abs(goal[chosen] / poles[chosen]) ** 2 * poles[chosen].imag / goal[chosen].imag
    else:
        scale[chosen] = (1.0 - placed[chosen]) / (1.0 - values[chosen])
    changed, single = chosen, system.B.shape[1] == system.C.shape[0] == 1
    if step is None and single and not _broad(poles[chosen]).any() and np.linalg.cond(right) < MAX_SKEW:
        changed, left = np.ones(len(poles), bool), np.asarray(np.linalg.inv(right), dtype=np.complex128)
        scale = _behind_filters(system, poles, goal, ((system.C @ right) * (left @ system.B).T)[0], scale)
    left = _dual(right[:, changed], left[changed])
    a = system.A + ((right[:, changed] * (placed - values)[changed]) @ left).real
    b = system.B + ((right[:, changed] * (scale - 1.0)[changed]) @ (left @ system.B)).real
    return LinearSystem(a, b, system.C, system.D, system.bias)


def _behind_filters(system: LinearSystem, poles: Complex, goal: Complex, residues: Complex, scale: Complex) -> Complex:
    """Factors (n,) on the residues of a system whose poles go to a `goal`, for modes that are a sum behind filters.

    The system is F H: F has the broad poles that stay and broad zeros, as an amplifier does, and H is the sum of the modes, whose
    residues alone grow by a `scale`. In the product the residue of a mode changes with F at its place, and that of a pole of F with H.
    """
    steady, size, zeros = _broad(poles) & (goal == poles), float(np.abs(poles).max()), _zeros(system)
    wide = _broad(-np.abs(zeros.real) + 1j * zeros.imag)
    ordered = zeros[np.lexsort([np.abs(zeros), ~wide])]  # broad ones first, the slowest of them first
    count = min(int(steady.sum()), int(wide.sum()))  # F has no more zeros than poles
    of_filters, of_sum, old, new = ordered[:count], ordered[count:], poles[~steady], goal[~steady]

    def product(points: Complex, roots: Complex) -> Complex:
        return np.asarray(np.prod((points[:, None] - roots) / size, axis=1))

    def filters(points: Complex) -> Complex:
        return product(points, of_filters) / product(points, poles[steady])

    def modes(points: Complex) -> Complex:
        return product(points, of_sum) / product(points, old)

    somewhere, at = np.array([size], complex), poles[steady]  # where a stable system has no pole: tells how large H is
    whole = _at(system, size)[0, 0] / (filters(somewhere) * modes(somewhere))
    before, after = filters(old), filters(new)
    parts = residues[~steady] / before
    change = (parts * (scale[~steady] / (at[:, None] - new) - 1.0 / (at[:, None] - old))).sum(axis=1)
    found = np.ones(len(poles), complex)
    found[~steady] = scale[~steady] * after / before
    found[steady] = 1.0 + change / (whole * modes(at))
    return found


def _at(system: LinearSystem, point: complex) -> Complex:
    """Transfer function (p, m) of a system at a point of the plane of its poles."""
    return np.asarray(
        system.C @ np.linalg.solve(point * np.eye(len(system.A)) - system.A, system.B) + system.D, dtype=np.complex128
    )


def _zeros(system: LinearSystem) -> Complex:
    """Zeros (rad/s) of a system of one input and output, those at infinity left out."""
    size = np.abs(np.linalg.eigvals(system.A)).max()
    b, c = np.linalg.norm(system.B) or 1.0, np.linalg.norm(system.C) or 1.0
    pencil = np.block([[system.A / size, system.B / b], [system.C / c, system.D * (size / (b * c))]])
    found = eigvals(pencil, np.diag([*np.ones(len(system.A)), 0.0]))
    return np.asarray(size * found[np.isfinite(found) & (np.abs(found) < FAR)], dtype=np.complex128)


def _modal(matrix: Array) -> tuple[Complex, Complex, Complex]:
    """Eigenvalues (n,), right eigenvectors as columns and left ones as rows, both (n, n), of any lengths."""
    if not len(matrix):
        return np.zeros(0, complex), np.zeros((0, 0), complex), np.zeros((0, 0), complex)
    values, left, right = eig(matrix, left=True, right=True)
    return values.astype(complex), right.astype(complex), left.conj().T.astype(complex)


def _dual(right: Complex, left: Complex) -> Complex:
    """Left eigenvectors as rows, scaled and mixed so that their products with the right ones are 1 and 0: equal modes share a space."""
    return np.asarray(np.linalg.solve(left @ right, left))


def _rates(values: Complex, step: float | None) -> Complex:
    """Poles in rad/s of the eigenvalues of a system, discrete with a step in s."""
    if step is None:
        return values
    with np.errstate(divide="ignore"):  # a delay's poles are at z = 0
        return np.asarray(np.log(values) / step)


def _ringing(stage: LinearStage, axes: int) -> Iterator[tuple[complex, float]]:
    """Poles of the resonances of a stage, and their peaks."""
    step = stage.sample_time if isinstance(stage, StateSpace) else None
    for system in stage.systems(axes):
        values, right, left = _modal(system.A)
        poles = _rates(values, step)
        for index in np.flatnonzero(_rings(poles) & (poles.imag > 0.0)):
            beside = 1e-9 * abs(poles[index]) + 1j * poles[index].imag  # of the axis, where a mode without damping has its pole
            at = complex(beside if step is None else np.exp(beside * step))
            pair = np.isclose(values, values[index], rtol=1e-6, atol=0.0)
            part = (system.C @ right[:, pair]) @ (_dual(right[:, pair], left[pair]) @ system.B) / (at - values[index])
            above = 1.0 + poles[index].real / (WELL_DAMPED * abs(poles[index]))
            yield complex(poles[index]), above * float(np.linalg.norm(part) / max(float(np.linalg.norm(_at(system, at))), 1e-300))
