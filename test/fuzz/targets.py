# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzed inputs: model files, bags and messages that are nearly right. Whatever comes in, it is read or refused in one line."""

from __future__ import annotations

import contextlib
import copy
import gzip
import inspect
import io
import os
import shutil
import sqlite3
import struct
import tempfile
from contextlib import closing
from functools import cache
from pathlib import Path

import numpy as np
import yaml
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.base.yaml_files import parse_yaml
from hyst_control.control.feedback.pi import PI
from hyst_control.export.c_source import Program
from hyst_control.export.compiled import COMPILERS, CompiledProgram
from hyst_control.export.controller import Controller, FaultResponse
from hyst_control.model_file import load_model, model_from_document, simulate
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.excitation.excitation import KINDS, build
from hyst_control.records.excitation.excitation_files import read_description
from hyst_control.records.record import Record, Signal
from hyst_control.records.stream.foreign_rows import LARGEST_VALUE, Refusal, admit
from hyst_control.records.stream.signal_message import MESSAGE_TYPE, Decoder, Encoder, decode
from hyst_control.records.stream.signal_rows import MAX_TICK, Missing, SignalRows
from hyst_control.records.tables.importing import import_table, parse_columns

MODELS = ("pea_hampi", "pea_hapi", "fsm_mhl", "fsm_mhl_inverse")
DOCUMENTS = [yaml.safe_load(config_path(f"models/{name}.yaml").read_text()) for name in MODELS]
TEXTS = [config_path(f"models/{name}.yaml").read_bytes() for name in MODELS]


def one_line(error: InputError) -> None:
    """A refusal is one line that says something."""
    assert str(error).strip() and "\n" not in str(error)


ODD = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**25), 10**25),
    st.floats(),
    st.text(max_size=6),
    st.lists(st.floats(-1e6, 1e6), max_size=4),
    st.just({}),
    st.just([]),
    st.just([[]]),
    st.just([[1.0], [2.0, 3.0]]),
    st.sampled_from([0, 1, -1, 1e-300, 1e300, 1e-9, "delay", [{"stage": "gain", "gain": 1.0}]]),
)


@st.composite
def damaged_documents(draw):
    """A shipped model with one to three of its values replaced, removed or doubled, anywhere in it."""
    document = copy.deepcopy(draw(st.sampled_from(DOCUMENTS)))
    for _ in range(draw(st.integers(1, 3))):
        holder = document
        while True:
            keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
            if not keys:
                break
            key = draw(st.sampled_from(keys))
            inner = holder[key]
            if isinstance(inner, (dict, list)) and inner and draw(st.integers(0, 3)):
                holder = inner
                continue
            action = draw(st.sampled_from(["replace", "remove", "double"]))
            if action == "replace":
                holder[key] = copy.deepcopy(draw(ODD))
            elif action == "remove":
                del holder[key]
            elif isinstance(holder, dict):
                holder[str(key) + draw(st.text(max_size=2))] = copy.deepcopy(inner)
            else:
                holder.append(copy.deepcopy(inner))
            break
    return document


def model_document(document) -> None:
    """A model is refused in one line, or simulates without a warning's worth of trouble."""
    try:
        model = model_from_document(document)
        with np.errstate(all="ignore"):
            output = simulate(model, np.zeros((4, len(model.axes))))
    except InputError as error:
        one_line(error)
    else:
        assert output.shape == (4, len(model.axes))


@st.composite
def damaged_bytes(draw, sources):
    """One of the sources with bytes replaced, cut out or put in."""
    data = bytearray(draw(st.sampled_from(sources)))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        action = draw(st.integers(0, 3))
        if action == 0:
            data[at : at + 1] = draw(st.binary(min_size=1, max_size=1))
        elif action == 1:
            del data[at : at + draw(st.integers(1, 40))]
        elif action == 2:
            data[at:at] = draw(st.binary(min_size=1, max_size=8))
        else:
            data = data[:at]
    return bytes(data)


def model_text(data: bytes) -> None:
    """The same for the bytes of a file."""
    with tempfile.TemporaryDirectory(dir=scratch()) as folder:
        path = Path(folder) / "model.yaml"
        path.write_bytes(data)
        try:
            load_model(path)
        except InputError as error:
            one_line(error)
            assert str(path) in str(error)
        assert [each.name for each in Path(folder).iterdir()] == ["model.yaml"]


MESSAGES = [
    Encoder(label).encode(np.arange(float(rows * columns)).reshape(rows, columns))
    for label, columns in (("t[s],x[um]", 2), ("t[s],x[mrad],y[mrad]", 3))
    for rows in (0, 1, 7)
]
MESSAGES.append(b"\x00\x01\x00\x00" + struct.pack("<III", 0, 0, 3) + bytes(28))
_decoder = Decoder()


def message(data: bytes) -> None:
    """A message gives a block that its label describes, the same from both readers, or is refused in one line."""
    found = []
    for read in (decode, _decoder.decode):
        try:
            label, block = read(data)
            assert block.ndim == 2 and (not label or block.shape[1] == label.count(",") + 1)
            found.append((label, block.tobytes()))
        except InputError as error:
            one_line(error)
            found.append(None)
    assert found[0] == found[1]


def bags() -> list[bytes]:
    """Small bags as bytes: finished, and cut off."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bag"
        with BagWriter(path) as writer:
            for k in range(6):
                writer.write("/command", Encoder("t[s],x[V]").encode(np.array([[k * 1e-3, 1.0]])), k)
                writer.write("/measurement", Encoder("t[s],x[um]").encode(np.array([[k * 1e-3, 2.0]])), k)
                if k == 3:
                    writer.flush()
        data = (path / "bag_0.mcap").read_bytes()
    return [data, data[: len(data) * 2 // 3]]


BAGS = bags()


def bag(data: bytes) -> None:
    """A damaged bag gives a record, or is refused in one line; nothing appears beside it."""
    with tempfile.TemporaryDirectory(dir=scratch()) as folder:
        path = Path(folder) / "a.mcap"
        path.write_bytes(data)
        try:
            record = read_bag(path)
            for signal in record.signals.values():
                assert signal.values.shape == (len(signal.time), len(signal.axes))
        except InputError as error:
            one_line(error)
        assert [each.name for each in Path(folder).iterdir()] == ["a.mcap"]


def scratch() -> str | None:
    """Memory in place of a disk, where there is some."""
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


NUMBERS = st.one_of(
    st.floats(-10, 10),
    st.integers(-3, 30),
    st.sampled_from([0.0, -0.0, 1e-12, 1e12, float("nan"), float("inf"), "1", None, True, [1.0], []]),
)


@st.composite
def descriptions(draw):
    """Excitations with parameters of all sorts."""
    kind = draw(st.sampled_from(sorted(KINDS)))
    names = [name for name in inspect.signature(KINDS[kind]).parameters if name not in ("sample_time", "axes")]
    spec = {name: draw(st.one_of(NUMBERS, st.lists(st.floats(0.1, 10), max_size=3))) for name in names if draw(st.integers(0, 3))}
    if "duration" in spec and isinstance(spec["duration"], (int, float)):
        spec["duration"] = min(spec["duration"], 5.0)
    return {"signal": kind, **spec}


def description(spec) -> None:
    """A description gives finite rows or is refused in one line."""
    try:
        with np.errstate(all="ignore"):
            rows = build(spec, 1e-2, 2)
    except InputError as error:
        one_line(error)
    else:
        assert rows.ndim == 2 and rows.shape[1] == 2 and np.isfinite(rows).all()


def saved_bags() -> list[dict[str, bytes]]:
    """Finished bags of every storage and compression, as their files' bytes by name."""
    store, found = get_typestore(Stores.ROS2_JAZZY), []
    for plugin in StoragePlugin:
        for mode in CompressionMode:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "bag"
                writer = Writer(path, version=9, storage_plugin=plugin)
                if mode != CompressionMode.NONE:
                    writer.set_compression(mode, CompressionFormat.ZSTD)
                try:
                    with writer:
                        for topic, unit in (("/command", "V"), ("/measurement", "um")):
                            connection = writer.add_connection(topic, MESSAGE_TYPE, typestore=store)
                            for k in range(4):
                                writer.write(connection, k, Encoder(f"t[s],x[{unit}]").encode(np.array([[k * 1e-3, 1.0]])))
                except WriterError:  # SQLite knows no compressed storage
                    continue
                found.append({each.name: each.read_bytes() for each in path.iterdir()})
    return found


SAVED = saved_bags()


@st.composite
def damaged_bags(draw):
    """A finished bag with one of its files damaged, emptied or left out."""
    files = dict(draw(st.sampled_from(SAVED)))
    name = draw(st.sampled_from(sorted(files)))
    action = draw(st.integers(0, 9))
    if action == 0:
        del files[name]
    elif action == 1:
        files[name] = b""
    else:
        files[name] = draw(damaged_bytes([files[name]]))
    return files


def finished_bag(files: dict[str, bytes]) -> None:
    """A damaged finished bag gives a record, or is refused in one line; nothing appears in it."""
    with tempfile.TemporaryDirectory(dir=scratch()) as folder:
        path = Path(folder) / "bag"
        path.mkdir()
        for name, content in files.items():
            (path / name).write_bytes(content)
        _read(path)
        assert {each.name for each in path.iterdir()} == set(files)


def _read(path: Path) -> None:
    try:
        record = read_bag(path)
        for signal in record.signals.values():
            assert signal.values.shape == (len(signal.time), len(signal.axes)) and np.isfinite(signal.time).all()
        assert not any("\n" in note for note in record.notes)
        record.aligned(allow_gaps=True)
    except InputError as error:
        one_line(error)


CELLS = st.one_of(
    st.none(), st.integers(-(2**63), 2**63 - 1), st.floats(), st.text(max_size=5), st.binary(max_size=30), st.sampled_from(MESSAGES)
)
COLUMNS = {"messages": ("id", "topic_id", "timestamp", "data"), "topics": ("id", "name", "type", "serialization_format")}
CHANGES = st.lists(
    st.sampled_from([(table, column) for table, columns in COLUMNS.items() for column in columns]).flatmap(
        lambda place: st.tuples(st.just(place[0]), st.just(place[1]), st.integers(1, 4), CELLS)
    ),
    min_size=1,
    max_size=4,
)


def database(changes) -> None:
    """A .db3 file whose columns are of no type and hold anything."""
    with tempfile.TemporaryDirectory(dir=scratch()) as folder:
        path = Path(folder) / "a.db3"
        with closing(sqlite3.connect(path)) as made:
            for table, columns in COLUMNS.items():
                made.execute(f"CREATE TABLE {table}({', '.join(columns)})")
            made.execute("INSERT INTO topics VALUES (1, '/command', ?, 'cdr')", (MESSAGE_TYPE,))
            made.execute("INSERT INTO topics VALUES (2, '/measurement', ?, 'cdr')", (MESSAGE_TYPE,))
            for k in range(4):
                made.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", (k, 1 + k % 2, k, MESSAGES[1]))
            for table, column, row, value in changes:
                made.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (value, row))
            made.commit()
        _read(path)


METADATA = [files["metadata.yaml"] for files in SAVED]


def metadata(data: bytes) -> None:
    """Whatever metadata.yaml says, an intact bag beside it is read, or refused in one line."""
    with tempfile.TemporaryDirectory(dir=scratch()) as folder:
        (Path(folder) / "bag_0.mcap").write_bytes(BAGS[0])
        (Path(folder) / "metadata.yaml").write_bytes(data)
        _read(Path(folder))


def tables() -> dict[str, bytes]:
    """Small tables of every kind, by the ending of their names."""
    values = np.random.default_rng(0).normal(size=(6, 2))
    made = {ending: io.BytesIO() for ending in (".npy", ".npz", ".mat", ".csv", ".dat", ".csv.gz")}
    np.save(made[".npy"], values)
    np.savez_compressed(made[".npz"], a=values)
    savemat(made[".mat"], {"a": values})
    np.savetxt(made[".csv"], values, delimiter=",", header="u,y", comments="")
    np.savetxt(made[".dat"], values)
    made[".csv.gz"].write(gzip.compress(b"1,5;2,5\n3,0;4,25\n", mtime=0))
    return {ending: file.getvalue() for ending, file in made.items()}


TABLES = tables()
_compressed = io.BytesIO()
savemat(_compressed, {"a": np.arange(12.0)}, do_compression=True)
COMPRESSED = _compressed.getvalue()
DAMAGED_TABLES = st.one_of(
    st.sampled_from(sorted({*TABLES} - {".mat"})).flatmap(
        lambda ending: st.tuples(st.just(ending), damaged_bytes([TABLES[ending]]))
    ),
    st.tuples(st.just(".csv"), st.text('0123456789.,; \t\ne-+uy"#%naif\ufeffé', max_size=60).map(str.encode)),
    st.tuples(st.just(".csv.gz"), st.binary(max_size=40).map(lambda data: gzip.compress(data, mtime=0))),
)
DAMAGED_MAT = st.tuples(st.just(".mat"), damaged_bytes([TABLES[".mat"], COMPRESSED]))
COLUMN_TEXTS = ("command=1[V],measurement=2[um]", "time=1[s],command=2[mV]", "command=u[V]", "measurement=1+2[m]", "command=0[kV]")


def table(given) -> None:
    """A damaged table gives finite signals, or is refused in one line."""
    (ending, data), columns, rate = given
    with tempfile.TemporaryDirectory(dir=scratch()) as folder:
        path = Path(folder) / f"run{ending}"
        path.write_bytes(data)
        try:
            record = import_table(path, parse_columns(columns), rate)
        except InputError as error:
            one_line(error)
        else:
            for signal in record.signals.values():
                assert np.isfinite(signal.values).all() and np.isfinite(signal.time).all()


DESCRIPTIONS = [
    b"signal: sine\nfrequency: 10\namplitude: 1.5\nduration: 0.5\n",
    b"signal: sequence\njoin: 0.1\nparts:\n- {signal: rest, duration: 0.1}\n"
    b"- {signal: steps, lowest: 0, highest: 5, hold: 0.1, count: 4}\n",
    b"signal: multisine\nperiod: 1.0\nlower_frequency: 1\nupper_frequency: 30\nrms: 2.0\nslew_limit: 1.0e+6\n",
    b"signal: staircase\nlevels: [0, 1, 2]\nhold: 0.1\nlower: -1\nupper: 5\n",
]


def excitation_file(data: bytes) -> None:
    """A damaged description gives finite rows, or is refused in one line."""
    with tempfile.TemporaryDirectory(dir=scratch()) as folder:
        path = Path(folder) / "excitation.yaml"
        path.write_bytes(data)
        try:
            spec = read_description([str(path)])
        except InputError as error:
            one_line(error)
        else:
            description(
                {**spec, **({"duration": min(spec["duration"], 5.0)} if isinstance(spec.get("duration"), (int, float)) else {})}
            )


TIME = st.one_of(
    st.floats(),
    st.integers(-5, 20).map(lambda k: k * 1e-3),
    st.sampled_from([1e305, -1e305, 1e-320, 9e9, 1.7e9, 5e-324, 2.0**52]),
)
TIMES = st.lists(TIME, max_size=6)


def times(given) -> None:
    """Records of any times give stretches on one clock, or are refused in one line."""
    command, measurement, timing, gaps = given
    signals = {
        name: Signal(np.array(stamps), np.zeros((len(stamps), 1)), ("x",), unit, timing)
        for name, stamps, unit in (("command", command, "V"), ("measurement", measurement, "um"))
    }
    try:
        with np.errstate(all="raise", under="ignore"):
            parts = Record(signals, "made").aligned(allow_gaps=gaps)
    except InputError as error:
        one_line(error)
    else:
        assert all(len(part.time) == len(part.command) and np.isfinite(part.time).all() for part in parts)


ROWS = st.lists(st.tuples(TIME, st.floats(), st.floats()), min_size=1, max_size=5)


def rows(given) -> None:
    """Rows of a message are admitted where they are finite ticks, or refused in one line; a receiver stays within its bounds."""
    messages, missing = given
    state = SignalRows(missing, 50, 0.0, 1e-3)
    for number, message in enumerate(messages):
        block = np.array(message)
        found = admit(block, 1e-3)
        if isinstance(found, Refusal):
            assert found.kind and found.reason and "\n" not in found.reason
        else:
            assert np.abs(block).max() <= LARGEST_VALUE and 0 <= found <= MAX_TICK
            state.receive(found, block[:, 1:], float(number))
            state.newest(found)
            assert state.behind(found) >= 0 and state.available <= 50 + len(block)


def any_yaml(data: bytes) -> None:
    """A text is read within its limits, or refused in one line."""
    with contextlib.suppress(UnicodeDecodeError):
        try:
            parse_yaml(data.decode(), "here")
        except InputError as error:
            one_line(error)


YAML_WORDS = st.lists(
    st.sampled_from(
        [
            "&a",
            "*a",
            "&b",
            "*b",
            "[",
            "]",
            "{",
            "}",
            ",",
            ": ",
            "- ",
            "\n",
            "<<",
            "!!timestamp",
            "!!int",
            "!!binary",
            "!!set",
            "!!omap",
        ]
        + [
            "1:59",
            "0x1f",
            "1e5",
            ".inf",
            "2001-01-01",
            "~",
            "'",
            '"',
            "|",
            ">",
            "? ",
            "%TAG",
            "---",
            "x",
            " ",
            "\t",
            "é",
            "!!python/name:os",
        ]
    ),
    max_size=25,
).map(lambda words: "".join(words).encode())


@cache
def controllers() -> tuple[Controller, CompiledProgram]:
    """A controller with short times, in Python and in C."""
    response = FaultResponse((2.0,), 3e3, "own", 3e-4, "automatic", 2e-4, -10.0, 30.0, 4e-4)
    found = Controller(PI(30.0, 900.0, 5e-5, 0.0, 50.0, 2e5, roll_off=300.0), 2, response)
    return found, CompiledProgram(Program("fuzzed", found.c_code(), 2, *found.slots(("x", "y"), "um"), 5e-5, ()))


STEPS = st.lists(
    st.tuples(st.tuples(*[st.one_of(st.floats(), st.floats(-5, 40))] * 4, st.sampled_from([0.0, 1.0, 1.0])), st.integers(1, 12)),
    min_size=1,
    max_size=12,
)


def controller_steps(given) -> None:
    """Inputs of any size, each for some ticks: the exported controller has Python's bits, and commands within the limits."""
    python, c = controllers()
    table = np.concatenate([np.tile(row, (count, 1)) for row, count in given])
    with np.errstate(all="ignore"):
        c.settle(table[0])
        python.settle(table[0])
        found = c.process(table)
        np.testing.assert_array_equal(found, python.process(table))
    assert np.all((found[:, :2] >= 0.0) & (found[:, :2] <= 50.0))


TARGETS = {
    "model documents": (damaged_documents(), model_document, 0.1),
    "model files": (damaged_bytes(TEXTS), model_text, 0.05),
    "messages": (damaged_bytes(MESSAGES), message, 0.25),
    "rows": (st.tuples(st.lists(ROWS, max_size=6), st.sampled_from(Missing)), rows, 0.05),
    "bags": (damaged_bytes(BAGS), bag, 0.1),
    "finished bags": (damaged_bags(), finished_bag, 0.1),
    "databases": (CHANGES, database, 0.05),
    "metadata": (damaged_bytes(METADATA), metadata, 0.05),
    "tables": (st.tuples(DAMAGED_TABLES, st.sampled_from(COLUMN_TEXTS), st.sampled_from([None, 10.0])), table, 0.095),
    "MATLAB files": (st.tuples(DAMAGED_MAT, st.sampled_from(COLUMN_TEXTS), st.sampled_from([None, 10.0])), table, 0.005),
    "times": (st.tuples(TIMES, TIMES, st.sampled_from(["layout", "receive"]), st.booleans()), times, 0.05),
    "excitations": (descriptions(), description, 0.03),
    "excitation files": (damaged_bytes(DESCRIPTIONS), excitation_file, 0.03),
    "texts": (YAML_WORDS, any_yaml, 0.04),
    **({"exported controller": (STEPS, controller_steps, 0.02)} if any(map(shutil.which, COMPILERS)) else {}),
}
"""By name: what comes in, what reads it, and its share of all inputs."""
