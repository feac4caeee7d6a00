# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A vibration without a waveform among the findings: which residual shows it, and what is left beside it, by the evidence alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hyst_control.diagnose.configuration import Thresholds
from hyst_control.diagnose.decide.record_findings import residual_of
from hyst_control.diagnose.evidence import Evidence, Finding, HumpEvidence
from hyst_control.diagnose.record_checks.summary import effect_found_by
from hyst_control.effects.effect import RecordCheck

LESS_SURE = 2.0 * (35.0 / 18.0) ** 0.5
"""Relative error of a width over that of a size: a size is the root of an energy, and a width is read under a Hann window."""


def vibration_found(evidence: Evidence, first: int, left: float, thresholds: Thresholds) -> int | None:
    """Find the hypothesis whose residual shows a vibration without a waveform, where the best explanation leaves too much.

    As a model of the noise the hump competes with effects by its likelihood: what a waveform explains, a spectrum explains less well.
    """
    if RecordCheck.SPECTRAL_HUMP not in evidence.checks or left <= thresholds.unknown_share:
        return None
    effect = effect_found_by(RecordCheck.SPECTRAL_HUMP)
    named = effect is not None and effect.name in evidence.hypotheses[first].names
    alone, beside = _clear(evidence, 0, thresholds), None if named else _clear(evidence, first, thresholds)
    if alone is None:
        return None if beside is None else first
    if beside is not None and alone.misfit - beside.misfit > evidence.null + thresholds.margin:
        return first
    if named and len(evidence.hypotheses[first].names) == 1:
        return 0  # the name is the same, and a line that changes leaves more of a wide hump
    return 0 if first == 0 or alone.gain > evidence.hypotheses[0].misfit - evidence.hypotheses[first].misfit else None


def vibration(hump: HumpEvidence, noise: float) -> Finding:
    """Finding of a vibration without a waveform."""
    rms, low, high = (noise * size for size in (hump.rms, *hump.ci90))
    times = (hump.ci90[1] / hump.rms) ** LESS_SURE
    sine = float(np.sqrt(2.0))
    return Finding(
        RecordCheck.SPECTRAL_HUMP,
        0,
        sine * rms,
        (sine * low, sine * high),
        rms,
        hump.gain,
        (
            ("frequency", hump.frequency, hump.frequency_ci90, "Hz"),
            ("width", hump.width, (hump.width / times, hump.width * times), "Hz"),
        ),
    )


def without_vibration(evidence: Evidence, thresholds: Thresholds) -> Evidence:
    """Take a vibration's energy off what hypotheses leave."""
    residuals = {}
    for index, one in enumerate(evidence.hypotheses):
        hump = None if one.residual is None else _clear(evidence, index, thresholds)
        if one.residual is not None and hump is not None:
            residuals[index] = replace(one.residual, energy=min(one.residual.energy, hump.left))
    return evidence.with_residuals(residuals)


def _clear(evidence: Evidence, index: int, thresholds: Thresholds) -> HumpEvidence | None:
    """The hump in what a hypothesis leaves, where it is one, of practical size, and none by chance."""
    hump = residual_of(evidence, index).hump
    if hump is None or not hump.plausible:
        return None
    large = hump.rms > max(evidence.floor, thresholds.flicker_size)
    return hump if large and hump.gain > evidence.null + thresholds.margin + thresholds.flicker_margin else None
