"""Injected cases: sizes and truth of what is put in, by formulas of their own, and the seal of the labels."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hyst_control.blind_test.injected import make
from hyst_control.blind_test.injected_machines import Clean
from hyst_control.blind_test.injected_scores import named_right, quiet, score
from hyst_control.blind_test.injections import OPEN_SET, SINGLES, strength_of
from hyst_control.errors import InputError
from hyst_control.records.bag_reader import read_bag
from hyst_control.reproduction.measured_data import data_folder

STEP = 1e-3
TIME = STEP * np.arange(2000)
CLEAN = Clean("sine", 10.0 * np.sin(2 * np.pi * 5.0 * TIME)[:, None], 20.0 * np.sin(2 * np.pi * 5.0 * TIME - 0.1)[:, None])


@pytest.mark.parametrize("injection", [*SINGLES, *OPEN_SET], ids=lambda one: f"{one.name} {one.realization}")
def test_an_effect_has_the_size_that_is_asked_for(injection):
    _, command, measurement = strength_of([injection], CLEAN, STEP, 0.3, (1, 2))
    moved = np.sqrt(np.mean((measurement - CLEAN.measurement) ** 2)) + 2.0 * np.sqrt(np.mean((command - CLEAN.command) ** 2))
    assert moved == pytest.approx(0.3, rel=0.35)  # steps of what is counted or rounded, and an effect that wraps around


def singled(name: str, realization: str):
    return next(one for one in SINGLES if (one.name, one.realization) == (name, realization))


def test_truth_of_sensor_and_drive():
    """A delay of a sine is a phase, a gain of the drive comes back by multiplying the command with it."""
    strength, _, late = strength_of([singled("delay", "sensor")], CLEAN, STEP, 0.3, (1,))
    tau = strength * len(TIME) * STEP
    expected = 20.0 * np.sin(2 * np.pi * 5.0 * (TIME - tau) - 0.1)
    np.testing.assert_allclose(late[20:, 0], expected[20:], atol=1e-3)
    strength, command, same = strength_of([singled("gain", "amplifier")], CLEAN, STEP, 0.3, (1,))
    np.testing.assert_allclose((1.0 + strength) * command, CLEAN.command)
    np.testing.assert_array_equal(same, CLEAN.measurement)


def report(verdict: str, *names: str) -> dict[str, object]:
    return {"verdict": verdict, "effects": [{"name": name} for name in names], "seconds": 1.0}


def test_scores():
    label = {"names": ["delay"], "one_frequency": True, "mode": "none", "kind": "single", "multiple": 3.0}
    assert named_right(label, report("effect", "sensor_lowpass"))
    assert named_right(label, report("effect", "offset", "delay"))
    assert not named_right({**label, "one_frequency": False}, report("effect", "sensor_lowpass"))
    assert not named_right(label, report("unknown", "delay"))
    assert quiet(report("parameters")) and quiet(report("effect", "offset")) and not quiet(report("effect", "gain"))
    clean = {**label, "kind": "none", "names": [], "multiple": 0.0}
    table = score([(label, report("effect", "delay")), (label, report("no_gap")), (clean, report("unknown"))])
    values = {(row.subject, row.quantity): row.value for row in table.rows}
    assert values["3 x own error", "top_1"] == 0.5 and values["none", "false_alarm"] == 1.0


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
    assert make(str(tmp_path / "run"), 5, 3, ["stack"], note=lambda _: None) == labels
    with pytest.raises(InputError, match="another seed"):
        make(str(tmp_path / "run"), 6, 3, ["stack"])
    with pytest.raises(InputError, match="--plants"):
        make(str(tmp_path / "other"), 5, 3, ["pea"])
