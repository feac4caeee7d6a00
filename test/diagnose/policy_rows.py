# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of the policy's table: each states a rule, evidence, and the decision that is expected."""

from __future__ import annotations

from dataclasses import dataclass

from hyst_control.diagnose.evidence import Evidence
from hyst_control.diagnose.verdict import Reason, Verdict
from hyst_control.effects.effect import RecordCheck


@dataclass(frozen=True)
class Row:
    """One rule: evidence, and the expected verdict, reasons, listed names and findings of checks."""

    rule: str
    evidence: Evidence
    verdict: Verdict
    reasons: tuple[Reason, ...]
    listed: tuple[str, ...] = ()
    checks: tuple[RecordCheck, ...] = ()
    remainder: float | None = None


V, R, C = Verdict, Reason, RecordCheck
