# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Configuration of the diagnosis: every number that was tuned, by group, with its unit and its meaning.

The values were set on seeds below 1000 of the blind test and frozen before scoring. What is no matter of tuning stays where it is used:
difference steps and stopping rules of the fits, guards against division by zero, factors of a window or of an interval's quantile.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the policy, which turns evidence into a verdict."""

    practical_size: float = 0.0001  # share of the measurement's range, rms: least that an effect must remove
    stated_excess: float = 0.3  # The same, as a share of what the stated noise exceeds the measured noise by
    rounding_share: float = 0.3  # The same, as a share of a converter's rounding error
    margin: float = 3.0  # nats: score above the 99 % quantile of the simulated null that a claim needs
    sharpness: float = 0.5  # Factor of the scores before they become probabilities
    sure_probability: float = 0.85  # Probability from which one hypothesis is named alone
    listed_probability: float = 0.05  # Probability from which a hypothesis is listed among what the data cannot separate
    unknown_share: float = 0.06  # share of the gap's energy: most that the best hypothesis may leave before it is called unknown
    # share of the gap's energy: most that a hypothesis by effects leaves, or removes by coefficients many tolerances away
    named_unexplained_share: float = 0.1
    # Clearest sign of an unknown effect, as a multiple of its rule's threshold, beyond which the verdict is unknown: conformal, of
    # single effects on tuning seeds at most 4 % exceed it
    novelty_threshold: float = 0.991
    max_effects: int = 2  # effects: most that may act together on an axis; beyond, an effect outside the catalogue is likelier
    # share of the measurement's range, rms: most that coefficients within their tolerance move a simulation without a gap
    moved_share: float = 0.03
    added_share: float = 0.002  # Share of all that a combination removes which each of its effects must add
    noise_deviations: float = 3.0  # standard errors of the noise's estimate: energy beyond the noise's that is no chance
    min_excess: float = 0.1  # share of the noise's energy: energy beyond the noise's under which nothing is called unknown
    # stated energies: energy that does not follow the command up to which it is the repeatability of the plant
    run_to_run: float = 4.0
    own_error_share: float = 0.5  # Share of the model discrepancy that is stated which an effect must remove
    own_error_energy: float = 1.5  # noise energies: stated energy from which a model is taken to state an error of its own
    # share of the model discrepancy's energy: least excess noise that is named beside an error whose spectrum is unknown
    noise_own_share: float = 0.01
    # standard deviations: chi-square of the coefficients above its mean from which they are strained
    strain_deviations: float = 4.0
    many_tolerances: float = 5.0  # tolerances: distance of a coefficient from which a known effect that does the same is named
    repeats: float = 10.0  # samples: repeated samples from which the record has held samples
    stuck: int = 2  # stretches: stretches on one value from which the sensor does not follow: none comes back by chance
    repeated_share: float = 0.002  # The same, as a share of the samples
    lattice_noise: float = 0.2  # noise rms: rounding error from which a lattice is a quantization
    beyond_clean: float = 2.0  # Times as much as in baseline records from which repeats, a lattice or a rough command are new
    rough_share: float = 0.5  # share of the smooth command's energy: most that a roughness of the command may have
    rough_correlation: float = 0.2  # Most that it may be correlated from sample to sample
    rough_tail: float = 2.4  # median size: 95 % quantile of its size up to which it is uniform (1.9), and not normal (2.9)
    rough_deviations: float = 8.0  # standard deviations: coefficient from which it is known whether the plant received it
    rough_received: float = 0.2  # Most of it that the plant may have received, in any band and at any time
    rough_scatter: float = 4.0  # standard deviations: the same where its coefficient is known less well
    excess_ratio: float = 1.15  # stated rms: noise from which it exceeds the stated one: that is never stated better
    many_outliers: float = 0.03  # share of the samples: samples that stand out up to which they are outliers
    outliers_share: float = 0.7  # share of the excess noise, rms: size of the outliers from which they are what the excess noise is
    flicker_margin: float = 5.0  # nats: gain of 1/f noise above what a claim needs
    flicker_size: float = 0.1  # noise rms: least 1/f noise that is named
    # noise rms: the same beside a single baseline record, whose own 1/f noise is unknown, and adds to that of the residual
    flicker_size_beside_one: float = 2.0
    flicker_hides: float = 0.3  # share of the power: 1/f noise at the top of the spectrum from which it hides the white noise
    companion_deviations: float = 5.0  # standard deviations: size from which a session's zero or drift is named
    flicker_white: float = 1.5  # Divisor of the white noise beside 1/f noise: what levels off at the top looks white


@dataclass(frozen=True)
class RecordSettings:
    """Records that can be used."""

    min_rows: int = 200  # samples: shortest gapless stretch that is used
    memory_part: int = 3  # 1/parts: first part of a stretch after missing ticks that does not count: the hysteresis' memory fills


@dataclass(frozen=True)
class NoiseSettings:
    """Noise floor."""

    least: float = 2e-05  # share of the range, rms: noise under which none is believed: numbers are rounded, models discretized
    # share of the Nyquist frequency: upper part of the spectrum that the noise is read from
    band: tuple[float, float] = (0.6, 0.98)
    rests_below: float = 0.85  # Share of the whole record's noise below which that of the rests is believed: they are short
    rest_samples: int = 400  # samples: shortest rest whose spectrum is used; two of them are needed in all
    rest_part: int = 3  # 1/parts: first part of a rest that does not count: it still settles
    copied_share: float = 0.5  # share of the samples: samples equal in two periods from which one is a copy of the other


@dataclass(frozen=True)
class CheckSettings:
    """Checks of the record without a fit."""

    lattice_levels: int = 2  # levels: fewest levels of a lattice
    lattice_crowding: float = 0.7  # levels per sample: most levels of a lattice
    lattice_spread: float = 1.5  # smallest step: distances of levels up to which they are one step
    lattice_off: float = 0.001  # steps: distance from the lattice up to which a level lies on it
    lattice_share: float = 0.999  # share of the levels: levels that must lie on the lattice
    repeat_smoothing: int = 5  # samples: mean that the motion on a lattice is read from
    repeat_motion: float = 6.0  # steps per sample: motion from which a repeated value on a lattice says something
    repeat_reach: int = 7  # samples: samples around that must move as well
    repeat_samples: int = 200  # samples: fewest samples that repeats are counted on
    repeat_chance: float = 3.0  # Times as often as by chance that neighbors must coincide to be held samples
    repeat_window: int = 11  # samples: samples around whose motion says how often neighbors coincide by chance
    outlier_deviations: float = 7.0  # robust standard deviations: distance from both neighbors from which a sample stands out
    line_ratio: float = 40.0  # power of the spectrum around: power of a line that is suggested (chance: 1 in e^ratio per bin)
    mains_ratio: float = 20.0  # power of the spectrum around: the same at the mains frequency
    mains_width: float = 0.7  # Hz: distance from the mains frequency, or a harmonic, that belongs to it
    mains_bins: float = 1.2  # bins: the same on a short record, at the mains frequency
    mains_harmonic_bins: float = 2.0  # bins: the same on a short record, around the harmonics where no other line is suggested
    mains_harmonics: tuple[int, ...] = (1, 2, 3, 5, 7)  # orders: harmonics of the mains that are no other line
    clean_line: float = 3.0  # amplitude in a baseline record: amplitude from which a line that baseline records have too is new
    truncation: float = 0.15  # steps: distance of a mean error from half a step up to which a converter rounds down or up
    lattice_ratio: float = 20.0  # power of the spectrum around: power over the command from which a lattice of it is suggested
    lattice_bins: int = 16384  # bins: bins of the command's range for that spectrum
    lattice_response: int = 100  # samples: length of the plant's response that the record is filtered with for it
    lattice_least: float = 4.0  # steps: fewest steps of a lattice over the command's range
    lattice_steps: int = 4  # steps: most steps of a lattice that are suggested
    lowest_line_bins: float = 4.0  # bins: frequency from which a line is suggested
    driven_share: float = 0.001  # share of the command's largest power: power of the command from which it drives a frequency
    driven_ratio: float = 8.0  # power of the spectrum around: the same, where it is a line of the command
    fundamental_bins: float = 10.0  # bins: frequency from which a fundamental of the command is resolved
    first_harmonics: int = 5  # orders: harmonics of a fundamental that is not resolved at which no line is suggested
    harmonic_bins: float = 2.5  # bins: distance from a harmonic of the command that belongs to it
    # fundamentals: the same: the first that holds the command's power counts
    harmonic_widths: tuple[float, ...] = (0.0, 0.05, 0.15)
    harmonic_power: float = 0.9  # share of the command's power: power near the harmonics from which the command is nearly one sine
    background_bins: int = 40  # bins: reach to either side of the spectrum around a line
    same_line_bins: float = 2.0  # bins: distance up to which two lines are one


@dataclass(frozen=True)
class FlickerSettings:
    """Estimation of 1/f noise."""

    segments: int = 24  # segments: parts of the record compared between rest and motion
    # Powers of the frequency with which it may fall, the usual one first
    exponents: tuple[float, ...] = (1.0, 0.7, 0.85, 1.15, 1.3, 1.6)
    exponent_margin: float = 5.0  # nats: gain from which another power than the usual one counts
    bands_per_octave: int = 3  # bands: bands of the spectrum
    # natural logarithm, rms: most that bands may be off a + b/f^p, each weighed by this and chance together
    shape_misfit: float = 0.35
    colored_share: float = 0.3  # share of the power: 1/f part from which a band counts for the shape
    min_bands: int = 4  # bands: fewest bands that count for the shape
    slow_corner: float = 0.1  # share of the Nyquist frequency: corner of the low-pass before rest and motion are compared
    motion_ratio: float = 4.0  # Most energy in motion over that at rest: more follows the command
    jump: float = 6.0  # standard deviations: step from one sample to the next from which it is a jump, as noise has none
    few_jumps: int = 2  # jumps: jumps up to which a residual is noise


@dataclass(frozen=True)
class HumpSettings:
    """Estimation of a vibration whose phase wanders."""

    lowest_bins: int = 4  # bins: frequency from which a hump is looked for
    min_half_width: float = 2.0  # bins: half width from which a hump is none of a line
    max_half_width: float = 0.1  # share of the frequency: half width up to which noise is of a narrow band
    min_gain: float = 20.0  # nats: gain from which a hump is fitted: a running mean over the white noise
    starts: int = 2  # widths: widths at which fits begin
    colored_share: float = 0.3  # share of the power: part of the hump from which a band counts for the shape
    narrowest_band: float = 0.5  # half widths: width of the bands at its top; the others widen from there
    bands: int = 12  # bands: bands on either side
    min_bands: int = 4  # bands: fewest bands that count for the shape
    # natural logarithm, rms: most that bands may be off the hump, each weighed by this and chance together
    shape_misfit: float = 0.35
    segments: int = 24  # segments: most parts of the record compared between rest and motion
    min_segments: int = 9  # segments: fewest parts that are compared
    motion_ratio: float = 4.0  # Most energy in motion over that at rest: more follows the command
    followed: float = 0.5  # share of the power: part of the hump from which it follows the command


@dataclass(frozen=True)
class SearchSettings:
    """Search for hypotheses."""

    beam: int = 3  # hypotheses: hypotheses that a further effect is added to
    beam_with_own_error: int = 5  # hypotheses: the same where the fits know of the model discrepancy: more effects are alike
    depth: int = 3  # effects: most effects of a hypothesis
    depth_with_own_error: int = 2  # effects: the same where the model states an error of its own: finer parts cannot be identified
    followed: int = 2  # starts: starts of an effect that are fitted to the end
    first: int = 6  # fits: fits beside linear coefficients that are finished first: others while they may come near the best
    slack: float = 0.01  # share of what the best removes: most that a fit beside linear coefficients may be off
    near: float = 50.0  # nats: the same, at least
    screened: int = 8  # starts: more starts of an effect are ranked first, by a linear step from each
    scanned: int = 12  # values: values of a parameter that are tried, and then as many between the best and its neighbors
    realizations: int = 8  # realizations: realizations without a number to fit that go on: those that come closest to the record
    promise: float = 0.5  # share of the threshold: least gain of a fit that is gone on with
    combinations: int = 8  # combinations: those of one effect more that are closest to the record to first order, and fitted
    laid_beside: int = 4  # starts: starts of an effect that are laid beside those of others for that
    spent: float = 0.03  # share of the noise's energy: energy beyond the noise's under which no further effect is looked for
    spent_floor: float = 0.5  # practical sizes squared: the same, of what is too small to be named
    # nats: cost of every parameter of an effect beyond the first, where the model states an error of its own
    own_error_parameter: float = 3.0
    # tolerances: how far nominal coefficients may be off in the hypothesis by coefficients alone, at first and at most
    inflation: float = 5.0
    most_inflation: float = 1e4


@dataclass(frozen=True)
class NullSettings:
    """Simulated null."""

    records: int = 200  # records: records without a gap that are drawn
    quantile: float = 0.99  # Quantile of the best score in them that a claim must exceed
    starts: int = 6  # starts: starts of an effect that are tried
    estimated_spectrum: float = 2.5  # Factor where the spectrum of the model discrepancy comes from a few baseline records


@dataclass(frozen=True)
class ReductionSettings:
    """Reduction on held-out blocks."""

    blocks: int = 20  # blocks: blocks of a record, every other of which is held out
    resamples: int = 400  # draws: draws of the bootstrap
    rounds: int = 4  # steps: most steps of a fit on one half


@dataclass(frozen=True)
class AttributionSettings:
    """Named effects and their intervals."""

    draws: int = 400  # draws: draws of the fit's covariance for an interval
    interval: float = 0.005  # share of the value: least width of an interval on either side: a stage is not the physics
    # degrees: of Student's t for intervals where the model's file alone states the model discrepancy: baseline records have two each
    freedom: float = 5.0
    coefficient_deviations: float = 2.0  # tolerances: distance from the nominal value from which a coefficient is listed
    candidate_probability: float = 0.0001  # Least probability of a candidate that is listed


@dataclass(frozen=True)
class BudgetSettings:
    """Shares of the gap by kind, band, amplitude, axis and time."""

    blocks: int = 24  # blocks: stretches that energies are summed over
    resamples: int = 300  # draws: draws of the bootstrap
    bands: tuple[float, ...] = (1.0, 10.0, 100.0, 1000.0)  # Hz: upper edges of the frequency bands but the last
    spans: int = 5  # spans: equal spans of time


@dataclass(frozen=True)
class ExperimentSettings:
    """Next experiment."""

    rivals: int = 3  # hypotheses: hypotheses that it is to separate
    distance: float = 3.0  # standard deviations: distance from which two hypotheses are distinguished
    duration: float = 1.0  # s: duration of an excitation


@dataclass(frozen=True)
class ReplaySettings:
    """Replay of recorded software blocks."""

    tolerance: float = 1e-06  # share of the range: departure within which a sum does what it should
    law_tolerance: float = 0.0001  # share of the range: departure within which a feedback law does what it should
    outlying: float = 5.0  # median departures: departure from which a tick is at a limit and left out


@dataclass(frozen=True)
class LiveTwinSettings:
    """Live twin."""

    noise_error: float = 1.1  # Factor that noise learned from few rows may by chance lie below the stated one


@dataclass(frozen=True)
class BaselineSettings:
    """Baseline records beside the new one."""

    same_command: float = 0.001  # share of the range, rms: difference up to which two commands are the same
    # share of the range, rms: difference up to which a model carries its error from one command to another
    similar_command: float = 0.02
    overlap: float = 0.5  # share of the new record: least part of it in which they are
    # share of what a model leaves that changes, in shares by which the motion of the command does
    error_slope: float = 8.0
    similar_overlap: float = 0.9  # share of the new record: the same of a command that is similar only
    # share of the range: standard deviation of the zero, drift and curvature of a session
    zero_share: tuple[float, ...] = (0.3, 0.05, 0.05)
    # share of its bins: independent values of a model discrepancy whose spectrum a model file states
    stated_independent: float = 0.05
    # share of the mean slope: standard deviation of the weights by which the initial memory of sessions differs
    memory_share: float = 0.2
    # share of the record: most rows that are left out beside a baseline record of the same command until this memory is wiped out
    memory_rows: float = 0.34
    unseen: float = 1.5  # model discrepancies: size of the model's error on a command on which it was not measured
    # share of the range: zero, drift and curvature that are usual where few baseline records are at hand
    usual_share: tuple[float, ...] = (0.1, 0.03, 0.03)
    same_floor: float = 0.15  # model discrepancy and noise, rms: least that an effect must remove
    # share of the motion, rms: what sessions differ by where a single baseline record without a period does not tell
    usual_repeatability: float = 0.003
    other_command: float = (
        0.35  # model discrepancies: size of an effect that is named where no baseline record has the same command
    )
    blocks: int = 10  # blocks: blocks of a record that a remainder is predicted on, each from the others


@dataclass(frozen=True)
class Configuration:
    """All groups."""

    policy: Thresholds = Thresholds()
    record: RecordSettings = RecordSettings()
    noise: NoiseSettings = NoiseSettings()
    checks: CheckSettings = CheckSettings()
    flicker: FlickerSettings = FlickerSettings()
    hump: HumpSettings = HumpSettings()
    search: SearchSettings = SearchSettings()
    null_distribution: NullSettings = NullSettings()
    reduction: ReductionSettings = ReductionSettings()
    attribution: AttributionSettings = AttributionSettings()
    budget: BudgetSettings = BudgetSettings()
    experiment: ExperimentSettings = ExperimentSettings()
    replay: ReplaySettings = ReplaySettings()
    live_twin: LiveTwinSettings = LiveTwinSettings()
    baseline: BaselineSettings = BaselineSettings()

    def digest(self) -> str:
        """Hash of all values, for the keys of caches."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()


CONFIGURATION = Configuration()  # The committed configuration
