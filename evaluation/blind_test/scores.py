"""Scores of a blind test: every metric with its Wilson interval and number of cases, beside its target."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import mannwhitneyu

from evaluation.blind_test.error_report import VERDICT
from evaluation.blind_test.metric import Metric, proportion
from hyst_control.effects import EFFECTS
from hyst_control.reporting.tables import Table

Pair = tuple[dict[str, Any], dict[str, Any]]

PUBLISHED = ("pea_published", "fsm_published")
"""Plants whose model is right up to its coefficients."""

FAMILIES = {
    "lag": ("delay", "amplifier_lowpass", "sensor_lowpass", "slew_limit", "added_mass", "dac_hold"),
    "hysteresis": ("hysteresis_width", "hysteresis_shape", "hysteresis_rate", "backlash"),
    "drift": ("creep", "gain_drift", "offset_drift"),
    "scale": ("gain", "offset", "sensor_nonlinearity", "saturation"),
    "noise": ("sensor_noise", "flicker_noise", "quantization", "held_samples"),
    "line": ("mains_hum", "vibration"),
}
"""Effects of similar signature; each effect not listed is a family by itself."""


OTHERWISE_DEFINED = ("vibration", "flicker_noise", "dac_hold", "sensor_nonlinearity", "hysteresis_shape")
"""Effects whose parameters have another definition in the plants (a curve over their stroke or rating instead of the record's range)."""
LAW = "law"
"""Parameter of the plants that chooses another course than the usual one, whose size is no end value: of a logarithm, or reached at tau."""


def metrics(pairs: Sequence[Pair], left_out: Sequence[Pair] = (), without_gap: Sequence[Pair] = ()) -> list[Metric]:
    """Compute every figure of the targets' table that the cases allow."""
    found: list[Metric] = []

    def share(name: str, target: float, cases: Iterable[Pair], right: Callable[[Pair], bool], at_least: bool = True) -> None:
        chosen = list(cases)
        if chosen:
            k = sum(right(pair) for pair in chosen)
            found.append(proportion(name, k, len(chosen), target, at_least))

    def value(
        name: str, target: float, amounts: Sequence[float], at_least: bool, reduce: Callable[[Sequence[float]], float]
    ) -> None:
        if len(amounts):
            found.append(Metric(name, float(reduce(amounts)), len(amounts), None, target, at_least))

    singles = [pair for pair in pairs if _label(pair)["kind"] == "single"]
    rich = [p for p in singles if _label(p)["excitation"] == "rich" and _label(p)["gap_rms"] >= 3 * _label(p)["noise_rms"]]
    published = [pair for pair in rich if _label(pair)["plant"] in PUBLISHED]
    share("top-1, single effects on published plants, rich record, gap >= 3 sigma", 0.97, published, _first)
    share("its family", 0.98, published, lambda pair: _family(_named(pair)[0] if _named(pair) else "") == _family(_truth(pair)[0]))
    if published:
        found.append(Metric("macro-F1", _macro_f1(published), len(published), None, 0.95))
    drawn = {False: "realizations that tuning drew", True: "realizations that tuning never drew"}
    for untuned, target in ((False, 0.97), (True, 0.92)):
        cases = [pair for pair in published if bool(pair[0].get("untuned")) == untuned]
        share(f"top-1, the same, {drawn[untuned]}", target, cases, _first)
    for noise in (5e-4, 3e-3):
        cases = [pair for pair in published if _label(pair)["noise"] == noise]
        share(f"top-1, the same, noise {100 * noise:g} %", 0.97, cases, _first)
    for plant in sorted({_label(pair)["plant"] for pair in rich}):
        share(f"top-1, rich record, {plant}", 0.97, [pair for pair in rich if _label(pair)["plant"] == plant], _first)
    sine = [pair for pair in singles if _label(pair)["excitation"] == "sine"]
    share("single sine: wrong name", 0.03, sine, _wrong, False)
    share("single sine: truth among the candidates", 0.95, sine, lambda pair: _truth(pair)[0] in _candidates(pair))
    for excitation in ("multisine", "closed_loop"):
        share(f"top-1, {excitation.replace('_', ' ')}", 0.85, [p for p in singles if _label(p)["excitation"] == excitation], _first)
    none = [pair for pair in (*pairs, *without_gap) if _label(pair)["kind"] == "none" and not _label(pair).get("hidden")]
    share(
        "false alarm on records without a gap",
        0.02,
        none,
        _alarmed,
        False,
    )
    for plant in sorted({_label(pair)["plant"] for pair in without_gap}):
        share(f"false alarm, {plant}", 0.02, [pair for pair in none if _label(pair)["plant"] == plant], _alarmed, False)
    share(
        "gap too small to be scored: a wrong name",
        0.05,
        [pair for pair in pairs if _label(pair).get("hidden")],
        lambda pair: bool(_named(pair)) and not set(_named(pair)) & set(_label(pair)["hidden"]),
        False,
    )
    share(
        "coefficients beyond tolerance: verdict parameters",
        0.92,
        [p for p in pairs if _label(p)["kind"] == "parameters"],
        lambda pair: pair[1]["verdict"] == "parameters",
    )
    opened = [pair for pair in pairs if _label(pair)["kind"] == "open_set"]
    share("open set: called unknown", 0.90, opened, lambda pair: pair[1]["verdict"] == "unknown")
    share("single effects called unknown", 0.04, singles, lambda pair: pair[1]["verdict"] == "unknown", False)
    if opened and singles:
        area = _auroc([_unknown(pair) for pair in opened], [_unknown(pair) for pair in singles])
        found.append(Metric("open set: AUROC of the novelty score", area, len(opened) + len(singles), None, 0.95))
    if left_out and singles:
        area = _auroc([_unknown(pair) for pair in left_out], [_unknown(pair) for pair in singles])
        found.append(Metric("leave-one-out: AUROC", area, len(left_out) + len(singles), None, 0.90))
    doubles = [pair for pair in pairs if _label(pair)["kind"] == "pair"]
    share("pairs: exactly both", 0.75, doubles, lambda pair: set(_named(pair)) == set(_truth(pair)))
    share(
        "pairs: exactly both, where each shows beside the other",
        0.82,
        [pair for pair in doubles if len(_label(pair).get("shown", ())) == 2],
        lambda pair: set(_named(pair)) == set(_truth(pair)),
    )
    share("pairs: at least one", 0.97, doubles, lambda pair: bool(set(_named(pair)) & set(_truth(pair))))
    apart = [pair[1]["shrink_realised"] for pair in pairs if pair[1].get("shrink_realised")]
    value("shrink, predicted - realized: median", 0.02, [abs(a - b) for a, b, _ in apart], False, np.median)
    value(
        "shrink, predicted - realized: 90 % quantile", 0.10, [abs(a - b) for a, b, _ in apart], False, lambda x: np.quantile(x, 0.9)
    )
    ahead = [
        abs(pair[1]["foreseen"]["shrink"] - pair[1]["shrink_realised"][1])
        for pair in pairs
        if pair[1].get("shrink_realised") and pair[1].get("foreseen")
    ]
    value("shrink, foreseen for the fresh command - realized: median", 0.02, ahead, False, np.median)
    value("shrink, foreseen for the fresh command - realized: 90 % quantile", 0.10, ahead, False, lambda x: np.quantile(x, 0.9))
    share(
        "true parameter within its 90 % interval",
        0.85,
        [p for p in singles if _covered(p) is not None],
        lambda p: bool(_covered(p)),
    )
    sure = [
        pair
        for pair in singles + doubles
        if pair[1]["effects"] and pair[1]["effects"][0]["probability"] >= 0.95 and pair[1]["verdict"] == "effect"
    ]
    share("right where it says >= 0.95", 0.97, sure, _first)
    if singles:
        found.append(Metric("calibration error (ECE)", _ece(singles), len(singles), None, 0.03, False))
    value("processor seconds a record: median", 6.0, [pair[1]["processor_seconds"] for pair in pairs], False, np.median)
    return found


def table(found: Sequence[Metric], source: str) -> Table:
    """Convert metrics to a result table, the target in place of a published figure."""
    result = Table(source)
    for metric in found:
        result.add(
            "Blind test",
            metric.name,
            "diagnosis",
            "seconds" if "seconds" in metric.name else "share",
            "s" if "seconds" in metric.name else "",
            metric.value,
            published=metric.target,
            n=metric.n,
            ci95=metric.ci95,
        )
    return result


def confusion(pairs: Sequence[Pair]) -> tuple[list[str], list[str], np.ndarray]:
    """Count the names given by true name, over single effects and records without a gap."""
    counts: Counter[tuple[str, str]] = Counter()
    for pair in pairs:
        kind = _label(pair)["kind"]
        if kind in ("single", "none", "open_set", "parameters"):
            truth = _truth(pair)[0] if kind == "single" else kind.replace("none", "no_gap")
            verdict = pair[1]["verdict"]
            counts[truth, _named(pair)[0] if verdict in ("effect", "ambiguous") and _named(pair) else verdict] += 1
    order = [*EFFECTS, "no_gap", "parameters", "open_set", "unknown", VERDICT]
    rows = sorted({row for row, _ in counts}, key=order.index)
    columns = sorted({column for _, column in counts}, key=order.index)
    return rows, columns, np.array([[counts[row, column] for column in columns] for row in rows])


def worst(pairs: Sequence[Pair], count: int = 12) -> list[Pair]:
    """Select the cases that went wrong, the largest gaps first."""
    wrong = [pair for pair in pairs if not _right(pair)]
    return sorted(wrong, key=lambda pair: -_label(pair)["gap_rms"] / max(_label(pair)["noise_rms"], 1e-300))[:count]


def _right(pair: Pair) -> bool:
    kind, verdict = _label(pair)["kind"], pair[1]["verdict"]
    if kind == "single":
        return _first(pair)
    if kind == "pair":
        return set(_named(pair)) == set(_truth(pair))
    if kind == "none" and set(_named(pair)) & set(_label(pair).get("hidden", ())):
        return True  # visible nevertheless
    right = {"none": ("no_gap", "parameters"), "parameters": ("parameters",), "open_set": ("unknown",)}
    return verdict in right[kind]


def _label(pair: Pair) -> dict[str, Any]:
    label: dict[str, Any] = pair[0]["label"]
    return label


def _truth(pair: Pair) -> list[str]:
    return list(_label(pair)["names"])


def _named(pair: Pair) -> list[str]:
    return [effect["name"] for effect in pair[1]["effects"]]


def _candidates(pair: Pair) -> set[str]:
    report = pair[1]
    return (
        set(_named(pair))
        | {name for effect in report["effects"] for name in effect["equivalent"]}
        | {row["name"] for row in report["candidates"]}
    )


def _first(pair: Pair) -> bool:
    return pair[1]["verdict"] in ("effect", "ambiguous") and bool(_named(pair)) and _named(pair)[0] in _truth(pair)


def _wrong(pair: Pair) -> bool:
    """Report whether an absent effect was named with certainty."""
    return pair[1]["verdict"] == "effect" and not set(_named(pair)) & set(_truth(pair))


def _alarmed(pair: Pair) -> bool:
    return pair[1]["verdict"] in ("effect", "ambiguous", "unknown", VERDICT)


def _family(name: str) -> str:
    return next((family for family, members in FAMILIES.items() if name in members), name)


def _unknown(pair: Pair) -> float:
    return _novelty(pair[1])


def _novelty(report: Mapping[str, Any]) -> float:
    return float(report.get("novelty") or report.get("unexplained_share") or 0.0)


def novelty_quantile(reports: Sequence[Mapping[str, Any]]) -> list[Metric]:
    """Compute the novelty score that 4 % of the single effects exceed: 0.5 where the diagnosis' conformal threshold was calibrated."""
    found = conformal([_novelty(report) for report in reports], 0.04)
    name = "all single effects: novelty score that 4 % exceed (unknown from 0.5)"
    return [Metric(name, found, len(reports), None, 0.5, False)] if np.isfinite(found) else []


def conformal(scores: Sequence[float], share: float) -> float:
    """Compute the threshold that a further score, exchangeable with these, exceeds in at most a given share of the cases."""
    rank = int(np.ceil((len(scores) + 1) * (1.0 - share)))
    return float(np.sort(scores)[rank - 1]) if rank <= len(scores) else np.inf


def _macro_f1(pairs: Sequence[Pair]) -> float:
    right: Counter[str] = Counter()
    given: Counter[str] = Counter()
    true: Counter[str] = Counter()
    for pair in pairs:
        truth, named = (
            _truth(pair)[0],
            _named(pair)[0] if _first(pair) or pair[1]["verdict"] == "effect" and _named(pair) else "none",
        )
        true[truth] += 1
        given[named] += 1
        right[truth] += truth == named
    return float(np.mean([2 * right[name] / max(true[name] + given[name], 1) for name in true]))


def _auroc(positive: Sequence[float], negative: Sequence[float]) -> float:
    """Fraction of pairs in which the positive one is the greater, ties counting half: the statistic U of Mann and Whitney, of 1."""
    return float(mannwhitneyu(positive, negative, method="asymptotic").statistic / (len(positive) * len(negative)))


def _ece(pairs: Sequence[Pair], bins: int = 5) -> float:
    """Expected calibration error of the first name's probability."""
    boxes: dict[int, list[tuple[float, bool]]] = defaultdict(list)
    for pair in pairs:
        if pair[1]["effects"] and pair[1]["verdict"] in ("effect", "ambiguous"):
            p = pair[1]["effects"][0]["probability"]
            boxes[min(int(p * bins), bins - 1)].append((p, _first(pair)))
    total = sum(map(len, boxes.values()))
    return float(sum(abs(sum(p for p, _ in box) - sum(right for _, right in box)) for box in boxes.values()) / max(total, 1))


def _covered(pair: Pair) -> bool | None:
    """Coverage: True when the true value of the named effect's main parameter lies in its interval; None where it was not named."""
    effect = _label(pair)["effects"][0]
    named = next((row for row in pair[1]["effects"] if row["name"] == effect["name"]), None)
    if named is None or effect["name"] in OTHERWISE_DEFINED or effect.get(LAW):
        return None
    for name, row in named["parameters"].items():
        if name in effect and name != "frequency":
            low, high = row["ci90"]
            return low is not None and low <= effect[name] <= high
    return None
