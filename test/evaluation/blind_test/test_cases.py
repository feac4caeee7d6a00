# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The blind test's cases: balanced, the same for a seed, and nothing in a case's folder tells its label."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from evaluation.blind_test.case import EXCITATIONS, KINDS, Case, Label, as_document, from_document
from evaluation.blind_test.case_drawing import SWITCH_FRACTION, draw
from evaluation.blind_test.case_records import commands, run_case
from evaluation.blind_test.effect_sizes import REALIZATIONS, SEVERITIES, UNTUNED
from evaluation.blind_test.plant_setups import PLANTS, SETUPS
from evaluation.blind_test.scores import conformal, metrics, score, wilson
from evaluation.blind_test.simulated import MIN_VISIBILITY, label_of
from hyst_control.cli import main
from hyst_plant_sim.physics import EFFECTS
from hyst_plant_sim.physics import PLANTS as TRUTH_PLANTS
from hyst_plant_sim.physics.effects import ELSEWHERE

NOVELTY = "all single effects: novelty score that 4 % exceed (unknown from 0.5)"


def test_a_seed_draws_the_same_balanced_cases():
    cases = draw(5, 300)
    assert cases == draw(5, 300) and cases != draw(6, 300)
    assert set(KINDS) == {case.kind for case in cases}
    singles = Counter(case.names[0] for case in cases if case.kind == "single")
    assert set(singles) == set(SEVERITIES)
    del singles["cross_coupling"]  # only a mirror has it
    assert max(singles.values()) - min(singles.values()) <= 3
    plants = Counter(case.plant for case in cases)
    assert plants == {name: len(cases) * PLANTS.count(name) // len(PLANTS) for name in PLANTS}


def test_some_realizations_are_drawn_by_scoring_seeds_alone():
    def realized(seed):
        return {
            (
                effect["name"],
                *sorted((key, value) for key, value in effect.items() if isinstance(value, int | str) and key != "axis"),
            )
            for case in draw(seed, 600, kinds=("single",))
            for effect in case.effects
        }

    tuning, scoring = realized(7), realized(100_007)
    assert not any(case.untuned for case in draw(7, 200))
    assert any(case.untuned for case in draw(100_007, 200)) and not all(case.untuned for case in draw(100_007, 200))
    assert tuning < scoring


def test_every_realization_is_one_that_the_plants_know():
    for name in SEVERITIES:
        for one in (*REALIZATIONS.get(name, ()), *UNTUNED.get(name, ())):
            keys = {key.removesuffix(" volt") for key in one} - {"at"}
            assert keys <= {*EFFECTS[name].absent, *EFFECTS[name].others}
            assert one.get("at", EFFECTS[name].place) in (*ELSEWHERE.get(name, ()), EFFECTS[name].place)


def test_labels_state_the_true_gap_and_hide_what_nobody_could_see():
    case = next(
        case
        for case in draw(3, 60, plants=("pea_published",))
        if case.kind == "single" and case.excitation == "rich" and case.names[0] not in ("sensor_noise", "held_samples")
    )
    label = label_of(case)
    difference = run_case(case, noisy=False)["measurement"] - run_case(case, effects=False, noisy=False)["measurement"]
    assert label.gap_rms == pytest.approx(np.sqrt(np.mean(difference**2))) and label.distance is not None
    assert label.kind == ("single" if label.distance >= MIN_VISIBILITY else "none")


def test_effects_begin_within_the_record_where_asked_for():
    """The cases are otherwise those of the seed, on every plant; before an effect begins the record is the one without it."""
    plants = tuple(SETUPS)
    always = draw(5, 100, plants, ("single", "pair", "open_set"))
    switched = draw(5, 100, plants, ("single", "pair", "open_set"), switched=1.0)
    assert {case.plant for case in switched} == set(plants) == set(TRUTH_PLANTS)
    assert [case.names for case in switched] == [case.names for case in always]
    for case in switched:
        length = len(commands(case)) * SETUPS[case.plant].sample_time
        assert all(
            SWITCH_FRACTION[0] * length - 1e-3 < effect["from"] < SWITCH_FRACTION[1] * length + 1e-3 for effect in case.effects
        )
    assert 0.3 < np.mean(["from" in case.effects[0] for case in draw(5, 100, kinds=("single",), switched=0.5)]) < 0.7
    case = next(case for case in switched if case.plant == "fsm" and case.kind == "pair" and case.excitation == "rich")
    begin = round(min(effect["from"] for effect in case.effects) / SETUPS["fsm"].sample_time)
    found, without = run_case(case)["measurement"], run_case(case, effects=False)["measurement"]
    np.testing.assert_array_equal(found[:begin], without[:begin])
    assert np.any(found[begin:] != without[begin:])


@pytest.mark.parametrize("plant", ["pea", "fsm", "third"])
@pytest.mark.parametrize("excitation", EXCITATIONS)
def test_plants_stay_within_their_range_and_stroke(plant, excitation):
    """Also those that the blind test does not take, in closed loop as well."""
    signals = run_case(Case("", plant, "none", excitation, 5e-4, 7))
    setup = SETUPS[plant]
    assert np.all((signals["command"] >= setup.command[0]) & (signals["command"] <= setup.command[1]))
    assert np.all(np.abs(signals["measurement"]) < 1.3 * setup.stroke) and np.ptp(signals["measurement"]) > 0.3 * setup.stroke
    if excitation == "closed_loop":  # settled on its slow lines: it tracks
        error = (signals["reference"] - signals["measurement"])[len(signals["reference"]) // 3 :]
        assert np.sqrt(np.mean(error**2)) < 0.1 * setup.stroke


def test_a_gap_under_the_noise_is_labelled_none_whatever_its_kind():
    """An effect that is switched on, two, one outside the catalogue, each too small for anybody to see."""
    small = [
        ("single", ({"name": "delay", "tau": 1e-8, "from": 0.5},)),
        ("open_set", ({"name": "outliers", "fraction": 1e-3, "size": 1e-4},)),
        ("pair", ({"name": "creep", "gamma": 1e-7}, {"name": "offset", "offset": 1e-6})),
    ]
    for kind, effects in small:
        case = Case("", "pea_published", kind, "multisine", 3e-3, 3, effects)
        label = label_of(case)
        assert label.kind == "none" and label.names == () and label.hidden == case.names and label.gap_rms > 0
        assert as_document(replace(case, label=label))["effects"] == list(effects)


@pytest.mark.parametrize(
    "excitation, gamma, shown",
    [("multisine", 1e-7, ["delay"]), ("multisine", 0.05, ["creep", "delay"]), ("closed_loop", 1e-7, ["delay"])],
)
def test_of_a_pair_it_is_told_which_could_be_seen_beside_the_other(excitation, gamma, shown):
    effects = ({"name": "creep", "gamma": gamma}, {"name": "delay", "tau": 5e-4})
    label = label_of(Case("", "pea_published", "pair", excitation, 5e-4, 3, effects))
    assert (label.kind, label.names, label.shown) == ("pair", ("creep", "delay"), tuple(shown))


@pytest.mark.parametrize("off, kind", [(5.0, "parameters"), (0.02, "none")])
def test_coefficients_that_are_off_count_by_their_gap(off, kind):
    case = Case("", "pea_published", "parameters", "multisine", 3e-3, 3, off=off)
    label = label_of(case)
    difference = run_case(case, noisy=False)["measurement"] - run_case(case, noisy=False, scattered=False)["measurement"]
    assert label.gap_rms == pytest.approx(np.sqrt(np.mean(difference**2)))
    assert label.kind == kind and label.hidden == (("parameters",) if kind == "none" else None)


def test_kinds_excitations_and_switches_are_chosen_on_the_command_line(tmp_path):
    folder = tmp_path / "out"
    arguments = ["cases", "make", "--seed", "4", "--count", "4", "--output", str(folder), "--plants", "pea_published"]
    chosen = ["--kinds", "open_set", "pair", "--excitations", "sine", "--switched", "1"]
    assert main([*arguments, *chosen]) == 0
    cases = json.loads((folder / "labels.json").read_text())["cases"]
    assert {case["kind"] for case in cases} == {"open_set", "pair"} and {case["excitation"] for case in cases} == {"sine"}
    assert all(effect["from"] > 0 for case in cases for effect in case["effects"])
    assert main([*arguments, *chosen]) == 0  # there already
    assert main([*arguments, "--kinds", "none"]) == 2  # other cases than those


def test_nothing_in_a_case_folder_tells_its_label(tmp_path, capsys):
    assert (
        main(["cases", "make", "--seed", "4", "--count", "3", "--output", str(tmp_path / "out"), "--plants", "pea_published"]) == 0
    )
    assert "SHA-256" in capsys.readouterr().out
    labels = json.loads((tmp_path / "out" / "labels.json").read_text())
    assert len(labels["cases"]) == 3
    for case in labels["cases"]:
        folder = tmp_path / "out" / "cases" / case["name"]
        assert sorted(path.name for path in folder.iterdir()) == ["bag", "model.yaml", "next.npy"]
        bare = Case(case["name"], case["plant"], "none", case["excitation"], case["noise"], case["seed"], ())
        fresh = replace(bare, excitation="multisine" if bare.excitation == "rich" else "rich")
        np.testing.assert_array_equal(np.load(folder / "next.npy"), commands(fresh))  # the same whatever is in the case
        text = b"".join(path.read_bytes() for path in folder.rglob("*") if path.is_file())
        assert not any(name.encode() in text for name in SEVERITIES if name not in ("delay", "gain", "offset", "saturation"))


def test_unusable_requests_are_refused(tmp_path, capsys):
    assert main(["cases", "make", "--seed", "1", "--count", "0", "--output", str(tmp_path / "a")]) == 2
    assert main(["cases", "make", "--seed", "1", "--count", "2", "--output", str(tmp_path / "b"), "--plants", "pear"]) == 2
    for option, value in (("--kinds", "triple"), ("--excitations", "step"), ("--switched", "2")):
        assert main(["cases", "make", "--seed", "1", "--count", "2", "--output", str(tmp_path / "b"), option, value]) == 2
    error = capsys.readouterr().err
    for words in ("--count: must be >= 1, got 0", "got pear", "got triple", "got step", "--switched: must be from 0 to 1, got 2"):
        assert words in error
    assert error.count("\n") == 5 and not (tmp_path / "b").exists()


def test_wilsons_interval_is_the_published_one():
    """Newcombe, Statistics in Medicine 17 (1998), Table I: 81 of 263 gives 0.2553 to 0.3662."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)


def scored(kind, names, verdict, given, role="", excitation="rich", plant="pea_published", hidden=None, **report):
    """Result of a case with these names, to which a report gives others."""
    label = Label(kind, tuple(names), 10.0, 1.0, hidden=hidden)
    effects = [{"name": name, "probability": 1.0, "equivalent": [], "parameters": {}} for name in given]
    said = {"verdict": verdict, "effects": effects, "candidates": [], "processor_seconds": 1.0, "unexplained_share": 0.0}
    put_in = tuple({"name": name} for name in names)
    return score(Case("", plant, kind, excitation, 5e-4, 1, put_in, label=label), {**said, **report}, role)


def test_scores_of_a_diagnosis_that_is_always_right_and_of_one_that_never_is():
    both = ["delay", "creep"]
    right = [
        scored("single", ["delay"], "effect", ["delay"]),
        scored("none", [], "no_gap", []),
        scored("pair", both, "effect", both[::-1]),
    ]
    wrong = [
        scored("single", ["delay"], "effect", ["creep"]),
        scored("none", [], "effect", ["creep"]),
        scored("pair", both, "no_gap", []),
    ]
    good, bad = ({metric.name: metric for metric in metrics(results)} for results in (right, wrong))
    for name in ("false alarm on records without a gap", "pairs: exactly both", "macro-F1", "right where it says >= 0.95"):
        assert good[name].met and not bad[name].met
    assert all(one.right for one in right) and not any(one.right for one in wrong)


def test_a_row_of_the_table_is_a_share_of_its_group():
    """Rows by plant, each counted here by hand; cases of another role are in no row but their own."""
    given = [("pea_published", "delay"), ("pea_published", "gain"), ("third", "delay"), ("third", "delay"), ("third", "gain")]
    results = [scored("single", ["delay"], "effect", [name], plant=plant) for plant, name in given]
    results += [scored("single", ["delay"], "unknown", [], role="left_out", plant="third")]
    results += [scored("none", [], "unknown", [], role="without_gap", plant="third"), scored("none", [], "no_gap", [])]
    results += [
        scored("none", [], "effect", ["gain"], hidden=("delay",)),
        scored("none", [], "effect", ["delay"], hidden=("delay",)),
    ]
    found = {metric.name: (metric.value, metric.n) for metric in metrics(results)}
    assert found["top-1, rich record, pea_published"] == (0.5, 2)
    assert found["top-1, rich record, third"] == (pytest.approx(2 / 3), 3)
    assert found["top-1, single effects on published plants, rich record, gap >= 3 sigma"] == (0.5, 2)
    assert found["single effects called unknown"] == (0.0, 5)
    assert found["false alarm on records without a gap"] == (0.5, 2) and found["false alarm, third"] == (1.0, 1)
    assert found["gap too small to be scored: a wrong name"] == (0.5, 2)
    assert found["macro-F1"] == (pytest.approx(2 / 3), 2)  # one of two found, one name given: 2 * 1 / (2 + 1)
    assert found["calibration error (ECE)"] == (pytest.approx(2 / 5), 5)  # sure of five, right on three


def test_predictions_and_intervals_are_held_against_the_truth():
    def told(low, high, predicted, realized):
        parameters = {"tau": {"value": 4e-4, "ci90": [low, high]}}
        effects = [{"name": "delay", "probability": 1.0, "equivalent": [], "parameters": parameters}]
        more = {"shrink_realised": [predicted, realized], "foreseen": {"shrink": realized + 0.01}}
        case = Case(
            "", "pea_published", "single", "rich", 5e-4, 1, ({"name": "delay", "tau": 4e-4},), label=Label("single", ("delay",))
        )
        return score(case, {"verdict": "effect", "effects": effects, "unexplained_share": 0.0, **more})

    results = [told(3e-4, 5e-4, 0.9, 0.8), told(4.1e-4, 5e-4, 0.7, 1.0), told(None, None, 0.9, 0.9)]
    assert [one.covered for one in results] == [True, False, None]
    found = {metric.name: metric.value for metric in metrics(results)}
    assert found["true parameter within its 90 % interval"] == 0.5
    assert found["shrink, predicted - realized: median"] == pytest.approx(0.1)
    assert found["shrink, foreseen for the fresh command - realized: 90 % quantile"] == pytest.approx(0.01)


def test_a_conformal_threshold_is_exceeded_as_seldom_as_asked_for():
    """Of a hundred scores and a new one, drawn alike, the new one exceeds it in 4 % of the draws, whatever the distribution."""
    random = np.random.default_rng(2)
    drawn = random.standard_cauchy((4000, 101)) ** 2
    exceeds = np.mean([row[-1] > conformal(row[:-1], 0.04) for row in drawn])
    assert 0.03 < exceeds <= 0.045
    assert conformal([0.1] * 10, 0.04) == np.inf  # ten scores say nothing of one in twenty-five


def test_the_novelty_score_ranks_the_open_set():
    results = [scored("single", ["delay"], "no_gap", [], excitation="sine", novelty=0.01 * k) for k in range(30)]
    results += [scored("open_set", [], "no_gap", [], excitation="sine", novelty=0.25 + 0.1 * k) for k in range(3)]
    found = {metric.name: metric for metric in metrics(results)}
    assert found["open set: AUROC of the novelty score"].value == pytest.approx((25.5 + 30 + 30) / 90)
    assert found[NOVELTY].value == pytest.approx(0.29)
    assert NOVELTY not in {metric.name for metric in metrics(results[:10])}  # ten scores say nothing of one in twenty-five


def test_last_digits_of_a_processor_do_not_change_the_hash_of_labels():
    """The same case, simulated on two machines, differs in the last bits; texts, counts and seeds stay as they are."""
    gap = 0.0991234567
    case = Case("case_0000", "third", "single", "rich", 5e-4, 1702228509, ({"name": "delay", "tau": 2.00000049, "order": 2},))
    one, other = (
        as_document(replace(case, label=Label("single", ("delay",), value, 1.0))) for value in (gap, float(np.nextafter(gap, 1.0)))
    )
    assert one == other and one["label"]["gap_rms"] == 0.0991235
    assert one["effects"] == [{"name": "delay", "tau": 2.0, "order": 2}] and one["seed"] == 1702228509
    assert from_document(json.loads(json.dumps(one))) == from_document(other)
    assert as_document(from_document(one)) == one
