# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst identify` and `identify_bags`: options come from the families, as texts or values, and none is dropped without a word."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.cli import main
from hyst_control.identify import estimators
from hyst_control.identify.families.estimator import every_option
from hyst_control.identify.workflow import chosen_families, identify_bags
from hyst_control.model_file import load_model
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.stream.signal_message import Encoder


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    """Loops of falling amplitude of three play operators, sampled at 1 kHz."""
    time = np.arange(3000) / 1000
    command = (40 * (1 - np.cos(2 * np.pi * 4 * time)) * np.exp(-0.5 * time) / 2)[:, None]
    measurement = (
        0.05 * command + 0.01 * np.maximum.accumulate(command - 3.0) + 1e-4 * np.random.default_rng(1).normal(size=command.shape)
    )
    path = tmp_path_factory.mktemp("bags") / "loops"
    with BagWriter(path) as writer:
        for topic, unit, values in (("/command", "V", command), ("/measurement", "um", measurement)):
            writer.write(topic, Encoder(f"t[s],x[{unit}]").encode(np.concatenate([time[:, None], values], axis=1)), 10**9)
    return path


@pytest.mark.parametrize(
    "words, line",
    [
        ("--model mhl --operators 5", "operators: mhl has no such option: it has method, degree, "),
        ("--model madelung --thresholds 0,2,5", "thresholds: madelung has no such option"),
        ("--model linear --one-sided", "one_sided: linear has no such option"),
        ("--model rdpi --one-sided", "one_sided: rdpi has no such option"),
        ("--model pi --structure modes=1", "structure: pi has no such option"),
        ("--model pi --method paper", "pi: method: must be joint, got 'paper'"),
        ("--model hampi --method paper --nuisance none", "hampi: nuisance: method paper does not have this option: omit it"),
        ("--model mhl --method paper --no-cross-coupling", "mhl: cross_coupling: method paper does not have this option"),
        ("--model pi --operators two", "pi: operators: must be an integer >= 3, got 'two'"),
        ("--model pi --operators 2", "pi: operators: must be an integer >= 3, got 2"),
        ("--model pi --thresholds 0,5,2", "pi: thresholds: must be strictly increasing, got [0.0, 5.0, 2.0]"),
        ("--model hapi --structure modes=1,springs=2", "hapi: structure: must be factors of G(s) such as modes=1"),
        ("--model prandtl", "model: 'prandtl' is not a model family: use one of "),
        ("--order 3", "order: not an option of any of pi, hapi, rdpi, hampi, of which the best is chosen: name a model"),
        ("--method paper", "method: must be joint where no model is named, got paper: name a model"),
    ],
)
def test_an_option_that_the_family_does_not_have_is_refused(bag, tmp_path, capsys, words, line):
    assert main(["identify", str(bag), "--output", str(tmp_path / "model.yaml"), *words.split()]) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert len(told) == 1 and told[0].startswith(f"hyst identify: {line}"), told
    assert not (tmp_path / "model.yaml").exists()


def test_texts_of_the_command_line_are_the_values_of_a_script(bag, tmp_path):
    words = "--model pi --thresholds 0,2,5,9 --nuisance offset --one-sided --quiet"
    assert main(["identify", str(bag), "--output", str(tmp_path / "line.yaml"), *words.split()]) == 0
    identify_bags([bag], "pi", tmp_path / "call.yaml", thresholds=np.array([0, 2, 5, 9]), nuisance="offset", one_sided=True)
    assert (tmp_path / "line.yaml").read_text() == (tmp_path / "call.yaml").read_text()
    stage = load_model(tmp_path / "line.yaml").chain.stages[0]
    assert isinstance(stage, PrandtlIshlinskii)
    assert stage.one_sided and stage.thresholds == (2.0, 5.0, 9.0)


def test_options_of_any_family_reach_it(bag, tmp_path):
    assert main(["identify", str(bag), "--output", str(tmp_path / "m.yaml"), *"--model madelung --degree 3 --quiet".split()]) == 0
    assert len(load_model(tmp_path / "m.yaml").chain.stages[0].ascending) == 3


def test_the_best_family_is_one_that_has_the_options(bag, tmp_path):
    assert chosen_families(None, "joint", {}) == ["pi", "hapi", "rdpi", "hampi"]
    assert chosen_families(None, "joint", {"one_sided": True}) == ["pi", "hapi", "hampi"]
    assert chosen_families(None, "joint", {"structure": "modes=1"}) == ["hapi", "hampi"]
    with pytest.raises(InputError, match="hapi: structure: must be"):
        chosen_families(None, "joint", {"structure": "modes"})
    out = tmp_path / "fit.json"
    words = ["--structure", "delay", "--operators", "3", "--json", str(out), "--quiet"]
    assert main(["identify", str(bag), "--output", str(tmp_path / "m.yaml"), *words]) == 0
    report = json.loads(out.read_text())
    assert report["family"] in ("hapi", "hampi") and report["structure"] == ["delay"]


def test_the_help_explains_every_family_and_option(capsys):
    with pytest.raises(SystemExit):
        main(["identify", "--help"])
    text = " ".join(capsys.readouterr().out.split())
    for name, estimator in estimators().items():
        assert f"{name}: {estimator.sentence}" in text
    for name, families in every_option().items():
        assert f"--{name.replace('_', '-')}" in text
        assert next(iter(families.values())).meaning[:40] in text


def test_auto_shows_what_it_tried(bag, tmp_path, capsys):
    out, figure = tmp_path / "fit.json", tmp_path / "choice.svg"
    words = ["--model", "auto", "--operators", "4", "--json", str(out), "--figure", str(figure), "--quiet"]
    assert main(["identify", str(bag), "--output", str(tmp_path / "m.yaml"), *words]) == 0
    rows = json.loads(out.read_text())["tried"]
    assert [row["family"] for row in rows] == ["pi", "hapi", "rdpi", "hampi"] and sum(row["chosen"] for row in rows) == 1
    chosen = next(row for row in rows if row["chosen"])
    assert chosen["family"] == json.loads(out.read_text())["family"]
    assert chosen["held_out_nrmse"] <= 1.0101 * min(row["held_out_nrmse"] for row in rows)
    assert all(row["seconds"] > 0 and row["parameters"] > 3 for row in rows)
    assert all(each["held_out_nrmse"] > 0 for row in rows if row["family"] == "hapi" for each in row["structures"])
    for row in rows[1::2]:  # those with dynamics
        assert [each["parameters"] for each in row["structures"] if each["chosen"]] == [row["parameters"]]
    told = capsys.readouterr().out
    assert f"* {chosen['family']} " in told and "held-out NRMSE" in told
    [row] = json.loads(out.read_text())["records"]
    rms = row["nrmse_own_zero"] / row["nrmse"] * row["rmse"]
    assert told.count(" RMSE ") == 1 and f"NRMSE {row['nrmse_own_zero']:.3f} % of range, RMSE {rms:.4g} um over" in told
    assert figure.read_text().lstrip().startswith("<?xml") and ">parameters<" in figure.read_text()


def test_a_figure_of_the_choice_needs_a_choice(bag, tmp_path, capsys):
    words = ["--model", "pi", "--figure", str(tmp_path / "choice.svg"), "--quiet"]
    assert main(["identify", str(bag), "--output", str(tmp_path / "m.yaml"), *words]) == 2
    assert "figure: shows the choice between families" in capsys.readouterr().err
    assert not (tmp_path / "m.yaml").exists()
