"""Injected cases: sizes and truth of what is put in, by formulas of their own, and the seal of the labels."""

from __future__ import annotations

import json

import numpy as np
import pytest

from evaluation.blind_test.error_report import VERDICT
from evaluation.blind_test.injected import diagnose_all, load, make
from evaluation.blind_test.injected_machines import MODEL_SEEDS, SCORING_SEEDS, TUNING_SEEDS, Clean, Machine, stack_machine
from evaluation.blind_test.injected_plan import planned
from evaluation.blind_test.injected_scores import injected_metrics, is_covered, named_exactly, named_right, quiet
from evaluation.blind_test.injections import OPEN_SET, SINGLES, apply_all, strength_of
from evaluation.blind_test.page import write_injected_page, write_page
from evaluation.blind_test.scores import metrics
from evaluation.reproduction.measured_data import data_folder
from hyst_control.errors import InputError
from hyst_control.records.bag_reader import read_bag

STEP = 1e-3
TIME = STEP * np.arange(2000)
CLEAN = Clean("sine", 10.0 * np.sin(2 * np.pi * 5.0 * TIME)[:, None], 20.0 * np.sin(2 * np.pi * 5.0 * TIME - 0.1)[:, None])


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
    tau = delay.truth(strength, CLEAN.command, CLEAN.measurement, STEP)["tau"]
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


LABEL = {
    "names": ["delay"],
    "one_frequency": True,
    "mode": "none",
    "kind": "single",
    "multiple": 3.0,
    "plant": "stack",
    "truth": [{"tau": [0.5]}],
    "axes": ["x"],
}


def test_names_that_are_right():
    assert named_right(LABEL, report("effect", "sensor_lowpass"))
    assert named_right(LABEL, report("effect", "offset", "delay"))
    assert not named_right({**LABEL, "one_frequency": False}, report("effect", "sensor_lowpass"))
    assert not named_right(LABEL, report("unknown", "delay"))
    assert not named_right(LABEL, report("effect", "offset"))
    assert quiet(report("parameters")) and quiet(report("effect", "offset")) and not quiet(report("effect", "gain"))
    both = {**LABEL, "names": ["delay", "backlash"]}
    assert named_exactly(both, report("effect", "backlash", "sensor_lowpass", "offset"))
    assert not named_exactly(both, report("effect", "backlash")) and not named_exactly(both, report("unknown", "backlash", "delay"))
    assert not named_exactly(both, report("effect", "backlash", "delay", "creep"))


def test_scores():
    clean = {**LABEL, "kind": "none", "names": [], "multiple": 0.0}
    found = injected_metrics([(LABEL, report("effect", "delay")), (LABEL, report("no_gap")), (clean, report("unknown"))])
    values = {metric.name: metric for metric in found}
    assert values["injected, no clean record: top-1 at 3 x"].value == 0.5
    alarms = values["clean measured records: anything but no_gap, parameters or a companion"]
    assert alarms.value == 1.0 and not alarms.met


def test_a_true_parameter_lies_in_its_interval_or_not():
    def told(low: float, high: float) -> dict[str, object]:
        effect = {"name": "delay", "axis": ["x"], "parameters": {"tau": {"value": 0.4, "ci90": [low, high]}}}
        return {"verdict": "effect", "effects": [effect]}

    assert is_covered(LABEL, told(0.4, 0.6)) is True and is_covered(LABEL, told(0.3, 0.49)) is False
    assert is_covered(LABEL, {"verdict": "effect", "effects": []}) is None


def test_a_plan_has_every_row_of_the_table_from_the_first_round_on():
    clean = Clean("one", np.zeros((4, 1)), np.zeros((4, 1)))
    machines = [
        Machine(name, ("x",), 1.0, 0.0, (clean, clean), {0: clean} if measured else {}, (clean,) if measured else (), lambda: None)
        for name, measured in (("stack", True), ("mirror, 100 mV", True), ("third", False), ("bouc_wen", False))
    ]
    cells = list(planned(machines, 7, 200))
    first = {(cell.kind, cell.mode, cell.multiple) for cell in cells[:22]}
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
    untouched = [(cell.machine.name, cell.record, cell.mode) for cell in cells if cell.kind == "none"]
    assert len(untouched) == len(set(untouched)) == 10  # the same input has the same report
    assert not any(one.name.startswith("offset") for cell in cells for one in cell.injections)


def test_cases_of_the_stack_keep_their_labels_apart(tmp_path):
    try:
        data_folder("pea_p885")
    except InputError as error:
        pytest.skip(str(error))
    labels = make(str(tmp_path / "run"), 5, 3, ["stack"], note=lambda _: None)
    documents = json.loads(labels.read_text())["cases"]
    for one in documents:
        place = tmp_path / "run" / "cases" / one["name"]
        assert not any(name in (place / "case.json").read_text() for name in (*one["names"], "multiple"))
        assert read_bag(place / "bag").signal("command").values.shape == (1600, 1)
        assert len(list(place.glob("clean_*"))) == {"none": 0, "other_command": 2, "same_command": 1}[one["mode"]]
        assert one["effect_rms"] == pytest.approx(one["multiple"] * one["own_error_rms"], rel=0.35)
    assert make(str(tmp_path / "run"), 5, 3, ["stack"], note=lambda _: None) == labels
    with pytest.raises(InputError, match="another seed"):
        make(str(tmp_path / "run"), 6, 3, ["stack"])
    with pytest.raises(InputError, match="--plants"):
        make(str(tmp_path / "other"), 5, 3, ["pea"])


def test_one_page_shows_both_tests(tmp_path):
    label = {**LABEL, "name": "case_0000", "record": "full, row 0", "realizations": ["sensor"]}
    said = {**report("effect", "delay"), "unexplained_share": 0.0}
    rows = [(label, said)]
    path = tmp_path / "page.md"
    untouched = {
        "kind": "none",
        "names": [],
        "effects": [],
        "gap_rms": 0.0,
        "noise_rms": 1.0,
        "plant": "third",
        "excitation": "rich",
        "noise": 0.003,
    }
    pairs = [({"name": "case_0000", "label": untouched}, {**report("no_gap"), "processor_seconds": 1.0})]
    alarm = ({"name": "without_gap/case_0000", "label": untouched}, {"verdict": VERDICT, "effects": [], "error": "no report"})
    found = [*metrics(pairs, without_gap=[alarm]), *injected_metrics(rows)]
    digests = {"": "a" * 64, "injected": "b" * 64, "without a gap": "d" * 64}
    write_page(path, found, pairs, rows, [alarm], "blind-test --seed 7", (1, 2, 5), digests, 0)
    text = path.read_text()
    assert text.index("b" * 64) < text.index("injected, no clean record: top-1 at 3 x | 1.000")
    assert "1 of the 1 simulated cases, 1 of the 2 injected ones, 1 of the 5 further ones without a gap" in text
    assert "| false alarm on records without a gap | 0.500 |" in text and "| false alarm, third | 0.500 |" in text
    assert "| without_gap/case_0000 | third, rich, 0.3 % | none | 0.0 | no report |" in text
    assert "| stack | none | 3 | 1 | 1 |" in text
    assert "| case_0000 | stack: full, row 0 | none | delay (sensor) | 3 | effect | delay | yes |" in text
    write_injected_page(path, injected_metrics(rows), rows, "blind-test --injected --seed 7", "c" * 64)
    assert "c" * 64 in path.read_text()


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
    place = tmp_path / "cases" / "case_0000"
    place.mkdir(parents=True)
    (place / "case.json").write_text('{"warm_up": 0.0}')
    (tmp_path / "labels.json").write_text(json.dumps({"cases": [{**LABEL, "name": "case_0000"}]}))
    diagnose_all(tmp_path, note=lambda _: None)
    (row,) = load(tmp_path)
    assert row[1]["verdict"] == "error" and "bag" in row[1]["error"]
    assert not named_right(*row) and not named_exactly(*row) and not quiet(row[1]) and is_covered(*row) is None
    assert next(metric for metric in injected_metrics([row]) if "top-1" in metric.name).value == 0.0
