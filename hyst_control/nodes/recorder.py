# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Recorder node: writes the signal topics to a rosbag2 MCAP bag that stays readable at any moment, even if the node is killed."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

from std_msgs.msg import Int64

from hyst_control.base.errors import InputError
from hyst_control.nodes.execution.interrupts import delayed
from hyst_control.nodes.execution.run import executable
from hyst_control.nodes.loop.recorded_topic import RecordedTopic
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.nodes.signal_node.message_io import QUEUE
from hyst_control.nodes.signal_node.parameters import Setting
from hyst_control.records.actuator_following import APPLIED
from hyst_control.records.bags.rosbag2_writer import open_bag
from hyst_control.records.stream.row_repetition import REPEAT_INTERVAL, RepetitionBackoff

SIGNALS = ("reference", "feedforward", "feedback", "command", "measurement")
PROGRESS_INTERVAL = 64  # ticks
DRAIN_INTERVAL = {"lockstep": 0.005, "timer": 0.02}
"""s, between two polls of the subscriptions: their queues hold far more, and one callback per message would cost ten times as much."""


class Recorder(SignalNode):
    """Node that stores every row of `topics` once, by tick; repetitions of the lockstep protocol are left out.

    In lockstep, rows after missing ones are held back until the missing ones are sent again, because the middleware may lose messages
    under load. Rows that are still missing after some seconds are a gap in the bag.

    It publishes on `recorded` the last tick up to which every topic is complete, for a plant that waits for it. With `ticks` it stores
    that many rows of every topic and ends. Values are stored as received, NaN included, because they are evidence. `merge` stores
    several rows of a topic in one message of the same layout, which makes bags smaller and writing cheaper.

    Under the timer, what the plant says on `applied` is stored beside `command`: rows at which the actuator did not follow it are no
    answer to it. Nothing is said there while it does, so no run waits for this topic.
    """

    SETTINGS = (
        Setting("output", "", "", "directory of the bag, which must not exist yet"),
        Setting("topics", SIGNALS, "", "topics to record"),
        Setting("merge", 1, "rows", "least number of rows stored in one message, unless 0.5 s have passed", 1, 65536),
        Setting("ticks", 0, "ticks", "rows of every topic after which the recorder ends, 0 for endless", 0, 2**52),
        Setting("duration", 0.0, "s", "time after which the recorder ends, 0 for endless", 0.0, 1e9),
    )

    _failure = ""  # Error that ended the writing of the bag; "" when there is none
    _said = False  # True once it was told how much was recorded

    def __init__(self, name: str = "recorder", **options: Any) -> None:
        super().__init__(name, **options)
        if not self.settings.output:
            raise InputError(f"{self.get_name()}: parameter output: give the directory of the bag")
        self.ends = self.settings.ticks > 0 or self.settings.duration > 0
        self._progress = self.create_publisher(Int64, "recorded", QUEUE)
        self.last_complete_tick = -1
        self._repetition = RepetitionBackoff(time.monotonic(), longest=REPEAT_INTERVAL)  # of the progress
        again = partial(self.progress, repeat=True)
        self._topics = [
            RecordedTopic(self, topic, self.store, again, self.settings.merge, self.settings.ticks)
            for topic in self.settings.topics
        ]
        beside = not self.lockstep and "command" in self.settings.topics and APPLIED not in self.settings.topics
        self._beside = [RecordedTopic(self, APPLIED, self.store, again, sparse=True)] if beside else []
        self._writer = open_bag(self.settings.output)  # once nothing else can be refused, which would leave an empty one
        for topic in self._topics:
            self._writer.add_topic(topic.name)
        self.every(DRAIN_INTERVAL[self.settings.schedule], self._drain)
        self.every(0.5, self._flush)
        if self.settings.duration:
            self.every(self.settings.duration, self._end)

    def store(self, topic: str, message: bytes, stamp: int) -> None:
        """Write a serialized message; when that fails, as on a full disk, the recorder ends and keeps the bag so far."""
        if not self.finished.done():
            try:
                self._writer.write(topic, message, stamp)
            except OSError as error:
                self._failed(error)

    def progress(self, repeat: bool = False) -> None:
        """Publish the last tick up to which every topic is complete, if it has advanced enough, or is asked for anew."""
        if not all(topic.rows.joined for topic in self._topics):
            return
        last = min(topic.rows.awaited for topic in self._topics) - 1
        wanted = self.settings.ticks
        done = wanted and (last >= wanted - 1 if self.lockstep else all(topic.recorded >= wanted for topic in self._topics))
        now = time.monotonic()
        repeat = repeat and self._repetition.due(now)
        if repeat or done or last - self.last_complete_tick >= (PROGRESS_INTERVAL if self.last_complete_tick >= 0 else 1):
            self.last_complete_tick = last
            self._repetition.progress(now)
            self._progress.publish(Int64(data=last))
        if done:
            self._end()

    def trouble(self) -> str:
        return self._failure

    def status(self) -> dict[str, Any]:
        return {"last complete tick": self.last_complete_tick}

    def close(self) -> None:
        if self._failure:  # the disk takes no more
            self._writer.abandon()
            return
        try:
            for topic in (*self._topics, *self._beside):
                topic.drain()
                topic.close()
            if not self.lockstep:
                clock = "simulated" if self.timer.simulated else "CLOCK_MONOTONIC"
                self._writer.custom_data = {"clock": clock, "offset_to_ros_time": f"{self.timer.offset_to_ros_time:.6f}"}
            self._writer.close()
            self._say_recorded()
        except OSError as error:
            self._failed(error)

    def _say_recorded(self) -> None:
        """Log how much was recorded, once."""
        if self._said:
            return
        self._said = True
        rows = {topic.name: topic.recorded for topic in self._topics}
        least, most = min(rows.values(), default=0), max(rows.values(), default=0)
        count = f"{most} rows" if least == most else f"{least} to {most} rows"
        self.get_logger().info(f"{self.settings.output}: recorded {count} of each of {len(rows)} topics")
        silent = [name for name, recorded in rows.items() if not recorded]
        if silent:
            self.get_logger().warning(f"nothing has come on {', '.join(silent)}")

    def _drain(self) -> None:
        if not self.finished.done():
            with delayed():  # rows taken from the queues must reach the bag
                for topic in (*self._topics, *self._beside):
                    topic.drain()
            self.progress()

    def _flush(self) -> None:
        if not self.finished.done():
            try:
                with delayed():
                    for topic in (*self._topics, *self._beside):
                        topic.write()
                    self._writer.flush()
            except OSError as error:
                self._failed(error)

    def _end(self) -> None:
        if not self.finished.done():
            self.close()
            self.finish(self._progress)

    def _failed(self, error: OSError) -> None:
        if not self._failure:
            self._failure = error.strerror or str(error)
            self.get_logger().error(
                f"{self.settings.output}: {self._failure}: recording ends here; the bag holds all rows stored before and is readable"
            )
            self.finish(self._progress, 2)


main = executable(Recorder)

if __name__ == "__main__":
    raise SystemExit(main())
