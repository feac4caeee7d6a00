# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Ablation of the policy: every threshold moved, every rule switched off, and the verdicts that change on cases of tuning seeds.

`collect` diagnoses the cases of a blind test's folder and stores, for each, its evidence with all tests that any move asks for, in
rules/NAME.json. `ablated` replays the decision alone on them, once for each move, and compares case by case.

    hyst blind-test --seed 531 --count 160 --output simulated
    python -m evaluation.blind_test.ablation collect simulated injected
    python -m evaluation.blind_test.ablation replay simulated injected
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import Enum
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np

from evaluation.blind_test.case import Case, from_document
from evaluation.blind_test.injected_machines import SCORING
from evaluation.blind_test.run import plain
from evaluation.blind_test.scores import score
from hyst_control.base.files import read_json, write_text
from hyst_control.base.parallel import compute_serially
from hyst_control.diagnose.configuration import CONFIGURATION, Thresholds
from hyst_control.diagnose.decide import novelty, policy, record_findings
from hyst_control.diagnose.evidence import Evidence, ResidualEvidence
from hyst_control.diagnose.record_checks.summary import effect_found_by
from hyst_control.diagnose.run import settle
from hyst_control.diagnose.run.diagnosis import diagnose
from hyst_control.diagnose.run.settle import Tests, settled
from hyst_control.diagnose.validate.constancy import VARIABLES
from hyst_control.diagnose.verdict import Decision
from hyst_control.model_file import load_model
from hyst_control.records.bags.bag_reader import read_bag

FACTORS = (1e-6, 0.5, 2.0, 1e6)
"""A threshold is switched off at one end, halved, doubled, and switched off at the other end."""

BEFORE = frozenset(
    "practical_size stated_excess rounding_share rough_share rough_correlation rough_tail rough_deviations rough_received "
    "rough_scatter".split()
)
"""Thresholds that act before the evidence is stored: a replay does not move them."""

LEAST = {"excess_ratio": 1.001}
"""Values below which a threshold has no meaning: noise under the stated one is no excess."""

Rule = tuple[object, str, Callable[..., Any]]
"""Module, name of a function, and what it does where the rule is off."""

RULES: dict[str, Rule] = {
    "vetoes": (settle, "VETOES", 0),  # type: ignore[dict-item]
    "_adds_too_little": (policy, "_adds_too_little", lambda *_: False),
    "_is_known_effect": (policy, "_is_known_effect", lambda *_: False),
    "_worth_naming": (policy, "_worth_naming", lambda *_: True),
    "_stands_out": (policy, "_stands_out", lambda *_: False),
    "_has_own_error": (policy, "_has_own_error", lambda *_: False),
    "strained": (policy, "strained", lambda *_: False),
    "_unusual": (policy, "_unusual", lambda *_: False),
    "vibration_found": (policy, "vibration_found", lambda *_: None),
    "flicker_found": (policy, "flicker_found", lambda *_: None),
    "too_many": (novelty, "_too_many", lambda *_: False),
    "_constancy": (novelty, "_constancy", lambda *_: []),
    "_is_own_error": (record_findings, "_is_own_error", lambda *_: False),
}
"""Rules of the policy that are more than a threshold."""


NUMBERS: dict[str, dict[str, Any]] = {
    "at_bound": {"at_bound": False},
    "local": {"local": np.inf},
    "beyond": {"beyond": 0.0},
    "taken_up": {"taken_up": np.inf},
    "predictable": {"predictable": 1.0},
    "hump": {"hump": None},
    "flicker": {"flicker": None},
    "companions": {"companions": ()},
    "temper": {"temper": 1.0},
    "weight": {"weight": 1.0},
    "clean_noise": {"clean_noise": False},
    "repeating": {"repeating": frozenset()},
    "ends_as": {"ends_as": ()},
    "moved": {"moved": 0.0},
}
"""Numbers of the evidence, and what they are where nothing is measured."""


class NotMeasured(KeyError):
    """A replay asks for a test that was not stored."""


@dataclass(frozen=True)
class StoredTests:
    """Tests of contenders as they were stored."""

    residuals: Mapping[int, ResidualEvidence]
    drops: Mapping[int, tuple[int, ...]]

    def residual(self, index: int) -> ResidualEvidence:
        """Residual under a hypothesis."""
        if index not in self.residuals:
            raise NotMeasured(index)
        return self.residuals[index]

    def dropped(self, index: int) -> tuple[int, ...]:
        """Hypotheses that are dropped because this one does not hold."""
        if index not in self.drops:
            raise NotMeasured(index)
        return self.drops[index]


@dataclass(frozen=True)
class Move:
    """A change of the policy."""

    name: str
    thresholds: Thresholds
    rule: Rule | None = None  # That is off
    numbers: Mapping[str, Any] = field(default_factory=dict)  # That are not measured

    def _changed(self, one: Any) -> Any:
        """A part of the evidence without the numbers."""
        known = {name: value for name, value in self.numbers.items() if hasattr(one, name)}
        if isinstance(one, ResidualEvidence) and self.name.startswith("distortions"):
            known["distortions"] = tuple(test for test in one.distortions if test.variable != self.name.split()[1])
        return replace(one, **known) if known else one

    def settled(self, evidence: Evidence, tests: Tests) -> tuple[Evidence, Decision]:
        """Decide."""
        evidence = self._changed(evidence)
        if self.numbers or self.name.startswith("distortions"):
            evidence = replace(evidence, hypotheses=tuple(map(self._changed, evidence.hypotheses)))
            tests = _ChangedTests(tests, self._changed)
        return settled(evidence, tests, self.thresholds)


@dataclass(frozen=True)
class _ChangedTests:
    """Tests some of whose numbers are changed."""

    tests: Tests
    change: Callable[[ResidualEvidence], ResidualEvidence]

    def residual(self, index: int) -> ResidualEvidence:
        return self.change(self.tests.residual(index))

    def dropped(self, index: int) -> tuple[int, ...]:
        return self.tests.dropped(index)


@dataclass(frozen=True)
class Outcome:
    """Result of a case, as far as it is scored."""

    verdict: str
    names: tuple[str, ...]
    right: bool
    reasons: tuple[str, ...]


AS_IT_IS = Move("", CONFIGURATION.policy)

Parts = Sequence[tuple[Evidence, Tests]]


def moves(thresholds: Thresholds) -> Iterator[Move]:
    """Every threshold moved, every rule switched off, every number not measured."""
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
    for name, numbers in NUMBERS.items():
        yield Move(f"number {name}", thresholds, numbers=numbers)
    for variable in VARIABLES:
        yield Move(f"distortions {variable}", thresholds)


@contextmanager
def without(rule: Rule | None) -> Iterator[None]:
    """The policy with a rule switched off."""
    if rule is None:
        yield
        return
    module, name, off = rule
    usual = getattr(module, name)
    users = [one for one in (policy, novelty, record_findings, settle) if getattr(one, name, None) is usual]
    for one in users:
        setattr(one, name, off)
    try:
        yield
    finally:
        for one in users:
            setattr(one, name, usual)


def outcome(case: Case, parts: Parts, move: Move) -> Outcome:
    """Decide on a case and score the decision."""
    decisions = [move.settled(evidence, tests) for evidence, tests in parts]
    joint = policy.join([decision for _, decision in decisions])
    names = _named(decisions)
    report = {"verdict": joint.verdict.value, "effects": [{"name": name, "parameters": {}} for name in names]}
    return Outcome(joint.verdict.value, names, score(case, report).right, tuple(reason.value for reason in joint.reasons))


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


def collect(folder: Path) -> None:
    """Diagnose the cases of a folder and store the evidence with all tests that moves ask for; what is stored is kept."""
    (folder / "rules").mkdir(exist_ok=True)
    for place in sorted((folder / "cases").iterdir()):
        path = folder / "rules" / f"{place.name}.json"
        if path.exists() or not (place / "model.yaml").exists():
            continue
        begin = time.process_time()
        try:
            warm_up = read_json(place / "case.json")["warm_up"] if (place / "case.json").exists() else 0.0
            clean = [read_bag(one) for one in sorted(place.glob("clean_*"))]
            parts = diagnose([read_bag(place / "bag")], load_model(place / "model.yaml"), warm_up=warm_up, baseline=clean).parts
        except Exception as error:  # a fault costs this case
            print(f"{place.name}: {type(error).__name__}: {error}")
            continue
        first = time.process_time()
        untested = [(part.tests.evidence, part.tests) for part in parts if part.tests is not None]
        for move in moves(CONFIGURATION.policy):
            with without(move.rule):
                for evidence, tests in untested:
                    move.settled(evidence, tests)
        stored = [{"evidence": evidence, "residuals": tests.residuals, "drops": tests.drops} for evidence, tests in untested]
        path.write_text(json.dumps(plain(stored)))
        print(f"{place.name}: {first - begin:.1f} s, tests {time.process_time() - first:.1f} s", flush=True)


def parts_of(path: Path) -> Parts:
    """Read what `collect` stored of a case."""
    return [
        (
            made(Evidence, part["evidence"]),
            StoredTests(
                {int(index): made(ResidualEvidence, one) for index, one in part["residuals"].items()},
                {int(index): tuple(one) for index, one in part["drops"].items()},
            ),
        )
        for part in json.loads(path.read_text())
    ]


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def made(kind: Any, value: Any) -> Any:
    """A value of a declared type from its JSON types."""
    origin, inner = get_origin(kind), get_args(kind)
    if value is None or kind in (Any, float, int, str, bool):
        return float(value) if kind is float else value
    if origin in (Union, UnionType):
        return made(next(one for one in inner if one is not type(None)), value)
    if origin is tuple:
        kinds = inner[:1] * len(value) if inner[-1] is Ellipsis else inner
        return tuple(made(one, each) for one, each in zip(kinds, value, strict=True))
    if origin is frozenset:
        return frozenset(made(inner[0], each) for each in value)
    if isinstance(kind, type) and is_dataclass(kind):
        hints = _hints(kind)
        # Evidence of before a number was deleted has it still.
        return kind(**{name: made(hints[name], each) for name, each in value.items() if name in hints})
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(value)
    raise TypeError(kind)


@dataclass(frozen=True)
class Change:
    """Outcome of a move on all cases, beside the policy as it is."""

    move: str
    changed: int  # Verdict or names differ
    better: int  # Wrong before, right now
    worse: int  # Right before, wrong now
    unmeasured: int  # Cases that ask for a test that was not stored


def replayed(folders: Sequence[Path], move: Move = AS_IT_IS) -> dict[str, tuple[Case, Parts, Outcome]]:
    """Read all stored cases with their outcome as the policy is."""
    found = {}
    for folder in folders:
        cases = {case.name: case for case in map(from_document, read_json(folder / "labels.json")["cases"])}
        for path in sorted((folder / "rules").glob("*.json")):
            parts = parts_of(path)
            found[f"{folder.name}/{path.stem}"] = cases[path.stem], parts, outcome(cases[path.stem], parts, move)
    return found


def ablated(cases: Mapping[str, tuple[Case, Parts, Outcome]]) -> list[Change]:
    """Compare every move with the policy as it is, case by case."""
    found = []
    for move in moves(CONFIGURATION.policy):
        changed = better = worse = unmeasured = 0
        with without(move.rule):
            for case, parts, usual in cases.values():
                try:
                    moved = outcome(case, parts, move)
                except NotMeasured:
                    unmeasured += 1
                    continue
                changed += (moved.verdict, moved.names) != (usual.verdict, usual.names)
                better += moved.right and not usual.right
                worse += usual.right and not moved.right
        found.append(Change(move.name, changed, better, worse, unmeasured))
    return found


def table(found: Sequence[Change], cases: int) -> str:
    """Write the changes as CSV, with the number of cases."""
    rows = [f"{one.move},{cases - one.unmeasured},{one.changed},{one.better},{one.worse}" for one in found]
    return "\n".join(["move,cases,changed,better,worse", *rows]) + "\n"


def main() -> None:
    """Collect evidence, or replay it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("collect", "replay"))
    parser.add_argument("folders", nargs="+", type=Path, help="folders of `hyst blind-test`, of tuning seeds")
    parser.add_argument("--table", type=Path, metavar="OUT.csv", help="file to write what moves change")
    given = parser.parse_args()
    for folder in given.folders:
        if read_json(folder / "labels.json")["seed"] >= SCORING:
            raise SystemExit(f"{folder}: holds cases of a scoring seed: rules are measured on tuning seeds, below {SCORING}")
    if given.what == "collect":
        compute_serially()
        for folder in given.folders:
            collect(folder)
        return
    cases = replayed(given.folders)
    found = ablated(cases)
    print(f"{len(cases)} cases, {sum(usual.right for *_, usual in cases.values())} right")
    for one in found:
        print(f"{one.move:40s} changed {one.changed:4d}  better {one.better:3d}  worse {one.worse:3d}  unmeasured {one.unmeasured}")
    if given.table is not None:
        write_text(given.table, table(found, len(cases)))


if __name__ == "__main__":
    main()
