# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Injected cases: sizes and truth of what is put in, by formulas of their own, and the seal of the labels."""

from __future__ import annotations

import json

import numpy as np
import pytest

from evaluation.blind_test.case import Case, Label, as_document
from evaluation.blind_test.injected import accepted, planned
from evaluation.blind_test.injected_machines import MODEL_SEEDS, SCORING_SEEDS, TUNING_SEEDS, Machine, stack_machine
from evaluation.blind_test.injections import COMPANIONS, OPEN_SET, SINGLES, apply_all, strength_of
from evaluation.blind_test.page import write_page
from evaluation.blind_test.run import Batch, diagnose_all, make
from evaluation.blind_test.scores import ERROR, Result, metrics, score
from evaluation.reproduction.measured_data import data_folder
from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import sampled_record

STEP = 1e-3
TIME = STEP * np.arange(2000)
COMMAND, MEASUREMENT = 10.0 * np.sin(2 * np.pi * 5.0 * TIME)[:, None], 20.0 * np.sin(2 * np.pi * 5.0 * TIME - 0.1)[:, None]
CLEAN = sampled_record("sine", COMMAND, MEASUREMENT, STEP, ("x",), "um")


@pytest.mark.parametrize("injection", [*SINGLES, *OPEN_SET], ids=lambda one: f"{one.name} {one.realization}")
def test_an_effect_has_the_size_that_is_asked_for(injection):
    """Rms of the change without a zero and a drift of its own, by a formula of this test; of a companion, which is both, as it is."""
    strength = strength_of(injection, CLEAN, STEP, 0.3, (1, 2))
    command, measurement = apply_all([injection], [strength], CLEAN, STEP, (1, 2))
    basis = np.stack([np.ones_like(TIME), TIME, TIME**2], axis=1) * (injection.name not in ("offset", "offset_drift"))

    def rms(change):
        return np.sqrt(np.mean((change - basis @ np.linalg.lstsq(basis, change, rcond=None)[0]) ** 2))

    moved = rms(measurement - CLEAN.measurement) + 2.0 * rms(command - CLEAN.command)
    assert moved == pytest.approx(0.3, rel=0.35)  # steps of what is counted or rounded, and an effect that wraps around


def singled(name: str, realization: str):
    return next(one for one in SINGLES if (one.name, one.realization) == (name, realization))


def test_truth_of_sensor_and_drive():
    """A delay of a sine is a phase, a gain of the drive comes back by multiplying the command with it."""
    delay, gain = singled("delay", "sensor"), singled("gain", "amplifier")
    strength = strength_of(delay, CLEAN, STEP, 0.3, (1,))
    _, late = apply_all([delay], [strength], CLEAN, STEP, (1,))
    tau = delay.truth(strength, CLEAN.measurement, STEP)["tau"]
    expected = 20.0 * np.sin(2 * np.pi * 5.0 * (TIME - tau) - 0.1)
    np.testing.assert_allclose(late[20:, 0], expected[20:], atol=1e-3)
    strength = strength_of(gain, CLEAN, STEP, 0.3, (1,))
    command, same = apply_all([gain], [strength], CLEAN, STEP, (1,))
    np.testing.assert_allclose((1.0 + strength) * command, CLEAN.command)
    np.testing.assert_array_equal(same, CLEAN.measurement)


def test_spikes_are_always_there():
    spikes = next(one for one in OPEN_SET if one.realization == "spikes")
    for seed in range(20):
        _, measurement = apply_all([spikes], [0.01], CLEAN, STEP, (seed,))
        assert 3 <= np.count_nonzero(measurement != CLEAN.measurement) <= 10


def report(verdict: str, *names: str) -> dict[str, object]:
    return {"verdict": verdict, "effects": [{"name": name, "axis": ["x"], "parameters": {}} for name in names]}


def injected(*names: str, kind: str = "single", one_frequency: bool = True) -> Case:
    """A case of the stack with a delay of 0.5 s, or other effects, in it."""
    right = tuple(tuple(accepted(name, one_frequency)) for name in names)
    label = Label(kind, names, 3.0, 1.0, accepted=right, ignored=COMPANIONS, truth={"tau": (0.5,)})
    put_in = tuple({"name": name, "realization": "sensor"} for name in names)
    return Case("case_0000", "stack", kind, "full, row 0", 0.0, 5, put_in, 1.0, label, source="injected", multiple=3.0, axes=("x",))


def test_names_that_are_right():
    def first(case: Case, verdict: str, *names: str) -> bool:
        return score(case, report(verdict, *names)).first

    delay = injected("delay")
    assert first(delay, "effect", "sensor_lowpass") and first(delay, "effect", "offset", "delay")
    assert not first(injected("delay", one_frequency=False), "effect", "sensor_lowpass")
    assert not first(delay, "unknown", "delay") and not first(delay, "effect", "offset")
    said = (report("parameters"), report("effect", "offset"), report("effect", "gain"))
    assert [score(injected(kind="none"), one).alarm for one in said] == [False, False, True]

    def both(verdict: str, *names: str) -> bool:
        return score(injected("delay", "backlash", kind="pair"), report(verdict, *names)).right

    assert both("effect", "backlash", "sensor_lowpass", "offset")
    assert not both("effect", "backlash") and not both("unknown", "backlash", "delay")
    assert not both("effect", "backlash", "delay", "creep")


def test_scores():
    results = [score(injected("delay"), report("effect", "delay")), score(injected("delay"), report("no_gap"))]
    found = metrics([*results, score(injected(kind="none"), report("unknown"))])
    values = {metric.name: metric for metric in found}
    assert values["injected, no clean record: top-1 at 3 x"].value == 0.5
    alarms = values["clean measured records: anything but no_gap, parameters or a companion"]
    assert alarms.value == 1.0 and not alarms.met


def test_a_true_parameter_lies_in_its_interval_or_not():
    def told(low: float, high: float) -> dict[str, object]:
        effect = {"name": "delay", "axis": ["x"], "parameters": {"tau": {"value": 0.4, "ci90": [low, high]}}}
        return {"verdict": "effect", "effects": [effect]}

    reports = (told(0.4, 0.6), told(0.3, 0.49), report("effect"), {**told(0.4, 0.6), "verdict": "unknown"})
    assert [score(injected("delay"), one).covered for one in reports] == [True, False, None, None]


def test_a_plan_has_every_row_of_the_table_from_the_first_round_on():
    clean, other = (sampled_record(name, np.zeros((4, 1)), np.zeros((4, 1)), 1.0, ("x",), "um") for name in ("one", "two"))
    machines = [
        Machine(name, ("x",), 1.0, 0.0, (clean, other), {0: clean} if measured else {}, (clean,) if measured else (), lambda: None)
        for name, measured in (("stack", True), ("mirror, 100 mV", True), ("third", False), ("bouc_wen", False))
    ]
    cells = list(planned(machines, 7, 200))
    assert [cell.name for cell in cells] == [f"case_{index:04d}" for index in range(200)]
    first = {(cell.kind, cell.regime, cell.multiple) for cell in cells[:22]}
    sizes = {
        ("none", 3.0),
        ("none", 10.0),
        ("other_command", 3.0),
        ("other_command", 10.0),
        ("same_command", 1.0),
        ("same_command", 3.0),
    }
    assert {(mode, size) for kind, mode, size in first if kind == "single"} == sizes
    assert {kind for kind, *_ in first} == {"single", "pair", "open_set", "none"}
    untouched = [(cell.plant, cell.excitation, cell.regime) for cell in cells if cell.kind == "none"]
    assert len(untouched) == len(set(untouched)) == 10  # the same input has the same report
    assert not any(name.startswith("offset") for cell in cells for name in cell.names)


def test_cases_of_the_stack_keep_their_labels_apart(tmp_path):
    try:
        data_folder("pea_p885")
    except InputError as error:
        pytest.skip(str(error))
    batch = Batch("injected", tmp_path / "run", 5, 3, {"plants": ["stack"]})
    labels = make(batch, note=lambda _: None)
    for one in batch.cases():
        place = tmp_path / "run" / "cases" / one.name
        assert sorted({path.name.partition("_")[0] for path in place.iterdir()} - {"clean"}) == ["bag", "case.json", "model.yaml"]
        assert json.loads((place / "case.json").read_text()) == {"warm_up": 2.0}
        assert read_bag(place / "bag").signal("command").values.shape == (1600, 1)
        assert len(list(place.glob("clean_*"))) == {"none": 0, "other_command": 2, "same_command": 1}[one.regime]
        if one.kind == "single":  # the gap is what was put in and what the model leaves, about at right angles
            assert one.answer.gap_rms == pytest.approx(np.hypot(one.multiple, 1.0) * one.answer.noise_rms, rel=0.4)
    assert make(batch, note=lambda _: None) == labels
    with pytest.raises(InputError, match="another seed"):
        make(Batch("injected", tmp_path / "run", 6, 3, {"plants": ["stack"]}))
    assert main(["cases", "make", "--measured", "--seed", "5", "--plants", "pea", "--output", str(tmp_path / "other")]) == 2


def test_one_page_shows_both_tests(tmp_path):
    def untouched(role: str, said: dict[str, object]) -> Result:
        return score(Case("case_0000", "third", "none", "rich", 0.003, 1, label=Label("none", (), 0.0, 1.0)), said, role)

    alarm = untouched("without_gap", {"verdict": ERROR, "effects": [], "error": "no report"})
    results = [untouched("", report("no_gap")), alarm, score(injected("delay"), report("effect", "delay"))]
    path = tmp_path / "page.md"
    write_page(path, metrics(results), results, "blind-test --seed 7", 8, {"simulated": "a" * 64, "injected": "b" * 64})
    text = path.read_text()
    assert text.index("b" * 64) < text.index("injected, no clean record: top-1 at 3 x | 1.000")
    assert "stopped after 3 of the 8 cases" in text
    assert "| false alarm on records without a gap | 0.500 |" in text and "| false alarm, third | 0.500 |" in text
    assert "| without_gap/case_0000 | third, rich, 0.3 % | nothing | 0.0 | no report |" in text
    assert "| stack | none | 3 | 1 | 1 |" in text
    assert "| case_0000 | stack, full, row 0 | none | delay (realization sensor) | 3 | effect | delay | yes |" in text
    write_page(path, metrics(results[2:]), results[2:], "blind-test --injected --seed 7", 1, {"injected": "c" * 64})
    assert "c" * 64 in path.read_text() and "confusion" not in path.read_text()


def test_scoring_and_tuning_draw_from_different_records():
    try:
        tuning, scoring = stack_machine(False), stack_machine(True)
    except InputError as error:
        pytest.skip(str(error))

    def stretches(machine: Machine) -> list[tuple[str, int]]:
        return [(name, int(row)) for name, row in (clean.name.split(", row ") for clean in machine.cases)]

    assert len(scoring.cases) > 8 and len(tuning.cases) >= 3
    for name, row in stretches(scoring):
        assert all(name != other or abs(row - begin) >= 1600 for other, begin in stretches(tuning))
    for machine in (tuning, scoring):
        for index, clean in machine.same.items():
            np.testing.assert_allclose(clean.command, machine.cases[index].command, atol=0.02 * np.ptp(clean.command))
    assert not {*TUNING_SEEDS} & {*SCORING_SEEDS} and not {*MODEL_SEEDS} & {*TUNING_SEEDS, *SCORING_SEEDS}


def test_a_diagnosis_that_ends_in_an_error_costs_its_case(tmp_path):
    """Every score counts it as wrong; nothing is asked of what is no record."""
    (tmp_path / "cases" / "case_0000").mkdir(parents=True)
    (tmp_path / "labels.json").write_text(json.dumps({"cases": [as_document(injected("delay"))]}))
    batch = Batch("injected", tmp_path)
    diagnose_all([batch], note=lambda _: None)
    (result,) = batch.results()
    assert result.verdict == "error" and "bag" in result.said
    assert not (result.first or result.exact or result.right) and result.covered is None
    assert next(metric for metric in metrics([result]) if "top-1" in metric.name).value == 0.0
