"""The page of effects: as committed, with every effect and a figure of each that shows it."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluation.blind_test.effect_figures import EXAMPLES, RECORD, draw, page
from hyst_control.cli import main
from hyst_control.effects import EFFECTS as CATALOGUE
from hyst_plant_sim.physics import EFFECTS

DOCS = Path(__file__).resolve().parents[3] / "docs"


def test_the_page_is_what_the_command_writes():
    assert list(EXAMPLES) == list(EFFECTS)
    text = (DOCS / "effects.md").read_text(encoding="utf-8")
    assert text == page(), "run: hyst cases figures --output docs"
    for name in EFFECTS:
        assert f"(figures/effects/{name}.png)" in text
        assert 5_000 < (DOCS / "figures" / "effects" / f"{name}.png").stat().st_size < 40_000


@pytest.mark.parametrize("name", ["delay", "cross_coupling", "sensor_noise"])
def test_a_figure_has_the_gap_in_it(name, tmp_path, monkeypatch):
    """Orange, the gap's color, where the effect is; and none of it when there is no effect to draw."""
    from PIL import Image

    def orange() -> int:
        draw(name, tmp_path / "figure.png")
        colours = np.asarray(Image.open(tmp_path / "figure.png").convert("RGB")).astype(int)[:, 250:500]  # the spectrum
        return int(np.sum(np.abs(colours - (255, 127, 14)).max(axis=2) < 20))

    assert orange() > 100
    monkeypatch.setattr("evaluation.blind_test.effect_figures._plant", lambda example, effects, own=load_without: own(example))
    assert orange() == 0


def load_without(example):
    from hyst_plant_sim.physics import load_plant

    return load_plant({"plant": example.plant}, seed=1, sample_time=5e-5, noise=0.0)


def test_a_seed_is_due(tmp_path, capsys):
    assert main(["cases", "make", "--output", str(tmp_path / "cases")]) == 2
    assert "--seed" in capsys.readouterr().err and not (tmp_path / "cases").exists()


def test_a_reader_finds_the_range_that_the_diagnosis_searches():
    """Read from the page, and held against the bounds that the fits have."""
    sections = re.split(r"^### ", (DOCS / "effects.md").read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
    text = {section.split()[0]: section for section in sections}
    assert set(text) == {*EFFECTS, *CATALOGUE}
    for name, effect in CATALOGUE.items():
        record = replace(RECORD, axes=2) if effect.couples else RECORD
        due = {each.name: (each.lower, each.upper) for each in effect.parameters(record) if each.told}
        table = re.findall(r"^\| `(\w+)` \| (\S+) \| (\S+) \| (\S+) \|$", text[name], re.MULTILINE)
        assert {row[0] for row in table} == set(due), name
        for parameter, unit, lower, upper in table:
            assert unit and (float(lower), float(upper)) == pytest.approx(due[parameter], rel=5e-3), f"{name}: {parameter}"
