# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst learn`: trials that are run here, and trials from bags, give the same."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hyst_control.cli import main
from hyst_control.control.feedback.pi import PI
from hyst_control.control.learning.iterative_learning import IterativeLearning
from hyst_control.control.learning.learning_filter import model_filter
from hyst_control.control.learning.learning_loop import run_learning_loop
from hyst_control.control.learning.learning_trials import best_compensator
from hyst_control.model_file import load_model
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag
from hyst_plant_sim.physics import load_plant

MODEL = str(Path(__file__).resolve().parents[2] / "config" / "models" / "fsm_mhl.yaml")
TS = 2e-4
LOOP = ["--kp", "6.7", "--ki", "134000", "--roll-off", "800"]
SINE = ["--rate", "5000", "--reference", "sine", "frequency=100", "amplitude=0.5", "offset=1", "duration=0.01"]


def learned_run(trials: int):
    """Signals and learner of the same trials by the library."""
    model = load_model(MODEL)
    reference = 1.0 + 0.5 * np.sin(2 * np.pi * 100.0 * np.arange(50) * TS)
    learner = IterativeLearning(model_filter(model, 50, sample_time=TS), trials=trials).start()
    controller = PI(6.7, 134000.0, TS, 0.0, 100.0, roll_off=800.0).start(2)
    _, compensator = best_compensator(model, TS, (0.0, 100.0))
    truth = load_plant("fsm", seed=0, sample_time=TS)
    rows = np.tile(np.repeat(reference[:, None], 2, axis=1), (3 * trials, 1))
    return run_learning_loop(rows, compensator, controller, truth, learner), learner


def test_trials_on_a_truth_plant(tmp_path, capsys):
    out = tmp_path / "out.json"
    assert main(["learn", MODEL, "--plant", "fsm", "--trials", "3", *LOOP, *SINE, "--json", str(out)]) == 0
    rows = json.loads(out.read_text())["rows"]
    errors = [row["value"] for row in rows if row["quantity"] == "nrmse"]
    _, learner = learned_run(3)
    span = np.ptp(0.5 * np.sin(2 * np.pi * np.arange(50) / 50))
    np.testing.assert_allclose(errors, [100 * each.error / span for each in learner.history], rtol=1e-9)
    assert errors[-1] < 0.3 * errors[0]
    assert learner.stopped in capsys.readouterr().out


def test_a_reference_beyond_the_stroke_is_told(capsys):
    beyond = [word.replace("amplitude=0.5", "amplitude=5") for word in SINE]
    assert main(["learn", MODEL, "--plant", "fsm", "--trials", "2", *LOOP, *beyond]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "stood at its limits, 0 to 100 V, for " in told and "the model moves between 0 and 2 mrad; change offset" in told
    assert main(["learn", MODEL, "--plant", "fsm", "--trials", "2", *LOOP, *SINE]) == 0
    assert "limits" not in capsys.readouterr().out


def test_a_loop_that_oscillates_is_told(capsys):
    """Four times the gain at which the mirror's loop is stable: the command jumps between its limits, though they hold the reference."""
    oscillating = ["--rate", "5000", "--kp", "0", "--ki", "800000"]
    assert main(["learn", MODEL, "--plant", "fsm", "--trials", "2", *oscillating, *SINE]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "stood at its limits" in told and "so the loop oscillates" in told and "lower the gains" in told


def test_gain_and_lag_of_a_truth_plant(capsys):
    arguments = ["learn", MODEL, "--plant", "fsm", "--gain-error", "0.1", *LOOP, *SINE, "--feedback-error", "1", "--json", "-"]
    assert main(arguments) == 0
    rows = {(row["case"], row["quantity"]): row["value"] for row in json.loads(capsys.readouterr().out)["rows"]}
    assert rows["last tenth", "nrmse"] < 0.9 * rows["first tenth", "nrmse"]
    assert rows["axis x", "gain"] < 0.0 and rows["axis y", "gain"] < 0.0


def test_bags_of_trials_give_the_next_feedforward(tmp_path, capsys):
    """Bags cut from a run of three trials: after each, the file is what the run itself learned, to the rounding of its sums."""
    signals, _ = learned_run(3)
    unit = {"reference": "mrad", "measurement": "mrad"}
    bags = []
    for trial in range(3):
        rows = slice(trial * 150, (trial + 1) * 150)
        bags.append(str(tmp_path / f"trial_{trial}"))
        named = {
            name: Signal(np.arange(150) * TS, values[rows], ("x", "y"), unit.get(name, "V")) for name, values in signals.items()
        }
        write_bag(bags[-1], Record(named, bags[-1]))
    for count in (1, 2):
        path = tmp_path / f"learned_{count}.npy"
        assert main(["learn", MODEL, *bags[:count], "--period", "0.01", "--output", str(path)]) == 0
        np.testing.assert_allclose(np.load(path), signals["learned"][150 * count : 150 * count + 50], atol=1e-9)
    for period in ("nan", "inf", "-0.01", "0.03001", "1e300", "1e-9"):
        assert main(["learn", MODEL, bags[0], "--period", period, "--output", str(tmp_path / "none.npy")]) == 2
        assert capsys.readouterr().err.count("\n") == 1 and not (tmp_path / "none.npy").exists()
    # A bag of the second trial alone goes on from what it held.
    assert main(["learn", MODEL, bags[1], "--period", "0.01", "--output", str(path)]) == 0
    assert np.abs(np.load(path) - signals["learned"][300:350]).max() < 0.2 * np.abs(signals["learned"][300:350]).max()


def test_a_measured_response_takes_the_place_of_the_models(tmp_path, capsys):
    assert (
        main(
            ["excite", "multisine", "period=0.4", "lower_frequency=5", "upper_frequency=2400", "rms=3", "offset=50"]
            + ["--axes", "2", "--rate", "5000", "--output", str(tmp_path / "drive.yaml")]
        )
        == 0
    )
    simulated = ["simulate", MODEL, "--excitation", str(tmp_path / "drive.yaml"), "--rate", "5000", "--seed", "1"]
    assert main([*simulated, "--output", str(tmp_path / "excitation")]) == 0
    out = tmp_path / "out.json"
    arguments = ["learn", MODEL, "--trials", "4", *LOOP, *SINE, "--response", str(tmp_path / "excitation"), "--json", str(out)]
    assert main(arguments) == 0
    errors = [row["value"] for row in json.loads(out.read_text())["rows"] if row["quantity"] == "nrmse"]
    assert min(errors) < 0.3 * errors[0]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([], "--reference"),
        (["absent"], "--period"),
        (["--plant", "fsm", "--period", "1", *SINE], "--reference"),
        (["--gain-error", "0.1", *SINE], "--plant"),
        (["--plant", "pea", *SINE], "axes"),
        ([*SINE, "--averaged", "1", *LOOP], "averaged"),
        ([*SINE, "--output", "learned.csv"], "npy"),
        ([*SINE, *LOOP, "--feedback-error", "0"], "--feedback-error"),
        ([*SINE, *LOOP, "--trials", "100000000"], "trials: 100000000 of 150 samples are too many to keep, 133333 are possible"),
        ([*SINE, *LOOP, "--averaged", "100000000"], "averaged: a trial of 5000000050 samples is too long"),
    ],
)
def test_unusable_input_is_refused_in_one_line(arguments, word, capsys):
    assert main(["learn", MODEL, *arguments]) == 2
    told = capsys.readouterr().err.strip()
    assert word in told and "\n" not in told
