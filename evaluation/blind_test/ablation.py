# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Ablation of the policy: every threshold moved, every rule switched off, and the verdicts that change on cases of tuning seeds.

Each case of the folders is diagnosed once; the decision alone is made anew for each move, and compared with that of the policy as it is.

    hyst blind-test --seed 531 --count 160 --output simulated
    python -m evaluation.blind_test.ablation simulated injected --table ablation.csv
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.blind_test.case import Case, from_document
from evaluation.blind_test.injected_machines import SCORING
from evaluation.blind_test.run import read_case
from evaluation.blind_test.scores import score
from hyst_control.base import progress
from hyst_control.base.files import read_json, write_text
from hyst_control.base.parallel import map_spawned
from hyst_control.diagnose.configuration import CONFIGURATION, Thresholds
from hyst_control.diagnose.decide import novelty, policy, record_findings
from hyst_control.diagnose.evidence import Evidence
from hyst_control.diagnose.record_checks.summary import effect_found_by
from hyst_control.diagnose.run.diagnosis import diagnose
from hyst_control.diagnose.run.settle import Tests, settled
from hyst_control.diagnose.verdict import Decision

FACTORS = (1e-6, 0.5, 2.0, 1e6)
"""A threshold is switched off at one end, halved, doubled, and switched off at the other end."""

BEFORE = frozenset(
    "practical_size stated_excess rounding_share rough_share rough_correlation rough_tail rough_deviations rough_received "
    "rough_scatter".split()
)
"""Thresholds that act before the decision, which alone is made anew."""

LEAST = {"excess_ratio": 1.001}
"""Values below which a threshold has no meaning: noise under the stated one is no excess."""

Rule = tuple[object, str, Callable[..., Any]]
"""Module, name of a function, and what it does where the rule is off."""

RULES: dict[str, Rule] = {
    "_adds_too_little": (policy, "_adds_too_little", lambda *_: False),
    "_is_known_effect": (policy, "_is_known_effect", lambda *_: False),
    "_has_plainer_one": (policy, "_has_plainer_one", lambda *_: False),
    "_worth_naming": (policy, "_worth_naming", lambda *_: True),
    "_has_own_error": (policy, "_has_own_error", lambda *_: False),
    "strained": (policy, "strained", lambda *_: False),
    "_unusual": (policy, "is_unusual", lambda *_: False),
    "vibration_found": (policy, "vibration_found", lambda *_: None),
    "flicker_found": (policy, "flicker_found", lambda *_: None),
    "too_many": (novelty, "_too_many", lambda *_: False),
    "_is_own_error": (record_findings, "_is_own_error", lambda *_: False),
}
"""Rules of the policy that are more than a threshold."""


@dataclass(frozen=True)
class Move:
    """A change of the policy."""

    name: str
    thresholds: Thresholds
    rule: Rule | None = None  # That is off


@dataclass(frozen=True)
class Outcome:
    """Result of a case, as far as it is scored."""

    verdict: str
    names: tuple[str, ...]
    right: bool


Parts = Sequence[tuple[Evidence, Tests]]


def moves(thresholds: Thresholds) -> Iterator[Move]:
    """Every threshold moved, every rule switched off."""
    for one in fields(thresholds):
        if one.name in BEFORE:
            continue
        value = getattr(thresholds, one.name)
        for factor in FACTORS:
            moved = max(round(value * factor), 1) if isinstance(value, int) else max(value * factor, LEAST.get(one.name, 0.0))
            if moved != value:
                yield Move(f"{one.name} x {factor:g}", replace(thresholds, **{one.name: moved}))
    for name, rule in RULES.items():
        yield Move(f"rule {name}", thresholds, rule)


@contextmanager
def without(rule: Rule | None) -> Iterator[None]:
    """The policy with a rule switched off."""
    if rule is None:
        yield
        return
    module, name, off = rule
    usual = getattr(module, name)
    users = [one for one in (policy, novelty, record_findings) if getattr(one, name, None) is usual]
    for one in users:
        setattr(one, name, off)
    try:
        yield
    finally:
        for one in users:
            setattr(one, name, usual)


def outcome(case: Case, parts: Parts, move: Move) -> Outcome:
    """Decide on a case and score the decision."""
    decisions = [settled(evidence, tests, move.thresholds) for evidence, tests in parts]
    joint = policy.join([decision for _, decision in decisions])
    names = _named(decisions)
    report = {"verdict": joint.verdict.value, "effects": [{"name": name, "parameters": {}} for name in names]}
    return Outcome(joint.verdict.value, names, score(case, report).right)


def _named(decisions: Sequence[tuple[Evidence, Decision]]) -> tuple[str, ...]:
    """Names in the order of a report: the most probable first, noise that is the smaller part of the gap last, companions at the end."""
    ranks: dict[str, tuple[bool, float]] = {}
    last: list[str] = []
    for evidence, decision in decisions:
        for index in decision.listed:
            for name in evidence.hypotheses[index].names:
                ranks.setdefault(name, (False, -round(decision.of(name), 3)))
        for finding in decision.findings:
            effect = effect_found_by(finding.check)
            if effect is None:
                continue
            gap = evidence.hypotheses[0].energy * float(np.mean(np.square(evidence.noise)))
            own = finding.check.is_noise or finding.check.is_of_the_record
            ranks.setdefault(effect.name, (own and finding.rms**2 < 0.5 * gap, -1.0 + float(np.exp(-min(finding.gain, 50.0)))))
        last += [one.effect for one in decision.companions]
    return (*sorted(ranks, key=ranks.__getitem__), *last)


def outcomes(case: Case, parts: Parts) -> list[Outcome]:
    """Decide on a case by the policy as it is, then once for each move."""
    found = [outcome(case, parts, Move("", CONFIGURATION.policy))]
    for move in moves(CONFIGURATION.policy):
        with without(move.rule):
            found.append(outcome(case, parts, move))
    return found


def _outcomes_of(job: tuple[Case, Path]) -> list[Outcome]:
    """Outcomes of a case that is diagnosed from its files; none where that fails."""
    case, place = job
    try:
        record, model, warm_up, clean = read_case(place)
        parts = diagnose([record], model, warm_up=warm_up, baseline=clean).parts
    except Exception as error:  # a fault costs this case
        progress.step(f"{case.name}: {type(error).__name__}: {error}")
        return []
    return outcomes(case, [(part.evidence, part.tests) for part in parts if part.tests is not None])


def changes(found: Sequence[Sequence[Outcome]]) -> dict[str, tuple[int, int, int]]:
    """By move: on how many cases verdict or names change, how many become right, and how many wrong."""
    return {
        move.name: (
            sum((one[place].verdict, one[place].names) != (one[0].verdict, one[0].names) for one in found),
            sum(one[place].right and not one[0].right for one in found),
            sum(one[0].right and not one[place].right for one in found),
        )
        for place, move in enumerate(moves(CONFIGURATION.policy), 1)
    }


def main() -> None:
    """Diagnose the cases of folders and print what each move changes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, help="folders of `hyst blind-test`, of tuning seeds")
    parser.add_argument("--table", type=Path, metavar="OUT.csv", help="file to write what moves change")
    given = parser.parse_args()
    jobs = []
    for folder in given.folders:
        labels = read_json(folder / "labels.json")
        if labels["seed"] >= SCORING:
            raise SystemExit(f"{folder}: holds cases of a scoring seed: rules are measured on tuning seeds, below {SCORING}")
        jobs += [(case, folder / "cases" / case.name) for case in map(from_document, labels["cases"])]
    found = [one for one in map_spawned(_outcomes_of, jobs) if one]
    print(f"{len(found)} cases, {sum(usual.right for usual, *_ in found)} right")
    rows = changes(found)
    for move, (changed, better, worse) in rows.items():
        print(f"{move:40s} changed {changed:4d}  better {better:3d}  worse {worse:3d}")
    if given.table is not None:
        head = ("move", "cases", "changed", "better", "worse")
        lines = [",".join(map(str, row)) for row in (head, *((move, len(found), *counts) for move, counts in rows.items()))]
        write_text(given.table, "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
