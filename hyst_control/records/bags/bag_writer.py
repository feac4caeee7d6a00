# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Writing rosbag2 MCAP bags of signal messages, so that what is on disk is readable at any moment.

The bag is a directory with one MCAP file and, once closed, metadata.yaml. Chunks are small beside the file and each goes straight
to it: when the writer is killed, all but the last chunk can be read back with the file's definitions, which stand first. Whoever calls
`flush` in time has no more to lose than what came since.
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml

from hyst_control.base.errors import InputError
from hyst_control.records.stream.signal_message import MESSAGE_TYPE

CHUNK_SIZE = 16 * 1024  # bytes, at least
MAX_CHUNKS = 4096
"""Chunks of CHUNK_SIZE; behind them each is a share of 1 / MAX_CHUNKS of the file, since the writer keeps an index entry of every chunk
in memory until the bag is closed."""
TYPE_HASH = "RIHS01_1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f"
DEFINITION = f"""std_msgs/MultiArrayLayout layout
float64[] data
{"=" * 80}
MSG: std_msgs/MultiArrayLayout
std_msgs/MultiArrayDimension[] dim
uint32 data_offset
{"=" * 80}
MSG: std_msgs/MultiArrayDimension
string label
uint32 size
uint32 stride
"""
# rosbag2 replays a topic with the quality it was offered with: reliable, keep last.
OFFERED_QOS = [
    {
        "history": "keep_last",
        "depth": 5000,
        "reliability": "reliable",
        "durability": "volatile",
        "deadline": {"sec": 9223372036, "nsec": 854775807},
        "lifespan": {"sec": 9223372036, "nsec": 854775807},
        "liveliness": "automatic",
        "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
        "avoid_ros_namespace_conventions": False,
    }
]


class BagWriter:
    """An open bag of Float64MultiArray topics; use it as a context manager or call `close`."""

    def __init__(self, path: str | Path, custom_data: dict[str, str] | None = None) -> None:
        """Create the directory `path`, whose metadata.yaml says `custom_data` besides; `InputError` when it exists or cannot be created."""
        from mcap.writer import CompressionType, Writer  # a ROS installation may not have it: see rosbag2_writer

        self.path = Path(path)
        self.custom_data = custom_data
        try:
            self.path.mkdir(parents=True)
            self._file = open(self.path / f"{self.path.name}_0.mcap", "wb")
        except FileExistsError:
            raise InputError(f"{path}: exists already: choose another name or remove it") from None
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}: choose a folder that can be written") from None
        self._writer = Writer(self._file, chunk_size=sys.maxsize, compression=CompressionType.NONE)
        self._writer.start(profile="ros2", library="hyst_control")
        self._schema = self._writer.register_schema(MESSAGE_TYPE, "ros2msg", DEFINITION.encode())
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._first: int | None = None
        self._last = 0
        self._unwritten = self._written = 0  # bytes
        self._closed = False

    def add_topic(self, topic: str) -> None:
        """Make a topic known, also when it will get no message."""
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(
                topic, "cdr", self._schema, {"offered_qos_profiles": yaml.safe_dump(OFFERED_QOS, sort_keys=False)}
            )
            self._counts[topic] = 0

    def write(self, topic: str, message: bytes, time: int) -> None:
        """Append a serialized message of a topic; time: ns since the epoch, of its reception."""
        if topic not in self._channels:
            self.add_topic(topic)
        self._writer.add_message(self._channels[topic], time, message, time, self._counts[topic])
        self._counts[topic] += 1
        if self._first is None or time < self._first:
            self._first = time
        if time > self._last:
            self._last = time
        self._unwritten += len(message)
        if self._unwritten >= max(CHUNK_SIZE, self._written // MAX_CHUNKS):
            self.flush()

    def flush(self) -> None:
        """Hand everything written so far to the operating system, as a whole chunk."""
        self._written += self._unwritten
        self._unwritten = 0
        self._writer.flush()  # type: ignore[no-untyped-call]  # mcap leaves it untyped

    def close(self) -> None:
        """Finish the file and write metadata.yaml; closing twice does nothing."""
        if self._closed:
            return
        self._closed = True
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it untyped
        finally:
            self._file.close()
        (self.path / "metadata.yaml").write_text(yaml.safe_dump(self._metadata(), sort_keys=False), encoding="utf-8")

    def abandon(self) -> None:
        """Leave the file as it is, after a write that failed: its whole chunks can be read."""
        self._closed = True
        with suppress(OSError):
            self._file.close()

    def _metadata(self) -> dict[str, Any]:
        first = self._first or 0
        span = {
            "duration": {"nanoseconds": max(self._last - first, 0)},
            "starting_time": {"nanoseconds_since_epoch": first},
            "message_count": sum(self._counts.values()),
        }
        file = f"{self.path.name}_0.mcap"
        topics = [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": MESSAGE_TYPE,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": OFFERED_QOS,
                    "type_description_hash": TYPE_HASH,
                },
                "message_count": count,
            }
            for topic, count in self._counts.items()
        ]
        document = {
            "version": 9,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file],
            "files": [{"path": file, **span}],
            "custom_data": self.custom_data,
            "ros_distro": "jazzy",
        }
        # without parts that stand in it twice, of which YAML would make anchors: rosbag2's reader knows none
        return {"rosbag2_bagfile_information": json.loads(json.dumps(document))}

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if isinstance(error, (OSError, MemoryError)):  # what is written now would meet the same
            self.abandon()
        else:
            self.close()
