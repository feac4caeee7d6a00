# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The two papers: published figures, claims, and sentences on the experiments that repeat theirs, from `papers.yaml`.

Every table, figure and numbered claim is scored against a target of `targets`, or has a reason why nothing can be.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from evaluation.data_files import table_file


@dataclass(frozen=True)
class Paper:
    """Published figures of one paper, its claims, and sentences on their repetition."""

    published: Mapping[str, Any]  # Figures by table, those of several columns as tuples
    claims: tuple[str, ...]  # Its tables, figures and numbered claims
    notes: tuple[str, ...]  # On the results
    causes: Mapping[str, str]  # Why targets are missed
    reasons: Mapping[str, str]  # Why a claim has no target

    @property
    def not_scored(self) -> list[str]:
        """Sentences on the claims that are not scored, for the page."""
        return [f"{claim}: not scored: {self.reasons[claim]}" for claim in self.claims if claim in self.reasons]


def _paper(name: str, claims: Mapping[str, Any], **given: Any) -> Paper:
    counted = [("Table", claims["tables"]), ("Fig.", claims["figures"])]
    every = [f"{name.upper()} {what} {number + 1}" for what, count in counted for number in range(count)]
    return Paper(claims=(*every, *claims["others"]), **given)


HAMPI, MHL = (_paper(name, **given) for name, given in table_file("reproduction/papers.yaml").items())
