# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Signals from any topic and field of a bag, against the numbers that were written by another library."""

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.records.bags.bag_files import bags_in
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.tables.importing import write_bag

COUNT, STEP, START = 200, 2_000_000, 1_700_000_000 * 10**9
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg("float32 volts\nfloat64[3] moved\nstring state\n", "lab_msgs/msg/Stage"))
TYPES = STORE.types
DRIVE, MOVED = np.arange(COUNT) * 0.1, np.cos(np.arange(COUNT) * 0.1)


def header(stamp):
    time = TYPES["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=time, frame_id="stage")


def message(kind, k):
    stamp, made = START + k * STEP, TYPES[kind]
    if kind == "std_msgs/msg/Float64":
        return made(data=DRIVE[k])
    if kind == "std_msgs/msg/Float64MultiArray":
        return made(layout=TYPES["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0), data=np.array([DRIVE[k], MOVED[k]]))
    if kind == "sensor_msgs/msg/JointState":
        position, none = np.array([5.0, MOVED[k]]), np.zeros(0)
        return made(header=header(stamp), name=["a", "b"], position=position, velocity=none, effort=DRIVE[k : k + 1])
    if kind == "geometry_msgs/msg/Vector3Stamped":
        return made(header=header(stamp), vector=TYPES["geometry_msgs/msg/Vector3"](x=DRIVE[k], y=MOVED[k], z=0.0))
    return made(volts=DRIVE[k], moved=np.array([MOVED[k], 1.0, 2.0]), state="x" * (k % 3))


def written(path, topics, plugin=StoragePlugin.MCAP, late=None):
    late = np.zeros(COUNT, dtype=int) if late is None else late
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        for topic, kind in topics.items():
            connection = bag.add_connection(topic, kind, typestore=STORE)
            for k in range(COUNT):
                bag.write(connection, START + k * STEP + int(late[k]), STORE.serialize_cdr(message(kind, k), kind))
    return path


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize(
    "topics, columns",
    [
        ({"/a/joints": "sensor_msgs/msg/JointState"}, "command=/a/joints.effort[V],measurement=/a/joints.position(2)[um]"),
        ({"/a/joints": "sensor_msgs/msg/JointState"}, "command=/a/joints.effort(1)[V],measurement=/a/joints.position(b)[um]"),
        ({"/v": "geometry_msgs/msg/Vector3Stamped"}, "command=v.vector.x[V],measurement=/v.vector.y[um]"),
        ({"/stage": "lab_msgs/msg/Stage"}, "command=/stage.volts[V],measurement=/stage.moved(1)[um]"),
        ({"/both": "std_msgs/msg/Float64MultiArray"}, "command=/both(1)[V],measurement=/both.data(2)[um]"),
        (
            {"/drive": "std_msgs/msg/Float64", "/both": "std_msgs/msg/Float64MultiArray"},
            "command=/drive[V],measurement=/both(2)[um]",
        ),
    ],
    ids=["joints", "joint by name", "vector", "own type", "array", "two topics"],
)
def test_any_field_of_any_topic(tmp_path, topics, columns, plugin):
    columns = columns.replace("both(", "both.data(")
    path = written(tmp_path / "bag", topics, plugin)
    record = read_bag(path, columns=columns)
    np.testing.assert_allclose(record.signals["command"].values[:, 0], DRIVE, rtol=1e-6)
    np.testing.assert_array_equal(record.signals["measurement"].values[:, 0], MOVED)
    np.testing.assert_allclose(record.signals["measurement"].time, np.arange(COUNT) * 2e-3, atol=1e-12)
    assert record.signals["measurement"].unit == "um"


def test_stamps_are_the_times_and_late_messages_shift_nothing(tmp_path):
    late = np.random.default_rng(0).integers(0, 1_500_000, COUNT)
    for kind, columns in (
        ("geometry_msgs/msg/Vector3Stamped", "command=/a.vector.x[V],measurement=/b.vector.y[um]"),
        ("std_msgs/msg/Float64MultiArray", "command=/a.data(1)[V],measurement=/b.data(2)[um]"),
    ):
        path = written(tmp_path / kind[-5:], {"/a": kind, "/b": kind}, late=late)
        record = read_bag(path, columns=columns)
        assert any("the time of reception stands for" in note for note in record.notes) == kind.endswith("MultiArray")
        [part] = record.aligned()
        assert part.sample_time == pytest.approx(2e-3, rel=1e-3) and len(part.time) == COUNT
        np.testing.assert_array_equal(part.command[:, 0], DRIVE)


def test_axes_on_several_topics_and_units(tmp_path):
    path = written(tmp_path / "bag", {"/a": "std_msgs/msg/Float64", "/b": "std_msgs/msg/Float64"})
    record = read_bag(path, columns="command=/a+/b[mV],measurement=/b+/a[2deg/V]")
    np.testing.assert_allclose(record.signals["command"].values, np.stack([DRIVE, DRIVE], axis=1) * 1e-3)
    assert record.signals["measurement"].unit == "deg" and record.signals["measurement"].values[10, 1] == pytest.approx(2.0)


def joints(path, names):
    """A bag whose messages name their joints as `names` says, each joint's position its own."""
    kind = "sensor_msgs/msg/JointState"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection("/j", kind, typestore=STORE)
        for k in range(COUNT):
            order, none = names(k), np.zeros(0)
            position = np.array([{"a": DRIVE, "b": MOVED, "c": MOVED}[name][k] for name in order])
            state = TYPES[kind](header=header(START + k * STEP), name=order, position=position, velocity=none, effort=none)
            bag.write(connection, START + k * STEP, STORE.serialize_cdr(state, kind))
    return path


@pytest.mark.parametrize("items", [("(1)", "(2)"), ("(a)", "(b)"), ("(1)", "(b)")])
def test_joints_in_another_order_are_read_by_name(tmp_path, items):
    path = joints(tmp_path / "bag", lambda k: ["b", "a"] if 50 < k < 90 else ["a", "b"])
    record = read_bag(path, columns=f"command=/j.position{items[0]}[V],measurement=/j.position{items[1]}[um]")
    np.testing.assert_array_equal(record.signals["command"].values[:, 0], DRIVE)
    np.testing.assert_array_equal(record.signals["measurement"].values[:, 0], MOVED)
    whole = read_bag(path, columns="measurement=/j.position[um]").signals["measurement"].values
    np.testing.assert_array_equal(whole, np.stack([DRIVE, MOVED], axis=1))


def test_numbered_joints_of_other_names_are_refused(tmp_path):
    path = joints(tmp_path / "bag", lambda k: ["a", "b"] if k < 50 else ["a", "c"])
    with pytest.raises(InputError, match=r"/j: position: is of a, c after a, b: name an item"):
        read_bag(path, columns="command=/j.position(1)[V]")
    assert len(read_bag(path, columns="command=/j.position(a)[V]").signals["command"].time) == COUNT


@pytest.mark.parametrize(
    "columns, words",
    [
        ("command=/nowhere[V]", r"has no messages of /nowhere: its topics are /v \(geometry_msgs/msg/Vector3Stamped\)"),
        ("command=/v.vector.w[V]", "/v: has no field vector.w: geometry_msgs/msg/Vector3Stamped has x, y, z"),
        ("command=/v.vector[V]", "/v: vector is no number: name a field of numbers"),
        ("command=/v.vector.x(2)[V]", "vector.x: has no item 2: must be 1 to 1"),
        ("time=/v.header.stamp[s],command=/v.vector.x[V]", "a bag's messages have their own times"),
    ],
)
def test_fields_that_are_not_there_are_named(tmp_path, columns, words, capsys):
    path = written(tmp_path / "bag", {"/v": "geometry_msgs/msg/Vector3Stamped"})
    with pytest.raises(InputError, match=words):
        read_bag(path, columns=columns)
    with pytest.raises(InputError, match="name fields as in --columns .* of its topics: /v .geometry_msgs"):
        read_bag(path)


def test_damaged_messages_are_refused_in_one_line(tmp_path):
    kind = "sensor_msgs/msg/JointState"
    whole = STORE.serialize_cdr(message(kind, 3), kind)
    rng = np.random.default_rng(0)
    for number in range(60):
        spoilt = bytearray(whole)
        for _ in range(3):
            spoilt[rng.integers(4, len(spoilt))] = rng.integers(256)
        with Writer(tmp_path / str(number), version=9) as bag:
            connection = bag.add_connection("/j", kind, typestore=STORE)
            for k in range(3):
                bag.write(
                    connection, START + k * STEP, bytes(spoilt[: rng.integers(8, len(spoilt) + 1)]) if k == 1 else bytes(whole)
                )
        try:
            record = read_bag(tmp_path / str(number), columns="command=/j.effort[V],measurement=/j.position[um]")
        except InputError as error:
            assert "\n" not in str(error) and str(tmp_path) in str(error)
        else:
            assert np.isfinite(record.signals["measurement"].values).all()


def test_a_bag_is_imported_and_a_folder_of_bags_is_all_of_them(tmp_path, capsys):
    path = written(tmp_path / "robot", {"/a/joints": "sensor_msgs/msg/JointState"})
    columns = "command=/a/joints.effort[V],measurement=/a/joints.position(2)[um]"
    for number in ("runs/1", "runs/2"):
        assert main(["import", str(path), "--columns", columns, "--output", str(tmp_path / number)]) == 0
    assert "measurement: 200 samples at 500 Hz, 0.4 s" in capsys.readouterr().out
    assert bags_in([tmp_path / "runs", path]) == [tmp_path / "runs/1", tmp_path / "runs/2", path]
    write_bag(tmp_path / "again", read_bag(tmp_path / "runs/1"))
    np.testing.assert_array_equal(read_bag(tmp_path / "again").signals["measurement"].values[:, 0], MOVED)


@pytest.mark.parametrize("columns", [None, "command=/command.data(1)[V],measurement=/measurement.data(1)[um]"])
def test_messages_in_bursts_and_lost_ones(tmp_path, columns):
    """Five at a time, 0.1 ms apart, every 10 ms: the median step is no sample time."""
    topics = {"/command": "std_msgs/msg/Float64MultiArray", "/measurement": "std_msgs/msg/Float64MultiArray"}
    late = np.tile([8_000_000, 6_100_000, 4_200_000, 2_300_000, 400_000], COUNT // 5)
    record = read_bag(written(tmp_path / "bursts", topics, late=late), columns=columns)
    [part] = record.aligned()
    assert part.sample_time == pytest.approx(2e-3, rel=2e-3) and len(part.time) == COUNT
    np.testing.assert_array_equal(part.command[:, 0], DRIVE)
    path = tmp_path / "lost"
    with Writer(path, version=9) as bag:
        for topic, kind in topics.items():
            connection = bag.add_connection(topic, kind, typestore=STORE)
            for k in [k for k in range(COUNT) if topic == "/command" or k not in (70, 71)]:
                bag.write(connection, START + k * STEP + int(late[k]) // 10, STORE.serialize_cdr(message(kind, k), kind))
    if columns is None:
        lost = read_bag(path)
        assert any("2 rows are missing" in note for note in lost.notes)
        parts = lost.aligned(allow_gaps=True)
        assert [len(part.time) for part in parts] == [70, COUNT - 72]
        np.testing.assert_array_equal(parts[1].command[:, 0], DRIVE[72:])
    else:
        with pytest.raises(InputError, match="2 rows are missing, after 0.1.*--resample"):
            read_bag(path, columns=columns)


CLOCKED = "command=/v.data(1)[V],measurement=/v.data(2)[um]"


def clocked(path, times, plugin=StoragePlugin.MCAP):
    """A bag of messages without a stamp, received at these times (s)."""
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        kind = "std_msgs/msg/Float64MultiArray"
        connection = bag.add_connection("/v", kind, typestore=STORE)
        for k, time in enumerate(times):
            bag.write(connection, START + round(time * 1e9), STORE.serialize_cdr(message(kind, k), kind))
    return path


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
@pytest.mark.parametrize("back", [0.1, 0.101, 0.5])
def test_a_clock_that_was_set_back_begins_another_record(tmp_path, capsys, back, plugin):
    times = np.arange(COUNT) * 2e-3
    times[80:] -= back
    path, out = clocked(tmp_path / "bag", times, plugin), tmp_path / "runs"
    assert main(["import", str(path), "--columns", CLOCKED, "--output", str(out), "--resample", "--hold", "foh"]) == 0
    assert "/v: the clock was set back in message 80: 2 runs" in capsys.readouterr().out
    for number, rows in (("1", slice(0, 80)), ("2", slice(80, COUNT))):
        signals = read_bag(out / number).signals
        np.testing.assert_allclose(signals["command"].values[:, 0], DRIVE[rows], atol=1e-9)
        np.testing.assert_allclose(signals["measurement"].values[:, 0], MOVED[rows], atol=1e-9)
    with pytest.raises(InputError, match="its clock was set back: 2 runs: hyst import --columns"):
        read_bag(path, columns=CLOCKED)
    with pytest.raises(InputError, match="the clock was set back in message 80"):
        read_bag(path, topics=["v"])


def test_messages_a_few_places_out_of_order_are_sorted(tmp_path):
    order = np.arange(COUNT)
    order[[1, 50, 51, 120, 123, 198, 199]] = order[[0, 51, 50, 123, 120, 199, 198]]
    order[0] = 1
    record = read_bag(clocked(tmp_path / "bag", order * 2e-3), columns=CLOCKED)
    np.testing.assert_allclose(np.diff(record.signals["command"].time), 2e-3, atol=1e-9)
    np.testing.assert_array_equal(record.signals["command"].values[:, 0], DRIVE[np.argsort(order)])
    assert any("out of order" in note for note in record.notes)


def test_a_clock_that_jumps_about_is_refused(tmp_path):
    times = np.arange(COUNT) * 2e-3
    times[80:] -= 1.0
    times[85:] -= 1.0
    with pytest.raises(InputError, match="the clock was set back .* record with a steady clock"):
        read_bag(clocked(tmp_path / "bag", times), columns=CLOCKED)


def test_two_messages_of_one_stamp_are_refused_with_a_remedy_for_bags(tmp_path):
    kind = "geometry_msgs/msg/Vector3Stamped"
    with Writer(tmp_path / "bag", version=9) as bag:
        connection = bag.add_connection("/v", kind, typestore=STORE)
        for k in range(COUNT):
            for stamped in (k, k + 0.3)[: 1 + (50 <= k < 70)]:  # a second source, at irregular times beside the first
                made = message(kind, k)
                made.vector.x = stamped
                made.header = header(START + int((k + 0.1 * (k % 3)) * STEP))
                bag.write(connection, START + k * STEP, STORE.serialize_cdr(made, kind))
    with pytest.raises(InputError, match="another row has the same time: two sources wrote it, .*: record it again"):
        read_bag(tmp_path / "bag", columns="command=/v.vector.x[V]")
