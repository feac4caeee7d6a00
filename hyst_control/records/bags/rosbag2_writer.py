# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Writing bags through `rosbag2_py` of a ROS installation, where the package `mcap`, which has no rosdep key, is missing."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml

from hyst_control.base.errors import InputError
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.stream.signal_message import MESSAGE_TYPE


def open_bag(path: str | Path, custom_data: dict[str, str] | None = None) -> BagWriter | Rosbag2Writer:
    """Open a new bag with what this computer has to write it."""
    if find_spec("mcap"):
        return BagWriter(path, custom_data)
    if find_spec("rosbag2_py"):
        return Rosbag2Writer(path, custom_data)
    raise InputError(f"{path}: nothing here writes bags: install mcap with pip, or rosbag2_py of a ROS installation")


class Rosbag2Writer:
    """An open bag of Float64MultiArray topics, with the methods of `BagWriter`; each message goes straight to the file."""

    def __init__(self, path: str | Path, custom_data: dict[str, str] | None = None) -> None:
        import rosbag2_py

        self.path, self.custom_data = Path(path), custom_data
        if self.path.exists():
            raise InputError(f"{path}: exists already: choose another name or remove it")
        self._topic, self._topics, self._closed = rosbag2_py.TopicMetadata, set[str](), False
        self._writer: Any = rosbag2_py.SequentialWriter()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._writer.open(
                rosbag2_py.StorageOptions(uri=str(self.path), storage_id="mcap", max_cache_size=0),
                rosbag2_py.ConverterOptions("", ""),
            )
        except (OSError, RuntimeError) as error:
            raise InputError(f"{path}: {error}: choose a folder that can be written") from None

    def add_topic(self, topic: str) -> None:
        """Make a topic known, also when it will get no message."""
        if topic not in self._topics:
            self._writer.create_topic(self._topic(id=len(self._topics), name=topic, type=MESSAGE_TYPE, serialization_format="cdr"))
            self._topics.add(topic)

    def write(self, topic: str, message: bytes, time: int) -> None:
        """Append a serialized message of a topic; time: ns since the epoch, of its reception."""
        self.add_topic(topic)
        try:
            self._writer.write(topic, message, time)
        except RuntimeError as error:  # what rosbag2 makes of a full disk
            raise OSError(str(error)) from None

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Finish the bag; closing twice does nothing."""
        if self._closed:
            return
        self._closed = True
        self._writer.close()
        if self.custom_data:
            file = self.path / "metadata.yaml"
            said = yaml.safe_load(file.read_text(encoding="utf-8"))
            said["rosbag2_bagfile_information"]["custom_data"] = self.custom_data
            file.write_text(yaml.safe_dump(said, sort_keys=False), encoding="utf-8")

    abandon = close

    def __enter__(self) -> Rosbag2Writer:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()
