# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst import` accepts what it suggests for a file; times across midnight, missing numbers, and units in names."""

import csv

import numpy as np
import pytest
from scipy.io import savemat

import hyst_control as hc
from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.tables.columns import parse_columns
from hyst_control.records.tables.exporting import export_record
from hyst_control.records.tables.importing import import_records, import_table
from hyst_control.records.tables.listing import listed_columns

TIME = np.arange(64) * 1e-3
DRIVE, MOVED = np.sin(TIME * 100.0), np.cos(TIME * 100.0)
NAMES = {
    "plain": ("t", "u", "y"),
    "brackets": ("t [s]", "u [V]", "y [um]"),
    "brackets within": ("t[s] raw", "u[0] (V)", "y[0] (x)"),
    "commas": ("t, s", "u,a=b", "y,um"),
    "joined": ("t+[s]", "u+v", "y + z"),
    "quotes": ("t [s]", 'u "in"', "y $HOME"),
    "spaces": (" t ", "u ", " y"),
}


def write(path, names, values):
    """A table of these columns in the form that the path's ending says."""
    if path.suffix == ".csv":
        with open(path, "w", newline="") as file:
            csv.writer(file).writerows([names, *np.column_stack(values).tolist()])
    elif path.suffix == ".parquet":
        arrow = pytest.importorskip("pyarrow")
        pytest.importorskip("pyarrow.parquet").write_table(arrow.table(dict(zip(names, values, strict=True))), path)
    elif path.suffix == ".npz":
        np.savez(path, **dict(zip(names, values, strict=True)))
    else:
        savemat(path, {"log": dict(zip(names, values, strict=True))})


@pytest.mark.parametrize("names", NAMES.values(), ids=NAMES)
@pytest.mark.parametrize("ending", ["csv", "parquet", "npz", "mat"])
def test_a_suggestion_is_accepted_for_its_own_file(tmp_path, ending, names):
    path = tmp_path / f"run.{ending}"
    write(path, names, (TIME, DRIVE, MOVED))
    suggestion = listed_columns(path)[1].split('"')
    if len(suggestion) == 1:  # there is no number for an array of such a name
        assert ending in ("npz", "mat") and "whose names have no quotes" in suggestion[0]
        return
    assert len(suggestion) == 3 and not set(suggestion[1]) & set("$`\\!")
    columns = parse_columns(suggestion[1].replace("UNIT", "V"))
    [record] = import_records(path, columns, 1000.0 if "--rate" in suggestion[2] else None)
    for topic, due in (("command", DRIVE), ("measurement", MOVED)):
        if ending in ("csv", "parquet") or topic in record.signals:  # by number, whatever the name
            np.testing.assert_allclose(record.signals[topic].values[:, 0], due, atol=1e-15)
            np.testing.assert_allclose(record.signals[topic].time, TIME, atol=1e-12)
    if names in (NAMES["plain"], NAMES["brackets"], NAMES["brackets within"]):
        assert [column.topic for column in columns] == ["time", "command", "measurement"]


def test_numbered_columns_of_one_array_are_suggested_by_their_numbers(tmp_path):
    np.savez(tmp_path / "run.npz", data=np.column_stack([TIME, DRIVE, MOVED]), other=DRIVE)
    columns = listed_columns(tmp_path / "run.npz", "data")[1].split('"')[1]
    record = import_table(tmp_path / "run.npz", parse_columns(columns.replace("UNIT", "V")), None, variable="data")
    np.testing.assert_array_equal(record.signals["measurement"].values[:, 0], MOVED)


@pytest.mark.parametrize(
    ("head", "due"),
    [
        ("t_ns,u,y", "time=t_ns[ns],command=u[UNIT],measurement=y[UNIT]"),
        ("time_us,command_mV,pos_nm", "time=time_us[us],command=command_mV[mV],measurement=pos_nm[nm]"),
        ("Time(ms),force_N,tip_mrad", "time=1[ms],command=force_N[N],measurement=tip_mrad[mrad]"),
        ("time_min,coil_A,pos_m", "time=time_min[min],command=coil_A[A],measurement=pos_m[m]"),
        ("t_s,u_m,y_m", "time=t_s[s],command=u_m[UNIT],measurement=y_m[UNIT]"),  # a model's u and y, measured
        ("t_ms,ch_A,pos_min", "time=t_ms[ms],command=ch_A[UNIT],measurement=pos_min[UNIT]"),
        ("Time (msec),u,y", "time=1[msec],command=u[UNIT],measurement=y[UNIT]"),
    ],
)
def test_a_unit_at_the_end_of_a_name(tmp_path, head, due):
    path = tmp_path / "run.csv"
    rows = "".join(f"{1711846799000000000 + 1000000 * k},{u},{y}\n" for k, (u, y) in enumerate(zip(DRIVE, MOVED, strict=True)))
    path.write_text(f"{head}\n{rows}")
    assert listed_columns(path)[1] == f'--columns "{due}"'
    if head.startswith("t_ns"):
        assert import_table(path, parse_columns(due.replace("UNIT", "V")), None).common_step(["command"]) == pytest.approx(
            1e-3, rel=1e-4
        )


def test_nanometers_taken_for_micrometers_are_told_at_the_import(tmp_path, capsys):
    path = tmp_path / "run.csv"
    path.write_text("t,drive,position\n" + "".join(f"{t},{u},{4e3 * y}\n" for t, u, y in zip(TIME, DRIVE, MOVED, strict=True)))
    for unit, told in (("um", True), ("nm", False)):
        columns = f"time=t[s],command=drive[V],measurement=position[{unit}]"
        assert main(["import", str(path), "--columns", columns, "--output", str(tmp_path / unit)]) == 0
        assert ("check the unit: is it in nm?" in capsys.readouterr().out) == told


FREQUENCY = np.geomspace(1.0, 400.0, 50)
RESPONSE = 0.3 / (1.0 + 1j * FREQUENCY / 100.0)


@pytest.mark.parametrize(
    ("head", "columns", "due"),
    [
        (
            "omega [rad/s],|G|,arg [rad]",
            (2 * np.pi * FREQUENCY, abs(RESPONSE), np.angle(RESPONSE)),
            "frequency=1[rad/s],magnitude=2[um/V],phase=3[rad]",
        ),
        ("f,re,im", (FREQUENCY, RESPONSE.real, RESPONSE.imag), "frequency=f[Hz],real=re[um/V],imaginary=im[um/V]"),
        (
            "Frequency (Hz),Magnitude (dB),Phase (°),Coherence",
            (FREQUENCY, 20 * np.log10(abs(RESPONSE)), np.degrees(np.angle(RESPONSE)), np.ones(50)),
            "frequency=1[Hz],magnitude=2[dB],phase=3[°],coherence=Coherence",
        ),
        (
            "w,gain,phase",
            (2 * np.pi * FREQUENCY, 20 * np.log10(abs(RESPONSE)), np.degrees(np.angle(RESPONSE))),
            "frequency=w[rad/s],magnitude=gain[dB],phase=phase[deg]",
        ),
    ],
)
def test_a_frequency_response_is_known_by_its_names(tmp_path, head, columns, due):
    path = tmp_path / "frf.csv"
    path.write_text(f"{head}\n" + "".join(",".join(f"{value:.12g}" for value in row) + "\n" for row in zip(*columns, strict=True)))
    assert listed_columns(path)[1] == f'--columns "{due}"'
    record, same = (
        import_table(path, parse_columns(due), None),
        import_table(path, parse_columns(due.replace("=Coherence", "=4[1]")), None),
    )
    np.testing.assert_array_equal(record.signals["measurement"].values, same.signals["measurement"].values)
    size = np.ptp(record.signals["measurement"].values) / np.ptp(record.signals["command"].values)
    assert 0.05 < size < 0.3


def test_a_force_and_a_target_are_no_frequency_response(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t [s],f [N],gain,target\n" + "".join(f"{t},{u},2,{y}\n" for t, u, y in zip(TIME, DRIVE, MOVED, strict=True)))
    assert "frequency" not in listed_columns(path)[1]


def clock(seconds):
    second = int(seconds % 86400)
    return f"{second // 3600:02d}:{second // 60 % 60:02d}:{second % 60:02d}.{round(seconds % 1 * 1e3) % 1000:03d}"


def test_a_time_of_day_goes_on_at_midnight(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time,u,y\n" + "".join(f"{clock(86399.96 + t)},{u},{y}\n" for t, u, y in zip(TIME, DRIVE, MOVED, strict=True)))
    columns = listed_columns(path)[1].split('"')[1]
    assert columns == "time=time[s],command=u[UNIT],measurement=y[UNIT]"
    record = import_table(path, parse_columns(columns.replace("UNIT", "um")), None)
    np.testing.assert_allclose(record.signals["command"].time, TIME, atol=1e-9)
    assert "passes midnight in row 40: a day was added" in record.notes[0]


@pytest.mark.parametrize(("seconds", "runs"), [([*range(86399 - 100, 86400), *range(100)], 1), ([*range(0, 46800, 30)] * 2, 2)])
def test_only_a_fall_by_a_day_is_midnight(tmp_path, seconds, runs):
    path = tmp_path / "run.csv"
    path.write_text("".join(f"{second},{number % 7},{number % 5}\n" for number, second in enumerate(seconds)))
    assert len(import_records(path, parse_columns("time=1[s],command=2[V],measurement=3[um]"), None)) == runs


@pytest.mark.parametrize("columns", ["time=1[s],command=2[V],measurement=3[um]", "command=2[V],measurement=3[um]"])
def test_rows_without_a_number_are_missing_rows_where_gaps_are_accepted(tmp_path, columns, capsys):
    path = tmp_path / "run.csv"
    moved = [f"{y:.9f}" for y in MOVED]
    moved[20:23] = ["NaN", "", "NaN"]
    path.write_text("t,u,y,temperature\n" + "".join(f"{t:.3f},{u},{y},nan\n" for t, u, y in zip(TIME, DRIVE, moved, strict=True)))
    given = ["import", str(path), "--columns", columns, *([] if "time" in columns else ["--rate", "1000"])]
    assert main([*given, "--output", str(tmp_path / "no")]) == 2 and not (tmp_path / "no").exists()
    assert (
        "row 20 and 2 more hold no finite number: --resample interpolates such rows, --allow-gaps leaves" in capsys.readouterr().err
    )
    assert main([*given, "--allow-gaps", "--output", str(tmp_path / "gaps")]) == 0
    assert "rows with no finite number in a column were taken as missing: 3" in capsys.readouterr().out
    kept = np.delete(np.arange(64), [20, 21, 22])
    np.testing.assert_allclose(read_bag(tmp_path / "gaps").signals["measurement"].time, TIME[kept], atol=1e-9)
    assert main([*given, "--resample", "--output", str(tmp_path / "filled")]) == 0
    np.testing.assert_allclose(read_bag(tmp_path / "filled").signals["measurement"].values[:, 0], MOVED, atol=0.02)


def test_a_row_keeps_its_number_beside_missing_ones(tmp_path):
    path = tmp_path / "run.csv"
    rows = [f"{k % 20},{'nan' if k == 3 else k},{k}\n" for k in range(40)]
    path.write_text("".join(rows))
    columns = parse_columns("time=1[s],command=2[V],measurement=3[um]")
    records = import_records(path, columns, None, allow_gaps=True)
    assert "starts again in row 20: 2 runs" in records[0].notes[1]
    path.write_text("".join(row.replace(row.split(",")[1], "nan") for row in rows))
    with pytest.raises(InputError, match="fewer than two rows hold finite numbers"):
        import_records(path, columns, None, allow_gaps=True)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("timed", [True, False])
def test_what_was_measured_beside_a_missing_number_stays(tmp_path, hold, timed):
    """Of a command in levels each sample is the one that was logged, also where the measurement begins a level with none."""
    path = tmp_path / "run.csv"
    levels, moved = np.repeat([1.0, -2.0, 4.0, 3.0], 16), [f"{y:.9f}" for y in MOVED]
    moved[16], moved[40:43] = "NaN", ["NaN"] * 3
    path.write_text("t,u,y\n" + "".join(f"{t:.3f},{u},{y}\n" for t, u, y in zip(TIME, levels, moved, strict=True)))
    columns = parse_columns("time=t[s],command=u[V],measurement=y[um]")[not timed :]
    [record] = import_records(path, columns, None if timed else 1000.0, hold=hold, resample=0.0)
    np.testing.assert_allclose(record.signals["command"].values[:, 0], levels, atol=1e-12)
    np.testing.assert_allclose(record.signals["measurement"].values[:, 0], MOVED, atol=0.02)
    np.testing.assert_allclose(record.signals["measurement"].values[[15, 17], 0], MOVED[[15, 17]], atol=1e-9)


def test_a_long_stretch_without_numbers_still_parts_a_record(tmp_path):
    path = tmp_path / "run.csv"
    moved = [*MOVED[:20], *["NaN"] * 20, *MOVED[40:]]
    path.write_text("t,u,y\n" + "".join(f"{t:.3f},{u},{y}\n" for t, u, y in zip(TIME, DRIVE, moved, strict=True)))
    records = import_records(path, parse_columns("time=t[s],command=u[V],measurement=y[um]"), None, resample=0.0)
    assert [len(record.signals["command"].time) for record in records] == [20, 24]


def test_a_column_without_any_number_is_told_as_one(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,u,y\n" + "".join(f"{t:.3f},{u},\n" for t, u in zip(TIME, DRIVE, strict=True)))
    with pytest.raises(InputError, match="measurement: no row holds a finite number: name another column"):
        import_records(path, parse_columns("time=t[s],command=u[V],measurement=3[um]"), None)


def table(path, header, columns):
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    return path


SWEEP = np.arange(400) * 1e-3, 30.0 + 20.0 * np.sin(np.arange(400) * 0.05), 3.0 + np.cos(np.arange(400) * 0.05)


@pytest.mark.parametrize(
    "header",
    ["time [s],command [V],measurement [um]", "t [s],u [V],y [um]", "Time (s),Drive voltage (V),Position (um)", "t_s,cmd_V,pos_um"],
)
def test_a_table_that_says_all_itself_is_a_record_for_every_reader(tmp_path, header):
    path = table(tmp_path / "run.csv", header, SWEEP)
    due = hc.from_arrays(SWEEP[1], SWEEP[2], rate=1000)
    for record in (read_bag(path), hc.read_csv(path)):
        for topic in ("command", "measurement"):
            np.testing.assert_allclose(record.signal(topic).values, due.signal(topic).values, rtol=1e-6)
            np.testing.assert_allclose(record.signal(topic).time, due.signal(topic).time, atol=1e-9)
    assert main(["import", str(path), "--output", str(tmp_path / "bag")]) == 0
    np.testing.assert_array_equal(
        read_bag(tmp_path / "bag").signal("measurement").values, read_bag(path).signal("measurement").values
    )


def test_the_axes_of_an_exported_table_come_back(tmp_path):
    record = hc.from_arrays(np.column_stack(SWEEP[1:]), np.column_stack(SWEEP[:0:-1]), rate=1000, unit="mrad")
    export_record(record, tmp_path / "run.csv", "csv")
    back = hc.read_csv(tmp_path / "run.csv")
    np.testing.assert_array_equal(back.signal("measurement").values, record.signal("measurement").values)
    np.testing.assert_array_equal(back.signal("command").values, record.signal("command").values)


@pytest.mark.parametrize(
    "header",
    [
        "time [s],output [V],input [um]",  # of the plant, or of the converters?
        "time [s],target [um],position [um]",
        "time [s],command [V],position error [um]",
        "time [s],command [V],measurement",  # in what unit?
        "sample [s],command [V],measurement [um]",
        "time [s],command [V],temperature [degC]",
    ],
)
def test_a_table_that_leaves_anything_open_is_not_guessed_at(tmp_path, header):
    path = table(tmp_path / "run.csv", header, SWEEP)
    with pytest.raises(InputError, match="leave open which is which.*try hyst import .* --columns"):
        read_bag(path)
    with pytest.raises(InputError, match=r"leave open which is which.*name them, as in command="):
        hc.read_csv(path)
    assert main(["import", str(path), "--output", str(tmp_path / "bag")]) == 2
    assert not (tmp_path / "bag").exists()


def test_the_inputs_and_outputs_of_a_converter_are_told_by_their_units(tmp_path):
    _, suggestion = listed_columns(table(tmp_path / "run.csv", "time [s],output [V],input [um]", SWEEP))
    assert suggestion == '--columns "time=1[s],command=2[V],measurement=3[um]"'


def test_a_rate_stands_for_the_times(tmp_path):
    path = table(tmp_path / "run.csv", "command [V],measurement [um]", SWEEP[1:])
    assert main(["import", str(path), "--output", str(tmp_path / "bag"), "--rate", "1000"]) == 0
    assert hc.read_csv(path, rate=1000).signal("command").time[-1] == pytest.approx(0.399)
    with pytest.raises(InputError, match="leave open"):
        hc.read_csv(path)
