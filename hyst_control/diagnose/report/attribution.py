# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The effects that a diagnosis names, over all axes: values with intervals, probabilities, reduction and shares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.parallel import map_forked
from hyst_control.diagnose.configuration import AttributionSettings
from hyst_control.diagnose.record_checks.summary import effect_found_by
from hyst_control.diagnose.report.coefficient_changes import CoefficientChange, coefficient_changes, repetition
from hyst_control.diagnose.run.diagnosis import AxisDiagnosis, Diagnosis
from hyst_control.diagnose.search.beam_search import FittedHypothesis
from hyst_control.diagnose.validate.cross_validation import HeldOut, held_out, shares, shrink
from hyst_control.effects import EFFECTS
from hyst_control.model_file import Model

Value = tuple[float, tuple[float, float], str]  # Value of a parameter, its 90 % interval and its unit

Axes = tuple[int, ...]


@dataclass(frozen=True)
class Named:
    """Effect of the report."""

    name: str  # Of the effect
    axes: tuple[str, ...]  # Names of the axes that it is on
    probability: float  # That it is at work
    values: dict[str, Value] = field(default_factory=dict)  # By parameter: value, 90 % interval, unit
    equivalent: tuple[str, ...] = ()  # Effects that the data cannot tell it from
    # rms_before, rms_after: Gap without and with it, measurement unit; None without a waveform, like all that follows but the share
    rms_before: float | None = None
    rms_after: float | None = None
    shrink: float | None = None  # With the coefficients as given
    shrink_ci90: tuple[float, float] | None = None  # 90 % interval of the shrink
    shrink_fitted: float | None = None  # With the coefficients fitted on both sides
    share: float = 1.0  # In what is named together; of noise in the gap's energy


@dataclass(frozen=True)
class Attribution:
    """Shares of the gap by effect."""

    effects: tuple[Named, ...]  # The most probable first
    candidates: tuple[tuple[str, float], ...]  # Every effect that was weighed, with its probability
    # Coefficients that are certainly off, by more than the model file allows, the furthest first
    parameters: tuple[CoefficientChange, ...]


def attribute(diagnosis: Diagnosis) -> Attribution:
    """Attribute the gap to the effects that the decisions list."""
    found_by_checks = _without_waveform(diagnosis)
    least = diagnosis.configuration.attribution.coefficient_deviations
    named = sorted(_waveforms(diagnosis) + found_by_checks, key=_rank)
    known = {(each.name, axis) for each in named for axis in each.axes}
    session = [each for each in _companions(diagnosis) if known.isdisjoint((each.name, axis) for axis in each.axes)]
    return Attribution(
        (*named, *session),
        _candidates(diagnosis, found_by_checks),
        tuple(change for change in coefficient_changes(diagnosis) if change.is_certain and abs(change.deviations) > least),
    )


def _rank(effect: Named) -> tuple[bool, float, float]:
    """Order among the named effects: the most probable first, but noise that is the smaller part of the gap last, however sure."""
    return effect.shrink is None and effect.share < 0.5, -round(effect.probability, 3), -effect.share


def _waveforms(diagnosis: Diagnosis) -> list[Named]:
    found: dict[str, list[tuple[AxisDiagnosis, FittedHypothesis, int, float]]] = {}
    for part in diagnosis.parts:
        seen: set[str] = set()
        for scored in part.listed:  # the first one that has an effect counts; it may have it on each of several coupled axes
            for index, name in enumerate(scored.names):
                if name not in seen:
                    found.setdefault(name, []).append((part, scored, index, part.decision.of(name)))
            seen |= set(scored.names)
    if not found:
        return []
    settings = diagnosis.configuration.reduction
    parts = diagnosis.parts
    weighed = [[scored for scored in part.listed if not scored.inflated] for part in parts]
    halves = list(map_forked(lambda i: held_out(parts[i].linearized, weighed[i], parts[i].found.none, settings), len(parts)))
    none = {part.axes: nothing for part, (nothing, _) in zip(parts, halves, strict=True)}
    errors = {
        (part.axes, scored.names): half
        for part, some, (_, each) in zip(parts, weighed, halves, strict=True)
        for scored, half in zip(some, each, strict=True)
    }
    whole = sum(float(none[part.axes].before.sum()) for part in diagnosis.parts)
    named = []
    for name, places in found.items():
        each = [_values(part, scored, index, diagnosis.configuration.attribution) for part, scored, index, _ in places]
        values = _joined(each)
        if EFFECTS[name].couples and len(places) > 1:  # a way from one axis to another is not that back
            for (part, scored, index, _), own in zip(places, each, strict=True):
                axis = diagnosis.model.axes[_axes_of(part, scored, index)[0]]
                values |= {f"{one}_{axis}": value for one, value in own.items()}
        axes = tuple(diagnosis.model.axes[axis] for part, scored, index, _ in places for axis in _axes_of(part, scored, index))
        # On axes that this effect is not on, what explains those: effects that are named together shrink the gap together.
        chosen = {
            part.axes: errors[(part.axes, part.chosen.names)]
            for part in diagnosis.parts
            if part.chosen.candidate is not None and part.listed
        }
        chosen |= {part.axes: errors[(part.axes, scored.names)] for part, scored, _, _ in places}
        before, after, before_fitted, after_fitted = _series(diagnosis, none, chosen)
        value, ci90 = shrink(before, after, diagnosis.seed, settings)
        fitted, _ = shrink(before_fitted, after_fitted, diagnosis.seed, settings)
        by_part = {part.axes: p for part, _, _, p in places}
        probability = 1.0 - float(np.prod([1.0 - p for p in by_part.values()]))
        share = sum(
            shares(part.linearized, scored)[index] * float(none[part.axes].before.sum()) / whole
            for part, scored, index, _ in places
        )
        others = tuple(
            sorted({other for part, _, _, _ in places for one in part.listed for other in one.names if name not in one.names})
        )
        named.append(
            Named(name, axes, probability, values, others, *_rms_unit(diagnosis, chosen, none), value, ci90, fitted, share)
        )
    total = sum(effect.share for effect in named) or 1.0
    return [replace(effect, share=effect.share / total) for effect in named]


def _companions(diagnosis: Diagnosis) -> list[Named]:
    """Zero and drift of the session where they are named: behind everything structural."""
    unit, gap = diagnosis.model.units["measurement"], _gap_energy(diagnosis)
    return [
        Named(
            one.effect,
            (diagnosis.model.axes[part.axes[one.axis]],),
            1.0,
            {one.parameter: (one.value, one.ci90, unit)},
            share=min(one.rms**2 / gap, 1.0) if gap else 1.0,
        )
        for part in diagnosis.parts
        for one in part.decision.companions
    ]


def _gap_energy(diagnosis: Diagnosis) -> float:
    """Mean square of the gap, summed over the axes."""
    return sum(float(np.sum(np.mean(part.gap() ** 2, axis=0))) for part in diagnosis.parts)


def _axes_of(part: AxisDiagnosis, scored: FittedHypothesis, index: int) -> Axes:
    """Axes of the plant that an effect of an explanation is on."""
    assert scored.candidate is not None
    axis = scored.candidate.members[index].axis
    return part.axes if axis is None else (part.axes[axis],)


def _series(
    diagnosis: Diagnosis, none: Mapping[Axes, HeldOut], chosen: Mapping[Axes, HeldOut]
) -> tuple[Array, Array, Array, Array]:
    """Squared errors of all axes side by side in time, before and after, given and fitted; axes without the effect do not change."""
    columns: list[list[Array]] = [[], [], [], []]
    rows = min(len(none[part.axes].before) // len(part.axes) for part in diagnosis.parts)
    for part in diagnosis.parts:
        errors = chosen.get(part.axes, none[part.axes])
        for column, series in zip(columns, (errors.before, errors.after, errors.before_fitted, errors.after_fitted), strict=True):
            weight = np.asarray(part.problem.sigma) ** 2 / np.mean(diagnosis.problem.sigma**2)
            column.append((series.reshape(-1, len(part.axes)) * weight)[:rows].sum(axis=1))
    count = len(diagnosis.model.axes)
    before, after, before_fitted, after_fitted = (np.sum(column, axis=0) / count for column in columns)
    return before, after, before_fitted, after_fitted


def _rms_unit(diagnosis: Diagnosis, chosen: Mapping[Axes, HeldOut], none: Mapping[Axes, HeldOut]) -> tuple[float, float]:
    """Rms before and after over all samples of all axes, in the measurement's unit."""
    sums, rows = np.zeros(2), 0
    for part in diagnosis.parts:
        errors = chosen.get(part.axes, none[part.axes])
        variance = np.asarray(part.problem.sigma) ** 2
        for i, series in enumerate((errors.before, errors.after)):
            sums[i] += float((series.reshape(-1, len(part.axes)) * variance).sum())
        rows += len(errors.before)
    return float(np.sqrt(sums[0] / rows)), float(np.sqrt(sums[1] / rows))


def _quantiles(values: Sequence[float]) -> Array:
    """Quantiles 5 and 95 %; of a limit that may be infinite they are values that were drawn: between these nothing is defined."""
    return np.quantile(values, [0.05, 0.95], method="linear" if np.isfinite(values).all() else "inverted_cdf")


def _values(part: AxisDiagnosis, scored: FittedHypothesis, index: int, settings: AttributionSettings) -> dict[str, Value]:
    """Parameter values of one effect with 90 % intervals, from draws of the fit's covariance: wider beside the model discrepancy."""
    assert scored.candidate is not None
    member = scored.candidate.members[index]
    where = scored.candidate.slices()[index]
    begin = part.linearized.count + where.start
    covariance = scored.solution.covariance[begin : begin + member.size, begin : begin + member.size] / part.found.temper
    covariance = covariance * repetition(part.problem)
    centre = scored.solution.x[where]
    lower, upper, _ = member.bounds()
    freedom = _freedom(part, settings)
    draws = np.clip(centre + deviations(covariance, settings.draws, freedom), lower, upper)
    told = [
        member.effect.reported(member.values(x), part.problem.surroundings, part.problem.model.chain.stages)
        for x in (centre, *draws)
    ]
    found = {}
    for name, value in told[0].items():
        if name in member.untold:
            continue
        low, high = _quantiles([one[name] for one in told[1:]])
        least = settings.interval * abs(value)
        found[name] = (
            float(value),
            (float(min(low, value - least)), float(max(high, value + least))),
            _unit(member.units().get(name, ""), part.problem.model),
        )
    return found


def _unit(unit: str, model: Model) -> str:
    """Unit of an effect's parameter, of which some are those of the model's signals."""
    signals = {"unit": model.units["measurement"], "command": model.units["command"], "command/s": f"{model.units['command']}/s"}
    return signals.get(unit, unit)


def _freedom(part: AxisDiagnosis, settings: AttributionSettings) -> float:
    """Degrees of freedom of the model discrepancy's size: a line of the spectrum has two, a sine and a cosine, on every baseline record."""
    if not part.problem.weighs_own_error:
        return np.inf
    clean = part.baseline.clean if part.baseline is not None else None
    return settings.freedom if clean is None else 2.0 * len(clean.pieces)


def deviations(covariance: Annotated[Array, "P P"], count: int, freedom: float) -> Array:
    """Draw deviations from an estimate."""
    random = np.random.default_rng(0)
    spread = np.linalg.cholesky(0.5 * (covariance + covariance.T) + 1e-18 * np.eye(len(covariance)))
    found = random.standard_normal((count, len(covariance))) @ spread.T
    return found if np.isinf(freedom) else found * np.sqrt(freedom / random.chisquare(freedom, (count, 1)))


def _joined(values: Sequence[dict[str, Value]]) -> dict[str, Value]:
    """One value for several axes: their mean, and an interval that covers what the axes' intervals say of it."""
    if len(values) == 1:
        return values[0]
    joined = {}
    for name, (_, _, unit) in values[0].items():
        rows = [one[name] for one in values]
        widths = np.array([row[1][1] - row[1][0] for row in rows])
        widest = widths.max()
        weights = np.maximum(widths / widest, 1e-6) ** -2.0 if widest > 0 else np.ones(len(rows))
        half = 0.5 * widest / np.sqrt(weights.sum())
        weights /= weights.sum()
        centre = float(weights @ np.array([row[0] for row in rows]))
        spread = max(abs(row[0] - centre) for row in rows)
        half = max(half, spread if spread > half else 0.0)
        joined[name] = (centre, (centre - half, centre + half), unit)
    return joined


def _without_waveform(diagnosis: Diagnosis) -> list[Named]:
    """Effects that checks of the record found."""
    named: dict[str, list[tuple[int, dict[str, Value], float, float]]] = {}
    for part in diagnosis.parts:
        for finding in part.decision.findings:
            effect = effect_found_by(finding.check)
            if effect is None:
                continue
            parameter = effect.checked_parameter(diagnosis.problem.surroundings)
            unit = _unit(parameter.unit, diagnosis.model)
            own = finding.rms**2 if finding.check.is_noise or finding.check.is_of_the_record else 0.0
            probability = float(1.0 - np.exp(-min(finding.gain, 50.0)))
            values = {parameter.name: (finding.value, finding.ci90, unit)}
            values |= {name: (value, interval, own_unit) for name, value, interval, own_unit in finding.further}
            named.setdefault(effect.name, []).append((part.axes[finding.axis], values, probability, own))
    gap = _gap_energy(diagnosis)
    found = []
    for name, rows in named.items():
        own = sum(energy for *_, energy in rows)
        found.append(
            Named(
                name,
                tuple(diagnosis.model.axes[axis] for axis, *_ in rows),
                max(p for *_, p, _ in rows),
                _joined([values for _, values, *_ in rows]),
                share=min(own / gap, 1.0) if own and gap else 1.0,
            )
        )
    return found


def _candidates(diagnosis: Diagnosis, found_by_checks: Sequence[Named]) -> tuple[tuple[str, float], ...]:
    """Every explanation weighed, most probable first: of an effect the probability that it is at work on some axis."""
    names = {name for part in diagnosis.parts for scored in part.hypotheses for name in scored.names}
    found = {name: 1.0 - float(np.prod([1.0 - min(part.decision.of(name), 1.0) for part in diagnosis.parts])) for name in names}
    for effect in found_by_checks:
        found[effect.name] = effect.probability
    ranked = sorted(found.items(), key=lambda item: (-item[1], item[0]))
    least = diagnosis.configuration.attribution.candidate_probability
    return tuple((name, p) for name, p in ranked if p >= least)
