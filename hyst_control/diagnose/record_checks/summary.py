# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Checks that fit nothing, and come first: repeated samples, the value grid of a converter, excess noise, single samples that stand out.

They measure; the policy says which of them found something.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.configuration import CONFIGURATION, CheckSettings, NoiseSettings
from hyst_control.diagnose.evidence import Finding, RecordEvidence
from hyst_control.diagnose.noise.white import noise_of
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.record_checks.repeated_values import level_crossings, repeated_samples, stuck_stretches
from hyst_control.effects import EFFECTS
from hyst_control.effects.effect import Effect, RecordCheck
from hyst_control.records.quantization_step import quantization_step

NORMAL_95 = 1.645  # 95 % quantile of the normal distribution: half a 90 % interval


def effect_found_by(check: RecordCheck) -> Effect | None:
    """Effect of the catalogue that a check finds."""
    return next((effect for effect in EFFECTS.values() if check in (effect.record_check, effect.random_check)), None)


def lattice_of(values: Annotated[Array, "N"], settings: CheckSettings = CONFIGURATION.checks) -> float:
    """Step of the value grid that all values lie on."""
    return quantization_step(
        values,
        fewest=settings.lattice_levels,
        crowding=settings.lattice_crowding,
        spread=settings.lattice_spread,
        off=settings.lattice_off,
        share=settings.lattice_share,
    )


def record_evidence(
    problem: Problem,
    residuals: Annotated[Array, "M A"],
    settings: CheckSettings = CONFIGURATION.checks,
    noise_settings: NoiseSettings = CONFIGURATION.noise,
) -> tuple[RecordEvidence, ...]:
    """Measure repeated samples and the value grid of a problem's records."""
    lattice = effect_found_by(RecordCheck.VALUE_LATTICE)
    modelled = lattice is not None and any(stage.name == lattice.name for stage in problem.model.chain.stages)
    found = []
    for axis in range(len(problem.model.axes)):
        values = np.concatenate([piece.counted(piece.readings)[:, axis] for piece in problem.pieces])
        noise = noise_of([residuals[:, axis]], settings=noise_settings)
        step = lattice_of(values, settings)
        share, count = repeated_samples(values, step, noise, settings)
        rms = float(np.sqrt(share * np.mean(np.abs(np.diff(values)) ** 2)))
        rough = problem.roughness[axis] if problem.roughness else None
        # A function has no stages to look at.
        grid = lattice_of(problem.rows(problem.simulate(problem.model.chain.stages))[:, axis], settings) if step else 0.0
        own = modelled or abs(grid - step) < settings.lattice_off * step
        rows = [(piece.counted(piece.command)[:, axis], piece.counted(piece.readings)[:, axis]) for piece in problem.pieces]
        simulated = np.split(values - residuals[:, axis], np.cumsum([len(measured) for _, measured in rows])[:-1])
        passages = level_crossings([(one, measured) for one, (_, measured) in zip(simulated, rows, strict=True)], step, noise)
        stuck = max(stuck_stretches(rows, step, noise), passages)
        found.append(RecordEvidence(len(values), share, count, rms, step, own, noise, roughness=rough, stuck=stuck))
    return tuple(found)


def held_samples(seen: RecordEvidence, axis: int) -> Finding:
    """Finding of repeated samples."""
    share, count = seen.repeated, seen.repeats_counted
    spread = NORMAL_95 * np.sqrt(share * (1 - share) / count)
    interval = (float(share - spread), float(share + spread))
    return Finding(RecordCheck.REPEATED_VALUES, axis, share, interval, seen.repeated_rms, share * count)


def rounding(seen: RecordEvidence, axis: int) -> Finding:
    """Finding of a value grid of values."""
    step = seen.step
    interval = (step * 0.999, step * 1.001)
    return Finding(RecordCheck.VALUE_LATTICE, axis, step, interval, float(step / np.sqrt(12.0)), float(seen.samples))


def rounded_command(seen: RecordEvidence, axis: int) -> Finding:
    """Finding of a recorded command that is rough as a rounded one, which the plant did not receive."""
    rough = seen.roughness
    assert rough is not None
    step = float(np.sqrt(12.0)) * rough.rms
    # Variance of the mean square of a uniform variable, and of how much is not known to be missing.
    error = NORMAL_95 * step * float(np.hypot(np.sqrt(0.2 / rough.samples), rough.deviation))
    gain = 0.5 * (rough.coefficient / rough.deviation) ** 2
    return Finding(RecordCheck.COMMAND_LATTICE, axis, step, (step - error, step + error), rough.response, gain)


def excess_noise(noise: float, stated: float, others: Sequence[Finding], axis: int, bins: float, ratio: float) -> Finding | None:
    """White noise beyond what the model states."""
    if stated <= 0:
        return None
    bare = float(np.sqrt(max(noise**2 - sum(finding.rms**2 for finding in others), 0.0)))
    if not bare > ratio * stated:
        return None
    rms = float(np.sqrt(bare**2 - stated**2))
    error = float(NORMAL_95 * bare**2 / rms / np.sqrt(bins))
    gain = bins * (np.log(stated / bare) + 0.5 * (bare / stated) ** 2 - 0.5)
    return Finding(RecordCheck.WHITE_SPECTRUM, axis, rms, (max(rms - error, 0.0), rms + error), rms, float(gain))


def outliers(
    residual: Annotated[Array, "N"], settings: CheckSettings = CONFIGURATION.checks, step: float = 0.0
) -> tuple[int, float]:
    """Single samples of a residual that stand out of their neighbors as no white noise does, and no rounding to some step.

    Against the mean of both neighbors, in robust standard deviations: what is smooth, steps or falls with frequency stands out little.
    """
    inner = residual[1:-1] - 0.5 * (residual[:-2] + residual[2:])
    scale = 1.4826 * float(np.median(np.abs(inner - np.median(inner))))
    size = np.pad(np.abs(inner), 1)
    apart = (size > max(settings.outlier_deviations * scale, 1.5 * step)) & (size >= np.roll(size, 1)) & (size >= np.roll(size, -1))
    return int(apart.sum()), float(np.sqrt(np.sum(size[apart] ** 2) / len(residual)))
