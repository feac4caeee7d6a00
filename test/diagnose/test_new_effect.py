# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The documentation's new effect, taken from its page and put into the catalogue: one file is all that it takes."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

import hyst_control.diagnose.search.candidate as candidates
from hyst_control.chain import stage as stages
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.effects import EFFECTS
from test.diagnose.conftest import nominal, record_of

PAGE = Path(__file__).resolve().parents[2] / "docs" / "extending.md"
DEAD_BAND = {"name": "crossover_dead_band", "half_width": 1.5}
RIVALS = {"backlash", "delay", "gain", "saturation", "quantization", "offset"}
"""Effects that remain in the catalogue: those that are nearest to it, and some others."""
WITHOUT = [name for name in EFFECTS if name not in RIVALS]


@pytest.fixture
def documented(tmp_path, monkeypatch):
    """The page's file as a module; the catalogue and the known stages are as before afterwards."""
    (source,) = [
        block
        for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
        if "class CrossoverDeadBand" in block
    ]
    (tmp_path / "documented_effect.py").write_text(source, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    kept = dict(stages.STAGES)
    import documented_effect

    monkeypatch.setitem(EFFECTS, documented_effect.EFFECT.name, documented_effect.EFFECT)
    assert candidates.EFFECTS is EFFECTS
    yield documented_effect
    for name in set(stages.STAGES) - set(kept):
        del stages.STAGES[name]
    sys.modules.pop("documented_effect")


def test_without_the_file_the_effect_is_not_named():
    document, _, _ = diagnosed([record_of("pea_published", [DEAD_BAND])], nominal("pea_published"), without=WITHOUT)
    assert document["verdict"] != "no_gap"
    assert DEAD_BAND["name"] not in {row["name"] for row in document["candidates"]}


def test_with_the_file_it_is_named_and_sized(documented):
    document, _, better = diagnosed([record_of("pea_published", [DEAD_BAND])], nominal("pea_published"), without=WITHOUT)
    named = {row["name"]: row for row in document["effects"]}
    assert document["verdict"] == "effect" and DEAD_BAND["name"] in named
    assert named[DEAD_BAND["name"]]["parameters"]["half_width"]["value"] == pytest.approx(1.5, rel=0.05)
    assert named[DEAD_BAND["name"]]["shrink"] > 0.9
    assert documented.CrossoverDeadBand in {type(stage) for stage in better.chain.stages}
