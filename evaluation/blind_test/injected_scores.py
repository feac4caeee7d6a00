"""Scores of the cases that are injected into records of machines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from evaluation.blind_test.injected_machines import SIMULATED
from evaluation.blind_test.injections import COMPANIONS
from evaluation.blind_test.metric import Metric, proportion

LAGS = ("delay", "sensor_lowpass", "amplifier_lowpass")
"""Effects that count as one name where the record has one frequency."""
QUASI_STATIC = ("gain", "resonance")
"""A further mode far above the one frequency of a record is a gain there."""
EQUAL = {"gain": ("hysteresis_width",), "dac_hold": ("sensor_noise",), "sensor_noise": ("flicker_noise",)}
"""Names that an engineer would accept as well."""

Row = tuple[Mapping[str, Any], Mapping[str, Any]]
"""Label and report of a case."""


def injected_metrics(rows: Sequence[Row]) -> list[Metric]:
    """Compute every figure of the table that injected cases allow."""
    found: list[Metric] = []

    def share(name: str, target: float, cases: Iterable[Row], right: Callable[..., bool], at_least: bool = True) -> None:
        hits = [right(*row) for row in cases]
        if hits:
            found.append(proportion(name, sum(hits), len(hits), target, at_least))

    singles = [row for row in rows if row[0]["kind"] == "single"]
    measured = [row for row in singles if row[0]["plant"] not in SIMULATED]
    share(
        "`third` and Bouc-Wen stage, model identified, no clean record: top-1 at >= 3 x its own error",
        0.85,
        [row for row in singles if row[0]["plant"] in SIMULATED],
        named_right,
    )
    for mode, words, sizes in (
        ("none", "no clean record", {3.0: 0.70, 10.0: 0.90}),
        ("other_command", "clean record of another command", {3.0: 0.85, 10.0: 0.95}),
        ("same_command", "clean record of the same command", {1.0: 0.85, 3.0: 0.97}),
    ):
        for size, target in sizes.items():
            cases = [row for row in measured if row[0]["mode"] == mode and row[0]["multiple"] == size]
            share(f"injected, {words}: top-1 at {size:g} x", target, cases, named_right)
    pairs = [row for row in rows if row[0]["kind"] == "pair"]
    share("injected, clean record of the same command: pairs exact", 0.85, pairs, named_exactly)
    share("injected, clean record of the same command: pairs, at least one", 0.97, pairs, named_right)
    opened = [row for row in rows if row[0]["kind"] == "open_set"]
    share("injected, open set: called unknown", 0.90, opened, lambda label, report: report["verdict"] == "unknown")
    share("injected, single effects called unknown", 0.04, singles, lambda _, report: report["verdict"] == "unknown", False)
    clean = [row for row in rows if row[0]["kind"] == "none"]
    for name, chosen, target in (
        ("clean measured records", [row for row in clean if row[0]["plant"] not in SIMULATED], 0.03),
        ("clean records of `third` and the Bouc-Wen stage", [row for row in clean if row[0]["plant"] in SIMULATED], 0.02),
    ):
        share(f"{name}: anything but no_gap, parameters or a companion", target, chosen, lambda _, report: not quiet(report), False)
    covered = [inside for row in singles if (inside := is_covered(*row)) is not None]
    if covered:
        found.append(proportion("injected: true parameter within its 90 % interval", sum(covered), len(covered), 0.85))
    return found


def accepted(name: str, label: Mapping[str, Any]) -> set[str]:
    """Names that are right for an injected effect."""
    names = {name, *EQUAL.get(name, ())}
    if label["one_frequency"]:
        for alike in (LAGS, QUASI_STATIC):
            names |= {right for other in alike for right in (other, *EQUAL.get(other, ()))} if name in alike else set()
    return names


def named_right(label: Mapping[str, Any], report: Mapping[str, Any]) -> bool:
    """Report whether the first name is that of an injected effect, and the verdict names effects."""
    right = {name for one in label["names"] for name in accepted(one, label)}
    named = _named(report, bool(right & set(COMPANIONS)))
    return report["verdict"] in ("effect", "ambiguous") and bool(named) and named[0] in right


def named_exactly(label: Mapping[str, Any], report: Mapping[str, Any]) -> bool:
    """Report whether the injected effects, and nothing but them and companions, are named."""
    right = [accepted(one, label) for one in label["names"]]
    named = set(_named(report, False))
    return report["verdict"] in ("effect", "ambiguous") and all(named & one for one in right) and named <= set().union(*right)


def _named(report: Mapping[str, Any], companions: bool) -> list[str]:
    names = [effect["name"] for effect in report["effects"]]
    return [name for name in names if companions or name not in COMPANIONS]


def quiet(report: Mapping[str, Any]) -> bool:
    """Report whether a diagnosis of an unchanged record names nothing but coefficients and session effects."""
    if report["verdict"] in ("no_gap", "parameters"):
        return True
    return report["verdict"] == "effect" and not _named(report, False)


def is_covered(label: Mapping[str, Any], report: Mapping[str, Any]) -> bool | None:
    """Report whether the true value of the injected effect's main parameter lies in its 90 % interval."""
    if report["verdict"] not in ("effect", "ambiguous"):
        return None
    for effect in report["effects"]:
        for parameter, truth in label["truth"][0].items():
            row = effect["parameters"].get(parameter)
            if effect["name"] != label["names"][0] or row is None or row["ci90"][0] is None:
                continue
            true = np.mean([truth[label["axes"].index(axis)] for axis in effect["axis"]] or truth)
            return bool(row["ci90"][0] <= true <= row["ci90"][1])
    return None
