# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Every table, figure and numbered claim of the two papers: scored against a target, or the reason why nothing can be.

A target of `hampi_targets` or `mhl_targets` names the claim that it belongs to; where a claim has none its reason stands here, and
with it in the page.
"""

from __future__ import annotations

HAMPI = (
    *(f"HAMPI Table {number}" for number in range(1, 6)),
    *(f"HAMPI Fig. {number}" for number in range(1, 17)),
    "HAMPI Theorem 1",
    "HAMPI conclusion 1",
    "HAMPI conclusion 2",
)
MHL = (
    *(f"MHL Table {number}" for number in range(1, 5)),
    *(f"MHL Fig. {number}" for number in range(1, 19)),
    "MHL §3, output of the feedback",
    "MHL §3, error at equal output",
    "MHL §4.4, NME lower",
    "MHL §4.4, NRMSE lower",
    "MHL §4.4, lags",
    "MHL §4.4, peak",
    "MHL §4.5, closed loop",
    "MHL §4.5, errors",
)

REASONS = {
    "HAMPI Table 3": "three formulas, which are checked against their definitions by tests; what they do is scored in Fig. 8.",
    "HAMPI Fig. 4": "loops at several rates without a figure; their lags are scored in Table 1, their form in Fig. 1.",
    "HAMPI Fig. 5": "the principle of the dynamic weights, a drawing.",
    "HAMPI Fig. 7": "a flow chart.",
    "HAMPI Fig. 9": "a block diagram.",
    "HAMPI Fig. 10": "the platform.",
    "HAMPI Fig. 13": "the loops of Table 4, which is scored.",
    "HAMPI Fig. 14": "the figures of Table 4 drawn, which is scored.",
    "HAMPI Theorem 1": "it holds in the limit of a small sampling time and has no figure; Table 5 says what it comes to.",
    "MHL Fig. 2": "how the curves are described, a drawing.",
    "MHL Fig. 3": "a block diagram.",
    "MHL Fig. 4": "a block diagram.",
    "MHL Fig. 6": "a block diagram.",
    "MHL Fig. 7": "a block diagram.",
    "MHL Fig. 8": "the setup.",
    "MHL Fig. 12": "the records of Table 3, which is scored.",
    "MHL Fig. 13": "the records of Table 3 as loops, which is scored.",
    "MHL Fig. 14": "the first row of Table 4, which is scored.",
    "MHL Fig. 15": "the second row of Table 4, which is scored.",
    "MHL Fig. 16": "the third row of Table 4, which is scored.",
    "MHL Table 1": "coefficients of another mirror: given beside ours, with the distance of the curves, but no mirror has to have them.",
}
"""Reason why a claim has no target, one sentence."""


def notes(claims: tuple[str, ...]) -> list[str]:
    """The sentences on claims that are not scored, for the page."""
    return [f"{claim}: not scored: {REASONS[claim]}" for claim in claims if claim in REASONS]
