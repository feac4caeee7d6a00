# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of any count: what is on a file is what would be in memory, and what works block by block is what works on the whole."""

from __future__ import annotations

import tempfile

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.identify.assess.fit_report import lag_one, record_rows
from hyst_control.identify.data.record_segmentation import resting_stretches, stretches_between_rests
from hyst_control.identify.data.reversal_points import turning_points
from hyst_control.model_file import Model, simulate
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import Record, Signal, increasing, sampled_record
from hyst_control.records.session_zero import without_zero
from hyst_control.records.stream import row_store
from hyst_control.records.stream.row_store import RowStore, empty_rows
from hyst_control.records.tables.importing import import_table, parse_columns, write_bag

RANDOM = np.random.default_rng(5)
COMMAND = np.where(np.arange(3000) % 400 < 130, 7.0, np.round(20.0 * np.sin(np.arange(3000) / 37.0), 1))
TIME = 1e-4 * np.arange(3000)


@pytest.fixture
def small(monkeypatch):
    """Blocks of 101 rows, and everything beyond a kilobyte on a file."""
    monkeypatch.setattr(row_store, "BLOCK", 101)
    monkeypatch.setattr(row_store, "IN_MEMORY", 1024)


def on_file(array: np.ndarray) -> bool:
    while array is not None and not isinstance(array, np.memmap):
        array = array.base
    return array is not None


@pytest.mark.parametrize("width", [None, 1, 3])
def test_a_store_gives_back_what_was_appended(small, width):
    rows = RANDOM.normal(size=(1000,) if width is None else (1000, width))
    store = RowStore(width)
    for begin in range(0, 1000, 37):
        store.append(rows[begin : begin + 37])
    found = store.array()
    np.testing.assert_array_equal(found, rows)
    assert on_file(found) and found.flags.c_contiguous
    assert RowStore(width).array().shape == ((0,) if width is None else (0, width))


def test_few_rows_stay_in_memory():
    store = RowStore(2)
    store.append(np.ones((5, 2)))
    assert not on_file(store.array()) and not on_file(empty_rows(100, 2))


def test_no_room_is_one_clear_line(small, monkeypatch):
    class Full:
        def write(self, _):
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: Full())
    with pytest.raises(InputError, match="no room for .* name a folder with more room in TMPDIR"):
        RowStore().append(np.zeros(1000))


def whole_record() -> Record:
    signals = {
        "command": Signal(TIME, COMMAND[:, None], ("x",), "V"),
        "measurement": Signal(TIME[3:], 0.1 * COMMAND[3:, None] + 0.01, ("x",), "um"),
    }
    return Record(signals, "record")


def test_a_bag_on_a_file_is_the_bag_in_memory(tmp_path, monkeypatch):
    write_bag(tmp_path / "bag", whole_record())
    held = read_bag(tmp_path / "bag").aligned()[0]
    monkeypatch.setattr(row_store, "BLOCK", 101)
    monkeypatch.setattr(row_store, "IN_MEMORY", 1024)
    stored = read_bag(tmp_path / "bag").aligned()[0]
    for topic in ("command", "measurement"):
        np.testing.assert_array_equal(stored.signal(topic).values, held.signal(topic).values)
        assert on_file(stored.signal(topic).values) and not on_file(held.signal(topic).values)
    np.testing.assert_array_equal(stored.time, held.time)
    assert len(held.time) == 2997


def test_consecutive_ticks_are_aligned_as_any_others_are(monkeypatch):
    """The short way, which copies nothing, against the long one."""
    record = whole_record()
    short = record.aligned()
    monkeypatch.setattr(Signal, "consecutive_ticks", lambda *_: None)
    [long] = record.aligned()
    np.testing.assert_array_equal(short[0].command, long.command)
    np.testing.assert_array_equal(short[0].measurement, long.measurement)
    np.testing.assert_array_equal(short[0].time, long.time)


def test_a_table_on_a_file_is_the_table_in_memory(tmp_path, monkeypatch):
    table = np.column_stack([COMMAND, 0.1 * COMMAND])
    np.save(tmp_path / "table.npy", table)
    np.savetxt(tmp_path / "table.csv", table, fmt="%.17g", delimiter=",", header="drive,position", comments="")
    columns = parse_columns("command=1[V],measurement=2[nm]")
    held = [import_table(tmp_path / name, columns, 1e4) for name in ("table.npy", "table.csv")]
    monkeypatch.setattr(row_store, "BLOCK", 101)
    monkeypatch.setattr(row_store, "IN_MEMORY", 1024)
    for name, expected in zip(("table.npy", "table.csv"), held, strict=True):
        found = import_table(tmp_path / name, columns, 1e4)
        for topic, signal in expected.signals.items():
            np.testing.assert_array_equal(found.signals[topic].values, signal.values)
            np.testing.assert_array_equal(found.signals[topic].time, signal.time)
            assert on_file(found.signals[topic].values)


def test_what_works_block_by_block_finds_what_the_whole_has(monkeypatch):
    model = Model("m", ("x",), {"command": "V", "measurement": "um"}, 1e-4, Chain((PrandtlIshlinskii([1.0, 4.0], [0.2, 0.1]),)))
    data = sampled_record(
        "d", COMMAND[:, None], 0.3 * COMMAND[:, None] + RANDOM.normal(size=(3000, 1)), 1e-4, ("x",), "um", start="settled"
    )

    def findings():
        return (
            turning_points(COMMAND).tolist(),
            resting_stretches(COMMAND, 20),
            stretches_between_rests(data, 0, 0),
            simulate(model, data.command).tolist(),
        )

    def figures():
        row = record_rows(model, [data])[0][0]
        rest, coefficients = without_zero(data.measurement)
        return [row["rmse"], row["nrmse_centered"], row["nme"], lag_one(data.measurement[:, 0]), *coefficients[0], *rest[:, 0]]

    whole, numbers = findings(), figures()
    monkeypatch.setattr(row_store, "BLOCK", 101)
    assert findings() == whole
    np.testing.assert_allclose(figures(), numbers, rtol=1e-12, atol=1e-12)
    assert increasing(TIME) and not increasing(COMMAND) and not increasing(np.zeros(300)) and increasing(np.zeros(300), equal=True)
    assert not increasing(np.concatenate([TIME[:101], TIME[100:]]))


def test_turning_points_are_those_of_the_definition(small):
    slope = np.sign(np.diff(COMMAND))
    moving = np.flatnonzero(slope)
    turns = moving[1:][slope[moving[1:]] != slope[moving[:-1]]]
    np.testing.assert_array_equal(turning_points(COMMAND), np.concatenate([[0], turns]))
