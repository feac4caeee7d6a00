# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The page of the papers' targets: what it says is met or missed follows the rows."""

import pytest

from evaluation.reproduction.page import write_page
from evaluation.reproduction.targets import Rows, hampi_targets
from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.reporting.tables import Table


class Asked(Rows):
    """Rows that hold whatever is asked for, one value a model, and remember what that was."""

    VALUES = {"HAPI": 1.5, "RDPI": 1.6, "HAMPI": 1.1}

    def __init__(self) -> None:
        super().__init__([])
        self.keys: dict[tuple[str, str, str, str], float] = {}

    def value(self, table: str, case: str, subject: str, quantity: str) -> float:
        return self.keys.setdefault((table, case, subject, quantity), self.VALUES.get(subject.split(",")[0], 1.0))


def result(path, tracked: float = 1.1, gain_margin: float = 8.0):
    """A HAMPI result whose rows are one value a model, but for HAMPI's tracking at 50 Hz and the margins."""
    asked = Asked()
    hampi_targets(asked)
    table = Table("reproduce hampi", notes=["A note."])
    for key, value in asked.keys.items():
        chosen = key == ("HAMPI Table 5", "50 Hz", "HAMPI, paper", "nrmse")
        table.add(*key, "", tracked if chosen else value)
    for quantity, value in (("gain_margin", gain_margin), ("phase_margin", 60.0)):
        table.add("HAMPI model: feedback tuned on it", "truth, gain +0%, first mode +0%", "tuned PI", quantity, "", value)
    table.write(path)


def verdicts(text: str) -> dict[str, bool]:
    """Whether a target is met, by its name."""
    lines = [line.split(" | ") for line in text.splitlines() if " | met | " in line or " | **missed** | " in line]
    return {line[0].removeprefix("| "): line[4] == "met" for line in lines}


@pytest.mark.parametrize(
    ("given", "name", "met"),
    [
        ({}, "HAMPI Table 5: 4 um at 50 Hz, open loop: NRMSE with HAMPI, paper", True),
        ({"tracked": 1.3}, "HAMPI Table 5: 4 um at 50 Hz, open loop: NRMSE with HAMPI, paper", False),
        ({"tracked": 1.3}, "HAMPI Table 5: 4 um at 100 Hz, open loop: NRMSE with HAMPI, paper", True),
        ({"tracked": 1.6}, "HAMPI Table 5: 4 um at 50 Hz: HAPI's NRMSE over HAMPI's, paper", False),
        ({}, "tuned feedback on the truth plant, ±10 % gain, ±20 % mode: gain margin", True),
        ({"gain_margin": 5.0}, "tuned feedback on the truth plant, ±10 % gain, ±20 % mode: gain margin", False),
        ({"gain_margin": float("nan")}, "tuned feedback on the truth plant, ±10 % gain, ±20 % mode: gain margin", False),
    ],
)
def test_targets_are_met_or_missed_as_the_rows_say(tmp_path, given, name, met):
    """The published bound at 50 Hz is 1.28 %; HAPI's error is 1.5 %."""
    result(tmp_path / "hampi.json", **given)
    assert main(["reproduce", "page", "--results", str(tmp_path / "hampi.json"), "--page", str(tmp_path / "page.md")]) == 0
    text = (tmp_path / "page.md").read_text()
    found = verdicts(text)
    assert found[name] is met
    assert f"{sum(found.values())} of {len(found)} targets met: " in text
    assert "- A note." in text and "### HAMPI Table 4" in text


def test_a_file_that_is_no_result_is_refused(tmp_path):
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(InputError, match="no result"):
        write_page([tmp_path / "other.json"], tmp_path / "page.md")
    assert main(["reproduce", "hampi", "--page", "page.md"]) == 2
