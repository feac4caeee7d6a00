# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Every check of the readers by its own words: a file that fails one of them is refused by this one, and not by one that comes later."""

import gzip
import io
import os
import sqlite3
import struct
import zlib
from contextlib import closing

import lz4.frame
import numpy as np
import pytest
import zstandard

from hyst_control.base.errors import InputError
from hyst_control.base.foreign_readers import foreign_reader
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.bags.decompression import Budget, Damage, decompress
from hyst_control.records.bags.mcap_stream import CutOff, McapStream
from hyst_control.records.bags.sqlite_bag import sqlite_messages
from hyst_control.records.record import Record, Signal
from hyst_control.records.stream.signal_message import MESSAGE_TYPE, Encoder
from hyst_control.records.tables.array_files import read_array, read_arrays
from hyst_control.records.tables.importing import import_table, parse_columns, write_bag

MAGIC = b"\x89MCAP0\r\n"
COMMAND = Encoder("t[s],x[V]")
ROW = COMMAND.encode(np.array([[0.0, 1.0]]))


def text(value):
    data = value if isinstance(value, bytes) else value.encode()
    return struct.pack("<I", len(data)) + data


def entry(kind, body, length=None):
    return struct.pack("<BQ", kind, len(body) if length is None else length) + body


def chunk(content, size=None, checksum=0, compression="", length=None):
    head = struct.pack("<QQQI", 0, 0, len(content) if size is None else size, checksum) + text(compression)
    return entry(6, head + struct.pack("<Q", len(content) if length is None else length) + content)


SCHEMA = entry(3, struct.pack("<H", 1) + text(MESSAGE_TYPE) + text("ros2msg") + text(""))
MESSAGE = entry(5, struct.pack("<HIQQ", 1, 0, 0, 0) + ROW)
FOOTER = entry(2, bytes(20))


def channel(topic="/command", encoding="cdr", number=1):
    return entry(4, struct.pack("<HH", number, 1) + text(topic) + text(encoding) + struct.pack("<I", 0))


def stream(data, sized):
    return McapStream(io.BytesIO(data), len(data) if sized else None, Budget(len(data)))


DAMAGED = {
    "does not begin as an MCAP file does": b"\x89MCAP1\r\n" + FOOTER + MAGIC,
    "does not end as an MCAP file does": MAGIC + FOOTER + MAGIC[::-1],
    "statistics cut short": MAGIC + entry(11, b"1234567"),
    "a chunk cut short": MAGIC + entry(6, bytes(31)),
    "a chunk of another length than it says": MAGIC + chunk(MESSAGE, length=3),
    "whose checksum is wrong": MAGIC + chunk(SCHEMA, checksum=zlib.crc32(b"other")),
    "a record cut short": MAGIC + chunk(b"\x05\x01"),
    "longer than its chunk": MAGIC + chunk(entry(5, b"", 2)),
    "a message cut short": MAGIC + entry(5, bytes(21)),
    "a schema cut short": MAGIC + entry(3, b"\x01"),
    "a channel cut short": MAGIC + entry(4, b"\x01\x00\x01"),
    "only cdr is read": MAGIC + SCHEMA + channel(encoding="json"),
    "gives the channel of /command to /other": MAGIC + SCHEMA + channel() + channel("/other"),
    "a text cut short": MAGIC + entry(3, struct.pack("<HI", 1, 9) + b"abc"),
    "a text that is none": MAGIC + entry(3, struct.pack("<H", 1) + text(b"\xff\xfe")),
    "is compressed with 'brotli'": MAGIC + chunk(MESSAGE, compression="brotli"),
    "a block of 10 bytes where 3 are announced": MAGIC + chunk(bytes(10), size=3),
}


@pytest.mark.parametrize("sized", [True, False], ids=["file", "stream"])
@pytest.mark.parametrize("words", DAMAGED)
def test_damage_of_an_mcap_file_is_named(words, sized):
    with pytest.raises(Damage, match=words):
        list(stream(DAMAGED[words], sized).messages())


@pytest.mark.parametrize("sized", [True, False], ids=["file", "stream"])
@pytest.mark.parametrize(
    "end", [b"", b"\x05", entry(5, b"abc", 2**62), entry(128, b"", 2**63 + 5), entry(128, b"", 5), entry(6, b"abc", 99), FOOTER]
)
def test_an_mcap_file_that_is_cut_off_gives_what_is_whole(end, sized):
    found = stream(MAGIC + SCHEMA + channel() + MESSAGE + entry(128, b"skipped") + end, sized).messages()
    assert next(found) == ("/command", 0, ROW)
    with pytest.raises(CutOff):
        next(found)


def test_messages_of_other_types_and_of_no_channel_are_passed_by():
    other = entry(3, struct.pack("<H", 2) + text("std_msgs/msg/String") + text("ros2msg") + text(""))
    foreign = entry(4, struct.pack("<HH", 7, 2) + text("/words") + text("json") + struct.pack("<I", 0))
    unknown = entry(5, struct.pack("<HIQQ", 9, 0, 0, 0) + b"data")
    whole = stream(MAGIC + SCHEMA + other + foreign + channel() + unknown + MESSAGE + FOOTER + MAGIC, True)
    assert [topic for topic, _, _ in whole.messages()] == ["/command"] and whole.found == 2


PLAIN = bytes(range(256)) * 8
OPEN = zstandard.ZstdCompressor(write_content_size=False)


@pytest.mark.parametrize(
    "data, kind, size, words",
    [
        (zstandard.compress(PLAIN), "zstd", 100, "expands to more than is announced"),
        (OPEN.compress(PLAIN), "zstd", 100, "expands to more than is announced"),
        (lz4.frame.compress(PLAIN), "lz4", 100, "expands to more than is announced"),
        (lz4.frame.compress(PLAIN)[:-9], "lz4", None, "or is cut off"),
        (zstandard.compress(PLAIN), "zstd", 4000, "a block of 2048 bytes where 4000 are announced"),
        (PLAIN, "", 4000, "a block of 2048 bytes where 4000 are announced"),
        (zstandard.compress(PLAIN), "zstd", 2**60, "expands to more than 200 times its size"),
        (PLAIN, "gzip", None, "only zstd and lz4 are read"),
    ],
)
def test_blocks_that_are_not_what_they_say_are_named(data, kind, size, words):
    with pytest.raises(Damage, match=words):
        decompress(data, kind, size, Budget(10))
    for packed, name in ((zstandard.compress(PLAIN), "zstd"), (OPEN.compress(PLAIN), "zstd"), (lz4.frame.compress(PLAIN), "lz4")):
        assert decompress(packed, name, len(PLAIN), Budget(10)) == decompress(packed, name, None, Budget(10)) == PLAIN


def database(path, topic=(1, "/command", MESSAGE_TYPE, "cdr"), row=(1, 5, ROW), tables=("TABLE topics", "TABLE messages")):
    with closing(sqlite3.connect(path)) as made:
        made.execute(f"CREATE {tables[0]}(id, name, type, serialization_format)")
        made.execute("INSERT INTO topics VALUES (?, ?, ?, ?)", topic)
        made.execute(f"CREATE {tables[1]}(id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
        made.execute(f"INSERT INTO {tables[1].split()[-1]} (topic_id, timestamp, data) VALUES (?, ?, ?)", row)
        made.commit()
    return path


@pytest.mark.parametrize(
    "change, words",
    [
        ({"row": (1, 1.5, ROW)}, "a message whose time is '1.5'"),
        ({"row": (1, -1, ROW)}, "a message whose time is '-1'"),
        ({"row": (1, 5, "text")}, "whose data is str"),
        ({"topic": (1, 5, MESSAGE_TYPE, "cdr")}, "names the topic '5'"),
        ({"topic": (1, "", MESSAGE_TYPE, "cdr")}, "names the topic ''"),
        ({"topic": ("one", "/command", MESSAGE_TYPE, "cdr")}, "its number 'one'"),
        ({"topic": (1, "/command", MESSAGE_TYPE, "json")}, "only cdr is read"),
        ({"tables": ("TABLE topics", "TABLE other")}, "it has no table messages"),
    ],
)
def test_a_database_that_is_no_bag_is_named(tmp_path, change, words):
    path = database(tmp_path / "a.db3", **change)
    for finished in (True, False):
        with pytest.raises(Damage, match=words):
            list(sqlite_messages(path, finished, {}))
    assert list(sqlite_messages(database(tmp_path / "sound.db3"), True, {})) == [("/command", 5, ROW)]


def test_rows_that_share_their_bytes_are_no_more_than_the_file_holds(tmp_path):
    """Four rows of 200 kB whose pages are those of the first one: a file of 200 kB that would be read as 800 kB, or any number."""
    path, size = tmp_path / "a.db3", 204_700  # of which 489 bytes stand in the table's page, and the others in pages of their own
    with closing(sqlite3.connect(path)) as made:
        made.execute("PRAGMA page_size = 4096")
        made.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format)")
        made.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
        made.execute("INSERT INTO topics VALUES (1, '/command', ?, 'cdr')", (MESSAGE_TYPE,))
        made.executemany("INSERT INTO messages VALUES (?, 1, 5, ?)", [(k, bytes(size)) for k in range(4)])
        made.commit()
        page = 4096 * (made.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()[0] - 1)
    file = bytearray(path.read_bytes())
    begins = [page + int.from_bytes(file[at : at + 2], "big") for at in range(page + 8, page + 16, 2)]  # the first row stands last
    ends = [page + 4096, *begins[:3]]
    first, second = (int.from_bytes(file[end - 4 : end], "big") for end in ends[:2])
    for end in ends:
        file[end - 4 : end] = first.to_bytes(4, "big")
    file[28:32] = (second - 1).to_bytes(4, "big")  # pages of the file
    path.write_bytes(file[: (second - 1) * 4096])
    with closing(sqlite3.connect(f"file:{path}?immutable=1", uri=True)) as opened:
        assert [len(row[0]) for row in opened.execute("SELECT data FROM messages")] == [size] * 4  # SQLite itself reads it
    with pytest.raises(Damage, match="holds more than its size"):
        list(sqlite_messages(path, True, {}))


def test_a_file_that_is_no_database_and_one_that_computes(tmp_path):
    (tmp_path / "none.db3").write_bytes(b"no database" * 100)
    with pytest.raises(Damage, match="is no SQLite3 bag .file is not a database"):
        list(sqlite_messages(tmp_path / "none.db3", True, {}))
    path = database(tmp_path / "a.db3")
    with closing(sqlite3.connect(path)) as made:
        made.execute("ALTER TABLE messages ADD COLUMN more AS (zeroblob(9))")
        made.commit()
    with pytest.raises(Damage, match="its table messages computes columns"):
        list(sqlite_messages(path, True, {}))


def small_bag(path, *topics, rows=3):
    with BagWriter(path) as writer:
        for topic in topics or ("/command",):
            for k in range(rows):
                writer.write(topic, COMMAND.encode(np.array([[k * 1e-3, float(k)]])), k)
    return path


SAID = "rosbag2_bagfile_information: {relative_file_paths: [bag_0.mcap], "


@pytest.mark.parametrize(
    "content, reason",
    [
        (SAID + "compression_mode: magic}", "compression mode 'magic' is not known"),
        (SAID + "compression_mode: file, compression_format: lzma}", "compression format 'lzma' is not known"),
        ("rosbag2_bagfile_information: {relative_file_paths: []}", "relative_file_paths is no list of names"),
        ("rosbag2_bagfile_information: {relative_file_paths: ['..']}", "names files that are not there|is no bag"),
        ("rosbag2_bagfile_information: {relative_file_paths: [5]}", "relative_file_paths is no list of names"),
        ("[1, 2]", "it says nothing of a bag"),
        ("{", "is not valid YAML"),
    ],
)
def test_metadata_that_cannot_be_used_says_why(tmp_path, content, reason):
    path = small_bag(tmp_path / "bag")
    (path / "metadata.yaml").write_text(content)
    try:
        notes = read_bag(path).notes
    except InputError as error:
        notes = (str(error),)
    assert len(notes) == 1
    with pytest.raises(AssertionError, match=reason):
        raise AssertionError(notes[0])


def test_a_folder_that_is_no_bag_says_why(tmp_path):
    def refused(path, words, **options):
        with pytest.raises(InputError, match=words) as found:
            read_bag(path, **options)
        assert "\n" not in str(found.value)

    refused(tmp_path / "nowhere", "does not exist: give the path of a bag")
    refused(tmp_path, "is no bag: must be a rosbag2 directory")
    (tmp_path / "a.txt").write_text("x")
    refused(tmp_path / "a.txt", "holds no rows below its first line")
    (tmp_path / "a.bin").write_text("x")
    refused(tmp_path / "a.bin", "is no bag: must be a rosbag2 directory.*; a table needs its ending, such as .csv, or hyst import")
    (tmp_path / "empty.mcap").write_bytes(b"")
    refused(tmp_path / "empty.mcap", "is empty: the recording wrote nothing")
    folder = small_bag(tmp_path / "bag")
    (folder / "metadata.yaml").unlink()
    (folder / "metadata.yaml").mkdir()
    assert "is no file" in read_bag(folder).notes[0]
    (folder / "metadata.yaml").rmdir()
    database(folder / "bag_1.db3")
    refused(folder, "holds both MCAP and SQLite3 files")
    gone = small_bag(tmp_path / "gone")
    (gone / "gone_0.mcap").rename(gone / "gone_1.mcap")
    refused(gone, "names files that are not there .gone_0.mcap.: copy the whole bag")
    two = small_bag(tmp_path / "two", "/a/command", "/b/command")
    refused(two, "/a/command and /b/command are both a command")
    refused(two, "no topic in the namespace 'c'", namespace="c")
    assert list(read_bag(two, "b").signals) == ["command"]
    nothing = MAGIC + SCHEMA + channel() + FOOTER + MAGIC
    (tmp_path / "nothing.mcap").write_bytes(nothing)
    refused(tmp_path / "nothing.mcap", "is empty: nothing was recorded on /command: record while")


def test_a_finished_bag_that_holds_less_than_it_says(tmp_path):
    folder = small_bag(tmp_path / "bag")
    whole = MAGIC + SCHEMA + channel() + MESSAGE
    file = folder / "bag_0.mcap"
    file.write_bytes(whole + entry(11, struct.pack("<Q", 2) + bytes(40)) + FOOTER + MAGIC)
    with pytest.raises(InputError, match="holds 1 messages where 2 are announced"):
        read_bag(folder)
    file.write_bytes(whole + entry(5, b"", 99) + MAGIC)
    with pytest.raises(InputError, match="a record is longer than the file"):
        read_bag(folder)
    file.write_bytes(whole + entry(5, b"", 99))
    assert "has no footer (recorder killed?): 1 messages up to its last whole chunk were read" in read_bag(folder).notes[0]
    file.write_bytes(MAGIC + SCHEMA)
    with pytest.raises(InputError, match="is cut off before its first whole chunk: record again"):
        read_bag(folder)
    file.write_bytes(MAGIC + entry(3, b"\x01") + MAGIC)
    with pytest.raises(InputError, match="is damaged .holds a schema cut short.: record again or repair"):
        read_bag(folder)
    file.write_bytes(MAGIC + entry(3, b"\x01"))
    with pytest.raises(InputError, match="is damaged or cut off before its first whole chunk .holds a schema cut short"):
        read_bag(folder)
    file.write_bytes(whole + entry(3, b"\x01"))
    assert "is damaged (holds a schema cut short): 1 messages before the damage were read" in read_bag(folder).notes[0]


def test_signals_that_are_none_are_named_or_left_out(tmp_path):
    def written(name, *blocks, topic="/command"):
        with BagWriter(tmp_path / name) as writer:
            for k, (label, rows) in enumerate(blocks):
                writer.write(topic, Encoder(label).encode(np.array(rows)), k)
            if topic != "/command":
                writer.write("/command", ROW, 0)
        return tmp_path / name

    with pytest.raises(InputError, match="command: two different rows of one sample time"):
        read_bag(written("contradicting", ("t[s],x[V]", [[0.0, 1.0]]), ("t[s],x[V]", [[0.0, 2.0]])))
    mixed = ("t[s],x[V],y[um]", [[0.0, 1.0, 2.0]])
    with pytest.raises(InputError, match="command: label must have one unit for all axes"):
        read_bag(written("mixed", mixed))
    other = written("other", mixed, topic="/extra")
    record = read_bag(other)
    assert (
        list(record.signals) == ["command"]
        and "extra: label must have one unit" in record.notes[0]
        and "(left out)" in record.notes[0]
    )
    with pytest.raises(InputError, match="extra: label must have one unit"):
        read_bag(other, topics=["extra"])
    empty = b"\x00\x01\x00\x00" + struct.pack("<III", 0, 0, 0)
    plain = entry(5, struct.pack("<HIQQ", 1, 0, 0, 0) + empty)
    (tmp_path / "plain.mcap").write_bytes(MAGIC + SCHEMA + channel() + plain + FOOTER + MAGIC)
    with pytest.raises(InputError, match="command: messages hold no values"):
        read_bag(tmp_path / "plain.mcap")
    widths = [struct.pack("<III", 0, 0, width) + bytes(4) + bytes(8 * width) for width in (1, 2)]
    two = b"".join(entry(5, struct.pack("<HIQQ", 1, 0, k, k) + b"\x00\x01\x00\x00" + body) for k, body in enumerate(widths))
    (tmp_path / "two.mcap").write_bytes(MAGIC + SCHEMA + channel() + two + FOOTER + MAGIC)
    with pytest.raises(InputError, match="messages of . and of . values"):
        read_bag(tmp_path / "two.mcap")
    with pytest.raises(InputError, match="label changes from 't.s.,x.V.' to 't.s.,z.V.'"):
        read_bag(written("renamed", ("t[s],x[V]", [[0.0, 1.0]]), ("t[s],z[V]", [[1.0, 2.0]])))
    (tmp_path / "odd.mcap").write_bytes(
        MAGIC + SCHEMA + channel() + entry(5, struct.pack("<HIQQ", 1, 0, 0, 0) + ROW + b"more") + FOOTER + MAGIC
    )
    with pytest.raises(InputError, match="command: message of .* 4 bytes follow its 2 values"):
        read_bag(tmp_path / "odd.mcap")


TABLE = "u,y\n1.0,2.0\n3.0,4.0\n5.0,6.0\n"
BOTH = "command=1[V],measurement=2[um]"


@pytest.mark.parametrize(
    "columns, words",
    [
        ("command", "must be topic=column"),
        ("command=1[furlong]", "command: unit 'furlong' is not known"),
        ("command=1[V],command=2[V]", "command stands twice"),
        ("", "columns: is empty"),
    ],
)
def test_descriptions_of_columns_that_say_nothing(columns, words):
    with pytest.raises(InputError, match=words):
        parse_columns(columns)


@pytest.mark.parametrize(
    "content, columns, options, words",
    [
        (TABLE, BOTH, {"rate": -1.0}, "rate: -1.0 Hz, a positive rate is due"),
        (TABLE, BOTH, {"rate": float("nan")}, "rate: nan Hz, a positive rate is due"),
        (TABLE, BOTH, {"rate": None}, "rate: is missing"),
        (TABLE, "time=1[s]", {}, "name command and measurement"),
        (TABLE, BOTH, {"rows": (2, 1)}, "rows must be a range within 0:3, got 2:1"),
        (TABLE, BOTH, {"rows": (0, 9)}, "rows must be a range within 0:3, got 0:9"),
        (TABLE, "command=0[V],measurement=2[um]", {}, "column 2 of 2: number them from 0 to 1"),
        (TABLE, "command=3[V]", {}, "column 3 of 2: number them from 1 to 2"),
        (TABLE, "command=volt[V]", {}, "has no column 'volt': u, y"),
        ("", BOTH, {}, "holds no rows$"),
        ("u,y\n", BOTH, {}, "holds no rows below its first line"),
        ("1,2\n3\n4,5\n", BOTH, {}, "line 2 has 1 columns, the first has 2"),
        ("1,2\n3,x4\n", BOTH, {}, "line 2, column 2: 'x4' is no number"),
        ("1,2\n3,\n", BOTH, {}, "measurement: row 1 holds no finite number"),
        ("1,2\n3,1e305\n", "command=1[V],measurement=2[m]", {}, "row 1 is too large for a number once it is in other units"),
        ("1,2\n1,3\n", "time=1[s],command=2[V]", {"rate": None}, "time: does not increase in row 1"),
        ("1,2\n2,3\n", "time=1[s],command=2[V]", {"rate": 5.0}, "time: has 1 samples/s, --rate says 5"),
        ("1,2\n2,3\n", "time=1+2[s],command=2[V]", {"rate": None}, "time: 2 columns, one is due"),
    ],
)
def test_tables_that_do_not_fit_are_named(tmp_path, content, columns, options, words):
    path = tmp_path / "a.csv"
    path.write_text(content)
    with pytest.raises(InputError, match=words):
        import_table(path, parse_columns(columns), **{"rate": 10.0, **options})


def test_files_that_do_not_fit_are_named(tmp_path):
    columns = parse_columns(BOTH)
    with pytest.raises(InputError, match="nowhere.csv: does not exist"):
        import_table(tmp_path / "nowhere.csv", columns, 10.0)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe: is a pipe or device, which is read once only: save it to a file first"):
        import_table(tmp_path / "pipe", columns, 10.0)
    (tmp_path / "a.csv.gz").write_bytes(gzip.compress(b"1,2\n3,4\n")[:-6])
    with pytest.raises(InputError, match="cannot be read as text .*: give a CSV"):
        import_table(tmp_path / "a.csv.gz", columns, 10.0)
    np.savez(tmp_path / "a.npz", u=np.zeros(3), y=np.zeros(4))
    with pytest.raises(InputError, match="name one of its arrays as the variable: u, y"):
        import_table(tmp_path / "a.npz", columns, 10.0)
    with pytest.raises(InputError, match="has no array v: name one of u, y"):
        import_table(tmp_path / "a.npz", parse_columns("command=v[V],measurement=y[um]"), 10.0)
    with pytest.raises(InputError, match="the arrays differ in length .u 3 x 1, y 4 x 1"):
        import_table(tmp_path / "a.npz", parse_columns("command=u[V],measurement=y[um]"), 10.0)
    np.savez(tmp_path / "b.npz", y=np.zeros((4, 2)))
    with pytest.raises(InputError, match="y has 2 columns: number them from 1"):
        import_table(tmp_path / "b.npz", parse_columns("measurement=y(:,3)[um]"), 10.0)
    time = np.arange(3.0)
    with pytest.raises(InputError, match="exists already"):
        write_bag(tmp_path / "a.npz", Record({"command": Signal(time, time[:, None], ("x",), "V")}, "made"))
    with pytest.raises(InputError, match="there is nothing to write: made has no signals"):
        write_bag(tmp_path / "new", Record({}, "made"))


def test_arrays_that_are_none_are_named(tmp_path):
    np.save(tmp_path / "words.npy", np.array(["a"]))
    with pytest.raises(InputError, match="words.npy: holds no real numbers"):
        read_array(tmp_path / "words.npy")
    whole = io.BytesIO()
    np.save(whole, np.zeros(9))
    (tmp_path / "cut.npy").write_bytes(whole.getvalue()[:-8].replace(b"(9,)", b"(99,)"))
    with pytest.raises(InputError, match="it announces 792 bytes and has"):
        read_array(tmp_path / "cut.npy")
    (tmp_path / "new.mat").write_bytes(b"MATLAB 7.3 MAT-file".ljust(116) + bytes(8) + b"\x00\x02IM" + bytes(400))
    with pytest.raises(InputError, match="is a MATLAB 7.3 file"):
        read_arrays(tmp_path / "new.mat", ".mat")


@pytest.mark.parametrize(
    "raised, words",
    [
        (InputError("as it is"), "^as it is$"),
        (MemoryError(), "^a: does not fit in memory, or is damaged: mend it$"),
        (FileNotFoundError(2, "No such file"), "^a: cannot be read as text .No such file.: mend it$"),
        (OSError("bare"), "^a: cannot be read as text .bare.: mend it$"),
        (KeyError("k\nl"), "^a: cannot be read as text .'k.*: mend it$"),
        (RuntimeError(), "^a: cannot be read as text .RuntimeError.: mend it$"),
    ],
)
def test_whatever_a_reader_raises_is_one_line(raised, words):
    with pytest.raises(InputError, match=words), foreign_reader("a", "text", "mend it"):
        raise raised
