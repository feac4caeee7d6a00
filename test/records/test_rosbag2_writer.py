# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Bags written by rosbag2_py. It has no wheel, so a stub records the calls that it would receive."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest
import yaml

from hyst_control.base.errors import InputError
from hyst_control.records.bags import rosbag2_writer
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.bags.rosbag2_writer import open_bag


class Writer:
    """Calls of rosbag2_py.SequentialWriter."""

    made: list = []

    def __init__(self):
        self.topics, self.messages, self.full = [], [], False
        self.made.append(self)

    def open(self, storage, converter):
        self.storage = storage

    def create_topic(self, topic):
        self.topics.append((topic.name, topic.type, topic.serialization_format))

    def write(self, topic, message, time):
        if self.full:
            raise RuntimeError("No space left on device")
        self.messages.append((topic, message, time))

    def close(self):
        from pathlib import Path

        folder = Path(self.storage.uri)
        folder.mkdir()
        (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9, custom_data: null}\n")


@pytest.fixture
def stub(monkeypatch):
    kinds = dict.fromkeys(("StorageOptions", "TopicMetadata"), SimpleNamespace)
    monkeypatch.setitem(
        sys.modules, "rosbag2_py", SimpleNamespace(SequentialWriter=Writer, ConverterOptions=lambda *_: None, **kinds)
    )
    monkeypatch.setattr(rosbag2_writer, "find_spec", lambda name: name if name == "rosbag2_py" else None)


def test_rows_and_facts_go_through_it(stub, tmp_path):
    with open_bag(tmp_path / "bag", {"hold": "foh"}) as bag:
        bag.add_topic("command")
        bag.write("command", b"1", 5)
        bag.write("measurement", b"2", 6)
    kept = Writer.made[-1]
    assert [name for name, *_ in kept.topics] == ["command", "measurement"]
    assert kept.topics[0][1:] == ("std_msgs/msg/Float64MultiArray", "cdr")
    assert kept.messages == [("command", b"1", 5), ("measurement", b"2", 6)] and kept.storage.storage_id == "mcap"
    said = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
    assert said["rosbag2_bagfile_information"]["custom_data"] == {"hold": "foh"}
    with pytest.raises(InputError, match="exists already"):
        open_bag(tmp_path / "bag")


def test_a_full_disk_is_an_error_of_the_machine(stub, tmp_path):
    bag = open_bag(tmp_path / "bag")
    Writer.made[-1].full = True
    with pytest.raises(OSError, match="No space"):
        bag.write("command", b"1", 5)


def test_who_writes_is_chosen_by_what_is_there(tmp_path, monkeypatch):
    with open_bag(tmp_path / "bag") as bag:
        assert isinstance(bag, BagWriter)
    monkeypatch.setattr(rosbag2_writer, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="install mcap"):
        open_bag(tmp_path / "other")
