# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The gap report: one JSON document with the fixed form of the interface, and the same in words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from string import Formatter
from typing import Any

import numpy as np

from hyst_control.diagnose.decide.policy import join
from hyst_control.diagnose.report.attribution import Attribution, Named
from hyst_control.diagnose.report.block_replay import Block
from hyst_control.diagnose.report.coefficient_changes import strain
from hyst_control.diagnose.report.gap_breakdown import SESSION, Rows, stages
from hyst_control.diagnose.report.next_experiment import next_experiment
from hyst_control.diagnose.run.diagnosis import Diagnosis
from hyst_control.diagnose.verdict import Reason, Verdict
from hyst_control.effects import EFFECTS
from hyst_control.reporting.quantities import quantity

SCHEMA = "hyst_control/gap-report"
VERSION = 1
FAR_OFF = 5.0  # Standard deviations from which the coefficients are named as the reason for doubt
SAID = {
    "stage": "place in the chain",
    "kind": "kind of curve",
    "amplitude": "displacement",
    "band": "frequency",
    "drive": "amplifier",
}
"""Words for the document's names."""


def gap_report(
    diagnosis: Diagnosis,
    attribution: Attribution,
    split: Mapping[str, Rows],
    blocks: Sequence[Block],
    augmented: str | None,
    remainder: dict[str, Any] | None,
) -> dict[str, Any]:
    """Make the report."""
    # split: the gap by kind, band, amplitude, axis and time, as `budget` has it
    joint = join([part.decision for part in diagnosis.parts])
    document: dict[str, Any] = _finite(
        {
            "schema": SCHEMA,
            "version": VERSION,
            "verdict": joint.verdict.value,
            "reasons": [reason.value for reason in joint.reasons],
            "gap": _gap(diagnosis),
            "where": {"stage": stages(diagnosis, attribution, [block.name for block in blocks if not block.faithful]), **split},
            "effects": [_effect(effect) for effect in attribution.effects],
            "candidates": [{"name": name, "probability": p} for name, p in attribution.candidates],
            "parameters": [
                {
                    "name": change.name,
                    "z": change.deviations,
                    "value": change.after,
                    "ci90": [change.after - change.spread, change.after + change.spread],
                    "nominal": change.before,
                    "unit": change.unit,
                }
                for change in attribution.parameters
            ],
            "strain": strain(diagnosis),
            "next_experiment": next_experiment(diagnosis),
            "augmented_model": augmented,
            "unexplained_share": joint.unexplained,
            "novelty": joint.novelty,
            "replay": [{"name": block.name, "faithful": block.faithful, "rms": block.rms, "text": block.text} for block in blocks],
            "notes": list(diagnosis.notes),
        }
    )
    if any(part.baseline for part in diagnosis.parts):
        document |= _finite(_beside_clean_records(diagnosis))
    if any(part.structure for part in diagnosis.parts):
        document["structure"] = [
            {"axis": [diagnosis.model.axes[i] for i in part.axes], "question": question, "probability": _finite(probability)}
            for part in diagnosis.parts
            for question, probability in part.structure.items()
        ]
    if remainder is not None:
        document["predictable"] = _finite(remainder)
    return document


def _beside_clean_records(diagnosis: Diagnosis) -> dict[str, Any]:
    """Baseline records as they were used, and what differs from session to session."""
    unit, rows = diagnosis.model.units["measurement"], []
    for part in diagnosis.parts:
        left = part.evidence.hypotheses[part.decision.chosen].residual
        rows += [
            {
                "name": one.effect,
                "axis": diagnosis.model.axes[part.axes[one.axis]],
                "value": one.value,
                "ci90": list(one.ci90),
                "usual": one.usual,
                "rms": one.rms,
                "unit": unit,
            }
            for one in (left.companions if left else ())
        ]
    used = [part.baseline for part in diagnosis.parts if part.baseline]
    return {
        "baseline": {
            "same_command": all(one.carried for one in used),
            "of_model": any(one.clean is None for one in used),
            "repeatability": [float(value) for one in used for value in one.repeatability],
            "unit": unit,
        },
        "companions": rows,
        "predictable": {
            "share": max(
                left.predictable
                for part in diagnosis.parts
                if (left := part.evidence.hypotheses[part.decision.chosen].residual) is not None
            )
        },
    }


def _finite(value: Any) -> Any:
    """The same document with null for what is no number."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return value


def _gap(diagnosis: Diagnosis) -> dict[str, Any]:
    """rms over all samples of all axes; nrmse over the range (HAMPI paper Eq. 26), in percent, the mean over the axes."""
    energies, floors, relative = [], [], []
    for part in diagnosis.parts:
        rows = part.gap()
        measured = part.problem.rows(part.linearized.measured)
        energies += list(np.mean(rows**2, axis=0))
        floors += list(np.asarray(part.problem.sigma) ** 2)
        relative += list(100.0 * np.sqrt(np.mean(rows**2, axis=0)) / np.maximum(np.ptp(measured, axis=0), 1e-300))
    return {
        "rms": np.sqrt(np.mean(energies)),
        "nrmse": np.mean(relative),
        "nrmse_unit": "% of range",
        "floor_rms": np.sqrt(np.mean(floors)),
        "unit": diagnosis.model.units["measurement"],
    }


def _effect(effect: Named) -> dict[str, Any]:
    return {
        "name": effect.name,
        "axis": effect.axes,
        "place": EFFECTS[effect.name].place,
        "meaning": EFFECTS[effect.name].meaning,
        "probability": effect.probability,
        "equivalent": effect.equivalent,
        "parameters": {name: {"value": value, "ci90": ci90, "unit": unit} for name, (value, ci90, unit) in effect.values.items()},
        "rms_before": effect.rms_before,
        "rms_after": effect.rms_after,
        "shrink": effect.shrink,
        "shrink_ci90": effect.shrink_ci90,
        "shrink_reidentified": effect.shrink_fitted,
        "share": effect.share,
    }


def off_by(row: Mapping[str, Any]) -> str:
    """Say what a parameter is and what the model has; older reports have its deviation alone."""
    deviations = f"({row['z']:+.1f} σ of its tolerance)"
    if None in (row.get("value"), *row.get("ci90", ())):
        return f"{row['name']} {deviations}"
    value, unit = within(row["value"], 0.5 * (row["ci90"][1] - row["ci90"][0])), f" {row['unit']}".rstrip()
    return f"{row['name']} is {value}{unit}, the model has {plain(row['nominal'])} {deviations}"


def within(value: float, half: float) -> str:
    """Write a value with half of its 90 % interval, to two digits of that."""
    known = 0.0 < half < math.inf and value
    digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(half)) + 2 if known else 4
    return f"{plain(value, max(digits, 2))} ± {plain(half, 2)}"


def plain(value: float, digits: int = 4) -> str:
    """Write a number to these digits, or to whole ones below a million."""
    whole = len(f"{abs(value):.0f}") if abs(value) < 1e6 else 0
    return f"{value:.{max(digits, whole)}g}"


def _reduction(report: Mapping[str, Any]) -> str:
    """Sentence on how much of the gap the effects explain; empty where none of them has a waveform."""
    effects = report["effects"]
    fitted = [effect["shrink_reidentified"] for effect in effects if effect["shrink_reidentified"] is not None]
    given = [effect["shrink"] for effect in effects if effect["shrink"] is not None]
    if not fitted:
        return ""
    explains = "The best of them explains" if report["verdict"] == Verdict.AMBIGUOUS.value else "Together they explain"
    explains = "It explains" if len(effects) == 1 else explains
    first, then = (f"{100 * max(0.0, *values):.0f} %" for values in (given, fitted))
    if max(given) < 0.0:
        return f" {explains} nothing of the gap itself, but {then} after re-fitting the model."
    return f" {explains} {first} of the gap{f', and {then} after re-fitting the model' if then != first else ''}."


def sentence(report: dict[str, Any]) -> str:
    """Say the verdict in one sentence."""
    # report: the JSON document; in one of before `reasons` were added the reason of `unknown` is taken to be the energy left
    gap, unit = report["gap"], report["gap"]["unit"]
    # What differs between sessions may be many times the gap that is to be explained: a sensor's zero lies anywhere.
    whole, beside = gap["rms"], None if _is_of_the_session(report) else _beside_session(report)
    told = whole if beside is None else beside
    range_share = gap["nrmse"] * told / whole if whole else 0.0
    within = "" if beside is None else f"; {whole:.3g} {unit} with the session's zero, drift and initial memory"
    size = f"{told:.3g} {unit} rms ({range_share:.2g} % of range, noise floor {gap['floor_rms']:.3g} {unit}{within})"
    names = [named(effect) for effect in report["effects"]]
    verdict, reasons = report["verdict"], report.get("reasons", ())
    strained = _strain(report)
    if verdict == Verdict.NO_GAP.value:
        known = _known_error(report)
        if strained > FAR_OFF and known:
            moved = (
                f"The best fit moves the model's coefficients by {strained:.0f} σ together, which the model discrepancy can cause."
            )
            return f"No gap beyond {known.strip(', ')} and the noise: simulation and record differ by {size}. {moved}"
        return f"No gap beyond the model's tolerances{known} and the noise: simulation and record differ by {size}."
    if verdict == Verdict.PARAMETERS.value:
        worst = "; ".join(off_by(row) for row in report["parameters"][:3])
        if Reason.COEFFICIENTS_WITHIN_TOLERANCE.value in reasons:
            return f"The gap of {size} is within the tolerance of the model's parameters, but too large to leave: re-identify the model."
        which = f": {worst}" if worst else f", {strained:.0f} σ off together, none of them by itself: re-identify the model"
        return f"The gap of {size} is caused by the model's parameters{which}."
    if verdict == Verdict.UNKNOWN.value:
        return f"No known effect explains the gap of {size}{_nearest(report, names)}."
    far = _reduction(report)
    if verdict == Verdict.AMBIGUOUS.value:
        return f"The gap of {size} is caused by {' or '.join(names)}: these data cannot tell which.{far}"
    return f"The gap of {size} is caused by {' and '.join(names)}.{far}"


def _strain(report: Mapping[str, Any]) -> float:
    """Distance of the coefficients from the model's; older reports have that of each."""
    return float(report.get("strain") or max((abs(row["z"]) for row in report.get("parameters", ())), default=0.0))


def _nearest(report: dict[str, Any], names: Sequence[str]) -> str:
    """Phrase on the explanation that comes nearest, and why it is none; empty where none is named."""
    reasons, together = report.get("reasons", ()), " and ".join(names)
    if Reason.ENERGY_LEFT.value not in reasons:
        if Reason.DISTORTION_LEVEL.value in reasons:  # of the record itself, whatever is named
            return "; the measurement stays on one level while the command moves on"
        if names and _strain(report) > FAR_OFF and Reason.UNEXPLAINED_SHARE.value in reasons:
            return f"; {together} would, but only with coefficients {_strain(report):.0f} σ from the model's"
        if names and Reason.AT_BOUND.value in reasons:
            return f"; {together} would, with a size at the end of its range"
        if names and Reason.TOO_MANY_EFFECTS.value in reasons:
            return f"; it would take {together} at once, and an effect outside the catalogue is more likely"
    if not names:
        return ""
    best = max(
        (row["shrink_reidentified"] for row in report["effects"] if row.get("shrink_reidentified") is not None), default=None
    )
    if best is None:  # an effect without a waveform takes nothing off
        return f"; the nearest, {together}, leaves {100 * report['unexplained_share']:.0f} % of it"
    far = f"explains {100 * best:.0f} % of it after re-fitting the model" if best > 0.0 else "explains nothing of it"
    return f"; the nearest, {together}, {far}"


def _known_error(report: dict[str, Any]) -> str:
    """Phrase on the size of the error that is known without a gap; empty where none is known."""
    baseline = report.get("baseline") or {}
    size = max(baseline.get("repeatability", ()), default=0.0)
    if not size:
        return ""
    of = "the records it was identified from" if baseline.get("of_model") else "baseline records"
    what = "baseline records differ by" if baseline["same_command"] else f"the model leaves on {of}"
    return f", the {size:.3g} {baseline['unit']} rms that {what},"


def _is_of_the_session(report: dict[str, Any]) -> bool:
    """True where all that is named differs from session to session, such as a zero: the gap is that of the session then."""
    effects = [EFFECTS[effect["name"]] for effect in report["effects"] if effect["name"] in EFFECTS]
    return bool(effects) and all(effect.companion is not None for effect in effects)


def _beside_session(report: dict[str, Any]) -> float | None:
    """Rms of a gap without what differs between sessions; None where that is less than half of the gap's energy."""
    share = next((row["share"] for row in report.get("where", {}).get("stage", ()) if row["name"] == SESSION), 0.0)
    return float(report["gap"]["rms"] * math.sqrt(max(1.0 - share, 0.0))) if share > 0.5 else None


def named(effect: Mapping[str, Any]) -> str:
    """Name an effect in the middle of a sentence."""
    plain = str(effect["name"]).replace("_", " ")
    known = EFFECTS[effect["name"]].phrase if effect["name"] in EFFECTS else ""
    values = {name: row["value"] for name, row in effect.get("parameters", {}).items()}
    needed = [field for _, field, _, _ in Formatter().parse(known) if field]
    if not known or "parameters" not in effect or any(values.get(name) is None for name in needed):
        return plain
    return known.format(**{name: quantity(values[name], effect["parameters"][name]["unit"]) for name in needed})


def in_words(report: dict[str, Any]) -> str:
    """Say the whole report, for a terminal."""
    lines = [sentence(report), ""]
    for effect in report["effects"]:
        values = ", ".join(
            f"{name} {_short(row['value'])} {row['unit']}".rstrip() + f" [{_short(row['ci90'][0])} … {_short(row['ci90'][1])}]"
            for name, row in effect["parameters"].items()
        )
        axes = f" on {', '.join(effect['axis'])}" if effect["axis"] else ""
        lines.append(f"  {effect['name']}{axes}: probability {effect['probability']:.2f}; {values}")
        if effect["shrink_reidentified"] is not None:
            lines.append(
                f"      reduction {reduction(effect['shrink'], effect['shrink_ci90'])}, "
                f"{reduction(effect['shrink_reidentified'])} after re-fitting the model"
            )
            if report["verdict"] == Verdict.UNKNOWN.value and max(effect["shrink"], effect["shrink_reidentified"]) < 0.0:
                lines.append(
                    "      it widens the gap: its probability is that among the effects of the catalogue, none of which explains it"
                )
        if effect["equivalent"]:
            lines.append(f"      cannot be told from: {', '.join(effect['equivalent'])}")
    for title, rows in report["where"].items():
        main = [row for row in sorted(rows, key=lambda row: -row["share"]) if row["share"] > 0.02][:4]
        lines.append(
            f"  {SAID.get(title, title)}: "
            + ", ".join(f"{SAID.get(row['name'], row['name'])} {100 * row['share']:.0f} %" for row in main)
        )
    for block in report["replay"]:
        lines.append(f"  {block['name']}: {block['text']}")
    if report["parameters"]:
        lines.append("  coefficients off: " + "; ".join(off_by(row) for row in report["parameters"][:6]))
    if report["next_experiment"]:
        following = report["next_experiment"]
        lines.append(
            f"  next: {following['excitation']} separates {' from '.join(following['separates'])} by {following['distance']:.1f} σ"
            + (f"; {following['note']}" if following["note"] else "")
        )
    if "level" in (report.get("predictable") or {}):
        lines += _predictable(report["predictable"])
    if report.get("foreseen"):
        ahead, unit = report["foreseen"], report["gap"]["unit"]
        lines.append(
            f"  on {ahead['command']}: a gap of {ahead['rms_before']:.3g} {unit} rms, with what was found added "
            f"{ahead['rms_after']:.3g} {unit}: "
            + (f"a reduction of {100 * ahead['shrink']:.1f} %" if ahead["shrink"] > 0.0 else "no reduction")
        )
    lines += [f"  note: {note}" for note in report["notes"]]
    return "\n".join(lines)


def reduction(value: float | None, ci90: Sequence[float] | None = None) -> str:
    """Write a reduction with its interval; one below zero has no size of its own: it is relative to a gap that may be small."""
    if value is None or value < 0.0:
        return "–" if value is None else "none (worse on held-out rows)"
    interval = [f"{100 * end:.1f}" if end >= 0.0 else "below 0" for end in ci90 or ()]
    return f"{100 * value:.1f} %" + (f" [{' … '.join(interval)}]" if interval else "")


def _predictable(found: dict[str, Any]) -> list[str]:
    """Lines on the part of an unexplained remainder that follows the command."""
    lines = [f"  of what is left beyond the noise, {100 * found['share']:.0f} % follows the command"]
    for title in ("band", "level", "branch"):
        rows = [row for row in found[title] if row["share"] > 0.02]
        if rows:
            told = ", ".join(f"{row['name']} {100 * row['predictable']:.0f} % of {100 * row['share']:.0f} %" for row in rows)
            lines.append(f"      {title}: {told}")
    if found["learned"]:
        far, added = found["learned"]["shrink"], found["learned"]["added"]
        does = "was added: it removes" if added else "would remove"
        share = f"{does} {100 * far:.0f} %" if far > 0.0 else "would remove nothing"
        lines.append(f"      a learned residual {share} of what the effects leave, on blocks that it was not learned from")
    return lines


def _short(value: float | None) -> str:
    return "?" if value is None else f"{value:.4g}"
