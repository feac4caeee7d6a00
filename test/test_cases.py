"""The blind test's cases: balanced, the same for a seed, and nothing in a case's folder tells its label."""

from __future__ import annotations

import json
from collections import Counter

import numpy as np
import pytest

from hyst_control.cli import main
from hyst_control.experiments.blind_scores import metrics, wilson
from hyst_plant_sim.cases import KINDS, LEAST, SEVERITIES, draw, labelled, run


def test_a_seed_draws_the_same_balanced_cases():
    cases = draw(5, 300)
    assert cases == draw(5, 300) and cases != draw(6, 300)
    assert set(KINDS) == {case.kind for case in cases}
    singles = Counter(case.names[0] for case in cases if case.kind == "single")
    assert set(singles) == set(SEVERITIES)
    del singles["cross_coupling"]  # only a mirror has it
    assert max(singles.values()) - min(singles.values()) <= 3
    plants = Counter(case.plant for case in cases)
    assert max(plants.values()) - min(plants.values()) <= 1


def test_labels_state_the_true_gap_and_hide_what_nobody_could_see():
    case = next(case for case in draw(3, 60, plants=("pea_published",)) if case.kind == "single" and case.excitation == "rich"
                and case.names[0] not in ("sensor_noise", "held_samples"))
    label = labelled(case).label
    difference = run(case, noisy=False)["measurement"] - run(case, effects=False, noisy=False)["measurement"]
    assert label["gap_rms"] == pytest.approx(np.sqrt(np.mean(difference ** 2)))
    assert label["kind"] == ("single" if label["distance"] >= LEAST else "none")


def test_nothing_in_a_case_folder_tells_its_label(tmp_path, capsys):
    assert main(["cases", "make", "--seed", "4", "--count", "3", "--out", str(tmp_path / "out"), "--plants", "pea_published"]) == 0
    assert "SHA-256" in capsys.readouterr().out
    labels = json.loads((tmp_path / "out" / "labels.json").read_text())
    assert len(labels["cases"]) == 3
    for case in labels["cases"]:
        folder = tmp_path / "out" / "cases" / case["name"]
        assert sorted(path.name for path in folder.iterdir()) == ["bag", "model.yaml"]
        text = b"".join(path.read_bytes() for path in folder.rglob("*") if path.is_file())
        assert not any(name.encode() in text for name in SEVERITIES if name not in ("delay", "gain", "offset", "saturation"))


def test_unusable_requests_are_refused(tmp_path, capsys):
    assert main(["cases", "make", "--seed", "1", "--count", "0", "--out", str(tmp_path / "a")]) == 2
    assert main(["cases", "make", "--seed", "1", "--count", "2", "--out", str(tmp_path / "b"), "--plants", "pear"]) == 2
    error = capsys.readouterr().err
    assert "--count 0" in error and "--plants pear" in error and error.count("\n") == 2


def test_wilsons_interval_is_the_published_one():
    """Newcombe, Statistics in Medicine 17 (1998), Table I: 81 of 263 gives 0.2553 to 0.3662."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)


def test_scores_of_a_diagnosis_that_is_always_right_and_of_one_that_never_is():
    def pair(kind: str, names: list[str], verdict: str, given: list[str]) -> tuple[dict, dict]:
        label = {"kind": kind, "names": names, "excitation": "rich", "noise": 5e-4, "plant": "pea", "gap_rms": 10.0, "noise_rms": 1.0,
                 "effects": [{"name": name} for name in names]}
        effects = [{"name": name, "probability": 1.0, "equivalent": [], "parameters": {}} for name in given]
        return {"label": label}, {"verdict": verdict, "effects": effects, "candidates": [], "seconds": 1.0, "unexplained_share": 0.0}

    both = ["delay", "creep"]
    right = [pair("single", ["delay"], "effect", ["delay"]), pair("none", [], "no_gap", []), pair("pair", both, "effect", both[::-1])]
    wrong = [pair("single", ["delay"], "effect", ["creep"]), pair("none", [], "effect", ["creep"]), pair("pair", both, "no_gap", [])]
    good, bad = ({metric.name: metric for metric in metrics(pairs)} for pairs in (right, wrong))
    for name in ("false alarm on records without a gap", "pairs: exactly both", "macro-F1", "right where it says >= 0.95"):
        assert good[name].met and not bad[name].met
