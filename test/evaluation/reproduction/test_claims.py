# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Every table, figure and numbered claim of both papers has a target on the page, or a sentence why it has none."""

import re
from pathlib import Path

import pytest

from evaluation.reproduction.page import write_page
from evaluation.reproduction.papers import HAMPI, MHL

DATA = Path(__file__).resolve().parents[3] / "docs" / "data"
EXPECTED = {
    "HAMPI": [
        *(f"HAMPI Table {number}" for number in range(1, 6)),
        *(f"HAMPI Fig. {number}" for number in range(1, 17)),
        "HAMPI Theorem 1",
        "HAMPI conclusion 1",
        "HAMPI conclusion 2",
    ],
    "MHL": [
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
    ],
}
"""What the papers hold, counted by hand: 5 tables and 16 figures, 4 tables and 18 figures, and the claims with a number."""


@pytest.fixture(scope="module")
def text(tmp_path_factory) -> str:
    """The page that `hyst reproduce page` writes from the results in docs/data."""
    path = tmp_path_factory.mktemp("claims") / "papers.md"
    write_page([DATA / "hampi.json", DATA / "mhl.json"], path)
    return path.read_text(encoding="utf-8")


def test_the_list_is_the_papers():
    assert [*HAMPI.claims, *MHL.claims] == [*EXPECTED["HAMPI"], *EXPECTED["MHL"]]
    assert set(HAMPI.reasons) <= set(HAMPI.claims) and set(MHL.reasons) <= set(MHL.claims)


@pytest.mark.parametrize("claim", [*EXPECTED["HAMPI"], *EXPECTED["MHL"]])
def test_a_claim_is_scored_or_says_why_not(text, claim):
    targets = re.findall(rf"^\| {re.escape(claim)}: .*\| (?:met|\*\*missed\*\*) \|", text, re.MULTILINE)
    reasons = re.findall(rf"^- {re.escape(claim)}: not scored: \w.*\.$", text, re.MULTILINE)
    assert len(reasons) == (0 if targets else 1)


def test_a_missed_target_has_its_reason(text):
    for line in text.splitlines():
        if "| **missed** |" in line:
            assert len(line.split("| **missed** |")[1].strip(" |")) > 40, line


def test_the_counts_are_those_of_the_table(text):
    """Of every section: all targets, those whose bound is the paper's, and those whose bound is ours; met, and in all."""
    for section in text.split("\n## ")[1:]:
        line = next(line for line in section.splitlines() if " targets met" in line)
        counts = [(int(met), int(every)) for met, every in re.findall(r"(\d+) of (\d+) ", line)]
        rows = re.findall(r"^\| .* \| (paper|ours) \| (met|\*\*missed\*\*) \|", section, re.MULTILINE)
        for (met, every), origins in zip(counts, ({"paper", "ours"}, {"paper"}, {"ours"}), strict=True):
            verdicts = [verdict for origin, verdict in rows if origin in origins]
            assert (met, every) == (verdicts.count("met"), len(verdicts))
