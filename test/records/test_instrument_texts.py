# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Texts as instruments and programs write them: whatever stands above and beside the numbers, the numbers come out."""

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.records.tables.header import Form, stated_sample_time
from hyst_control.records.tables.importing import import_records, import_table, parse_columns
from hyst_control.records.tables.listing import listed_columns

COUNT = 80
TIME, DRIVE, MOVED = np.arange(COUNT) * 1e-3, np.arange(COUNT) * 0.5 - 3.0, np.cos(np.arange(COUNT)).round(5)
ROWS = list(zip(TIME, DRIVE, MOVED, strict=True))


def body(form, comma=False):
    text = "".join(form.format(k=k, t=t, u=u, y=y) for k, (t, u, y) in enumerate(ROWS))
    return text.replace(".", ",") if comma else text


BESIDE = ["Record Length,80", "Interval,1.0e-03", "Trigger,0", ",", "Vertical Units,V"] + [","] * (COUNT - 5)
TEXTS = {
    "settings beside the rows": (
        "".join(f"{beside},,{t:.9f},{u:.5f},{y:.5f}\n" for beside, (t, u, y) in zip(BESIDE, ROWS, strict=True)),
        "time=4[s],command=5[V],measurement=6[um]",
    ),
    "two markers, decimal commas": (
        "Recorder\t\nDecimal\t,\n***End_of_Header***\t\nChannels\t2\t\nSamples\t80\t80\t\n***End_of_Header***\t\n"
        "X_Value\tdrive\tpos\tComment\t\n" + body("{t:.6f}\t{u:.6f}\t{y:.6f}\t\n", True),
        "time=X_Value[s],command=drive[V],measurement=pos[um]",
    ),
    "settings of numbers": (
        "Gain\tRange\tTemp,C\n010\t0000100\t+025.00\nTime,s\tCh1,V\tCh2,um\n" + body("{t:.4f}\t{u:.4f}\t{y:.5f}\n"),
        "time=Time[s],command=Ch1[V],measurement=Ch2[um]",
    ),
    "quoted names with commas": (
        '"Time, rel. [s]","Drive, ch. 1 [V]","Position [um]"\n' + body("{t:.4f},{u:.4f},{y:.5f}\n"),
        "time=Time, rel.[s],command=Drive, ch. 1[V],measurement=Position[um]",
    ),
    "names and units below": (
        "X;CH1;CH2\nSecond;Volt;Micron\n" + body("{t};{u};{y}\n", True),
        "time=X[s],command=CH1[V],measurement=CH2[um]",
    ),
    "quoted numbers": (body('"{t:.4f}","{u:.4f}","{y:.5f}"\n'), "time=1[s],command=2[V],measurement=3[um]"),
    "a literal of MATLAB": (
        "data = [\n" + body(" {t:.4f}, {u:.4f}, {y:.5f};\n") + "];\n",
        "time=1[s],command=2[V],measurement=3[um]",
    ),
    "a literal in one bracket": ("[" + body("{t:.4f} {u:.4f} {y:.5f};\n")[:-2] + "]", "time=1[s],command=2[V],measurement=3[um]"),
    "names in a comment": ("# made by a logger\n# t u y\n" + body("{t} {u} {y}\n"), "time=t[s],command=u[V],measurement=y[um]"),
    "an array of PI's controllers": (
        "# REM E-712\n# VERSION = 1\n# TYPE = 1\n# SEPARATOR = 32\n# DIM = 2\n# SAMPLE_TIME = 0.001\n# NDATA = 80\n#\n"
        "# NAME0 = Target Position of axis X\n# NAME1 = Current Position of axis X\n#\n# END_HEADER\n" + body("{u:.4f} {y:.5f}\n"),
        "command=Target Position of axis X[V],measurement=Current Position of axis X[um]",
    ),
    "exponents of Fortran": (
        body(" {t:.8E} {u:.8E} {y:.8E}\n").replace("E", "D"),
        "time=1[s],command=2[V],measurement=3[um]",
    ),
    "digits in groups": (
        '"t (us)","u (mV)","y (nm)"\n' + "".join(f'"{1e6 * t:,.1f}","{1e3 * u:,.1f}","{1e3 * y:,.2f}"\n' for t, u, y in ROWS),
        "time=1[us],command=2[mV],measurement=3[nm]",
    ),
    "an increment below its name": (
        "X,CH1,CH2,Start,Increment,\nSequence,Volt,Micron,-4.0e-02,1.0e-03\n" + body("{k},{u:.5f},{y:.5f},,\n"),
        "command=2[V],measurement=3[um]",
    ),
    "a sampling period above the rows": (
        '"MMI scope"\n"Sampling period, ms",1\n"Index";"DOUT(0)";"FPOS(0)"\n' + body("{k};{u:.5f};{y:.5f}\n"),
        "command=2[V],measurement=3[um]",
    ),
    "moments": (
        "when,u,y\n" + "".join(f"2024-05-03 23:59:59.{k:03d},{u},{y}\n" for k, (_, u, y) in enumerate(ROWS)),
        "time=when[s],command=u[V],measurement=y[um]",
    ),
    "names and units among the settings": (
        '"Model","DL850"\n"TraceName","drive","pos"\n"VUnit","V","um"\n"SampleRate",1000,1000\n"Date","2020/01/02","2020/01/02"\n'
        '"Time","10:11:12.5","10:11:12.5"\n\n' + body(",{u:.6E},{y:.6E}\n"),
        "command=drive[V],measurement=pos[um]",
    ),
    "moments of an American half day": (
        "when,u,y\n" + "".join(f"5/31/2024 1:00:00.{k:03d} PM,{u},{y}\n" for k, (_, u, y) in enumerate(ROWS)),
        "time=when[s],command=u[V],measurement=y[um]",
    ),
    "moments of a European day": (
        "when;u;y\n" + "".join(f"31.05.2024 13:00:00,{k:03d};{u};{y}\n" for k, (_, u, y) in enumerate(ROWS)),
        "time=when[s],command=u[V],measurement=y[um]",
    ),
    "durations": ("Time,u,y\n" + body("{t:.3f} sec,{u},{y}\n"), "time=Time[s],command=u[V],measurement=y[um]"),
    "units as words behind names": (
        '"in s","C1 in V","C2 in um"\n' + body("{t:.3f},{u},{y}\n"),
        "time=in s[s],command=C1[V],measurement=C2[um]",
    ),
    "channels by number above their units": (
        "x-axis,1,2\nsecond,Volt,Volt\n" + body("{t},{u},{y}\n"),
        "time=x-axis[s],command=2[V],measurement=3[um]",
    ),
    "names and units in comments": (
        "# run 7\n# t u y\n# s V um\n" + body("{t} {u} {y}\n"),
        "time=t[s],command=u[V],measurement=y[um]",
    ),
    "thousands with points": (
        "t;u [uV];y\n" + "".join(f"{t:.4f};{1e6 * u:_.1f};{y:.5f}\n".replace(".", ",").replace("_", ".") for t, u, y in ROWS),
        "time=t[s],command=u[uV],measurement=y[um]",
    ),
    "thousands of the Swiss": (
        "t,u [uV],y\n" + "".join(f"{t:.4f},{1e6 * u:_.1f},{y:.5f}\n".replace("_", "'") for t, u, y in ROWS),
        "time=t[s],command=u[uV],measurement=y[um]",
    ),
    "words in a column that is not used": ("t,state,u,y\n" + body("{t},ok,{u},{y}\n"), "time=t[s],command=u[V],measurement=y[um]"),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-16-le", "cp1252"])
@pytest.mark.parametrize("kind", TEXTS)
def test_the_numbers_come_out(tmp_path, kind, encoding):
    text, columns = TEXTS[kind]
    path = tmp_path / "run.csv"
    path.write_bytes(text.encode(encoding))
    record = import_table(path, parse_columns(columns), None)
    for topic, due in (("command", DRIVE), ("measurement", MOVED)):
        np.testing.assert_allclose(record.signals[topic].values[:, 0], due, atol=1e-9)
        np.testing.assert_allclose(record.signals[topic].time, TIME, atol=1e-9)


@pytest.mark.parametrize("kind", TEXTS)
def test_the_suggestion_can_be_pasted(tmp_path, kind, capsys):
    path = tmp_path / "run.csv"
    path.write_text(TEXTS[kind][0])
    assert main(["import", str(path)]) == 2
    out, err = capsys.readouterr()
    assert "columns of numbers, with their ranges" in out and err.count("\n") == 1
    _, suggestion = listed_columns(path)
    assert suggestion in err
    columns = suggestion.split('"')[1].replace("UNIT", "V")
    assert parse_columns(columns)[-1].topic == "measurement"
    rate = 1000.0 if "--rate" in suggestion else None
    record = import_table(path, parse_columns(columns), rate)
    np.testing.assert_allclose(record.signals["measurement"].values[:, 0], MOVED, atol=1e-9)
    np.testing.assert_allclose(record.signals["command"].values[:, 0], DRIVE, atol=1e-9)


def test_units_in_the_header_are_suggested(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("Time [ms],Angle (arcsec),Coil current [mA]\n" + body("{k},{y},{u}\n"))
    lines, suggestion = listed_columns(path)
    assert suggestion.startswith('--columns "time=1[ms],command=3[mA],measurement=2[arcsec]"')
    assert "3 'Coil current [mA]': 80 rows, -3 to 36.5 mA" in lines[3]


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("10:00:00.5", 36000.5),
        ("1970-01-01T00:00:07.25Z", 7.25),
        ("1970-01-01T01:00:07.1234567+01:00", 7.123456),
        ("12:00:01 AM", 1.0),
        ("12:00:01 pm", 43201.0),
        ("1/2/1970 00:00:00", 86400.0),
        ("13/1/1970 00:00:00", 12 * 86400.0),
        ("2.1.1970 00:00", 86400.0),
        ("28-Jan-1970 23:59:59.9", 28 * 86400 - 0.1),
        ("2 February 1970 00:00", 32 * 86400.0),
        ("2-Foo-1970 00:00", None),
        ("1.5e-3 sec", 0.0015),
        ("2 min", 120.0),
        ("31.02.2024 10:00:00", None),
        ("13:00:00 PM", 46800.0),
        ("10 mm", None),
    ],
)
def test_moments_and_durations(text, seconds):
    assert Form(";", ".").number(text) == (seconds if seconds is None else pytest.approx(seconds, abs=1e-6))


def test_names_and_units_come_from_labeled_settings(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("Model,MSO44\nVertical Units,V,nm\nGain,1,1\nLabels,drive,pos\n\nTIME,CH1,CH2\n" + body("{t},{u},{y}\n"))
    lines, suggestion = listed_columns(path)
    assert suggestion == '--columns "time=TIME[s],command=drive[V],measurement=pos[nm]"'
    assert lines[2].startswith("  drive: 80 rows") and lines[3].endswith(" nm")


def test_ticks_of_a_clock_of_unknown_rate_are_not_suggested_as_seconds(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("timestamp;drive;pos\n" + "".join(f"{int(210e6 * (7 + t))};{u};{y}\n" for t, u, y in ROWS))
    assert listed_columns(path)[1] == '--columns "command=drive[UNIT],measurement=pos[UNIT]" --rate HZ'


def test_a_column_that_steps_as_the_settings_say_is_the_time(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(
        "".join(f"{beside},,{t:.9f},{u:.5f}\n" for beside, (t, u, _) in zip(BESIDE, ROWS, strict=True)).replace("Int", "Sample Int")
    )
    assert listed_columns(path)[1] == '--columns "time=4[s],command=5[UNIT]"'


def test_words_below_the_numbers_are_left_out_and_words_among_them_are_not(tmp_path):
    path, columns = tmp_path / "run.csv", parse_columns("time=t[s],command=u[V],measurement=y[um]")
    path.write_text("t,u,y\n" + body("{t},{u},{y}\n") + "stopped by hand\nEND,,\n")
    record = import_table(path, columns, None)
    assert len(record.signals["command"].time) == COUNT and "from line 82 on holds no numbers" in record.notes[0]
    path.write_text("t,u,y\n" + body("{t},{u},{y}\n") + "stopped by hand\n0.08,1,2\n")
    with pytest.raises(InputError, match="line 82 has 1 columns, the first has 3"):
        import_table(path, columns, None)


def test_lines_can_be_skipped(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("1,2,3\n" * 20 + "t,u,y\n" + body("{t},{u},{y}\n"))
    columns = parse_columns("time=t[s],command=u[V],measurement=y[um]")
    with pytest.raises(InputError, match="has no column 't'"):
        import_records(path, columns, None)
    [record] = import_records(path, columns, None, skip=20)
    np.testing.assert_allclose(record.signals["command"].values[:, 0], DRIVE)


def test_what_was_imported_is_told(tmp_path, capsys):
    path = tmp_path / "run.csv"
    path.write_text(TEXTS["names in a comment"][0])
    options = ["--columns", "time=t[s],command=u[V],measurement=y[nm]", "--output", str(tmp_path / "bag")]
    assert main(["import", str(path), *options]) == 0
    out = capsys.readouterr().out
    assert "command: 80 samples at 1000 Hz, 0.08 s, x -3 to 36.5 V" in out and "x -0.001 to 0.001 um" in out


@pytest.mark.parametrize(
    ("line", "sample_time"),
    [
        ("Sample Interval,Analog:1.000000E-04", 1e-4),
        ("% Acquisition rate: 1.0e4 Sa/s", 1e-4),
        ("Sampling Rate\t2.5 kHz", 4e-4),
        ("SampleTime[ms];0.1;0.1", 1e-4),
        ("Abtastzeit [µs]: 100", 1e-4),
        ("Delta_X\t1.0E-4\t1.0E-4", 1e-4),
        ("Samples\t8000\t8000", None),
        ("Scan time: 10:00:30", None),
        ("Sample rate", None),
    ],
)
def test_settings_state_the_sample_time(line, sample_time):
    found = stated_sample_time(line)
    assert found == pytest.approx(sample_time) if sample_time else found is None


def test_a_minus_sign_of_a_printer_is_one(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(("t,u,y\n" + body("{t},{u},{y}\n")).replace("-", "\u2212"), encoding="utf-8")
    record = import_table(path, parse_columns("time=t[s],command=u[V],measurement=y[um]"), None)
    np.testing.assert_allclose(record.signals["measurement"].values[:, 0], MOVED)


COLUMNS = parse_columns("time=t[s],command=u[V],measurement=y[um]")


def test_two_columns_of_one_name_are_refused(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,CH,CH\ns,V,um\n" + body("{t},{u},{y}\n"))
    with pytest.raises(InputError, match="'CH' names several columns: choose one by its number: 2, 3"):
        import_table(path, parse_columns("time=t[s],command=CH[V],measurement=CH[um]"), None)
    record = import_table(path, parse_columns("time=t[s],command=2[V],measurement=3[um]"), None)
    np.testing.assert_allclose(record.signals["measurement"].values[:, 0], MOVED)


def test_a_header_between_the_rows_is_left_out(tmp_path):
    path, rows = tmp_path / "run.csv", body("{t},{u},{y}\n").splitlines(keepends=True)
    path.write_text("".join(["t,u,y\n", *rows[:40], "t,u,y\n", *rows[40:]]))
    [record] = import_records(path, COLUMNS, None)
    np.testing.assert_allclose(record.signals["measurement"].values[:, 0], MOVED)
    assert record.notes == (f"{path}: lines that repeat the header were left out: 1, the first is line 42",)
    path.write_text("".join(f"Run {number}\nt,u,y\n{''.join(rows)}\n" for number in (1, 2, 3)))
    records = import_records(path, COLUMNS, None)
    assert [len(record.signals["command"].time) for record in records] == [COUNT] * 3
    assert "left out: 4, the first is line 84" in records[0].notes[0]
    path.write_text("".join(f"Run {number}\nt,u,y\n{''.join(part)}\n" for number, part in enumerate((rows[:10], rows * 4))))
    assert [len(record.signals["command"].time) for record in import_records(path, COLUMNS, None)] == [10, *[COUNT] * 4]


def test_a_last_line_that_is_cut_off_is_told(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,u,y\n" + body("{t},{u},{y}\n") + "0.08,1")
    record = import_table(path, COLUMNS, None)
    assert len(record.signals["command"].time) == COUNT and record.notes == (
        f"{path}: the last line, 82, is cut off and was left out",
    )


@pytest.mark.parametrize(
    "word", ["OVERLOAD", "OVLD", "OL", "-OL", "∞", "#N/A", "--", "n/a", "null", "nan", "NAN", "-Inf", "9.9E37", "9.91E+37"]
)
@pytest.mark.parametrize("comma", [False, True])
def test_words_for_a_missing_number(tmp_path, word, comma):
    path, rows = tmp_path / "run.csv", body("{t};{u};{y}\n").splitlines(keepends=True)
    for row in (0, 1, 30):
        rows[row] = rows[row].rpartition(";")[0] + f";{word}\n"
    path.write_text("t;u;y\n" + "".join(rows).replace(".", "," if comma else "."), encoding="utf-8")
    with pytest.raises(InputError, match="measurement: row 0 and 2 more hold no finite number: --resample interpolates such rows"):
        import_records(path, COLUMNS, None)
    [record] = import_records(path, COLUMNS, None, resample=0.0)
    assert f"{path}: rows with no finite number in a column were taken as missing: 3" in record.notes
    measured = record.signals["measurement"].values[:, 0]
    assert measured[28] == pytest.approx((MOVED[29] + MOVED[31]) / 2) and measured[-1] == MOVED[-1]


@pytest.mark.parametrize(
    "end, is_noted", [("0", True), ("0.984", True), ("0.984295", False), ("0.984295\n", False), ("0\n", False)]
)
def test_a_last_number_that_may_be_cut_off_is_told(tmp_path, end, is_noted):
    rows = [f"{k / 1e3:.6f},{1.0 + np.sin(k / 30):.6f},{0.2 + 0.1 * np.cos(k / 30):.6f}\n" for k in range(100)]
    path = tmp_path / "log.csv"
    path.write_text(f"t,u,y\n{''.join(rows)}0.100000,1.190568,{end}", encoding="utf-8")
    [record] = import_records(path, parse_columns("time=t[s],command=u[V],measurement=y[um]"), None)
    assert len(record.signals["command"].values) == 101
    said = f"{path}: the last line, 102, has no line end and is the shortest: its last number may be cut off"
    assert (said in record.notes) == is_noted
