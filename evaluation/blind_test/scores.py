# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Scores of a blind test: each diagnosed case becomes a row of results, and a grouping of the rows becomes the published table.

A published row is a filter and a measure in `ROWS`; its name may hold columns in braces, of which each value has a row by itself.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from io import StringIO
from pathlib import Path
from statistics import fmean, median
from typing import Any

import numpy as np
from scipy.stats import binomtest, mannwhitneyu

from evaluation.blind_test.case import VERDICTS, Case
from evaluation.blind_test.effect_sizes import FILE
from evaluation.blind_test.ideal_observer import ceiling
from evaluation.blind_test.injected_machines import SIMULATED
from hyst_control.base.files import write_text
from hyst_control.diagnose.report.document import sentence
from hyst_control.reporting.tables import Table

ERROR = "error"
"""Verdict of a case whose diagnosis ended in an error."""

PUBLISHED = ("pea_published", "fsm_published")
"""Plants whose model is right up to its coefficients."""

FAMILIES: dict[str, tuple[str, ...]] = FILE["families"]
"""Effects of similar signature; each effect not listed is a family by itself."""

OTHERWISE_DEFINED = ("vibration", "flicker_noise", "dac_hold", "sensor_nonlinearity", "hysteresis_shape")
"""Effects whose parameters have another definition in the plants (a curve over their stroke or rating instead of the record's range)."""
LAW = "law"
"""Parameter of the plants that chooses another course than the usual one, whose size is no end value: of a logarithm, or reached at tau."""


@dataclass(frozen=True)
class Result:
    """One row of results: a case, and what its report is worth."""

    case: Case
    role: str  # "" of a scored case, "left_out" without its effect in the catalogue, "without_gap" of false alarms alone
    kind: str  # Kind that is scored: none where nobody could see the gap
    hidden: tuple[str, ...]  # What nobody could see
    size: float  # True gap over what hides it
    noise_percent: float  # Noise of the sensor, per cent of the stroke
    clear: bool  # The record is rich, and the gap at least 3 sigma
    published: bool  # The model is right up to its coefficients
    stand_in: bool  # The machine is a simulation
    both_shown: bool  # Each effect of a pair shows beside the other
    verdict: str
    named: tuple[str, ...]  # Names that count, in the order of the report
    leads: bool  # The first name is right
    first: bool  # The same, with a verdict that names effects
    some: bool  # One of the names is right
    exact: bool  # The names are those of the effects
    wrong: bool  # Names are given, of which none is in the case
    decided: bool  # The verdict is one that is right for the kind
    alarm: bool  # Something is named, or unknown, where nothing is
    right: bool  # The case went right as a whole; what nobody should see may be named nevertheless
    in_set: bool  # The first effect is among the candidates
    unknown: bool  # The verdict is unknown
    sure: bool  # An effect is named with a probability of at least 0.95
    probability: float | None  # Of the first name
    novelty: float
    covered: bool | None  # The interval of the first effect's parameter holds the true value; None where there is none
    reduction_error: float | None  # Predicted - realized reduction in a later session
    foreseen_error: float | None  # The same, predicted for that session's command
    processor_seconds: float
    said: str  # The report in one sentence
    ceiling: float | None  # Probability that an ideal observer names the effects; None where that is not known


def score(case: Case, report: Mapping[str, Any], role: str = "", apart: Sequence[Mapping[str, Any]] | None = None) -> Result:
    """Score the report on a case."""
    # apart: by part of the diagnosis, how far the effects' fits are apart; None where that is not known
    label, verdict = case.answer, report["verdict"]
    hidden = label.hidden or ()
    accepted = label.accepted if label.accepted is not None else tuple((name,) for name in label.names)
    right = {name for names in accepted for name in names}
    named = tuple(effect["name"] for effect in report["effects"] if effect["name"] not in (label.ignored or ()))
    decided = verdict in (label.verdicts or VERDICTS[label.kind])
    leads = bool(named) and named[0] in right
    exact = set(named) <= right and all(set(named) & set(names) for names in accepted)
    alarm = not decided and (verdict != "effect" or bool(named))
    whole = {"single": leads and decided, "pair": exact and decided, "none": not alarm or bool(set(named) & set(hidden))}
    candidates = {*named, *(row["name"] for row in report.get("candidates", ()))}
    candidates |= {name for effect in report["effects"] for name in effect.get("equivalent", ())}
    probability = report["effects"][0].get("probability") if report["effects"] else None
    realized, foreseen = report.get("shrink_realised"), report.get("foreseen")
    return Result(
        case=case,
        role=role,
        kind=label.kind,
        hidden=hidden,
        size=label.gap_rms / max(label.noise_rms, 1e-300),
        noise_percent=100 * case.noise,
        clear=case.excitation == "rich" and label.gap_rms >= 3 * label.noise_rms,
        published=case.plant in PUBLISHED,
        stand_in=case.plant in SIMULATED,
        both_shown=len(label.shown or ()) == 2,
        verdict=verdict,
        named=named,
        leads=leads,
        first=leads and decided,
        some=bool(right & set(named)),
        exact=exact,
        wrong=bool(named) and not set(named) & {*label.names, *hidden},
        decided=decided,
        alarm=alarm,
        right=whole.get(label.kind, decided),
        in_set=bool(accepted) and bool(candidates & set(accepted[0])),
        unknown=verdict == "unknown",
        sure=verdict == "effect" and (probability or 0.0) >= 0.95,
        probability=probability,
        novelty=float(report.get("novelty") or report.get("unexplained_share") or 0.0),
        covered=_covered(case, report),
        reduction_error=abs(realized[0] - realized[1]) if realized else None,
        foreseen_error=abs(foreseen["shrink"] - realized[1]) if realized and foreseen else None,
        processor_seconds=report.get("processor_seconds", 0.0),
        said=report["error"] if verdict == ERROR else sentence(dict(report)) if "gap" in report else "",
        ceiling=_ceiling(accepted, apart or ()),
    )


def _ceiling(accepted: Sequence[Sequence[str]], apart: Sequence[Mapping[str, Any]]) -> float | None:
    """Ceiling of the axis that shows the effects best."""
    found = [ceiling(one["names"], one["products"], accepted) for one in apart if accepted and one["names"]]
    return max((one for one in found if one is not None), default=None)


def _covered(case: Case, report: Mapping[str, Any]) -> bool | None:
    """Whether the interval of the first effect's main parameter holds the true value; None where it was not named."""
    label = case.answer
    truth = _own_truth(case) if label.truth is None else label.truth
    if label.truth is not None and report["verdict"] not in VERDICTS["single"]:
        return None
    for effect in report["effects"]:
        for parameter, row in effect["parameters"].items():
            if effect["name"] not in label.names[:1] or parameter not in truth or row["ci90"][0] is None:
                continue
            values = truth[parameter]
            axes = [case.axes.index(axis) for axis in effect["axis"]] if case.axes else []
            true = np.mean([values[axis] for axis in axes] or values)
            return bool(row["ci90"][0] <= true <= row["ci90"][1])
    return None


def _own_truth(case: Case) -> dict[str, tuple[float, ...]]:
    """True parameters of a simulated case's first effect, where plant and gap report define them alike."""
    effect = case.effects[0] if case.effects else {"name": ""}
    if effect["name"] in OTHERWISE_DEFINED or effect.get(LAW):
        return {}
    return {name: (value,) for name, value in effect.items() if isinstance(value, (int, float)) and name != "frequency"}


@dataclass(frozen=True)
class Metric:
    """One published figure: a proportion with its Wilson 95 % interval, or a plain value, beside its target."""

    name: str
    value: float
    n: int  # Number of cases
    ci95: tuple[float, float] | None  # None for a plain value
    target: float | None
    at_least: bool = True  # The value should reach the target; False: it should not exceed it

    @property
    def met(self) -> bool:
        """True when the figure itself reaches its target."""
        return self.target is None or (self.value >= self.target if self.at_least else self.value <= self.target)


@dataclass(frozen=True)
class Row:
    """One row of the published table."""

    name: str  # With columns of the result `r` in braces: a row for each of their values
    target: float | None
    chosen: Callable[[Result], bool]  # Filter
    measure: str | Callable[[Result], Any]  # Column of the result, or what is computed of it; None where it is not counted
    at_least: bool = True
    value: Callable[[Sequence[Any]], float] | None = None  # Of all measures; None: their share, with Wilson's interval


def group_by(results: Iterable[Result], row: Row) -> list[Metric]:
    """Group the results by a row's name, and compute the figure of each group; one that is no number is left out."""
    groups: dict[str, list[Any]] = {}
    for r in results:
        measured = None
        if row.chosen(r):
            measured = getattr(r, row.measure) if isinstance(row.measure, str) else row.measure(r)
        if measured is not None:
            groups.setdefault(row.name.format(r=r), []).append(measured)
    found = []
    for name, measures in sorted(groups.items()):
        n, value = len(measures), np.mean(measures) if row.value is None else row.value(measures)
        interval = wilson(sum(measures), n) if row.value is None else None
        found.append(Metric(name, float(value), n, interval, row.target, row.at_least))
    return [metric for metric in found if np.isfinite(metric.value)]


def wilson(k: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a proportion k / n."""
    interval = binomtest(k, n).proportion_ci(0.95, "wilson")
    return float(interval.low), float(interval.high)


def conformal(scores: Sequence[float], share: float = 0.04) -> float:
    """Compute the threshold that a further score, exchangeable with these, exceeds in at most a given share of the cases."""
    rank = int(np.ceil((len(scores) + 1) * (1.0 - share)))
    return float(np.sort(scores)[rank - 1]) if rank <= len(scores) else np.inf


def _macro_f1(pairs: Sequence[tuple[str, str]]) -> float:
    """Mean over the true names of F1, of (true name, given name)."""
    true, given = (Counter(names) for names in zip(*pairs, strict=True))
    right = Counter(truth for truth, name in pairs if truth == name)
    return float(np.mean([2 * right[name] / max(true[name] + given[name], 1) for name in true]))


def _auroc(scores: Sequence[tuple[bool, float]]) -> float:
    """Fraction of pairs in which the positive one is the greater, ties counting half: the statistic U of Mann and Whitney, of 1."""
    positive, negative = ([value for sign, value in scores if sign == wanted] for wanted in (True, False))
    if not positive or not negative:
        return np.nan
    return float(mannwhitneyu(positive, negative, method="asymptotic").statistic / (len(positive) * len(negative)))


def _ece(pairs: Sequence[tuple[float | None, bool]], bins: int = 5) -> float:
    """Expected calibration error of the first name's probability, of (probability, right); a case without a name has None."""
    given = np.array([(p, right) for p, right in pairs if p is not None]).reshape(-1, 2)
    boxes = np.minimum((given[:, 0] * bins).astype(int), bins - 1)
    off = np.array([np.sum(given[boxes == box, 0] - given[boxes == box, 1]) for box in range(bins)])
    return float(np.sum(np.abs(off)) / max(len(given), 1))


def _family(name: str) -> str:
    return next((family for family, members in FAMILIES.items() if name in members), name)


def _same_family(r: Result) -> bool:
    return _family(r.named[0] if r.named else "") == _family(r.case.answer.names[0])


def _given(r: Result) -> tuple[str, str]:
    told = r.named and (r.first or r.verdict == "effect")
    return r.case.answer.names[0], r.named[0] if told else "none"


def _calibration(r: Result) -> tuple[float | None, bool]:
    return r.probability if r.verdict in VERDICTS["single"] else None, r.first


def _outside(r: Result) -> tuple[bool, float]:
    return r.kind == "open_set" or r.role == "left_out", r.novelty


def _only(source: str, *kinds: str, **columns: object) -> Callable[[Result], bool]:
    """Filter: scored cases of a source, of some kinds, whose columns have these values."""

    def chosen(r: Result) -> bool:
        if r.case.source != source or r.role or r.kind not in (kinds or VERDICTS):
            return False
        return all(getattr(r if hasattr(r, name) else r.case, name) == value for name, value in columns.items())

    return chosen


def _no_gap(r: Result) -> bool:
    return r.case.source == "simulated" and r.role != "left_out" and r.kind == "none" and not r.hidden


SIMULATION, INJECTION, WITHHELD = (partial(_only, source) for source in ("simulated", "injected", "withheld"))
CLEAR, PUBLISHED_PLANTS = SIMULATION("single", clear=True), partial(SIMULATION, "single", clear=True, published=True)
SINGLE, PAIR, ALL, SINE = SIMULATION("single"), SIMULATION("pair"), SIMULATION(), SIMULATION("single", excitation="sine")
MACHINE, STAND_IN = partial(INJECTION, stand_in=False), partial(INJECTION, stand_in=True)
NONE, OTHER, SAME = "no clean record", "clean record of another command", "clean record of the same command"
QUIET = "anything but no_gap, parameters or a companion"
REDUCTION, FORESEEN = "shrink, predicted - realized", "shrink, foreseen for the fresh command - realized"

ROWS = (
    Row("top-1, single effects on published plants, rich record, gap >= 3 sigma", 0.97, PUBLISHED_PLANTS(), "first"),
    Row("ideal observer, the same cases", None, PUBLISHED_PLANTS(), "ceiling", value=fmean),
    Row("its family", 0.98, PUBLISHED_PLANTS(), _same_family),
    Row("macro-F1", 0.95, PUBLISHED_PLANTS(), _given, value=_macro_f1),
    Row("top-1, the same, realizations that tuning drew", 0.97, PUBLISHED_PLANTS(untuned=False), "first"),
    Row("top-1, the same, realizations that tuning never drew", 0.92, PUBLISHED_PLANTS(untuned=True), "first"),
    Row("top-1, the same, noise {r.noise_percent:g} %", 0.97, PUBLISHED_PLANTS(), "first"),
    Row("top-1, rich record, {r.case.plant}", 0.97, CLEAR, "first"),
    Row("single sine: wrong name", 0.03, SINE, lambda r: r.wrong and r.verdict == "effect", False),
    Row("single sine: truth among the candidates", 0.95, SINE, "in_set"),
    Row("top-1, multisine", 0.85, SIMULATION("single", excitation="multisine"), "first"),
    Row("top-1, closed loop", 0.85, SIMULATION("single", excitation="closed_loop"), "first"),
    Row("false alarm on records without a gap", 0.02, _no_gap, "alarm", False),
    Row("false alarm, {r.case.plant}", 0.02, _no_gap, "alarm", False),
    Row("gap too small to be scored: a wrong name", 0.05, lambda r: ALL(r) and bool(r.hidden), "wrong", False),
    Row("coefficients beyond tolerance: verdict parameters", 0.92, SIMULATION("parameters"), "decided"),
    Row("open set: called unknown", 0.90, SIMULATION("open_set"), "unknown"),
    Row("single effects called unknown", 0.04, SINGLE, "unknown", False),
    Row("open set: AUROC of the novelty score", 0.95, SIMULATION("open_set", "single"), _outside, value=_auroc),
    Row("leave-one-out: AUROC", 0.90, lambda r: SINGLE(r) or r.role == "left_out", _outside, value=_auroc),
    Row("pairs: exactly both", 0.75, PAIR, "exact"),
    Row("pairs: exactly both, where each shows beside the other", 0.82, SIMULATION("pair", both_shown=True), "exact"),
    Row("pairs: at least one", 0.97, PAIR, "some"),
    Row(f"{REDUCTION}: median", 0.02, ALL, "reduction_error", False, median),
    Row(f"{REDUCTION}: 90 % quantile", 0.10, ALL, "reduction_error", False, partial(np.quantile, q=0.9)),
    Row(f"{FORESEEN}: median", 0.02, ALL, "foreseen_error", False, median),
    Row(f"{FORESEEN}: 90 % quantile", 0.10, ALL, "foreseen_error", False, partial(np.quantile, q=0.9)),
    Row("true parameter within its 90 % interval", 0.85, SINGLE, "covered"),
    Row("right where it says >= 0.95", 0.97, SIMULATION("single", "pair", sure=True), "first"),
    Row("calibration error (ECE)", 0.03, SINGLE, _calibration, False, _ece),
    Row("processor seconds a record: median", 6.0, ALL, "processor_seconds", False, median),
    Row(f"`third` and Bouc-Wen stage, model identified, {NONE}: top-1 at >= 3 x its own error", 0.85, STAND_IN("single"), "first"),
    Row("ideal observer of `third` and the Bouc-Wen stage", None, STAND_IN("single"), "ceiling", value=fmean),
    Row("ideal observer, injected, {r.case.regime}, {r.case.multiple:g} x", None, MACHINE("single"), "ceiling", value=fmean),
    Row(f"injected, {NONE}: top-1 at 3 x", 0.70, MACHINE("single", regime="none", multiple=3.0), "first"),
    Row(f"injected, {NONE}: top-1 at 10 x", 0.90, MACHINE("single", regime="none", multiple=10.0), "first"),
    Row(f"injected, {OTHER}: top-1 at 3 x", 0.85, MACHINE("single", regime="other_command", multiple=3.0), "first"),
    Row(f"injected, {OTHER}: top-1 at 10 x", 0.95, MACHINE("single", regime="other_command", multiple=10.0), "first"),
    Row(f"injected, {SAME}: top-1 at 1 x", 0.85, MACHINE("single", regime="same_command", multiple=1.0), "first"),
    Row(f"injected, {SAME}: top-1 at 3 x", 0.97, MACHINE("single", regime="same_command", multiple=3.0), "first"),
    Row(f"injected, {SAME}: pairs exact", 0.85, INJECTION("pair"), "right"),
    Row(f"injected, {SAME}: pairs, at least one", 0.97, INJECTION("pair"), "first"),
    Row("injected, open set: called unknown", 0.90, INJECTION("open_set"), "unknown"),
    Row("injected, single effects called unknown", 0.04, INJECTION("single"), "unknown", False),
    Row(f"clean measured records: {QUIET}", 0.03, MACHINE("none"), "alarm", False),
    Row(f"clean records of `third` and the Bouc-Wen stage: {QUIET}", 0.02, STAND_IN("none"), "alarm", False),
    Row("injected: true parameter within its 90 % interval", 0.85, INJECTION("single"), "covered"),
    Row("withheld: all cases solved", None, WITHHELD(), "right"),
    Row("withheld elements: named first", None, WITHHELD("single"), "leads"),
    Row(
        "all single effects: novelty score that 4 % exceed (unknown from 0.5)",
        0.5,
        lambda r: SINGLE(r) or INJECTION("single")(r),
        "novelty",
        False,
        conformal,
    ),
)
"""The published table."""

BY_MACHINE = Row("{r.case.plant} | {r.case.regime} | {r.case.multiple:g}", None, INJECTION("single"), "first")
"""First names by machine, baseline records, and size."""


def metrics(results: Sequence[Result], rows: Sequence[Row] = ROWS) -> list[Metric]:
    """Compute every figure of a table that the results allow."""
    return [metric for row in rows for metric in group_by(results, row)]


def table(found: Sequence[Metric], source: str) -> Table:
    """Convert metrics to a result table, the target in place of a published figure."""
    result = Table(source)
    for one in found:
        quantity, unit = ("seconds", "s") if "seconds" in one.name else ("share", "")
        result.add("Blind test", one.name, "diagnosis", quantity, unit, one.value, published=one.target, n=one.n, ci95=one.ci95)
    return result


def write_results(path: Path, results: Sequence[Result]) -> None:
    """Write a CSV file with a row for every case: its columns, and what its report is worth."""
    rows = []
    for result in results:
        columns = asdict(result)
        case = columns.pop("case")
        label = {f"true_{name}": value for name, value in case.pop("label").items()}
        rows.append({**case, **label, **columns, "kind": case["kind"], "scored_kind": result.kind})
    text = StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())
