# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Bags into records: what is read back, what is refused, and what is said of damaged ones."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from hyst_control.base.errors import InputError
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.record import Record, Signal
from hyst_control.records.stream.signal_message import MESSAGE_TYPE, Encoder, label_for
from hyst_control.records.tables.importing import write_bag

STORE = get_typestore(Stores.ROS2_JAZZY)
STEP = 1e-4


def record(samples: int = 200, axes: tuple[str, ...] = ("x",), **changes: Signal) -> Record:
    rng = np.random.default_rng(samples)
    time = np.arange(samples) * STEP
    signals = {
        "command": Signal(time, rng.normal(size=(samples, len(axes))), axes, "V"),
        "measurement": Signal(time, rng.normal(size=(samples, len(axes))), axes, "um"),
        **changes,
    }
    return Record(signals, "made")


def foreign_bag(
    path: Path, plugin: StoragePlugin, layout: bool, topics: tuple[str, ...] = ("/command", "/measurement")
) -> np.ndarray:
    """A bag written by rosbags from message objects, one row per message."""
    message, dimension, form = (
        STORE.types[f"std_msgs/msg/{name}"] for name in ("Float64MultiArray", "MultiArrayDimension", "MultiArrayLayout")
    )
    values = np.random.default_rng(0).normal(size=50)
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic in topics:
            connection = writer.add_connection(topic, MESSAGE_TYPE, typestore=STORE)
            unit = "V" if "command" in topic else "um"
            for k, value in enumerate(values):
                row = [k * STEP, value] if layout else [value]
                dims = [dimension(label="sample", size=1, stride=2), dimension(label=label_for(("x",), unit), size=2, stride=2)]
                data = message(layout=form(dim=dims if layout else [], data_offset=0), data=np.array(row))
                writer.write(connection, 1_000_000_000 + int(k * STEP * 1e9), STORE.serialize_cdr(data, MESSAGE_TYPE))
    return values


@settings(max_examples=25, deadline=None)
@given(
    values=arrays.arrays(
        np.float64, st.tuples(st.integers(2, 130), st.integers(1, 3)), elements=st.floats(-1e6, 1e6, allow_nan=False)
    )
)
def test_what_is_written_is_read_back(tmp_path_factory, values):
    axes = ("x", "y", "z")[: values.shape[1]]
    time = np.arange(len(values)) * STEP
    path = tmp_path_factory.mktemp("bag") / "bag"
    write_bag(
        path, Record({"command": Signal(time, values, axes, "V"), "measurement": Signal(time, -values, axes, "mrad")}, "made")
    )
    read = read_bag(path)
    for topic, sign in (("command", 1), ("measurement", -1)):
        signal = read.signals[topic]
        np.testing.assert_array_equal(signal.values, sign * values)
        np.testing.assert_array_equal(signal.time, time)
        assert signal.axes == axes and signal.timing == "layout"
    assert read.aligned()[0].sample_time == STEP


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("layout", [True, False])
def test_bags_of_other_writers(tmp_path, plugin, layout):
    values = foreign_bag(tmp_path / "foreign.bag", plugin, layout)
    read = read_bag(tmp_path / "foreign.bag", unit="um")
    part = read.aligned()[0]
    np.testing.assert_array_equal(part.measurement[:, 0], values)
    assert part.sample_time == pytest.approx(STEP) and (part.command_unit, part.unit) == ("V", "um")
    assert read.signals["command"].timing == ("layout" if layout else "receive")
    assert bool(read.notes) == (not layout)


def test_our_bags_open_in_rosbags(tmp_path):
    write_bag(tmp_path / "bag", record(120))
    with AnyReader([tmp_path / "bag"], default_typestore=STORE) as reader:
        rows = [
            STORE.deserialize_cdr(raw, MESSAGE_TYPE)
            for connection, _, raw in reader.messages()
            if connection.topic == "/measurement"
        ]
    assert rows[0].layout.dim[1].label == "t[s],x[um]"
    np.testing.assert_array_equal(np.concatenate([row.data for row in rows])[1::2], record(120).signals["measurement"].values[:, 0])


def test_a_killed_recorder_leaves_a_readable_prefix(tmp_path):
    """A process that is killed while it writes: everything up to its last whole chunk is read, and the record says so."""
    path = tmp_path / "killed"
    code = f"""
import numpy as np, os, signal
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.stream.signal_message import Encoder
writer = BagWriter({str(path)!r})
encoders = {{"/command": Encoder("t[s],x[V]"), "/measurement": Encoder("t[s],x[um]")}}
for k in range(2000):
    for topic, encoder in encoders.items():
        writer.write(topic, encoder.encode(np.array([[k * 1e-4, k]])), k)
os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    read = read_bag(path)
    assert len(read.notes) == 1 and "no footer" in read.notes[0] and "whole chunk" in read.notes[0]
    signal = read.signals["measurement"]
    assert len(signal.time) > 1700
    np.testing.assert_array_equal(signal.values[:, 0], np.arange(len(signal.time)))


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.9, 0.999])
def test_a_bag_cut_anywhere_gives_a_prefix_or_one_clear_line(tmp_path, share):
    write_bag(tmp_path / "bag", record(3000))
    file = next((tmp_path / "bag").glob("*.mcap"))
    whole = file.read_bytes()
    file.write_bytes(whole[: int(share * len(whole))])
    (tmp_path / "bag" / "metadata.yaml").unlink()
    try:
        read = read_bag(tmp_path / "bag")
    except InputError as error:
        assert share < 0.1 and "\n" not in str(error) and str(file) in str(error)
    else:
        signal = read.signals["command"]
        np.testing.assert_array_equal(signal.values, record(3000).signals["command"].values[: len(signal.values)])
        assert read.notes


def test_steps_of_next_to_nothing_are_no_sample_time():
    times = Signal(np.array([0.0, 0.0, 2.3e-313, 1.0]), np.zeros((4, 1)), ("x",), "V", "layout")
    with np.errstate(all="raise", under="ignore"), pytest.raises(InputError, match="sample time 0 s"):
        Record({"command": times, "measurement": times}, "made").aligned()


@pytest.mark.parametrize(
    "change, words",
    [
        ({"command": Signal(np.arange(200) * STEP, np.full((200, 1), np.nan), ("x",), "V")}, "200 of 200 samples are NaN"),
        ({"measurement": Signal(np.arange(1) * STEP, np.zeros((1, 1)), ("x",), "um")}, "1 sample, at least two"),
        ({"measurement": Signal(np.arange(200) * 3 * STEP, np.zeros((200, 1)), ("x",), "um")}, "sample time 0.0003 s"),
        ({"measurement": Signal(5 + np.arange(200) * STEP, np.zeros((200, 1)), ("x",), "um")}, "share no sample time"),
    ],
)
def test_unusable_signals_are_named(change, words):
    with pytest.raises(InputError, match=words):
        record(200, **change).aligned()


def test_lost_samples_are_found_and_cut_out():
    kept = np.r_[0:80, 90:200]
    whole = record(200)
    lossy = Signal(whole.signals["command"].time[kept], whole.signals["command"].values[kept], ("x",), "V")
    with pytest.raises(InputError, match="10 ticks are missing in 1 gaps, the first before t = 0.009 s"):
        record(200, command=lossy).aligned()
    parts = record(200, command=lossy).aligned(allow_gaps=True)
    assert [len(part.time) for part in parts] == [80, 110]
    np.testing.assert_array_equal(parts[1].measurement, whole.signals["measurement"].values[90:])


def test_gapless_parts_are_records_again():
    """They keep what is known of their record, know how they begin, and are their own gapless parts."""
    kept = np.r_[0:80, 90:200]
    whole = record(200, axes=("x", "y"))
    lossy = whole.signals["command"]
    lossy = Signal(lossy.time[kept], lossy.values[kept], lossy.axes, "V")
    gappy = replace(whole, signals={**whole.signals, "command": lossy}, hold="foh", start="settled")
    parts = gappy.aligned(allow_gaps=True)
    assert [(part.name, part.start, part.hold) for part in parts] == [("made", "settled", "foh"), ("made[1]", "unknown", "foh")]
    assert all(part.is_gapless for part in parts) and not gappy.is_gapless
    for part, rows in zip(parts, (slice(0, 80), slice(90, 200)), strict=True):
        assert (part.axes, part.unit, part.command_unit, part.sample_time) == (("x", "y"), "um", "V", STEP)
        [again] = part.aligned()
        for each in (part, again):
            np.testing.assert_array_equal(each.command, whole.command[rows])
            np.testing.assert_array_equal(each.time, np.arange(len(each)) * STEP)
    cut = parts[0].rows(10, 30).with_values(measurement=np.zeros((20, 2)))
    assert cut.start == "unknown" and len(cut) == 20 and not cut.measurement.any() and cut.is_gapless
    np.testing.assert_array_equal(cut.command, whole.command[10:30])
    known = whole.between(20.5 * STEP, None)
    np.testing.assert_array_equal(known.start.memory, whole.command[:21])
    np.testing.assert_array_equal(known.between(30.5 * STEP, None).start.memory, whole.command[:31])  # the memory before is kept
    assert whole.between(None, 20.5 * STEP).start == "auto" and gappy.between(150.5 * STEP, None).start == "unknown"


def test_repeated_messages_count_once_and_contradicting_ones_are_refused(tmp_path):
    encoder = Encoder("t[s],x[V]")
    for name, second in (("same", 1.0), ("other", 2.0)):
        with BagWriter(tmp_path / name) as writer:
            for time, value in ((0.0, 0.0), (STEP, 1.0), (STEP, second), (2 * STEP, 3.0)):
                writer.write("/command", encoder.encode(np.array([[time, value]])), 0)
    assert read_bag(tmp_path / "same").signals["command"].values[:, 0].tolist() == [0.0, 1.0, 3.0]
    with pytest.raises(InputError, match="two different rows of one sample time"):
        read_bag(tmp_path / "other")


def test_namespaces(tmp_path):
    foreign_bag(tmp_path / "two", StoragePlugin.MCAP, True, ("/left/command", "/right/command", "/left/measurement"))
    with pytest.raises(InputError, match="/left/command and /right/command are both a command"):
        read_bag(tmp_path / "two")
    assert set(read_bag(tmp_path / "two", namespace="left").signals) == {"command", "measurement"}
    with pytest.raises(InputError, match="no topic in the namespace 'middle'"):
        read_bag(tmp_path / "two", namespace="middle")


def test_nothing_to_read(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        read_bag(tmp_path / "absent")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="is no bag"):
        read_bag(tmp_path / "empty")
    (tmp_path / "zero.mcap").touch()
    with pytest.raises(InputError, match="is empty"):
        read_bag(tmp_path / "zero.mcap")
    with BagWriter(tmp_path / "silent") as writer:
        writer.add_topic("/command")
    with pytest.raises(InputError, match="silent: is empty: nothing was recorded on /command"):
        read_bag(tmp_path / "silent")
    (tmp_path / "text.db3").write_text("no database")
    with pytest.raises(InputError, match="no SQLite3 bag"):
        read_bag(tmp_path / "text.db3")
    write_bag(tmp_path / "bag", record())
    with pytest.raises(InputError, match=r"has no topic feedback \(topics: command, measurement\)"):
        read_bag(tmp_path / "bag").signal("feedback")
    with pytest.raises(InputError, match="exists already"):
        write_bag(tmp_path / "bag", record())
