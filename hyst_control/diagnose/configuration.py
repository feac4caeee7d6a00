# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Configuration of the diagnosis: every number that was tuned, by group, with its unit and its meaning.

The values stand in `configuration.yaml`, whose comments are made from the meanings here. What is no matter of tuning stays where it is
used: difference steps and stopping rules of the fits, guards against division by zero, factors of a window or of an interval's
quantile.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from hyst_control.base.errors import InputError
from hyst_control.base.quantity import INTEGER, LISTS, NUMBER, OF_TYPE, Quantity
from hyst_control.base.yaml_files import read_yaml

Group = TypeVar("Group")


SEEDS = Quantity("", None, "", "seeds of the blind test on which the values were set", kind=INTEGER)


def _setting(unit: str, meaning: str) -> Any:
    return field(metadata={"quantity": Quantity("", None, "" if unit == "1" else unit, meaning, kind=NUMBER)})


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the policy, which turns evidence into a verdict."""

    practical_size: float = _setting("share of the measurement's range, rms", "least that an effect must take off")
    stated_excess: float = _setting("1", "the same, as a share of what the stated noise exceeds the measured noise by")
    rounding_share: float = _setting("1", "the same, as a share of a converter's rounding error")
    margin: float = _setting("nats", "score above the 99 % quantile of the simulated null that a claim needs")
    sharpness: float = _setting("1", "factor of the scores before they become probabilities")
    sure_probability: float = _setting("1", "probability from which one explanation is named alone")
    listed_probability: float = _setting("1", "probability from which an explanation is listed among what the data cannot separate")
    unknown_share: float = _setting(
        "share of the gap's energy", "most that the best explanation may leave before it is called unknown"
    )
    named_unexplained_share: float = _setting(
        "share of the gap's energy",
        "most that an explanation by effects leaves, or takes off by coefficients many tolerances away",
    )
    novelty_threshold: float = _setting(
        "1",
        "clearest sign of an unknown effect, as a multiple of its rule's threshold, beyond which the verdict is unknown: conformal, "
        "of single effects on tuning seeds at most 4 % exceed it",
    )
    max_effects: int = _setting(
        "effects", "most that may act together on an axis; beyond, an effect outside the catalogue is likelier"
    )
    moved_share: float = _setting(
        "share of the measurement's range, rms", "most that coefficients within their tolerance move a simulation without a gap"
    )
    added_share: float = _setting("1", "share of all that a combination takes off which each of its effects must add")
    distortion_change: float = _setting("1", "change of an effect's size with a variable from which it is another effect")
    distortion_share: float = _setting("share of the energy that the effect explains", "least that this change must explain")
    distortion_whitened: float = _setting(
        "nats",
        "what such a change must gain where the fits know the spectrum of the model discrepancy: what the largest of four changes gains "
        "by chance in 4 % of the cases, and the margin",
    )
    min_excess: float = _setting("share of the noise's energy", "energy beyond the noise's under which nothing is called unknown")
    run_to_run: float = _setting(
        "stated energies", "energy that does not follow the command up to which it is the plant's variation from run to run"
    )
    own_error_share: float = _setting("1", "share of the error that a model states of itself which an effect must take off")
    own_error_energy: float = _setting("noise energies", "stated energy from which a model is taken to state an error of its own")
    noise_own_share: float = _setting(
        "share of the own error's energy", "least excess noise that is named beside an error whose spectrum is unknown"
    )
    under_own_error: float = _setting(
        "1", "weight of what stays under the model discrepancy: one shape, of which the bins of a record are hardly independent"
    )
    own_error_local: float = _setting(
        "energies of own error and noise",
        "what no effect must leave at an explanation's frequencies: fits follow the largest bins, of normal ones the mean is 3",
    )
    strain_deviations: float = _setting(
        "standard deviations", "chi-square of the coefficients above its mean from which they are strained"
    )
    many_tolerances: float = _setting(
        "tolerances", "distance of a coefficient from which a known effect that does the same is named"
    )
    repeats: float = _setting("samples", "repeated samples from which the record has held samples")
    stuck: int = _setting("stretches", "stretches on one value from which the sensor does not follow: none comes back by chance")
    repeated_share: float = _setting("1", "the same, as a share of the samples")
    lattice_noise: float = _setting("noise rms", "rounding error from which a lattice is a quantization")
    beyond_clean: float = _setting(
        "1", "times as much as in clean records from which repeats, a lattice or a rough command are new"
    )
    rough_share: float = _setting("share of the smooth command's energy", "most that a roughness of the command may have")
    rough_correlation: float = _setting("1", "most that it may be correlated from sample to sample")
    rough_tail: float = _setting("median size", "95 % quantile of its size up to which it is uniform (1.9), and not normal (2.9)")
    rough_deviations: float = _setting("standard deviations", "coefficient from which it is known whether the plant received it")
    rough_received: float = _setting("1", "most of it that the plant may have received, in any band and at any time")
    rough_scatter: float = _setting("standard deviations", "the same where its coefficient is known less well")
    excess_ratio: float = _setting("stated rms", "noise from which it exceeds the stated one: that is never stated better")
    many_outliers: float = _setting("share of the samples", "samples that stand out up to which they are outliers")
    outliers_share: float = _setting(
        "share of the excess noise, rms", "size of the outliers from which they are what the excess noise is"
    )
    flicker_margin: float = _setting("nats", "gain of 1/f noise above what a claim needs")
    flicker_size: float = _setting("noise rms", "least 1/f noise that is named")
    flicker_size_beside_one: float = _setting(
        "noise rms", "the same beside a single clean record, whose own 1/f noise nobody knows and is in the difference as well"
    )
    flicker_hides: float = _setting(
        "share of the power", "1/f noise at the top of the spectrum from which it hides the white noise"
    )
    companion_deviations: float = _setting("standard deviations", "size from which a session's zero or drift is named")
    flicker_white: float = _setting("1", "divisor of the white noise beside 1/f noise: what levels off at the top looks white")


@dataclass(frozen=True)
class RecordSettings:
    """Records that can be used."""

    min_rows: int = _setting("samples", "shortest gapless stretch that is used")
    memory_part: int = _setting(
        "1/parts", "first part of a stretch after missing ticks that does not count: the hysteresis' memory fills"
    )


@dataclass(frozen=True)
class NoiseSettings:
    """Noise floor."""

    least: float = _setting(
        "share of the range, rms", "noise under which none is believed: numbers are rounded, models discretized"
    )
    band: tuple[float, float] = _setting("share of the Nyquist frequency", "upper part of the spectrum that the noise is read from")
    rests_below: float = _setting(
        "1", "share of the whole record's noise below which that of the rests is believed: they are short"
    )
    rest_samples: int = _setting("samples", "shortest rest whose spectrum is used; two of them are needed in all")
    rest_part: int = _setting("1/parts", "first part of a rest that does not count: it still settles")
    copied_share: float = _setting("share of the samples", "samples equal in two periods from which one is a copy of the other")


@dataclass(frozen=True)
class CheckSettings:
    """Checks of the record without a fit."""

    lattice_levels: int = _setting("levels", "fewest levels of a lattice")
    lattice_crowding: float = _setting("levels per sample", "most levels of a lattice")
    lattice_spread: float = _setting("smallest step", "distances of levels up to which they are one step")
    lattice_off: float = _setting("steps", "distance from the lattice up to which a level lies on it")
    lattice_share: float = _setting("share of the levels", "levels that must lie on the lattice")
    repeat_smoothing: int = _setting("samples", "mean that the motion on a lattice is read from")
    repeat_motion: float = _setting("steps per sample", "motion from which a repeated value on a lattice says something")
    repeat_reach: int = _setting("samples", "samples around that must move as well")
    repeat_samples: int = _setting("samples", "fewest samples that repeats are counted on")
    repeat_chance: float = _setting("1", "times as often as by chance that neighbors must coincide to be held samples")
    repeat_window: int = _setting("samples", "samples around whose motion says how often neighbors coincide by chance")
    outlier_deviations: float = _setting(
        "robust standard deviations", "distance from both neighbors from which a sample stands out"
    )
    line_ratio: float = _setting("power of the spectrum around", "power of a line that is suggested (chance: 1 in e^ratio per bin)")
    mains_ratio: float = _setting("power of the spectrum around", "the same at the mains frequency")
    mains_width: float = _setting("Hz", "distance from the mains frequency, or a harmonic, that belongs to it")
    mains_bins: float = _setting("bins", "the same on a short record, at the mains frequency")
    mains_harmonic_bins: float = _setting(
        "bins", "the same on a short record, around the harmonics where no other line is suggested"
    )
    mains_harmonics: tuple[int, ...] = _setting("orders", "harmonics of the mains that are no other line")
    clean_line: float = _setting("amplitude in a clean record", "amplitude from which a line that clean records have too is new")
    truncation: float = _setting("steps", "distance of a mean error from half a step up to which a converter rounds down or up")
    lattice_ratio: float = _setting(
        "power of the spectrum around", "power over the command from which a lattice of it is suggested"
    )
    lattice_bins: int = _setting("bins", "bins of the command's range for that spectrum")
    lattice_response: int = _setting("samples", "length of the plant's response that the record is filtered with for it")
    lattice_least: float = _setting("steps", "fewest steps of a lattice over the command's range")
    lattice_steps: int = _setting("steps", "most steps of a lattice that are suggested")
    lowest_line_bins: float = _setting("bins", "frequency from which a line is suggested")
    driven_share: float = _setting("share of the command's largest power", "power of the command from which it drives a frequency")
    driven_ratio: float = _setting("power of the spectrum around", "the same, where it is a line of the command")
    fundamental_bins: float = _setting("bins", "frequency from which a fundamental of the command is resolved")
    first_harmonics: int = _setting("orders", "harmonics of a fundamental that is not resolved at which no line is suggested")
    harmonic_bins: float = _setting("bins", "distance from a harmonic of the command that belongs to it")
    harmonic_widths: tuple[float, ...] = _setting("fundamentals", "the same: the first that holds the command's power counts")
    harmonic_power: float = _setting(
        "share of the command's power", "power near the harmonics from which the command is nearly one sine"
    )
    background_bins: int = _setting("bins", "reach to either side of the spectrum around a line")
    same_line_bins: float = _setting("bins", "distance up to which two lines are one")


@dataclass(frozen=True)
class FlickerSettings:
    """Estimation of 1/f noise."""

    segments: int = _setting("segments", "parts of the record compared between rest and motion")
    exponents: tuple[float, ...] = _setting("1", "powers of the frequency with which it may fall, the usual one first")
    exponent_margin: float = _setting("nats", "gain from which another power than the usual one counts")
    bands_per_octave: int = _setting("bands", "bands of the spectrum")
    shape_misfit: float = _setting(
        "natural logarithm, rms", "most that bands may be off a + b/f^p, each weighed by this and chance together"
    )
    colored_share: float = _setting("share of the power", "1/f part from which a band counts for the shape")
    min_bands: int = _setting("bands", "fewest bands that count for the shape")
    slow_corner: float = _setting("share of the Nyquist frequency", "corner of the low-pass before rest and motion are compared")
    motion_ratio: float = _setting("1", "most energy in motion over that at rest: more follows the command")
    jump: float = _setting("standard deviations", "step from one sample to the next from which it is a jump, as noise has none")
    few_jumps: int = _setting("jumps", "jumps up to which a residual is noise")


@dataclass(frozen=True)
class HumpSettings:
    """Estimation of a vibration whose phase wanders."""

    lowest_bins: int = _setting("bins", "frequency from which a hump is looked for")
    min_half_width: float = _setting("bins", "half width from which a hump is none of a line")
    max_half_width: float = _setting("share of the frequency", "half width up to which noise is of a narrow band")
    min_gain: float = _setting("nats", "gain from which a hump is fitted: a running mean over the white noise")
    starts: int = _setting("widths", "widths at which fits begin")
    colored_share: float = _setting("share of the power", "part of the hump from which a band counts for the shape")
    narrowest_band: float = _setting("half widths", "width of the bands at its top; the others widen from there")
    bands: int = _setting("bands", "bands on either side")
    min_bands: int = _setting("bands", "fewest bands that count for the shape")
    shape_misfit: float = _setting(
        "natural logarithm, rms", "most that bands may be off the hump, each weighed by this and chance together"
    )
    segments: int = _setting("segments", "most parts of the record compared between rest and motion")
    min_segments: int = _setting("segments", "fewest parts that are compared")
    motion_ratio: float = _setting("1", "most energy in motion over that at rest: more follows the command")
    followed: float = _setting("share of the power", "part of the hump from which it follows the command")


@dataclass(frozen=True)
class SearchSettings:
    """Search for explanations."""

    beam: int = _setting("explanations", "explanations that a further effect is added to")
    beam_with_own_error: int = _setting(
        "explanations", "the same where the fits know of the model discrepancy: more effects are alike"
    )
    depth: int = _setting("effects", "most effects of an explanation")
    depth_with_own_error: int = _setting(
        "effects", "the same where the model states an error of its own: finer parts cannot be told"
    )
    followed: int = _setting("starts", "starts of an effect that are fitted to the end")
    first: int = _setting(
        "fits", "fits beside linear coefficients that are finished first: others while they may come near the best"
    )
    slack: float = _setting("share of what the best takes off", "most that a fit beside linear coefficients may be off")
    near: float = _setting("nats", "the same, at least")
    screened: int = _setting("starts", "starts of an effect that are looked at on top of another effect")
    scanned: int = _setting("values", "values of a parameter that are tried, and then as many between the best and its neighbors")
    realizations: int = _setting(
        "realizations", "realizations without a number to fit that go on: those that come closest to the record"
    )
    promising: int = _setting("effects", "effects that a linear step makes most of, added to an explanation")
    promise: float = _setting("share of the threshold", "least that such a step must gain")
    joint_pairs: int = _setting(
        "pairs", "pairs that are closest to the record to first order and fitted, beside clean records of one axis"
    )
    joint_starts: int = _setting("starts", "starts of an effect that are laid beside those of another for that")
    spent: float = _setting("share of the noise's energy", "energy beyond the noise's under which no further effect is looked for")
    spent_floor: float = _setting("practical sizes squared", "the same, of what is too small to be named")
    own_error_parameter: float = _setting(
        "nats", "cost of every parameter of an effect beyond the first, where the model states an error of its own"
    )
    inflation: float = _setting("tolerances", "how far nominal coefficients may be off in the explanation by coefficients alone")


@dataclass(frozen=True)
class NullSettings:
    """Simulated null."""

    records: int = _setting("records", "records without a gap that are drawn")
    quantile: float = _setting("1", "quantile of the best score in them that a claim must exceed")
    starts: int = _setting("starts", "starts of an effect that are tried")
    estimated_spectrum: float = _setting("1", "factor where the spectrum of the model discrepancy comes from a few clean records")


@dataclass(frozen=True)
class ReductionSettings:
    """Reduction on held-out blocks."""

    blocks: int = _setting("blocks", "blocks of a record, every other of which is held out")
    resamples: int = _setting("draws", "draws of the bootstrap")
    rounds: int = _setting("steps", "most steps of a fit on one half")


@dataclass(frozen=True)
class AttributionSettings:
    """Named effects and their intervals."""

    draws: int = _setting("draws", "draws of the fit's covariance for an interval")
    interval: float = _setting("share of the value", "least width of an interval on either side: a stage is not the physics")
    freedom: float = _setting(
        "degrees", "of Student's t for intervals where the model's file alone states its own error: clean records have two each"
    )
    coefficient_deviations: float = _setting("tolerances", "distance from the nominal value from which a coefficient is listed")
    candidate_probability: float = _setting("1", "least probability of a candidate that is listed")


@dataclass(frozen=True)
class BudgetSettings:
    """Shares of the gap by kind, band, amplitude, axis and time."""

    blocks: int = _setting("blocks", "stretches that energies are summed over")
    resamples: int = _setting("draws", "draws of the bootstrap")
    bands: tuple[float, ...] = _setting("Hz", "upper edges of the frequency bands but the last")
    spans: int = _setting("spans", "equal spans of time")


@dataclass(frozen=True)
class ExperimentSettings:
    """Next experiment."""

    rivals: int = _setting("explanations", "explanations that it is to separate")
    distance: float = _setting("standard deviations", "distance from which two explanations are told apart")
    duration: float = _setting("s", "duration of an excitation")


@dataclass(frozen=True)
class ReplaySettings:
    """Replay of recorded software blocks."""

    tolerance: float = _setting("share of the range", "departure within which a sum does what it should")
    law_tolerance: float = _setting("share of the range", "departure within which a feedback law does what it should")
    outlying: float = _setting("median departures", "departure from which a tick is at a limit and left out")


@dataclass(frozen=True)
class LiveTwinSettings:
    """Live twin."""

    noise_error: float = _setting("1", "factor that noise learned from few rows may by chance lie below the stated one")


@dataclass(frozen=True)
class BaselineSettings:
    """Baseline records beside the new one."""

    same_command: float = _setting("share of the range, rms", "difference up to which two commands are the same")
    similar_command: float = _setting(
        "share of the range, rms", "difference up to which a model carries its error from one command to another"
    )
    overlap: float = _setting("share of the new record", "least part of it in which they are")
    similar_overlap: float = _setting("share of the new record", "the same of a command that is similar only")
    zero_share: float = _setting("share of the range", "standard deviation of the zero, drift and curvature of a session")
    memory_share: float = _setting(
        "share of the mean slope", "standard deviation of the weights by which the initial memory of sessions differs"
    )
    memory_rows: float = _setting(
        "share of the record",
        "most rows that are left out beside a clean record of the same command until this memory is wiped out",
    )
    unseen: float = _setting("own errors", "size of the model's error on a command on which it was not measured")
    usual_share: tuple[float, ...] = _setting(
        "share of the range", "zero, drift and curvature that are usual where few clean records are at hand"
    )
    same_floor: float = _setting("own error and noise, rms", "least that an effect must take off")
    usual_repeatability: float = _setting(
        "share of the motion, rms", "what sessions differ by where a single clean record without a period does not tell"
    )
    other_command: float = _setting("own errors", "size of an effect that is named where no clean record has the same command")
    blocks: int = _setting("blocks", "blocks of a record that a remainder is predicted on, each from the others")


@dataclass(frozen=True)
class Configuration:
    """All groups; tuning_seeds: seeds of the blind test on which the values were set."""

    policy: Thresholds
    record: RecordSettings
    noise: NoiseSettings
    checks: CheckSettings
    flicker: FlickerSettings
    hump: HumpSettings
    search: SearchSettings
    null_distribution: NullSettings
    reduction: ReductionSettings
    attribution: AttributionSettings
    budget: BudgetSettings
    experiment: ExperimentSettings
    replay: ReplaySettings
    live_twin: LiveTwinSettings
    baseline: BaselineSettings
    tuning_seeds: tuple[int, ...]

    def digest(self) -> str:
        """Hash of all values, for the keys of caches."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()


def load_configuration(path: str | Path) -> Configuration:
    """Read a configuration file."""
    document = read_yaml(path, "give a YAML file with all groups of the configuration")
    try:
        return _group(Configuration, document, "")
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def configuration_text(configuration: Configuration) -> str:
    """Text of a configuration file, with the unit and the meaning of every value as its comment."""
    lines = [
        "# Configuration of the diagnosis. Set on the tuning seeds of the blind test (0-999) and frozen before scoring.",
        "# The comments are made by configuration.py: change values here, and meanings there.",
        f"tuning_seeds: {list(configuration.tuning_seeds)}",
    ]
    for group in fields(configuration):
        values = getattr(configuration, group.name)
        if not is_dataclass(values):
            continue
        lines += ["", f"{group.name}:  # {str(type(values).__doc__).rstrip('.')}"]
        for one in fields(values):
            value = getattr(values, one.name)
            declared = one.metadata["quantity"]
            lines.append(f"  {one.name}: {_text(value)}  # {declared.unit or '1'}: {declared.meaning}")
    return "\n".join(lines) + "\n"


def _text(value: float | tuple[float, ...]) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(_text(one) for one in value)}]"
    mantissa, exponent, digits = repr(value).partition("e")
    return mantissa + (".0" if exponent and "." not in mantissa else "") + exponent + digits  # YAML 1.1 takes 1e-06 for text


def _group(kind: type[Group], document: object, where: str) -> Group:
    """A group from its part of a document. where: the path to it, for messages."""
    name = where or "configuration"
    if not isinstance(document, Mapping):
        raise InputError(f"{name}: must be a mapping of names to values, got {document!r}")
    hints = get_type_hints(kind)
    due = [one.name for one in fields(kind)]  # type: ignore[arg-type]
    for unknown in sorted(set(document) - set(due), key=str):
        raise InputError(f"{name}: has no {unknown!r}: remove it, or use one of {', '.join(due)}")
    for missing in (one for one in due if one not in document):
        raise InputError(f"{name}: lacks {missing!r}: add it")
    declared = {one.name: one.metadata.get("quantity", SEEDS) for one in fields(kind)}  # type: ignore[arg-type]
    found = {}
    for one in due:
        path = f"{where}.{one}" if where else one
        if is_dataclass(hints[one]):
            found[one] = _group(hints[one], document[one], path)
        else:
            found[one] = _value(hints[one], document[one], replace(declared[one], name=path, unit=""))
    return kind(**found)


def _value(kind: Any, value: object, quantity: Quantity) -> float | tuple[float, ...]:
    """A number, or a list of numbers, of the kind that a field declares."""
    kinds: tuple[Any, ...] = getattr(kind, "__args__", ())
    if not kinds:
        return replace(quantity, kind=OF_TYPE[kind]).checked(value)  # type: ignore[no-any-return]
    counts = len(kinds) if kinds[-1] is not Ellipsis else None
    if not isinstance(value, list) or counts not in (None, len(value)):
        raise InputError(f"{quantity.name}: must be a list of {counts or 'some'} numbers, got {value!r}")
    return replace(quantity, kind=LISTS[kinds[0]]).checked(value)  # type: ignore[no-any-return]


CONFIGURATION = load_configuration(str(files("hyst_control.diagnose") / "configuration.yaml"))
"""The committed configuration."""
