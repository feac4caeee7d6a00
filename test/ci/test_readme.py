# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The comparison of the README with what its commands print: a changed number or word is found, rounding is not."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

readme = pytest.importorskip("readme", reason="a part of .ci/run")
README = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")
DEMO = "HAMPI Table 5\n" + "\n".join(f"  {at}  {name}  nrmse  {value}  %  1" for at, name, value in readme.table_of(README))


@pytest.mark.parametrize(
    ("said", "printed", "same"),
    [
        ("held-out: NRMSE 0.355 %", "  held-out:  NRMSE 0.3554 %", True),
        ("held-out: NRMSE 0.355 %", "held-out: NRMSE 0.395 %", False),
        ("70600 samples", "70600 samples", True),
        ("70600 samples", "98600 samples", False),
        ("at most 2e+05 V/s", "at most 2.01e+05 V/s", True),
        ("caused by a slew limit of 29.5 kV/s. …", "caused by a slew limit of 29.6 kV/s. Adding it …", True),
        ("caused by a slew limit of 29.5 kV/s. …", "caused by a delay of 29.5 us.", False),
        ("kp 0.272", "kp 0.272, ki 3", False),
    ],
)
def test_a_line_is_compared_with_its_numbers(said, printed, same):
    assert readme.same(said, printed) is same


def test_lines_are_due_in_their_order():
    assert not readme.missing(["a 1", "…", "b 2"], "a 1\nmore\nb 2\n")
    assert readme.missing(["b 2", "a 1"], "a 1\nb 2\n") == ["a 1"]


def test_every_number_of_the_table_is_compared():
    assert not readme.untrue_errors(README, DEMO) and len(readme.table_of(README)) == 16
    for number in re.findall(r"nrmse  ([\d.]+)", DEMO):
        changed = DEMO.replace(f"nrmse  {number}", f"nrmse  {1.1 * float(number) + 0.02}", 1)
        assert len(readme.untrue_errors(README, changed)) == 1
    assert readme.untrue_errors(README, "")


def test_the_readme_runs_commands_and_python_and_shows_their_output():
    found = readme.shown(README)
    assert [each.title.split()[:2] for each in found if each.title.startswith("hyst")][:2] == [["hyst", "demo"], ["hyst", "excite"]]
    assert sum(each.words[0] == sys.executable for each in found) == 1
    assert sum(bool(each.lines) for each in found) >= 5
