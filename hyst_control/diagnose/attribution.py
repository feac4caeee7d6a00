"""The effects that a diagnosis names, over all axes: values with intervals, probabilities, shrink and shares."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hyst_control.chain.stage import Array
from hyst_control.diagnose.decision import key, thresholds
from hyst_control.diagnose.diagnosis import AxisDiagnosis, Diagnosis
from hyst_control.diagnose.gap_reduction import HeldOut, held_out, shares, shrink
from hyst_control.diagnose.hypothesis import Member
from hyst_control.diagnose.hypothesis_search import INFLATION, Scored

DRAWS = 400


@dataclass(frozen=True)
class Named:
    """An effect of the report. values: {parameter: (value, (low, high), unit)}; axes: names; shrink None without a waveform."""

    name: str
    axes: tuple[str, ...]
    probability: float
    values: dict[str, tuple[float, tuple[float, float], str]]
    equivalent: tuple[str, ...] = ()
    rms_before: float | None = None
    rms_after: float | None = None
    shrink: float | None = None
    shrink_ci90: tuple[float, float] | None = None
    shrink_fitted: float | None = None
    share: float = 1.0
    by_axis: dict[str, dict[str, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Explanation:
    """The verdict over all axes, the effects named, the candidates weighed, and the held-out errors by axis."""

    verdict: str
    effects: tuple[Named, ...]
    candidates: tuple[tuple[str, float], ...]
    parameters: tuple[tuple[str, float], ...]
    unknown: float


def explain(diagnosis: Diagnosis) -> Explanation:
    """All that is concluded, put together over the axes."""
    parts = diagnosis.parts
    verdicts = [part.decision.verdict for part in parts]
    named = _waveforms(diagnosis) + _without_waveform(diagnosis)
    if "unknown" in verdicts:
        verdict = "unknown"
    elif "ambiguous" in verdicts:
        verdict = "ambiguous"
    elif named:
        verdict = "effect"
    elif "parameters" in verdicts:
        verdict = "parameters"
    else:
        verdict = "no_gap"
    return Explanation(
        verdict,
        tuple(sorted(named, key=lambda effect: (-round(effect.probability, 3), -effect.share))),
        _candidates(diagnosis),
        _parameters(diagnosis),
        max(part.decision.remainder for part in parts),
    )


def _waveforms(diagnosis: Diagnosis) -> list[Named]:
    found: dict[str, list[tuple[AxisDiagnosis, Scored, int, float]]] = {}
    for part in diagnosis.parts:
        seen = set()
        for scored in part.decision.listed:
            for index, name in enumerate(scored.names):
                if name not in seen:
                    seen.add(name)
                    found.setdefault(name, []).append((part, scored, index, part.decision.of(name)))
    if not found:
        return []
    errors = {
        (part.axes, key(scored)): held_out(part.linearised, scored, part.found.none)
        for part in diagnosis.parts
        for scored in part.decision.listed
        if not scored.inflated
    }
    none = {part.axes: held_out(part.linearised, part.found.none, part.found.none) for part in diagnosis.parts}
    whole = sum(float(none[part.axes].before.sum()) for part in diagnosis.parts)
    named = []
    for name, places in found.items():
        values = _joined([_values(part, scored, index) for part, scored, index, _ in places])
        axes = tuple(
            diagnosis.model.axes[axis]
            for part, scored, index, _ in places
            for axis in (
                part.axes if scored.candidate.members[index].axis is None else (part.axes[scored.candidate.members[index].axis],)
            )
        )
        # On axes that this effect is not on, what explains those: effects that are named together shrink the gap together.
        chosen = {
            part.axes: (errors[(part.axes, key(part.decision.chosen))], part.decision.chosen)
            for part in diagnosis.parts
            if part.decision.chosen.candidate is not None and part.decision.listed
        }
        chosen |= {part.axes: (errors[(part.axes, key(scored))], scored) for part, scored, _, _ in places}
        before, after, before_fitted, after_fitted = _series(diagnosis, none, chosen)
        value, ci90 = shrink(before, after, diagnosis.seed)
        fitted, _ = shrink(before_fitted, after_fitted, diagnosis.seed)
        probability = 1.0 - float(np.prod([1.0 - p for *_, p in places]))
        share = sum(
            shares(part.linearised, scored)[index] * float(none[part.axes].before.sum()) / whole
            for part, scored, index, _ in places
        )
        unit = _rms_unit(diagnosis, chosen, none)
        others = tuple(
            sorted(
                {other for part, _, _, _ in places for one in part.decision.listed for other in one.names if name not in one.names}
            )
        )
        named.append(Named(name, axes, probability, values, others, unit[0], unit[1], value, ci90, fitted, share))
    total = sum(effect.share for effect in named) or 1.0
    return [Named(**{**effect.__dict__, "share": effect.share / total}) for effect in named]


def _series(diagnosis: Diagnosis, none: dict, chosen: dict) -> tuple[Array, Array, Array, Array]:
    """Squared errors of all axes side by side in time, before and after, given and fitted; axes without the effect do not change."""
    columns: list[list[Array]] = [[], [], [], []]
    rows = min(len(none[part.axes].before) // len(part.axes) for part in diagnosis.parts)
    for part in diagnosis.parts:
        errors: HeldOut = chosen[part.axes][0] if part.axes in chosen else none[part.axes]
        for column, series in zip(columns, (errors.before, errors.after, errors.before_fitted, errors.after_fitted), strict=True):
            weight = np.asarray(part.problem.sigma) ** 2 / np.mean(diagnosis.problem.sigma**2)
            column.append((series.reshape(-1, len(part.axes)) * weight)[:rows].sum(axis=1))
    count = len(diagnosis.model.axes)
    return tuple(np.sum(column, axis=0) / count for column in columns)  # type: ignore[return-value]


def _rms_unit(diagnosis: Diagnosis, chosen: dict, none: dict) -> tuple[float, float]:
    """Rms before and after over all samples of all axes, in the measurement's unit."""
    sums, rows = np.zeros(2), 0
    for part in diagnosis.parts:
        errors = chosen[part.axes][0] if part.axes in chosen else none[part.axes]
        variance = np.asarray(part.problem.sigma) ** 2
        for i, series in enumerate((errors.before, errors.after)):
            sums[i] += float((series.reshape(-1, len(part.axes)) * variance).sum())
        rows += len(errors.before)
    return float(np.sqrt(sums[0] / rows)), float(np.sqrt(sums[1] / rows))


def _values(part: AxisDiagnosis, scored: Scored, index: int) -> dict[str, tuple[float, tuple[float, float], str]]:
    """Parameter values of one effect with 90 % intervals: from draws of the fit's covariance, wider where more than noise is left."""
    member: Member = scored.candidate.members[index]
    where = scored.candidate.slices()[index]
    begin = part.linearised.count + where.start
    covariance = scored.solution.covariance[begin : begin + member.size, begin : begin + member.size] / part.found.temper
    centre = scored.solution.x[where]
    random = np.random.default_rng(0)
    lower, upper, _ = member.bounds()
    spread = np.linalg.cholesky(0.5 * (covariance + covariance.T) + 1e-18 * np.eye(member.size))
    draws = np.clip(centre + random.standard_normal((DRAWS, member.size)) @ spread.T, lower, upper)
    drawn = [member.values(x) for x in draws]
    found = {}
    hidden = [parameter.name for parameter in member.parameters if not parameter.told]
    for name, value in member.values(centre).items():
        if name in hidden:
            continue
        low, high = np.quantile([one[name] for one in drawn], [0.05, 0.95])
        least = thresholds().form * abs(value)
        found[name] = (float(value), (float(min(low, value - least)), float(max(high, value + least))), member.units()[name])
    return found


def _joined(values: list[dict[str, Any]]) -> dict[str, tuple[float, tuple[float, float], str]]:
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
    named: dict[str, list] = {}
    for part in diagnosis.parts:
        for finding in part.findings:
            units = {"fraction": "", "step": diagnosis.model.units["measurement"], "rms": diagnosis.model.units["measurement"]}
            values = {name: (value, finding.ci90[name], units[name]) for name, value in finding.values.items()}
            named.setdefault(finding.name, []).append((part.axes[finding.axis], values, 1.0 - np.exp(-min(finding.evidence, 50.0))))
        if part.flicker is not None:
            values = {"rms": (part.flicker.rms, part.flicker.ci90, diagnosis.model.units["measurement"])}
            named.setdefault("flicker_noise", []).append((part.axes[0], values, 1.0 - np.exp(-min(part.flicker.gain, 50.0))))
    gap = sum(float(np.sum(np.mean(part.gap() ** 2, axis=0))) for part in diagnosis.parts)
    found = []
    for name, rows in named.items():
        own = sum(values["rms"][0] ** 2 for _, values, _ in rows if "rms" in values)
        found.append(
            Named(
                name,
                tuple(diagnosis.model.axes[axis] for axis, _, _ in rows),
                float(max(p for *_, p in rows)),
                _joined([values for _, values, _ in rows]),
                share=min(own / gap, 1.0) if own and gap else 1.0,
            )
        )
    return found


def _candidates(diagnosis: Diagnosis) -> tuple[tuple[str, float], ...]:
    """Every explanation weighed, most probable first: of an effect the probability that it is at work on some axis."""
    names = {
        name
        for part in diagnosis.parts
        for explanation in part.decision.probability
        for name in explanation
        if name != "parameters"
    }
    found = {name: 1.0 - float(np.prod([1.0 - min(part.decision.of(name), 1.0) for part in diagnosis.parts])) for name in names}
    for effect in _without_waveform(diagnosis):
        found[effect.name] = effect.probability
    ranked = sorted(found.items(), key=lambda item: (-item[1], item[0]))
    return tuple((name, p) for name, p in ranked if p >= 1e-4)


def _parameters(diagnosis: Diagnosis) -> tuple[tuple[str, float], ...]:
    """Nominal coefficients that are off by more than their tolerance suggests, in standard deviations of it."""
    found = []
    for part in diagnosis.parts:
        chosen = part.decision.chosen
        factor = INFLATION if chosen.inflated else 1.0
        scatter = part.linearised.scatter.coefficients
        axis = f" ({diagnosis.model.axes[part.axes[0]]})" if len(diagnosis.parts) > 1 else ""
        found += [
            (c.name + axis, float(z * factor)) for c, z in zip(scatter, chosen.solution.z, strict=True) if abs(z * factor) > 2.0
        ]
    return tuple(sorted(found, key=lambda item: -abs(item[1])))
