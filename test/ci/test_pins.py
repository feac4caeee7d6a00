# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The scripts of the supply chain: hashes in requirement files, and constraints without them."""

from __future__ import annotations

import re

import pytest

pins = pytest.importorskip("pins", reason="a tool of the supply chain, in .ci")
wheel = pytest.importorskip("wheel", reason="a part of .ci/run")

LINES = ["# what is pinned", "One_Thing==1.0", 'two==2 ; python_version < "3.11"', 'two==3 ; python_version >= "3.11"']
FOUND = {("one-thing", "1.0"): {"b" * 64, "a" * 64}, ("two", "2"): {"c" * 64}, ("two", "3"): {"d" * 64}}


def test_hashes_are_written_and_taken_off_again():
    text = pins.with_hashes(LINES, FOUND)
    assert text.count("--hash=sha256:") == 4 and pins.pinned(text) == LINES
    assert text.index("a" * 64) < text.index("b" * 64), "the order is one"
    assert pins.with_hashes(pins.pinned(text), pins.known_hashes(text)) == text and pins.known_hashes(text) == FOUND


def test_a_version_that_no_interpreter_takes_ends_it():
    with pytest.raises(SystemExit, match="two==3"):
        pins.with_hashes(LINES, {key: value for key, value in FOUND.items() if key != ("two", "3")})


def test_every_pinned_line_of_the_tree_has_a_hash():
    for name in pins.FILES:
        blocks = (pins.ROOT / name).read_text().replace(" \\\n", " ").splitlines()
        lacking = [
            line for line in blocks if line and not line.startswith("#") and not re.search(r"--hash=sha256:[0-9a-f]{64}", line)
        ]
        assert not lacking, name


def test_constraints_are_the_pins_without_hashes(tmp_path, monkeypatch):
    (tmp_path / "requirements.txt").write_text(pins.with_hashes(LINES, FOUND))
    monkeypatch.setattr(wheel, "ROOT", tmp_path)
    assert wheel.constraints(tmp_path).read_text().splitlines() == LINES
