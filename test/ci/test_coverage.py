# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The gate of the coverage: what is below its limit is named, and the files of the safety path are there."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
if not (ROOT / ".ci").is_dir():
    pytest.skip("the gate is a tool of the checkout, in .ci", allow_module_level=True)
GATE = runpy.run_path(str(ROOT / ".ci" / "measure_coverage.py"))
LIMITS = yaml.safe_load((ROOT / ".ci" / "coverage.yaml").read_text(encoding="utf-8"))


def report(share: float, **files: float) -> dict:
    shown = {
        name: {"summary": {"percent_covered": value}, "missing_lines": [7], "missing_branches": [[8, 9]]}
        for name, value in files.items()
    }
    return {"totals": {"percent_covered": share}, "files": shown}


def test_the_safety_path_is_there_and_wholly_covered():
    assert LIMITS["safety_path"] == 100
    assert all((ROOT / name).is_file() for name in [*LIMITS["safety_files"], *LIMITS["safety_tests"]])


def test_what_is_below_its_limit_is_named():
    limits = {"package": 90, "safety_path": 100, "safety_files": ["a", "b"]}
    assert GATE["shortfalls"](report(90.0, a=100.0, b=100.0), limits) == []
    low = GATE["shortfalls"](report(89.9, a=99.0), limits)
    assert [line.split(":")[0] for line in low] == ["package", "a", "b"] and "7, 8->9" in low[1]
