"""Bags as other readers see them: finished ones in rosbags, unfinished ones in the mcap package."""

from __future__ import annotations

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from hyst_control.base.errors import InputError
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.stream.signal_message import Encoder, decode

LABELS = {"/command": "t[s],x[V]", "/measurement": "t[s],x[um]"}


def fill(writer: BagWriter, count: int) -> None:
    encoders = {topic: Encoder(label) for topic, label in LABELS.items()}
    for index in range(count):
        for topic, encoder in encoders.items():
            writer.write(topic, encoder.encode(np.array([[index * 1e-3, np.sqrt(index)]])), 10**9 + index * 10**6)


def test_finished_bag_opens_in_rosbags(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/reference")
        fill(writer, 700)
    with AnyReader([tmp_path / "bag"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        assert reader.message_count == 1400 and reader.duration == 699 * 10**6 + 1
        assert set(reader.topics) == {"/reference", "/command", "/measurement"}
        rows = [
            reader.deserialize(raw, connection.msgtype).data
            for connection, _, raw in reader.messages()
            if connection.topic == "/command"
        ]
    np.testing.assert_array_equal(rows, np.stack([np.arange(700) * 1e-3, np.sqrt(np.arange(700))], axis=1))


def test_unfinished_bag_gives_back_all_that_was_flushed(tmp_path):
    writer = BagWriter(tmp_path / "bag")
    fill(writer, 2000)
    writer.flush()
    fill(writer, 30)
    found = []
    with open(tmp_path / "bag" / "bag_0.mcap", "rb") as file:
        try:
            for record in StreamReader(file).records:
                if type(record).__name__ == "Message":
                    found.append(decode(record.data)[1][0, 0])
        except McapError:
            pass
    np.testing.assert_array_equal(found, np.repeat(np.arange(2000) * 1e-3, 2))
    writer.close()


def test_existing_path_is_refused_and_left_alone(tmp_path):
    (tmp_path / "bag").mkdir()
    with pytest.raises(InputError, match="exists already"):
        BagWriter(tmp_path / "bag")
    assert list((tmp_path / "bag").iterdir()) == []
