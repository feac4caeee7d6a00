"""Bags that are damaged, or made to harm: what is intact is read, the rest refused in one line, and memory stays in bounds."""

import sqlite3
import struct
import sys
import tracemalloc
import zlib

import lz4.frame
import numpy as np
import pytest
import zstandard
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.bags.decompression import Budget, Damage, decompress
from hyst_control.records.record import Record, Signal
from hyst_control.records.stream.signal_message import MESSAGE_TYPE, Decoder, Encoder, decode
from hyst_control.records.tables.importing import write_bag

MAGIC = b"\x89MCAP0\r\n"
STORE = get_typestore(Stores.ROS2_JAZZY)
COMMAND = Encoder("t[s],x[V]")


def rows(first, count=1):
    ticks = np.arange(first, first + count)
    return np.stack([ticks * 1e-3, np.sin(ticks)], axis=1)


def text(value):
    return struct.pack("<I", len(value)) + value.encode()


def entry(kind, body):
    return struct.pack("<BQ", kind, len(body)) + body


def message(data, time=0, channel=1):
    return entry(5, struct.pack("<HIQQ", channel, 0, time, time) + data)


DEFINITIONS = (
    entry(1, text("ros2") + text("test")),
    entry(3, struct.pack("<H", 1) + text(MESSAGE_TYPE) + text("ros2msg") + text("")),
    entry(4, struct.pack("<HH", 1, 1) + text("/command") + text("cdr") + struct.pack("<I", 0)),
)
END = entry(15, struct.pack("<I", 0)) + entry(2, struct.pack("<QQI", 0, 0, 0)) + MAGIC


def chunk(content, compression="", size=None, data=None, checksum=0):
    packed = content if data is None else data
    head = struct.pack("<QQQI", 0, 0, len(content) if size is None else size, checksum)
    return entry(6, head + text(compression) + struct.pack("<Q", len(packed)) + packed)


def mcap(path, *parts):
    path.write_bytes(MAGIC + b"".join(DEFINITIONS) + b"".join(parts) + END)
    return path


def zeros(count):
    """So many zeros as a zstd frame that does not say how many."""
    packer, piece = zstandard.ZstdCompressor().compressobj(), bytes(2**20)
    return b"".join([packer.compress(piece) for _ in range(count >> 20)]) + packer.flush()


def refused(path, words=".", **options):
    with pytest.raises(InputError, match=words) as found:
        read_bag(path, **options)
    assert "\n" not in str(found.value) and len(str(found.value)) < 1000
    return str(found.value)


GOOD = [message(COMMAND.encode(rows(k))) for k in range(5)]
MUCH = 400 * 2**20


@pytest.mark.parametrize("said", [MUCH, 100, None], ids=["honest", "lying", "much more"])
@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_chunk_that_expands_without_measure_takes_no_memory(tmp_path, compression, said):
    data = zeros(MUCH) if compression == "zstd" else lz4.frame.compress(bytes(MUCH))
    size = 2**62 if said is None else said
    path = mcap(tmp_path / "bomb.mcap", chunk(b"".join(GOOD)), chunk(b"", compression, size, data))
    tracemalloc.start()
    try:
        record = read_bag(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 64 * 2**20
    assert len(record.signals["command"].time) == 5 and "expands to more than" in record.notes[0]


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_compressed_files_and_messages_are_bounded_too(tmp_path, mode, plugin):
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/command", MESSAGE_TYPE, typestore=STORE)
        for k in range(5):
            writer.write(connection, k, COMMAND.encode(rows(k)))
    np.testing.assert_array_equal(read_bag(tmp_path / "bag").signals["command"].values[:, 0], rows(0, 5)[:, 1])
    if mode == CompressionMode.FILE:
        file = next((tmp_path / "bag").glob("*.zstd"))
        skipped = MAGIC + b"".join(DEFINITIONS) + b"\x80" + struct.pack("<Q", MUCH) + bytes(MUCH)  # a record of no known kind
        file.write_bytes(zstandard.compress(skipped) if plugin == StoragePlugin.MCAP else file.read_bytes() + zeros(MUCH))
    else:
        with_bomb(tmp_path / "bag", plugin)
    tracemalloc.start()
    try:
        refused(tmp_path / "bag", "expands to more than|SQLite3")
        assert tracemalloc.get_traced_memory()[1] < 128 * 2**20
    finally:
        tracemalloc.stop()


def with_bomb(path, plugin):
    if plugin == StoragePlugin.SQLITE3:
        with sqlite3.connect(next(path.glob("*.db3"))) as database:
            database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (1, 9, ?)", (zeros(MUCH),))
        database.close()
    else:
        mcap(next(path.glob("*.mcap")), chunk(message(zeros(MUCH))))


@pytest.mark.parametrize("extra", [1, 4, 8, 16])
def test_bytes_behind_a_message_are_not_read_as_its_data(tmp_path, extra):
    raw = COMMAND.encode(rows(3, 4)) + bytes(extra)
    for reader in (decode, Decoder().decode):
        with pytest.raises(InputError, match=f"{extra} bytes follow its 8 values"):
            reader(raw)
    path = mcap(tmp_path / "a.mcap", *GOOD, message(COMMAND.encode(rows(5)) + bytes(extra)))
    refused(path, "bytes follow")


@pytest.mark.parametrize("bad", [1e305, -1e305, 1e12, np.nan, np.inf])
def test_times_that_no_clock_has_are_refused(tmp_path, bad):
    path = mcap(tmp_path / "a.mcap", *GOOD, message(COMMAND.encode(np.array([[bad, 0.0]]))))
    refused(path, "the time column holds")
    record = Record({"command": Signal(np.array([0.0, 1.0, bad]), np.zeros((3, 1)), ("x",), "V")}, "made")
    with pytest.raises(InputError, match="the time column holds"):
        record.aligned(["command"])


def test_steps_that_no_float_counts_are_refused():
    close = Signal(np.array([0.0, 1e-300, 2e-300, 1.0]), np.zeros((4, 1)), ("x",), "V")
    with pytest.raises(InputError, match="steps of 1e-300 s"):
        Record({"command": close}, "made").aligned(["command"])


def database(path, topics, messages="CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)"):
    made = sqlite3.connect(path)
    made.execute("CREATE TABLE topics(id, name, type, serialization_format, offered_qos_profiles)")
    made.executemany("INSERT INTO topics VALUES (?, ?, ?, ?, '')", topics)
    made.execute(messages)
    if messages.startswith("CREATE TABLE messages(id INTEGER"):
        made.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)",
            [(k, COMMAND.encode(rows(k))) for k in range(5)],
        )
    made.commit()
    return made


TOPIC = (1, "/command", MESSAGE_TYPE, "cdr")
ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
ENDLESS += "SELECT i AS id, 1 AS topic_id, i AS timestamp, x'00' AS data FROM n"


@pytest.mark.parametrize(
    "change, values",
    [
        ("UPDATE messages SET data = ? WHERE id = 3", ("text",)),
        ("UPDATE messages SET data = ? WHERE id = 3", (None,)),
        ("UPDATE messages SET data = ? WHERE id = 3", (7,)),
        ("UPDATE messages SET data = ? WHERE id = 3", (1.5,)),
        ("UPDATE messages SET timestamp = ? WHERE id = 3", ("noon",)),
        ("UPDATE messages SET timestamp = ? WHERE id = 3", (None,)),
        ("UPDATE messages SET timestamp = ? WHERE id = 3", (1e300,)),
        ("UPDATE messages SET timestamp = ? WHERE id = 3", (b"\x00",)),
        ("UPDATE messages SET timestamp = ? WHERE id = 3", (-(2**63),)),
        ("UPDATE topics SET name = ?", (5,)),
        ("UPDATE topics SET name = ?", (b"/command",)),
        ("UPDATE topics SET name = ?", (None,)),
        ("UPDATE topics SET id = ?", ("one",)),
        ("UPDATE topics SET id = ?", (1.0,)),
        ("UPDATE topics SET serialization_format = ?", ("json",)),
        ("ALTER TABLE messages DROP COLUMN data", ()),
    ],
)
@pytest.mark.parametrize("finished", [True, False])
def test_columns_of_another_type_are_refused(tmp_path, change, values, finished):
    path = tmp_path / "bag"
    path.mkdir()
    made = database(path / "bag_0.db3", [TOPIC])
    made.execute(change, values)
    made.commit()
    made.close()
    if finished:
        (path / "metadata.yaml").write_text("rosbag2_bagfile_information: {relative_file_paths: [bag_0.db3]}\n")
    refused(path)


@pytest.mark.parametrize(
    "messages",
    [
        f"CREATE VIEW messages AS {ENDLESS}",
        "CREATE TABLE messages(i INTEGER PRIMARY KEY, topic_id AS (1), timestamp AS (i), data AS (zeroblob(900000000)), id AS (i))",
        "CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data)",
    ],
)
def test_tables_that_compute_are_refused(tmp_path, messages):
    path = tmp_path / "a.db3"
    made = database(path, [TOPIC], messages)
    if "zeroblob" in messages:
        made.execute("INSERT INTO messages (i) VALUES (1)")
        made.commit()
    made.close()
    refused(path, "is no SQLite3 bag")


@pytest.mark.parametrize(
    "content", ["", "\n", "[]", "rosbag2_bagfile_information:", "{", "rosbag2_bagfile_information: {relative_file_paths: 5}"]
)
@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_metadata_that_is_empty_or_damaged_does_not_hide_the_bag(tmp_path, content, plugin):
    with Writer(tmp_path / "bag", version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/command", MESSAGE_TYPE, typestore=STORE)
        for k in range(5):
            writer.write(connection, k, COMMAND.encode(rows(k)))
    whole = read_bag(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").write_text(content)
    record = read_bag(tmp_path / "bag")
    np.testing.assert_array_equal(record.signals["command"].values, whole.signals["command"].values)
    assert len(record.notes) == 1 and "metadata.yaml: cannot be used" in record.notes[0] and "\n" not in record.notes[0]


def test_a_few_rows_of_a_second_source_are_left_out_and_many_refused(tmp_path):
    """Whichever came first; the times of reception of a topic without a layout stay those of its own messages."""
    other = Encoder("t[s],x[V],y[V]")
    for name, first, foreign in (("first", True, 1), ("last", False, 1), ("many", False, 12)):
        with BagWriter(tmp_path / name) as writer:
            for k in range(foreign if first else 0):
                writer.write("/command", other.encode(np.full((1, 3), float(k))), k)
            for k in range(20):
                writer.write("/command", COMMAND.encode(rows(k)), k)
            for k in range(0 if first else foreign):
                writer.write("/command", other.encode(np.full((1, 3), float(k))), k)
    for name in ("first", "last"):
        record = read_bag(tmp_path / name)
        np.testing.assert_array_equal(record.signals["command"].values[:, 0], rows(0, 20)[:, 1])
        assert len(record.notes) == 1 and "1 rows of another form ('t[s],x[V],y[V]') were left out" in record.notes[0]
    refused(tmp_path / "many", "record one plant per topic")
    plain = [b"\x00\x01\x00\x00" + struct.pack("<III", 0, 0, width) + bytes(4 * (width > 0)) + bytes(8 * width) for width in (1, 2)]
    path = mcap(tmp_path / "plain.mcap", *(message(plain[k == 7], 1000 * k) for k in range(30)))
    signal = read_bag(path).signals["command"]
    np.testing.assert_allclose(signal.time, 1e-6 * np.delete(np.arange(30), 7), rtol=1e-12)


def test_topics_without_messages_or_rows_are_named(tmp_path, capsys):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/feedback")
        writer.write("/measurement", Encoder("t[s],x[um]").encode(np.zeros((0, 2))), 0)
        for k in range(5):
            writer.write("/command", COMMAND.encode(rows(k)), k)
    notes = read_bag(tmp_path / "bag").notes
    assert [note.partition(": ")[2] for note in notes] == ["/feedback: holds no messages", "measurement: holds no rows"]
    assert main(["import", str(tmp_path / "bag"), "--output", str(tmp_path / "again")]) == 0
    assert "measurement: holds no rows" in capsys.readouterr().out


def test_damage_within_a_finished_file_is_seen(tmp_path):
    time = np.arange(400) * 1e-3
    write_bag(tmp_path / "bag", Record({"command": Signal(time, np.sin(time)[:, None], ("x",), "V")}, "made"))
    file = tmp_path / "bag" / "bag_0.mcap"
    whole = file.read_bytes()
    value = np.sin(time)[333:334].tobytes()
    file.write_bytes(whole.replace(value, bytes(8)))
    refused(tmp_path / "bag", "is damaged .*checksum")
    at = whole.index(entry(6, b"")[:1] + whole[whole.index(b"\x06", 900) + 1 :][:8], 900)
    file.write_bytes(whole[:at] + b"\x80" + whole[at + 1 :])  # a chunk becomes a record of a kind that nobody knows
    refused(tmp_path / "bag", "is damaged")


@pytest.mark.parametrize(
    "part",
    [
        entry(6, b"short"),
        chunk(b"".join(GOOD), size=3),
        chunk(b"\x05" + struct.pack("<Q", 2**63)),
        chunk(message(b"")[:20]),
        chunk(b"".join(GOOD), "brotli"),
        chunk(b"".join(GOOD), "zstd", data=b"none"),
        chunk(b"".join(GOOD), checksum=zlib.crc32(b"other")),
        entry(4, struct.pack("<HH", 1, 1) + text("/measurement") + text("cdr") + struct.pack("<I", 0)),
        entry(4, struct.pack("<HH", 2, 1) + text("/measurement") + text("ros1") + struct.pack("<I", 0)),
        entry(4, struct.pack("<HHI", 2, 1, 2**31)),
        entry(3, b"\x01"),
        b"\x05" + struct.pack("<Q", 2**60),
        b"\x80" + struct.pack("<Q", 2**63 + 5),
    ],
)
def test_an_unfinished_bag_is_read_up_to_its_damage(tmp_path, part):
    path = mcap(tmp_path / "a.mcap", *GOOD, part)
    record = read_bag(path)
    assert len(record.signals["command"].time) == 5 and len(record.notes) == 1 and "5 messages" in record.notes[0]
    refused(mcap(tmp_path / "b.mcap", part), "before its first whole chunk")


def test_times_before_zero_can_be_written_again(tmp_path):
    path = mcap(tmp_path / "a.mcap", *(message(COMMAND.encode(rows(k))) for k in range(-3, 3)))
    write_bag(tmp_path / "again", read_bag(path))
    np.testing.assert_array_equal(read_bag(tmp_path / "again").signals["command"].time, rows(-3, 6)[:, 0])


@pytest.mark.parametrize("compression, package", [("zstd", "zstandard"), ("lz4", "lz4")])
def test_a_compressed_block_without_the_package_for_it_is_one_line(monkeypatch, compression, package):
    """As on a ROS installation, which brings neither."""
    data = zeros(10) if compression == "zstd" else lz4.frame.compress(bytes(10))
    for name in [package, *(each for each in sys.modules if each.startswith(f"{package}."))]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(Damage, match=f"compressed with {compression}, and the package {package}.* is not installed"):
        decompress(data, compression, 10, Budget(1000))
