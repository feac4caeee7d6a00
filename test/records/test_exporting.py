"""Exported signals, read back by other libraries: mcap's reader, scipy, pyarrow, numpy, and by `hyst import`."""

from __future__ import annotations

import numpy as np
import pytest
from mcap.reader import make_reader
from scipy.io import loadmat

from hyst_control.base.errors import InputError
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import Record, Signal
from hyst_control.records.stream.signal_message import decode
from hyst_control.records.tables.exporting import export_record, table_of
from hyst_control.records.tables.importing import import_table, parse_columns

TIME = 0.25 + 1e-3 * np.arange(50)


@pytest.fixture
def record():
    values = np.random.default_rng(1).standard_normal((50, 2))
    return Record(
        {
            "command": Signal(TIME, 50.0 + values, ("x", "y"), "V"),
            "measurement": Signal(TIME[10:], values[10:], ("x", "y"), "mrad"),
        },
        "here",
    )


def test_mcap_has_one_row_a_message_at_its_sample_time(record, tmp_path):
    export_record(record, tmp_path / "bag", "mcap")
    [file] = (tmp_path / "bag").glob("*.mcap")
    seen = {"command": [], "measurement": []}
    with open(file, "rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            label, block = decode(message.data)
            assert block.shape == (1, 3)
            assert message.log_time == round(block[0, 0] * 1e9)
            seen[channel.topic.strip("/")].append(block[0, 1:])
    for topic, signal in record.signals.items():
        np.testing.assert_array_equal(np.array(seen[topic]), signal.values)
    again = read_bag(tmp_path / "bag")
    np.testing.assert_array_equal(again.signal("measurement").values, record.signal("measurement").values)


def test_a_signal_that_is_not_there_has_an_empty_cell(record, tmp_path):
    names, table = table_of(record)
    assert names == ["time [s]", "command.x [V]", "command.y [V]", "measurement.x [mrad]", "measurement.y [mrad]"]
    assert np.isnan(table[:10, 3:]).all() and np.isfinite(table[10:]).all()
    export_record(record, tmp_path / "table.csv", "csv")
    found = np.genfromtxt(tmp_path / "table.csv", delimiter=",", skip_header=1)
    np.testing.assert_array_equal(found, table)


def test_an_exported_table_is_imported_again(record, tmp_path):
    part = record.between(TIME[10], None)
    export_record(part, tmp_path / "table.csv", "csv")
    columns = parse_columns("time=1[s],command=2+3[V],measurement=4+5[mrad]")
    again = import_table(tmp_path / "table.csv", columns, rate=None)
    for topic in ("command", "measurement"):
        np.testing.assert_array_equal(again.signal(topic).values, part.signal(topic).values)


def test_matlab_structures(record, tmp_path):
    export_record(record, tmp_path / "run.mat", "mat")
    found = loadmat(tmp_path / "run.mat", simplify_cells=True)["measurement"]
    np.testing.assert_array_equal(found["values"], record.signal("measurement").values)
    np.testing.assert_array_equal(found["time"], record.signal("measurement").time)
    assert found["unit"] == "mrad" and [axis.strip() for axis in found["axes"]] == ["x", "y"]


def test_parquet_columns(record, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    export_record(record, tmp_path / "run.parquet", "parquet")
    found = parquet.read_table(tmp_path / "run.parquet")
    names, table = table_of(record)
    assert found.column_names == names
    assert found.column("measurement.x [mrad]").null_count == 10
    np.testing.assert_array_equal(found.column("command.y [V]").to_numpy(), table[:, 2])


def test_what_cannot_be_exported_is_refused(record, tmp_path):
    with pytest.raises(InputError, match=r"xls: no form.*mcap"):
        export_record(record, tmp_path / "a.xls", "xls")
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match="exists already"):
        export_record(record, tmp_path / "bag", "mcap")
    with pytest.raises(InputError, match="no samples from 9"):
        record.between(9.0, None)
