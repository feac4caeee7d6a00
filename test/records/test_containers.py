# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Arrays within structures, rows of matrices, and the containers of other programs, against what was written into them."""

import json
import zipfile

import numpy as np
import pytest
from scipy.io import savemat

from hyst_control.base.errors import InputError
from hyst_control.records.tables.array_files import read_arrays
from hyst_control.records.tables.importing import import_records, import_table, parse_columns
from hyst_control.records.tables.listing import listed_columns
from hyst_control.records.tables.selection import read_columns

TIME = np.arange(64) * 1e-3
DRIVE, MOVED = np.sin(TIME * 100.0), np.cos(TIME * 100.0)
RUNS = np.zeros(2, dtype=[("E", object), ("P", object)])
RUNS[1] = (DRIVE[:, None], MOVED[:, None])
RUNS[0] = (np.zeros(3), np.zeros(3))
CONTENT = {
    "data": np.vstack([DRIVE, MOVED]),
    "rec": {"u": DRIVE[:, None], "y": MOVED[:, None], "note": "stage"},
    "log": {"day1": {"drive": {"u": DRIVE}, "sensor": {"y": MOVED}}, "id": 7.0},
    "out": {"time": TIME[:, None], "signals": {"values": np.column_stack([DRIVE, MOVED]), "label": "scope"}},
    "runs": RUNS,
}


@pytest.mark.parametrize(
    ("columns", "packed"),
    [
        ("command=data(1,:)[V],measurement=data(2,:)[um]", False),
        ("command=rec.u[V],measurement=rec.y[um]", True),
        ("command=log.day1.drive.u[V],measurement=log/day1/sensor/y[um]", False),
        ("time=out.time[s],command=out.signals.values(:,1)[V],measurement=out.signals.values(:,2)[um]", True),
        ("command=runs(2).E[V],measurement=runs(2).P[um]", False),
    ],
)
def test_structures_of_matlab_by_path(tmp_path, columns, packed):
    savemat(tmp_path / "run.mat", CONTENT, do_compression=packed)
    record = import_table(tmp_path / "run.mat", parse_columns(columns), None if "time" in columns else 1000.0)
    np.testing.assert_array_equal(record.signals["command"].values[:, 0], DRIVE)
    np.testing.assert_array_equal(record.signals["measurement"].values[:, 0], MOVED)
    assert record.common_step(["command"]) == pytest.approx(1e-3)


@pytest.mark.parametrize("kind", [".mat", ".npz", ".npy"])
def test_a_wide_matrix_is_not_taken_for_axes(tmp_path, kind):
    path = tmp_path / f"run{kind}"
    wide = np.vstack([DRIVE, MOVED])
    savemat(path, {"data": wide}) if kind == ".mat" else np.savez(path, data=wide) if kind == ".npz" else np.save(path, wide)
    name = "" if kind == ".npy" else "data"
    with pytest.raises(InputError, match=rf"is 2 x 64: its signals lie in its rows: name them as in command={name}\(1,:\)"):
        import_table(path, parse_columns("command=1[V],measurement=2[um]"), 1e3)
    record = import_table(path, parse_columns(f"command={name}(1,:)[V],measurement={name}(2,:)[um]"), 1e3)
    np.testing.assert_array_equal(record.signals["measurement"].values[:, 0], MOVED)
    with pytest.raises(InputError, match="has 2 rows: number them from 1"):
        import_table(path, parse_columns(f"command={name}(3,:)[V]"), 1e3)


def test_cells_of_matlab(tmp_path):
    cells = np.empty((1, 3), object)
    cells[0, :] = TIME, DRIVE, MOVED
    numbers = np.empty((1, 64), object)
    numbers[0, :] = MOVED.tolist()
    savemat(tmp_path / "run.mat", {"log": cells, "each": numbers})
    for columns in (
        "time=log{1}[s],command=log{2}[V],measurement=log(3)[um]",
        "time=log(1)[s],command=log(2)[V],measurement=each[um]",
    ):
        record = import_table(tmp_path / "run.mat", parse_columns(columns), None)
        np.testing.assert_array_equal(record.signals["command"].values[:, 0], DRIVE)
        np.testing.assert_array_equal(record.signals["measurement"].values[:, 0], MOVED)


@pytest.mark.parametrize("kind", ["npz", "npy"])
def test_tables_and_moments_of_numpy(tmp_path, kind):
    moments = np.datetime64("2026-11-28T23:59:59.99") + (TIME * 1e6).round().astype("m8[us]")
    table = np.rec.fromarrays([moments, DRIVE, MOVED], names="t,u,y")
    path, rec = tmp_path / f"run.{kind}", "rec." if kind == "npz" else ""
    np.save(path, table) if kind == "npy" else np.savez(path, rec=table, when=moments)
    columns = f"time={'when' if rec else 't'}[s],command={rec}u[V],measurement={rec}y[um]"
    record = import_table(path, parse_columns(columns), None)
    np.testing.assert_allclose(record.signals["command"].time, TIME, atol=1e-9)
    np.testing.assert_array_equal(record.signals["measurement"].values[:, 0], MOVED)


def test_an_object_of_matlab_is_told_as_one(tmp_path, monkeypatch):
    """SciPy cannot write one: what it makes of one when it reads."""
    from scipy.io.matlab import MatlabOpaque

    kind = np.dtype([("s0", object), ("s1", object), ("s2", object), ("arr", object)])
    found = np.array([(b"T", b"MCOS", b"timetable", np.zeros(3))], dtype=kind)
    savemat(tmp_path / "run.mat", {"a": 1.0})
    monkeypatch.setattr("scipy.io.loadmat", lambda *_, **__: {"__header__": b"", "None": MatlabOpaque(found)})
    with pytest.raises(InputError, match=r"T is a MATLAB object \(timetable\): only MATLAB reads it: save its columns there"):
        read_arrays(tmp_path / "run.mat", ".mat", in_child=True)


def test_parquet_by_name_and_by_number(tmp_path):
    arrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    stamps = (1_700_000_000_000_000_000 + np.arange(64) * 1_000_000).astype("M8[ns]")
    table = arrow.table({"t": stamps, "u [mV]": DRIVE, "y": MOVED.astype(np.float32), "who": ["x"] * 64})
    parquet.write_table(table, tmp_path / "run.parquet")
    for columns in ("time=t[s],command=u[mV],measurement=y[um]", "time=1[s],command=2[mV],measurement=3[um]"):
        record = import_table(tmp_path / "run.parquet", parse_columns(columns), None)
        np.testing.assert_allclose(record.signals["command"].values[:, 0], DRIVE * 1e-3)
        np.testing.assert_allclose(record.signals["measurement"].time, TIME, atol=1e-12)
    assert "time=t[s],command=u" in listed_columns(tmp_path / "run.parquet")[1]
    whole = (tmp_path / "run.parquet").read_bytes()
    rng = np.random.default_rng(0)
    for number in range(60):
        spoilt = bytearray(whole)
        for _ in range(4):
            spoilt[rng.integers(len(spoilt))] = rng.integers(256)
        (tmp_path / "spoilt.parquet").write_bytes(spoilt[: None if number % 2 else rng.integers(len(spoilt))])
        try:
            import_table(tmp_path / "spoilt.parquet", parse_columns("command=u[V],measurement=y[um]"), 1e3)
        except InputError as error:
            assert "\n" not in str(error) and "spoilt.parquet" in str(error)


def test_a_table_with_names_in_hdf5(tmp_path):
    h5py = pytest.importorskip("h5py")
    table = np.zeros(64, dtype=[("t", "f8"), ("u", "f4"), ("y", "f8"), ("who", "S3")])
    table["t"], table["u"], table["y"] = TIME, DRIVE, MOVED
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["day/log"] = table
    assert (
        listed_columns(tmp_path / "run.h5")[1]
        == '--columns "time=day.log.t[s],command=day.log.u[UNIT],measurement=day.log.y[UNIT]"'
    )
    with h5py.File(tmp_path / "empty.h5", "w") as file:
        file["note"] = "nothing"
    with pytest.raises(InputError, match="empty.h5: holds no columns of numbers"):
        listed_columns(tmp_path / "empty.h5")


JSON = {
    "lists": {"t": TIME.tolist(), "loop": {"u": DRIVE.tolist(), "y": MOVED.tolist()}, "who": "x", "tags": ["a", "b"]},
    "rows": [{"t": t, "loop": {"u": u}, "note": None, "y": y} for t, u, y in zip(TIME, DRIVE, MOVED, strict=True)],
}


@pytest.mark.parametrize(
    ("ending", "text"),
    [
        (".json", json.dumps(JSON["lists"])),
        (".json", json.dumps(JSON["rows"])),
        (".jsonl", "".join(f"{json.dumps(row)}\n" for row in JSON["rows"])),
    ],
)
def test_json_by_path(tmp_path, ending, text):
    path = tmp_path / f"run{ending}"
    path.write_text(text)
    lines, suggestion = listed_columns(path)
    moved = "loop.y" if any(line.startswith("  loop.y: 64 rows") for line in lines) else "y"
    assert suggestion == f'--columns "time=t[s],command=loop.u[UNIT],measurement={moved}[UNIT]"'
    record = import_table(path, parse_columns(suggestion.split('"')[1].replace("UNIT", "V")), None)
    np.testing.assert_array_equal(record.signals["command"].values[:, 0], DRIVE)
    np.testing.assert_array_equal(record.signals["measurement"].values[:, 0], MOVED)


def universal(name, values, kind="58", spacing=1, form="{:13.5e}", per_line=6):
    """A dataset of a universal file as the definition of type 58 has it."""
    numbers = values if spacing else np.column_stack([TIME, values]).ravel()
    cells = [form.format(value) for value in numbers]
    rows = ["".join(cells[at : at + per_line]) for at in range(0, len(cells), per_line)]
    type_of_numbers = 2 if form == "{:13.5e}" else 4
    head = [f"{kind:>6}", name, *["NONE"] * 4, "    1         0    0         0       NONE         1   3       NONE         0   0"]
    head += [f"{type_of_numbers:10d}{len(values):10d}{spacing:10d}  0.00000e+00  1.00000e-03  0.00000e+00"]
    head += ["        17    0    0    0 Time                 s                   "] + [
        "         8    0    0    0 NONE                 V"
    ] * 3
    return "\n".join(["    -1", *head, *rows, "    -1", ""])


@pytest.mark.parametrize("form", [("{:13.5e}", 6), ("{:20.12e}", 4)])
@pytest.mark.parametrize("spacing", [1, 0])
def test_a_universal_file(tmp_path, form, spacing):
    path = tmp_path / "run.uff"
    other = "    -1\n   151\nmodel\n    -1\n"
    path.write_text(other + universal("drive", DRIVE, "58", spacing, *form) + universal("sensor", MOVED, "58", spacing, *form))
    time = "" if spacing else "time=drive.time[s],"
    assert listed_columns(path)[1] == f'--columns "{time}command=drive[UNIT],measurement=sensor[UNIT]"'
    record = import_table(path, parse_columns(f"{time}command=drive[V],measurement=sensor[um]"), None)
    np.testing.assert_allclose(record.signals["command"].values[:, 0], DRIVE, atol=6e-6)
    np.testing.assert_allclose(record.signals["measurement"].values[:, 0], MOVED, atol=6e-6)
    assert record.common_step(["command"]) == pytest.approx(1e-3)
    path.write_text(universal("drive", DRIVE, "58b"))
    with pytest.raises(InputError, match="run.uff.*binary datasets"):
        listed_columns(path)
    path.write_text("    -1\n    58\ncut off\n")
    with pytest.raises(InputError, match="run.uff"):
        listed_columns(path)


def test_a_workbook(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["made", "by hand"])
    sheet = book.create_sheet("Data")
    for row in [["t [s]", "u", "y"], *np.column_stack([TIME, DRIVE, MOVED]).tolist()]:
        sheet.append(row)
    book.save(tmp_path / "run.xlsx")
    record = import_table(tmp_path / "run.xlsx", parse_columns("time=t[s],command=u[V],measurement=y[um]"), None)
    np.testing.assert_allclose(record.signals["measurement"].values[:, 0], MOVED, rtol=1e-14)
    with pytest.raises(InputError, match="has no sheet Other: name one of Sheet, Data"):
        import_records(tmp_path / "run.xlsx", parse_columns("command=u[V]"), 1e3, variable="Other")
    with zipfile.ZipFile(tmp_path / "bomb.xlsx", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/workbook.xml", bytes(100 * 2**20))
    with pytest.raises(InputError, match="expands to more than"):
        import_table(tmp_path / "bomb.xlsx", parse_columns("command=u[V]"), 1e3)


def test_hdf5_and_what_matlab_writes_with_it(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["log/u"], file["log/y"] = DRIVE, MOVED
        file["table"] = np.column_stack([TIME, DRIVE, MOVED])
        turned = file.create_dataset("u", data=DRIVE[None])
        turned.attrs["MATLAB_class"] = np.bytes_("double")
        file.create_dataset("bomb", shape=(2**40,), dtype="f8", chunks=(2**20,), compression="gzip")
        del file["bomb"]
    record = import_table(tmp_path / "run.h5", parse_columns("command=u[V],measurement=log/y[um]"), 1e3)
    np.testing.assert_array_equal(record.signals["command"].values[:, 0], DRIVE)
    np.testing.assert_array_equal(record.signals["measurement"].values[:, 0], MOVED)
    with h5py.File(tmp_path / "bomb.h5", "w") as file:
        file.create_dataset("bomb", shape=(2**40,), dtype="f8", chunks=(2**20,), compression="gzip")
    with pytest.raises(InputError, match="expands to more than"):
        import_table(tmp_path / "bomb.h5", parse_columns("command=bomb[V]"), 1e3)


def test_tdms_with_its_increment(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    channels = [
        nptdms.ChannelObject("log", name, values, properties={"wf_increment": 1e-3})
        for name, values in (("u", DRIVE), ("y", MOVED))
    ]
    with nptdms.TdmsWriter(tmp_path / "run.tdms") as writer:
        writer.write_segment(channels)
    record = import_table(tmp_path / "run.tdms", parse_columns("command=log.u[V],measurement=log.y[um]"), None)
    np.testing.assert_array_equal(record.signals["measurement"].values[:, 0], MOVED)
    assert "states 1000 samples/s" in record.notes[0]


@pytest.mark.parametrize("name, words", [("a.xls", "old Excel workbook: save it as .xlsx"), ("a.ods", "OpenDocument")])
def test_containers_that_are_not_read_are_named(tmp_path, name, words):
    (tmp_path / name).write_bytes(b"\xd0\xcf\x11\xe0")
    with pytest.raises(InputError, match=words):
        import_table(tmp_path / name, parse_columns("command=1[V]"), 1e3)


def test_a_column_of_an_array_is_no_copy_of_it(tmp_path):
    """An hour at 50 kHz took 2.8 GB: its columns were copied."""
    np.save(tmp_path / "table.npy", np.arange(40.0).reshape(20, 2))
    columns = read_columns(tmp_path / "table.npy", ["1", "2"]).columns
    assert np.may_share_memory(columns["1"], columns["2"])  # both lie in the table
    np.testing.assert_array_equal(columns["2"], np.arange(1.0, 40.0, 2.0)[:, None])
