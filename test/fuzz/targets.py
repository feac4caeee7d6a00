"""Fuzzed inputs: model files, bags and messages that are nearly right. Whatever comes in, it is read or refused in one line."""

from __future__ import annotations

import copy
import inspect
import os
import struct
import tempfile
from pathlib import Path

import numpy as np
import yaml
from hypothesis import strategies as st

from hyst_control.config_files import config_path
from hyst_control.errors import InputError
from hyst_control.model_file import load_model, model_from_document, simulate
from hyst_control.records.bag_reader import read_bag
from hyst_control.records.bag_writer import BagWriter
from hyst_control.records.excitation import KINDS, build
from hyst_control.records.signal_message import Decoder, Encoder, decode

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


TARGETS = {
    "model documents": (damaged_documents(), model_document, 0.1),
    "model files": (damaged_bytes(TEXTS), model_text, 0.1),
    "messages": (damaged_bytes(MESSAGES), message, 0.5),
    "bags": (damaged_bytes(BAGS), bag, 0.25),
    "excitations": (descriptions(), description, 0.05),
}
"""By name: what comes in, what reads it, and its share of all inputs."""
