# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence of a diagnosis: numbers only, measured by code that decides nothing, on which the policy decides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hyst_control.effects.effect import RecordCheck


@dataclass(frozen=True)
class RoughnessEvidence:
    """Roughness of a recorded command, and how much of it the plant received."""

    samples: int  # Samples of the command
    rms: float  # Size of the roughness, V
    share: float  # Its energy in that of the smooth command
    # Largest correlation with itself one, two or three samples later: 0 for white roughness
    correlation: float
    # 95 % quantile of its size over the median: 1.9 where it is uniform, 2.9 where it is normal
    tail: float
    # Of the residual on what the model makes of the roughness: -1 where the plant did not receive it, 0 where it did
    coefficient: float
    deviation: float  # Standard deviation of the coefficient
    bands: tuple[tuple[float, float], ...]  # The same in bands of frequency, the lowest first
    # Largest coefficient of the same later or earlier, on what is left where the plant did not receive it
    echo: float
    response: float  # What the model makes of the roughness, rms, measurement unit


@dataclass(frozen=True)
class RecordEvidence:
    """Record of one axis, looked at without a fit of effects."""

    samples: int  # Samples that count
    # Share of the samples that repeat the one before exactly, beyond what a lattice explains
    repeated: float
    repeats_counted: int  # Samples that this share was counted on
    repeated_rms: float  # Error (rms, measurement unit) that repeated samples bring
    step: float  # Step of the lattice that all values lie on, measurement unit; 0 without a lattice
    step_modelled: bool  # Whether the model has a lattice of its own
    noise: float  # White noise (rms, measurement unit) in what the coefficients leave
    usual_repeated: float = 0.0  # The same share of repeated samples in baseline records
    usual_step: float = 0.0  # Step of their lattice, measurement unit; 0 without one
    # That of a command that the plant did not receive; None of any other
    roughness: RoughnessEvidence | None = None
    usual_roughness: float = 0.0  # Its size (rms, V) in baseline records; 0 without one
    # Stretches that stand on one and the same value while the command moves, where they are most of the repeated samples; else 0
    stuck: int = 0
    usual_stuck: int = 0  # The same in baseline records


@dataclass(frozen=True)
class FlickerEvidence:
    """1/f noise beside white noise in a residual, all in the residual's unit."""

    rms: float  # Size of the 1/f noise
    ci90: tuple[float, float]  # 90 % interval of the size
    white: float  # Size (rms) of the white noise
    gain: float  # Gain in log-likelihood over white noise alone, nats
    # Whether the spectrum has that shape, and is about the same where the command rests and where it moves
    plausible: bool
    top: float  # Share of the 1/f noise in the power at the highest frequencies


@dataclass(frozen=True)
class HumpEvidence:
    """A hump in a residual's spectrum: a vibration whose phase wanders."""

    frequency: float  # Of its top, Hz
    frequency_ci90: tuple[float, float]  # 90 % interval, Hz
    width: float  # At half its height, Hz
    rms: float  # Size, in units of the noise
    ci90: tuple[float, float]  # 90 % interval of the size
    gain: float  # Gain in log-likelihood over white noise of the same floor, nats
    misfit: float  # Of the residual by Whittle's likelihood of noise and hump, nats
    left: float  # Energy of the residual without it, in units of the residual
    # Whether it is wider than a line, has the shape of a hump, and does not follow the command
    plausible: bool


@dataclass(frozen=True)
class ResidualEvidence:
    """Remainder that a hypothesis leaves."""

    energy: float  # Mean square in noise energies, without what the hypothesis' effects leave by nature
    white: tuple[float, ...]  # White noise (rms, measurement unit) by axis
    outliers: tuple[int, ...]  # Single samples that stand out of the noise, by axis
    outliers_rms: tuple[float, ...]  # Error (rms, measurement unit) that they bring, by axis
    # 1/f noise, in units of the noise; None where it was not looked for
    flicker: FlickerEvidence | None = None
    predictable: float = 1.0  # Share of it that follows the command; 1 where it was not looked for
    # As this hypothesis has them; none without baseline records
    companions: tuple[CompanionEvidence, ...] = ()
    # A vibration whose phase wanders; None where none stands out, or none was looked for
    hump: HumpEvidence | None = None


@dataclass(frozen=True)
class CompanionEvidence:
    """Session effect of all hypotheses, which differs from session to session, as the best explanation has it."""

    effect: str  # Its name among the effects
    parameter: str  # Of that effect
    axis: int  # Index in the problem
    value: float  # Relative to the baseline records, measurement unit
    deviation: float  # Standard deviation, measurement unit
    usual: float  # Largest size that is usual from session to session; NaN where nothing says what is
    rms: float  # Error that it brings, measurement unit

    @property
    def ci90(self) -> tuple[float, float]:
        """90 % interval."""
        return self.value - 1.645 * self.deviation, self.value + 1.645 * self.deviation


@dataclass(frozen=True)
class HypothesisEvidence:
    """Fit of a hypothesis: no effect, coefficients alone, or effects."""

    names: tuple[str, ...]  # Effects; none for the nominal model and for coefficients alone
    coefficients_alone: bool  # Whether the coefficients may leave their tolerance, with no effect
    score: float  # Evidence over "no effect", nats
    misfit: float  # Penalized misfit, nats: that of the model discrepancy's bins by as much as they are independent
    energy: float  # Mean square of the residual, noise energies
    strain: float  # Part of the misfit that is the coefficients' distance from the nominal ones, nats
    residual: ResidualEvidence | None = None  # Only of the hypotheses that the policy may choose
    farthest: float = 0.0  # Distance of the coefficient that is farthest from its nominal value, tolerances
    # Whether the size of one of its effects is at the end of the range that the catalogue gives it
    at_bound: bool = False
    # Energy that its coefficients take off by what of their distance is not believed, noise energies
    taken_up: float = np.inf
    # Reduction of the energy, at the frequencies that it changes if that is more, noise energies; None: at all frequencies
    reduction: float | None = None
    # Axis of each effect, None where it is on all; empty where the record has one axis
    axes: tuple[int | None, ...] = ()

    @property
    def together(self) -> int:
        """Most effects that act on one axis."""
        return max((sum(own in (None, axis) for own in self.axes) for axis in self.axes), default=len(self.names))


@dataclass(frozen=True)
class Evidence:
    """Evidence on one problem: an axis, or all axes of a model that mixes them."""

    hypotheses: tuple[HypothesisEvidence, ...]  # "No effect" first
    # Weight of a sample, at most 1: less where even the best hypothesis leaves more than noise
    temper: float
    coefficients: int  # Number of uncertain coefficients
    null: float  # Score that the best hypothesis stays under on simulated records without a gap, nats
    # Practical size: the rms, in units of the noise, that an effect must take off to be worth naming
    floor: float
    stated: float  # Energy that the model itself says it leaves, noise energies, at least 1
    noise: tuple[float, ...]  # Noise floor (rms, measurement unit) by axis
    # Noise (rms, measurement unit) that the model states, by axis; 0 where it states none
    stated_noise: tuple[float, ...]
    rows: int  # Rows that count, after those that only repeat the one before were left out
    noise_bins: float  # Bins of the spectrum that the noise was read from
    record: tuple[RecordEvidence, ...] = ()  # By axis
    checks: frozenset[RecordCheck] = frozenset()  # Checks whose effect is in the catalogue
    weight: float = 1.0  # Weight of a sample in the fits, below 1 where they know of the model discrepancy
    # True where a single baseline record is carried over, so that its own noise is in the residual and nobody knows how much that is
    clean_noise: bool = False
    # True where the fits know the spectrum of the model discrepancy: energies are then in units of it and the noise together
    whitened: bool = False
    repeating: frozenset[str] = frozenset()  # Names of the effects that repeat values by themselves
    lines: frozenset[str] = frozenset()  # Names of the effects that are fitted only where a line stands out of a spectrum
    # True where the model discrepancy is carried over from a baseline record of the same command, so that it is in no residual
    carried: bool = False
    # Effects that become a simpler one at an end of their ranges, each with that one
    ends_as: tuple[tuple[str, str], ...] = ()
    # Effects that simpler ones may stand for, each with one of these
    plainer: tuple[tuple[str, str], ...] = ()
    # Rms by which the coefficients of "no effect" move the simulation, beyond the model discrepancy, as a share of the range
    moved: float = 0.0
    nominal: float = 0.0  # Energy of the nominal model's residual, with no coefficient moved, noise energies

    def before(self, chosen: int) -> float:
        """Energy that an explanation begins with: coefficients alone also take off what moves them in "no effect"."""
        least = self.hypotheses[0].energy
        return max(least, self.nominal) if self.hypotheses[chosen].coefficients_alone else least

    def with_residuals(self, residuals: Mapping[int, ResidualEvidence]) -> Evidence:
        """Add what hypotheses leave."""
        return replace(
            self,
            hypotheses=tuple(
                replace(hypothesis, residual=residuals[index]) if index in residuals else hypothesis
                for index, hypothesis in enumerate(self.hypotheses)
            ),
        )


@dataclass(frozen=True)
class Finding:
    """Effect without a waveform on an axis, measured by a check of the record."""

    check: RecordCheck  # The check, which tells the effect
    axis: int  # Index in the problem
    value: float  # Value of the effect's one parameter, or its first
    ci90: tuple[float, float]  # 90 % interval of the value
    rms: float  # Error that it brings, measurement unit
    gain: float  # Evidence for it, nats
    # Name, value, 90 % interval and unit of further parameters
    further: tuple[tuple[str, float, tuple[float, float], str], ...] = ()


@dataclass(frozen=True)
class Outliers:
    """Single samples on an axis that stand out of the noise: how many, and the error (rms, measurement unit) that they bring."""

    axis: int
    count: int
    rms: float
