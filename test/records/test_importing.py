# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Foreign recordings: what comes out is what is in the file, in the record's units; what is unusable is named."""

import gzip

import numpy as np
import pytest
from scipy.io import savemat

from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.identify.workflow import gapless_records
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.tables.importing import import_records, import_table, parse_columns

VOLTS = np.linspace(0.0, 5000.0, 40)
NANOMETRES = np.sqrt(VOLTS)


def written(tmp_path, kind):
    path = tmp_path / f"run.{kind}"
    both = np.stack([VOLTS, NANOMETRES], axis=1)
    if kind == "csv":
        path.write_text("drive,pos\n" + "\n".join(f"{u!r},{y!r}" for u, y in both.tolist()))
    elif kind == "dat.gz":
        with gzip.open(path, "wt") as file:
            np.savetxt(file, both, fmt="%.17g")
    elif kind == "npy":
        np.save(path, both)
    elif kind == "npz":
        np.savez(path, drive=VOLTS, pos=NANOMETRES)
    else:
        savemat(path, {"drive": VOLTS, "pos": NANOMETRES})
    return path


@pytest.mark.parametrize("kind", ["csv", "dat.gz", "npy", "npz", "mat"])
def test_every_format_gives_the_same_record(tmp_path, kind):
    names = "command=drive[mV],measurement=pos[nm]" if kind in ("csv", "npz", "mat") else "command=1[mV],measurement=2[nm]"
    record = import_table(written(tmp_path, kind), parse_columns(names), 1000.0)
    np.testing.assert_allclose(record.signals["command"].values[:, 0], VOLTS * 1e-3, rtol=1e-15)
    np.testing.assert_allclose(record.signals["measurement"].values[:, 0], NANOMETRES * 1e-3, rtol=1e-15)
    assert record.signals["measurement"].unit == "um" and record.signals["command"].time[-1] == pytest.approx(0.039)


@pytest.mark.parametrize(
    "text, encoding",
    [
        ("Model,XYZ\nSample Interval,0.001\nPoints\n1000\n\nTIME,CH1,CH2\n0,1,2\n1,3,4\n", "utf-8"),
        ("TIME,CH1,CH2\n(s),(V),(um)\n\n0,1,2\n1,3,4\n", "utf-8"),
        ("TIME;CH1;CH2\n[s];[V];[µm]\n0,0;1,0;2,0\n1,0;3,0;4,0\n", "cp1252"),
        ("Stage 4, second unit\nTIME\tCH1\tCH2\n0\t1\t2\n1\t3\t4\n", "utf-8"),
    ],
    ids=["settings", "units", "decimal commas", "title"],
)
def test_what_instruments_write_around_the_names(tmp_path, text, encoding):
    path = tmp_path / "scope.csv"
    path.write_bytes(text.encode(encoding))
    record = import_table(path, parse_columns("time=TIME[s],command=CH1[V],measurement=CH2[um]"), None)
    np.testing.assert_array_equal(record.signals["command"].values[:, 0], [1, 3])
    np.testing.assert_array_equal(record.signals["measurement"].values[:, 0], [2, 4])
    np.testing.assert_array_equal(record.signals["measurement"].time, [0, 1])


def test_several_axes_and_rows(tmp_path):
    np.save(tmp_path / "fsm.npy", np.arange(120.0).reshape(10, 3, 4))
    record = import_table(tmp_path / "fsm.npy", parse_columns("measurement=1+5[rad]"), 10.0, (2, 6))
    signal = record.signals["measurement"]
    assert signal.axes == ("x", "y") and signal.unit == "mrad"
    np.testing.assert_array_equal(signal.values, 1e3 * np.arange(120.0).reshape(10, 12)[2:6][:, [0, 4]])


@pytest.mark.parametrize(
    ("unit", "due"), [("5um/V", 5.0), ("5 um / V", 5.0), ("-2.5e3 nm/V", -2.5), (".5*um", 0.5), ("1um", 1.0), ("um", 1.0)]
)
def test_a_sensitivity_stands_before_the_unit(tmp_path, unit, due):
    path = tmp_path / "volts.csv"
    path.write_text("1,2\n3,-4\n")
    record = import_table(path, parse_columns(f"command=1[V],measurement=2[{unit}]"), 10.0)
    assert record.signals["measurement"].unit == "um" and not record.notes
    np.testing.assert_allclose(record.signals["measurement"].values[:, 0], [2 * due, -4 * due], rtol=1e-15)


def test_a_measurement_in_volts_is_told(tmp_path):
    path = tmp_path / "volts.csv"
    path.write_text("1,2\n3,4\n")
    record = import_table(path, parse_columns("command=1[V],measurement=2[V]"), 10.0)
    assert any("[5um/V]" in note for note in record.notes)


@pytest.mark.parametrize(
    "columns, rate, text, words",
    [
        ("command=3[V]", 10.0, "1,2\n3,4", "column 3 of 2"),
        ("command=drive[V]", 10.0, "u,y\n3,4", "no column 'drive': u, y"),
        ("command=2[V]", 10.0, "1,2\n3,four", "line 2, column 2: 'four' is no number"),
        ("command=1[V]", 10.0, "1,2\n3\n4,5", "line 2 has 1 columns, the first has 2"),
        ("command=1[V]", 10.0, "1,2\na,b\n3,4\n5,6", "line 2, column 1: 'a' is no number"),
        ("command=1[V]", 10.0, "u,y\n1,2\na,b\n3,4\n5,6", "line 3, column 1: 'a' is no number"),
        ("command=1[V]", 10.0, "u,y\nx,2\n3,4\n5,6", "line 2, column 1: 'x' is no number"),
        ("command=1[V]", 10.0, "1,2\nnan,4", "row 1 holds no finite number"),
        ("command=1[V]", 0.0, "1,2", "rate: 0.0 Hz"),
        ("command=1[V]", 10.0, "", "holds no rows"),
        ("command=1[furlong]", 10.0, "1,2", "unit 'furlong' is not known"),
        ("command=1[0um]", 10.0, "1,2", "must be finite and not 0"),
        ("command:1", 10.0, "1,2", "topic=column\\[unit\\]"),
    ],
)
def test_unusable_files_are_named(tmp_path, columns, rate, text, words):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        import_table(path, parse_columns(columns), rate)


def test_a_signalling_nan_is_named_as_any_other(tmp_path):
    table = np.array([[1.0, 2.0], [3.0, 4.0]])
    table.view(np.uint64)[1, 1] = 0x7FF0000000000001
    np.save(tmp_path / "bad.npy", table)
    with pytest.raises(InputError, match="row 1 holds no finite number"):
        import_table(tmp_path / "bad.npy", parse_columns("command=1[V],measurement=2[nm]"), 10.0)


def test_the_measured_stack_becomes_a_bag_and_is_fitted(tmp_path, measured_data, capsys):
    """`hyst import` and `hyst identify` on a measured record, one cycle; scored on nested loops of another: at most 3.5 %."""
    files = [measured_data / "pea_p885" / name for name in ("Model_Vi_Do.dat", "Test_Vi_Do_Di.dat")]
    columns = "command=1[V],measurement=5[um]"
    for file, bag, rows in ((files[0], "cycle", "2005:2206"), (files[1], "nested", "5:14150")):
        assert (
            main(
                [
                    "import",
                    str(file),
                    "--output",
                    str(tmp_path / bag),
                    "--columns",
                    columns,
                    "--rate",
                    "200",
                    "--rows",
                    rows,
                    "--hold",
                    "foh",
                ]
            )
            == 0
        )
    model = tmp_path / "model.yaml"
    assert main(["identify", str(tmp_path / "cycle"), "--model", "hampi", "--output", str(model), "--start", "unknown"]) == 0
    from hyst_control.model_file import load_model, simulate

    data = gapless_records(read_bag(tmp_path / "nested"))[0]
    assert data.hold == "foh"
    error = (simulate(load_model(model), data.command, data.sample_time, "foh") - data.measurement)[7945:]
    assert np.std(error) / np.ptp(data.measurement[7945:]) < 0.035


def test_one_line_and_status_2_and_nothing_left_behind(tmp_path, capsys):
    before = set(tmp_path.iterdir())
    assert (
        main(["import", str(tmp_path / "no.csv"), "--output", str(tmp_path / "bag"), "--columns", "command=1[V]", "--rate", "1"])
        == 2
    )
    assert main(["identify", str(tmp_path / "bag"), "--model", "hampi", "--output", str(tmp_path / "m.yaml")]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 2 and all(line.startswith("hyst ") for line in lines) and set(tmp_path.iterdir()) == before


def test_rows_that_a_column_of_times_passes_over_are_told(tmp_path):
    time = np.delete(np.arange(100) / 50.0, [10, 11, 40])
    np.savetxt(tmp_path / "run.csv", np.column_stack([time, time, time]), delimiter=",")
    columns = parse_columns("time=1[s],command=2[V],measurement=3[um]")
    words = "3 rows are missing, in 2 gaps, the first after 0.18 s"
    with pytest.raises(InputError, match=f"{words}: --resample interpolates them, --allow-gaps"):
        import_table(tmp_path / "run.csv", columns, None)
    [kept] = import_records(tmp_path / "run.csv", columns, None, allow_gaps=True)
    assert words in kept.notes[0] and [len(part.time) for part in kept.aligned(["measurement"], allow_gaps=True)] == [10, 28, 59]
    [filled] = import_records(tmp_path / "run.csv", columns, None, resample=0.0)
    np.testing.assert_allclose(filled.signals["measurement"].values[:, 0], np.arange(100) / 50.0, atol=1e-12)
    np.savetxt(tmp_path / "whole.csv", np.column_stack([np.arange(50) / 50.0] * 3), delimiter=",")
    assert import_table(tmp_path / "whole.csv", columns, None).notes == ()
