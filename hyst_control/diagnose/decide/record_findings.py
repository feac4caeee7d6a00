# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Findings in a record itself: repeated samples, value grids, noise, single samples far off. Pure functions of the evidence."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from hyst_control.diagnose.configuration import Thresholds
from hyst_control.diagnose.evidence import (
    Evidence,
    Finding,
    FlickerEvidence,
    Outliers,
    RecordEvidence,
    ResidualEvidence,
    RoughnessEvidence,
)
from hyst_control.diagnose.record_checks.summary import excess_noise, held_samples, rounded_command, rounding
from hyst_control.effects.effect import RecordCheck


def detected(record: Sequence[RecordEvidence], checks: Collection[RecordCheck], thresholds: Thresholds) -> tuple[Finding, ...]:
    """Repeated samples, value grids and commands that were not received as recorded, which the fits have to know of."""
    found = []
    for axis, seen in enumerate(record):
        new = seen.repeated - seen.usual_repeated
        repeats = new * seen.repeats_counted > thresholds.repeats and seen.repeated > thresholds.repeated_share
        repeats &= seen.repeated > thresholds.beyond_clean * seen.usual_repeated
        if RecordCheck.REPEATED_VALUES in checks and repeats:
            found.append(held_samples(seen, axis))
        coarse = seen.step > 0 and seen.step / np.sqrt(12.0) > thresholds.lattice_noise * seen.noise
        coarse &= seen.step > thresholds.beyond_clean * seen.usual_step
        if RecordCheck.VALUE_LATTICE in checks and coarse and not seen.step_modelled:
            found.append(rounding(seen, axis))
        rough = seen.roughness is not None and seen.roughness.rms > thresholds.beyond_clean * seen.usual_roughness
        if RecordCheck.COMMAND_LATTICE in checks and rough:
            found.append(rounded_command(seen, axis))
    return tuple(found)


def not_received(seen: RoughnessEvidence, thresholds: Thresholds) -> bool:
    """True where a recorded command is rough as a rounded one is, and the plant did not receive that."""
    rounded = (
        seen.share < thresholds.rough_share
        and seen.correlation < max(thresholds.rough_correlation, thresholds.rough_scatter / float(np.sqrt(seen.samples)))
        and seen.tail < thresholds.rough_tail
    )

    def absent(received: float, deviation: float) -> bool:
        return abs(received) <= max(thresholds.rough_received, thresholds.rough_scatter * deviation)

    known = -seen.coefficient > thresholds.rough_deviations * seen.deviation
    within = absent(seen.coefficient + 1.0, 0.0) and all(absent(value + 1.0, spread) for value, spread in seen.bands)
    # Of many times at which an echo may come, the largest by chance is farther off than one is.
    chance = seen.deviation * float(np.sqrt(2.0 * np.log(seen.samples))) / max(thresholds.rough_scatter, 1e-300)
    return rounded and known and within and absent(seen.echo, chance + 0.25 * seen.deviation)


def findings(
    evidence: Evidence, chosen: int, noise: FlickerEvidence | None, thresholds: Thresholds
) -> tuple[tuple[Finding, ...], tuple[Outliers, ...]]:
    """Find effects without a waveform, and excess noise that is outliers."""
    holds = bool(evidence.repeating.intersection(evidence.hypotheses[chosen].names))
    found = [
        finding
        for finding in detected(evidence.record, evidence.checks, thresholds)
        if not (finding.check is RecordCheck.REPEATED_VALUES and (holds or is_stuck(evidence.record[finding.axis], thresholds)))
        and not _is_within_floor(finding, evidence, thresholds)
    ]
    outliers: list[Outliers] = []
    hidden = noise is not None and noise.top > thresholds.flicker_hides
    if RecordCheck.WHITE_SPECTRUM in evidence.checks and not hidden:
        residual = residual_of(evidence, chosen)
        for axis, measured in enumerate(residual.white):
            # What is rough in a command is in no residual, since fits go on without it.
            others = [one for one in found if one.axis == axis and one.check is not RecordCheck.COMMAND_LATTICE]
            if any(finding.check is RecordCheck.REPEATED_VALUES for finding in others):
                continue
            white = measured if noise is None else noise.white * evidence.noise[0] / thresholds.flicker_white
            more = excess_noise(white, evidence.stated_noise[axis], others, axis, evidence.noise_bins, thresholds.excess_ratio)
            count, rms = residual.outliers[axis], residual.outliers_rms[axis]
            few = count <= thresholds.many_outliers * evidence.rows
            # Where nobody states the noise, single samples that are nearly all of it are no noise either.
            whole = more.rms if more is not None else white if evidence.stated_noise[axis] <= 0.0 else np.inf
            if few and rms > thresholds.outliers_share * whole:
                outliers.append(Outliers(axis, count, rms))
            elif more is not None and not _is_own_error(more, evidence, thresholds):
                found.append(more)
    if noise is not None:
        scale = evidence.noise[0]
        low, high = noise.ci90
        rms = noise.rms * scale
        found.append(Finding(RecordCheck.FALLING_SPECTRUM, 0, rms, (low * scale, high * scale), rms, noise.gain))
    return tuple(found), tuple(outliers)


def flicker_found(evidence: Evidence, first: int, thresholds: Thresholds) -> FlickerEvidence | None:
    """Find 1/f noise in what the coefficients leave, if it explains more than the best explanation, else in what that leaves."""
    if RecordCheck.FALLING_SPECTRUM not in evidence.checks:
        return None
    for index in (0, first):
        seen = residual_of(evidence, index).flicker
        if seen is None or not seen.plausible:
            continue
        size = thresholds.flicker_size_beside_one if evidence.clean_noise else thresholds.flicker_size
        large = seen.rms > max(evidence.floor, size)
        if large and seen.gain > evidence.null + thresholds.margin + thresholds.flicker_margin:
            if index == first or outweighs(seen, evidence, first):
                return seen
    return None


def outweighs(noise: FlickerEvidence, evidence: Evidence, first: int) -> bool:
    """True where 1/f noise explains more than the best explanation does."""
    one = evidence.hypotheses[first]
    return not one.names or noise.gain > evidence.temper * (evidence.hypotheses[0].misfit - one.misfit)


def _is_own_error(noise: Finding, evidence: Evidence, thresholds: Thresholds) -> bool:
    """True where so little noise may as well be what the model leaves at high frequencies, of which only the whole size is known."""
    if evidence.whitened or evidence.clean_noise:
        return False
    return (noise.rms / evidence.noise[noise.axis]) ** 2 < thresholds.noise_own_share * (evidence.stated - 1.0)


def _is_within_floor(finding: Finding, evidence: Evidence, thresholds: Thresholds) -> bool:
    """True for rounding that is no gap where neither model nor baseline records say how much noise is usual."""
    usual = evidence.stated_noise[finding.axis] > 0.0 or evidence.whitened or evidence.carried or evidence.clean_noise
    if finding.check is not RecordCheck.VALUE_LATTICE or usual:
        return False
    noise = evidence.noise[finding.axis]  # with the rounding in it
    coarse = finding.rms**2 >= 0.5 * noise**2  # the rounding error is as large as the noise
    large = finding.rms > evidence.floor * noise
    share = finding.rms**2 > thresholds.unknown_share * evidence.nominal * noise**2  # less of a gap needs no explanation
    return not (coarse and large and share)


def is_stuck(seen: RecordEvidence, thresholds: Thresholds) -> bool:
    """True where the measurement comes back to one value again and again, and does not in baseline records."""
    return seen.stuck >= thresholds.stuck and seen.stuck > thresholds.beyond_clean * seen.usual_stuck


def share_of_outliers(evidence: Evidence, outliers: Outliers) -> float:
    """Compute the share of the gap's energy that is outliers, which no effect of the catalogue is."""
    energy = (outliers.rms / evidence.noise[outliers.axis]) ** 2 / len(evidence.noise)
    return float(np.clip(energy / max(evidence.hypotheses[0].energy - 1.0, 1e-12), 0.0, 1.0))


def residual_of(evidence: Evidence, index: int) -> ResidualEvidence:
    """Evidence on what a hypothesis leaves."""
    residual = evidence.hypotheses[index].residual
    if residual is None:
        raise ValueError(f"hypothesis {index}: collect the evidence on what it leaves before deciding")
    return residual
