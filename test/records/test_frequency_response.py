# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A frequency response as a record: its measurement is what the plant in closed form answers to its command, once it is steady."""

import numpy as np
import pytest
from scipy import signal

from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.tables.importing import import_table, parse_columns

POLE = 2 * np.pi * 200.0
PLANT = [0.12 * POLE**2], [1.0, 0.3 * POLE, POLE**2]
FREQUENCY = np.geomspace(5.0, 1000.0, 200)
RESPONSE = signal.freqs(*PLANT, 2 * np.pi * FREQUENCY)[1]
FORMS = {
    "frequency=1[Hz],magnitude=2[dB],phase=3[deg]": (FREQUENCY, 20 * np.log10(abs(RESPONSE)), np.degrees(np.angle(RESPONSE)) + 360),
    "frequency=1[kHz],magnitude=2[dB (um/V)],phase=3[rad]": (FREQUENCY / 1e3, 20 * np.log10(abs(RESPONSE)), np.angle(RESPONSE)),
    "frequency=1[rad/s],magnitude=2[nm/V],phase=3[mrad]": (2 * np.pi * FREQUENCY, 1e3 * abs(RESPONSE), 1e3 * np.angle(RESPONSE)),
    "frequency=1[Hz],real=2[nm/mV],imaginary=3[nm/mV]": (FREQUENCY, RESPONSE.real, RESPONSE.imag),
}


@pytest.mark.parametrize("columns", FORMS)
def test_the_record_is_one_of_the_plant(tmp_path, columns, capsys):
    np.savetxt(tmp_path / "a.csv", np.column_stack(FORMS[columns]), "%.12g", ",")
    assert main(["import", str(tmp_path / "a.csv"), "--columns", columns, "--output", str(tmp_path / "bag")]) == 0
    assert "a frequency response is no record in time: written is the steady answer to 200 sines" in capsys.readouterr().out
    record = read_bag(tmp_path / "bag")
    assert record.hold == "foh" and record.signals["measurement"].unit == "um" and record.signals["command"].unit == "V"
    [part] = record.aligned()
    command, measurement = part.command[:, 0], part.measurement[:, 0]
    answer = signal.lsim(PLANT, command, part.time, interp=True)[1]
    steady = slice(2000, None)
    assert np.std((answer - measurement)[steady]) < 1e-3 * np.std(measurement)
    # turned in phase by a degree it would be 1.7 % off
    assert np.std(np.roll(answer, 1)[steady] - measurement[steady]) > 1e-2 * np.std(measurement)


def test_lines_without_coherence_are_left_out(tmp_path):
    coherence = np.where(np.arange(200) % 4, 0.9, 0.1)
    wrong = np.where(coherence < 0.5, 100.0, 20 * np.log10(abs(RESPONSE)))
    np.savetxt(tmp_path / "a.csv", np.column_stack([FREQUENCY, wrong, np.degrees(np.angle(RESPONSE)), coherence]), "%.12g", ",")
    columns = "frequency=1[Hz],magnitude=2[dB],phase=3[deg],coherence=4[1]"
    record = import_table(tmp_path / "a.csv", parse_columns(columns), None)
    assert "50 frequencies were left out" in record.notes[1]
    answer = signal.lsim(PLANT, record.signals["command"].values[:, 0], record.signals["command"].time, interp=True)[1]
    measured = record.signals["measurement"].values[:, 0]
    assert np.std((answer - measured)[2000:]) < 1e-3 * np.std(measured)


@pytest.mark.parametrize(
    "columns, words",
    [
        ("frequency=1[Hz],magnitude=2[dB]", "needs frequency, magnitude and phase"),
        ("frequency=1[Hz],magnitude=2[dB],command=3[V]", "a frequency response is made of frequency, magnitude"),
        ("frequency=1[um],magnitude=2[dB],phase=3[deg]", "frequency: unit 'um' is not known, must be one of Hz, kHz, rad/s"),
        ("frequency=1[Hz],magnitude=2[um],phase=3[deg]", "unit 'um' must be one of a response, such as um/V"),
        ("frequency=2[Hz],magnitude=2[dB],phase=3[deg]", "only . frequencies have a finite response"),
    ],
)
def test_what_is_no_response_is_refused(tmp_path, columns, words):
    np.savetxt(tmp_path / "a.csv", np.column_stack([FREQUENCY, -np.abs(FREQUENCY), FREQUENCY]), "%.12g", ",")
    with pytest.raises(InputError, match=words):
        import_table(tmp_path / "a.csv", parse_columns(columns), None)


def test_too_many_decades_are_refused(tmp_path):
    frequency = np.geomspace(1e-4, 1e5, 100)
    np.savetxt(tmp_path / "a.csv", np.column_stack([frequency, np.ones(100), np.ones(100)]), "%.12g", ",")
    with pytest.raises(InputError, match="are too many decades for one record"):
        import_table(tmp_path / "a.csv", parse_columns("frequency=1[Hz],magnitude=2[um/V],phase=3[deg]"), None)


def test_each_axis_is_a_plant_of_its_own(tmp_path):
    plants = PLANT, ([0.06 * POLE], [1.0, POLE])
    answers = [signal.freqs(*plant, 2 * np.pi * FREQUENCY)[1] for plant in plants]
    parts = [part for answer in answers for part in (20 * np.log10(abs(answer)), np.degrees(np.angle(answer)))]
    np.savetxt(tmp_path / "a.csv", np.column_stack([FREQUENCY, *parts]), "%.12g", ",")
    record = import_table(tmp_path / "a.csv", parse_columns("frequency=1[Hz],magnitude=2+4[dB],phase=3+5[deg]"), None)
    assert record.notes[-1].endswith("for identify --model linear --no-coupled")
    command, measured = record.signals["command"], record.signals["measurement"]
    assert command.axes == measured.axes == ("x", "y")
    for axis, plant in enumerate(plants):
        answer = signal.lsim(plant, command.values[:, axis], command.time, interp=True)[1]
        assert np.std((answer - measured.values[:, axis])[2000:]) < 2e-3 * np.std(answer)
    assert abs(np.corrcoef(command.values.T)[0, 1]) < 0.5  # neither drives the other


@pytest.mark.parametrize(
    "columns, words",
    [
        ("frequency=1[Hz],magnitude=2+2[dB],phase=3[deg]", r"phase: 1 columns: another has 2: name one of each axis"),
        ("frequency=1+1[Hz],magnitude=2+2[dB],phase=3+3[deg]", "frequency: 2 columns: name one"),
        ("frequency=1[Hz],real=2[um/V],imaginary=3+3[um/V]", "real: 1 columns: another has 2"),
    ],
)
def test_other_numbers_of_axes_are_refused(tmp_path, columns, words):
    np.savetxt(tmp_path / "a.csv", np.column_stack([FREQUENCY, RESPONSE.real, RESPONSE.imag]), "%.12g", ",")
    with pytest.raises(InputError, match=words):
        import_table(tmp_path / "a.csv", parse_columns(columns), None)
