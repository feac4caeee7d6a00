# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Notes of `hyst identify` on a residual with mains hum, and on a machine whose gain changes within the record."""

import json

import numpy as np
from scipy.signal import lfilter

from hyst_control.cli import main
from hyst_control.identify.assess.attainable import poorly_explained
from hyst_control.identify.assess.residual_lines import line_notes
from hyst_control.records.record import Record, Signal, sampled_record
from hyst_control.records.tables.importing import write_bag

STEP, ROWS = 1e-4, 20_000
TIME = STEP * np.arange(ROWS)
BINARY = np.repeat(np.random.default_rng(7).choice([-1.0, 1.0], ROWS // 10), 10)
TONES = sum(np.sin(2 * np.pi * frequency * TIME) for frequency in (11.0, 23.0))
POLE = np.exp((-0.05 + 1j) * 2 * np.pi * 120.0 * STEP)
NOISE = 0.005 * np.random.default_rng(8).standard_normal(ROWS)


def mode(command):
    return lfilter([0.0, abs(1 - POLE) ** 2], [1.0, -2.0 * POLE.real, abs(POLE) ** 2], command)


def lines(error, command=BINARY):
    measured = mode(command) + error
    record = sampled_record("r", command[:, None], measured[:, None], STEP, ("x",), "um", "zoh", "settled")
    return line_notes([record], [error[:, None]])


def test_a_hum_in_the_rest_is_named_with_its_frequency_and_size():
    for command in (BINARY, TONES):
        [note] = lines(NOISE + 0.1 * np.sin(2 * np.pi * 50.02 * TIME), command)
        assert "x: hum of 50.02 Hz, 0.1 um" in note
    [note] = lines(NOISE + 0.1 * np.sin(2 * np.pi * 77.0 * TIME))
    assert "a vibration or an interference of 77 Hz" in note


def test_what_the_command_makes_and_what_does_not_last_is_no_hum():
    assert lines(NOISE) == lines(NOISE + 0.2 * mode(BINARY)) == []
    for frequency in (11.0, 22.0, 46.0, 34.0, 12.0):  # lines, harmonics, sums and differences
        assert lines(NOISE + 0.1 * np.sin(2 * np.pi * frequency * TIME), TONES) == []
    swelling = np.linspace(0.2, 1.0, ROWS) * np.sin(2 * np.pi * 5.0 * TIME)
    assert lines(NOISE + 0.1 * np.sin(2 * np.pi * 4.7 * TIME), swelling) == []  # nearer than what the record's length can tell
    assert lines(NOISE + 0.3 * (TIME < 0.4) * np.sin(2 * np.pi * 50.0 * TIME)) == []
    ringing = np.zeros(ROWS)
    ringing[np.random.default_rng(3).choice(ROWS, 12)] = 1.0
    assert lines(NOISE + 0.2 * lfilter([1.0], [1.0, -2.0 * POLE.real, abs(POLE) ** 2], ringing)) == []


def test_identify_notes_a_hum(tmp_path):
    signals = {
        "command": Signal(TIME, BINARY[:, None], ("x",), "V"),
        "measurement": Signal(TIME, (mode(BINARY) + NOISE + 0.1 * np.sin(2 * np.pi * 50.0 * TIME))[:, None], ("x",), "um"),
    }
    write_bag(tmp_path / "bag", Record(signals, "made"))
    words = ["identify", str(tmp_path / "bag"), "--model", "linear", "--output", str(tmp_path / "m.yaml")]
    assert main([*words, "--json", str(tmp_path / "fit.json")]) == 0
    notes = json.loads((tmp_path / "fit.json").read_text())["notes"]
    assert any("hum of 50" in note for note in notes)


def test_a_gain_that_jumps_in_mid_record_follows_time():
    answer, gain = mode(BINARY), np.where(TIME < 1.0, 1.0, 1.25)
    measured = gain * answer + NOISE
    record = sampled_record("r", BINARY[:, None], measured[:, None], STEP, ("x",), "um", "zoh", "settled")
    [poor] = poorly_explained([record], [(measured - 1.125 * answer)[:, None]])
    assert poor.follows == "time" and not poor.linear
    text = poor.text()
    assert "follows time" in text and "0.889, 0.889, 1.11, 1.11 times the model's" in text and "leaves" not in text
    # A model of another gain is as wrong in every part.
    measured = answer + NOISE
    record = sampled_record("r", BINARY[:, None], measured[:, None], STEP, ("x",), "um", "zoh", "settled")
    [poor] = poorly_explained([record], [(measured - 0.8 * answer)[:, None]])
    assert poor.follows != "time" and "of these rows alone" in poor.reference_name
