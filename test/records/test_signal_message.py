"""The signal message against two other implementations of the wire format: rosbags' and, where present, ROS 2's own."""

from __future__ import annotations

import array
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from hyst_control.base.errors import InputError
from hyst_control.records.stream.signal_message import Decoder, Encoder, decode, label_for, parse_label

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPE = "std_msgs/msg/Float64MultiArray"
AXES = st.lists(st.text("abcxyzé_", min_size=1, max_size=9), min_size=1, max_size=4, unique=True)
BLOCK = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def rosbags_message(label: str, block: np.ndarray):
    dimension = STORE.types["std_msgs/msg/MultiArrayDimension"]
    layout = STORE.types["std_msgs/msg/MultiArrayLayout"]
    rows, columns = block.shape
    dimensions = [dimension("sample", rows, rows * columns), dimension(label, columns, columns)]
    return STORE.types[TYPE](layout(dimensions, 0), block.ravel())


@given(AXES, st.sampled_from(["V", "um", "mrad"]), st.integers(1, 70), BLOCK)
def test_bytes_read_the_same_in_rosbags_and_back(axes, unit, rows, generator):
    label = label_for(axes, unit)
    block = generator.standard_normal((rows, len(axes) + 1))
    message = STORE.deserialize_cdr(Encoder(label).encode(block), TYPE)
    assert [(d.label, d.size, d.stride) for d in message.layout.dim] == [
        ("sample", rows, block.size),
        (label, len(axes) + 1, len(axes) + 1),
    ]
    assert message.layout.data_offset == 0
    np.testing.assert_array_equal(message.data.reshape(block.shape), block)

    for little_endian in (True, False):
        raw = bytes(STORE.serialize_cdr(rosbags_message(label, block), TYPE, little_endian=little_endian))
        found, read = decode(raw)
        assert found == label
        np.testing.assert_array_equal(read, block)
    assert parse_label(label) == (tuple(axes), (unit,) * len(axes))


def test_same_message_as_ros_serialization():
    serialization = pytest.importorskip("rclpy.serialization")
    from std_msgs.msg import Float64MultiArray, MultiArrayDimension

    block = np.arange(12.0).reshape(4, 3) / 7
    label = label_for(["x", "y"], "mrad")
    message = Float64MultiArray(data=array.array("d", block.tobytes()))
    message.layout.dim = [
        MultiArrayDimension(label="sample", size=4, stride=12),
        MultiArrayDimension(label=label, size=3, stride=3),
    ]
    assert serialization.deserialize_message(Encoder(label).encode(block), Float64MultiArray) == message
    found, read = decode(serialization.serialize_message(message))
    assert found == label
    np.testing.assert_array_equal(read, block)


def test_message_without_layout_is_one_row():
    plain = STORE.types[TYPE](STORE.types["std_msgs/msg/MultiArrayLayout"]([], 0), np.array([1.0, 2.0]))
    label, block = decode(bytes(STORE.serialize_cdr(plain, TYPE)))
    assert label == ""
    np.testing.assert_array_equal(block, [[1.0, 2.0]])


def test_empty_block_round_trips():
    encoder = Encoder("t[s],x[um]")
    label, block = decode(encoder.encode(np.zeros((0, 2))))
    assert label == encoder.label and block.shape == (0, 2)


@given(st.lists(st.tuples(st.sampled_from(["t[s],x[um]", "t[s],x[V]", "t[s],x[um],y[um]"]), st.integers(1, 5)), max_size=12))
def test_decoder_with_memory_equals_the_plain_one(messages):
    decoder = Decoder()
    for index, (label, rows) in enumerate(messages):
        raw = Encoder(label).encode(np.full((rows, label.count(",") + 1), float(index)))
        found, block = decoder.decode(raw)
        expected_label, expected = decode(raw)
        assert found == expected_label
        np.testing.assert_array_equal(block, expected)


@given(st.binary(max_size=200))
def test_arbitrary_bytes_are_refused_or_read_but_never_crash(raw):
    try:
        label, block = decode(raw)
    except InputError:
        return
    assert block.ndim == 2 and (label == "" or label.count(",") + 1 == block.shape[1])


@given(st.data())
def test_damaged_messages_are_refused_or_read_but_never_crash(data):
    raw = bytearray(Encoder("t[s],x[um],y[um]").encode(np.ones((3, 3))))
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    raw = raw[: data.draw(st.integers(0, len(raw)))]
    try:
        label, block = Decoder().decode(bytes(raw))
    except InputError:
        return
    assert block.ndim == 2 and (label == "" or label.count(",") + 1 == block.shape[1])


@pytest.mark.parametrize("label", ["", "x[um]", "t[s]", "t[ms],x[um]", "t[s],x", "t[s],x[um],x[um]", "t[s],x[um"])
def test_labels_of_another_form_are_refused(label):
    with pytest.raises(InputError):
        Encoder(label)


def test_block_of_another_width_is_refused():
    with pytest.raises(InputError, match="2 columns"):
        Encoder("t[s],x[um],y[um]").encode(np.zeros((1, 2)))


def packed(dimensions, values, tail=b"", number=None):
    """A message as CDR by the rules of the format: dimensions (label, size, stride), then the values."""
    body = bytearray(struct.pack("<I", len(dimensions) if number is None else number))
    for label, size, stride in dimensions:
        body += bytes(-len(body) % 4) + struct.pack("<I", len(label) + 1) + label.encode() + b"\0"
        body += bytes(-len(body) % 4) + struct.pack("<II", size, stride)
    body += struct.pack("<II", 0, len(values))
    body += bytes(-len(body) % 8) if values else b""
    return b"\0\1\0\0" + bytes(body) + struct.pack(f"<{len(values)}d", *values) + tail


ROW, TWO = ("sample", 1, 2), ("t[s],x[um]", 2, 2)
LONG = packed([ROW, TWO], [0.0, 1.0])


@pytest.mark.parametrize(
    "message, words",
    [
        (packed([ROW, TWO], [0.0, 1.0], b"\0" * 8), "8 bytes follow its 2 values"),
        (packed([ROW, TWO, TWO], [0.0, 1.0]), "two dimensions, samples and columns, got 3"),
        (packed([("sample", 2, 2), TWO], [0.0, 1.0]), "does not fit its 2 values"),
        (packed([ROW, ("", 2, 2)], [0.0, 1.0]), "got none"),
        (packed([ROW, ("t[s],x[um],y[um]", 2, 2)], [0.0, 1.0]), "names 3 columns, the layout has 2"),
        (packed([], [], b"\0" * 400, number=17), "two dimensions, samples and columns, got 17"),
        (LONG[:8] + struct.pack("<I", 1 << 20) + LONG[12:], "cut short within its layout"),
    ],
)
def test_every_disagreement_of_a_layout_is_named(message, words):
    with pytest.raises(InputError, match=words):
        decode(message)
    assert decode(LONG)[1].tolist() == [[0.0, 1.0]]


def test_many_numbered_axes_are_one_entry_of_the_label():
    axes = [f"a{number}" for number in range(5000)]
    label = label_for(axes, "um")
    assert label == "t[s],a0..a4999[um]"
    assert parse_label(label) == (tuple(axes), ("um",) * 5000)
    block = np.random.default_rng(0).standard_normal((3, 5001))
    message = STORE.deserialize_cdr(Encoder(label).encode(block), TYPE)
    assert [(d.label, d.size, d.stride) for d in message.layout.dim] == [("sample", 3, 15003), (label, 5001, 5001)]
    found, back = decode(Encoder(label).encode(block))
    assert found == label and np.array_equal(back, block)


@pytest.mark.parametrize(
    ("axes", "label"),
    [
        (["x", "y"], "t[s],x[V],y[V]"),
        ([f"a{n}" for n in range(15)], "t[s]," + ",".join(f"a{n}[V]" for n in range(15))),
        (["x", *(f"a{n}" for n in range(9, 30)), "y"], "t[s],x[V],a9..a29[V],y[V]"),
        ([f"a{n:03d}" for n in range(20)], "t[s]," + ",".join(f"a{n:03d}[V]" for n in range(20))),
    ],
)
def test_few_or_other_names_are_written_one_by_one(axes, label):
    assert label_for(axes, "V") == label and parse_label(label)[0] == tuple(axes)


@pytest.mark.parametrize(
    "label", ["t[s],a0..a999999999[um]", "t[s],a0..a4999[um],a7[um]", "t[s]," + "a0..a60000[um]," * 3 + "x[um]"]
)
def test_labels_of_too_many_columns_are_refused_at_once(label):
    with pytest.raises(InputError, match="more than 100000|twice"):
        parse_label(label)
