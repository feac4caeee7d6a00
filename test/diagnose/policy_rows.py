"""Row of the policy's table: one rule, with the numbers that it is about and what is due."""

from __future__ import annotations

from dataclasses import dataclass

from hyst_control.diagnose.evidence import Evidence
from hyst_control.diagnose.verdict import Reason, Verdict
from hyst_control.effects.effect import RecordCheck


@dataclass(frozen=True)
class Row:
    """One rule: evidence, and the verdict, reasons, names listed and checks that found something that are due."""

    rule: str
    evidence: Evidence
    verdict: Verdict
    reasons: tuple[Reason, ...]
    listed: tuple[str, ...] = ()
    checks: tuple[RecordCheck, ...] = ()
    remainder: float | None = None


V, R, C = Verdict, Reason, RecordCheck
