# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A change of the public API is noticed, and stated under its version."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / ".ci" / "public_api.py"
if not SCRIPT.exists():
    pytest.skip("a tool of the checkout, in .ci", allow_module_level=True)
LONGEST = 40
"""Lines of a screen."""


def test_the_public_api_is_the_one_that_is_stated():
    found = subprocess.run([sys.executable, str(SCRIPT)], capture_output=True, text=True, cwd=ROOT)
    assert found.returncode == 0, found.stderr


def test_another_api_is_noticed(monkeypatch):
    sys.path.insert(0, str(SCRIPT.parent))
    import public_api

    text = (ROOT / "docs" / "public_api.txt").read_text(encoding="utf-8")
    for line in (
        "hc.read_bag(",
        "executable pi_feedback",
        "parameter pi_feedback kp = ",
        "service base reset",
        "effect creep",
        "output pi_feedback command",
    ):
        assert sum(each.startswith(line) for each in text.splitlines()) == 1, line
    monkeypatch.setattr(public_api, "SOURCES", ())
    assert set(text.splitlines()) - set("\n".join(public_api.interfaces()).splitlines()) > {"output pi_feedback command"}


def test_the_newest_changes_fit_on_a_screen_and_name_the_version():
    newest = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")[1]
    version = re.findall("<version>(.*)</version>", (ROOT / "package.xml").read_text(encoding="utf-8"))[0]
    assert newest.startswith(version) and len(newest.splitlines()) <= LONGEST


def test_every_box_of_the_declaration_has_a_check_that_exists():
    rows = [line.split(" | ") for line in (ROOT / "QUALITY_DECLARATION.md").read_text(encoding="utf-8").splitlines()]
    boxes = [cells for cells in rows if re.match(r"\| \d\.\d ", cells[0])]
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(boxes) >= 20
    for box in boxes:
        shown = re.findall(r"`([^`]+)`", box[2])
        assert shown, box[0]
        for command in shown:
            words = command.split()
            if words[0] == "make":
                assert words[1] in targets, command
            for word in words:
                if "/" in word and not word.startswith("-"):
                    assert (ROOT / word).exists(), command
