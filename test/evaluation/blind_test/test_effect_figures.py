# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of the effects: one of each, which shows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluation.blind_test.effect_figures import EXAMPLES, draw
from hyst_control.cli import main
from hyst_plant_sim.physics import EFFECTS

FIGURES = Path(__file__).resolve().parents[3] / "docs" / "figures" / "effects"


def test_every_effect_has_a_figure():
    assert list(EXAMPLES) == list(EFFECTS)
    for name in EFFECTS:
        assert 5_000 < (FIGURES / f"{name}.png").stat().st_size < 40_000


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
