"""The recorder: writes the signal topics to a rosbag2 MCAP bag that is readable at any moment, also when it is killed."""

from __future__ import annotations

import time
from typing import Any

from std_msgs.msg import Int64

from hyst_control.errors import InputError
from hyst_control.nodes.base import SignalNode
from hyst_control.nodes.interrupts import undivided
from hyst_control.nodes.message_io import QUEUE
from hyst_control.nodes.parameters import Setting
from hyst_control.nodes.recorded_topic import RecordedTopic
from hyst_control.nodes.run import main as run_main
from hyst_control.records.bag_writer import BagWriter
from hyst_control.records.row_repetition import REPEAT_INTERVAL, RepetitionBackoff

SIGNALS = ("reference", "feedforward", "feedback", "command", "measurement")
PROGRESS_INTERVAL = 64  # ticks
DRAIN_INTERVAL = {"lockstep": 0.005, "timer": 0.02}
"""s, between two looks at what has arrived: the queues hold far more, and a callback for every message would cost ten times as much."""


class Recorder(SignalNode):
    """Stores every row of `topics` once, by tick; rows repeated by the lockstep protocol are left out.

    In lockstep rows behind missing ones are held until these are sent again: under load the middleware may lose a message. What does
    not come for some seconds is a gap in the bag.

    Publishes on `recorded` the last tick up to which every topic is complete, for a plant that waits for it. With `ticks`
    it stores that many rows of every topic and ends. Values are stored as they come, a NaN too: it is evidence. `merge`
    stores several rows of a topic in one message of the same layout, which makes bags small and writing cheap.
    """

    SETTINGS = (
        Setting("output", "", "", "directory of the bag, which must not exist yet"),
        Setting("topics", SIGNALS, "", "topics to record"),
        Setting("merge", 1, "rows", "rows of a topic stored in one message at least, unless 0.5 s pass", 1, 65536),
        Setting("ticks", 0, "ticks", "rows of every topic after which the recorder ends, 0 for endless", 0, 2**52),
        Setting("duration", 0.0, "s", "time after which the recorder ends, 0 for endless", 0.0, 1e9),
    )

    _failure = ""
    """Reason why the bag could not be written any further."""

    def __init__(self, name: str = "recorder", **options: Any) -> None:
        super().__init__(name, **options)
        if not self.settings.output:
            raise InputError(f"{self.get_name()}: parameter output: give the directory of the bag")
        self.ends = self.settings.ticks > 0 or self.settings.duration > 0
        self._writer = BagWriter(self.settings.output)
        self._progress = self.create_publisher(Int64, "recorded", QUEUE)
        self.told = -1
        self._repetition = RepetitionBackoff(time.monotonic(), longest=REPEAT_INTERVAL)  # of what was told
        self._topics = [
            RecordedTopic(self, topic, self.store, self.repeat_progress, self.settings.merge, self.settings.ticks)
            for topic in self.settings.topics
        ]
        for topic in self._topics:
            self._writer.add_topic(topic.name)
        self.every(DRAIN_INTERVAL[self.settings.schedule], self._drain)
        self.every(0.5, self._flush)
        if self.settings.duration:
            self.every(self.settings.duration, self._time_is_up)

    def store(self, topic: str, message: bytes, stamp: int) -> None:
        """Write a serialized message; a full disk ends the recorder with what is on it."""
        if not self.finished.done():
            try:
                self._writer.write(topic, message, stamp)
            except OSError as error:
                self._failed(error)

    def repeat_progress(self) -> None:
        """Tell again how far every topic is complete, unless that was told a moment ago."""
        self.progress(repeat=True)

    def progress(self, repeat: bool = False) -> None:
        """Tell how far every topic is complete, unless that is little more than what was told last; `repeat`: tell it again."""
        if not all(topic.rows.joined for topic in self._topics):
            return
        last = min(topic.rows.awaited for topic in self._topics) - 1
        wanted = self.settings.ticks
        done = wanted and (last >= wanted - 1 if self.lockstep else all(topic.recorded >= wanted for topic in self._topics))
        now = time.monotonic()
        repeat = repeat and self._repetition.due(now)
        if repeat or done or last - self.told >= (PROGRESS_INTERVAL if self.told >= 0 else 1):
            self.told = last
            self._repetition.progress(now)
            self._progress.publish(Int64(data=last))
        if done and not self.finished.done():
            self.close()
            self.finish(self._progress)

    def trouble(self) -> str:
        return self._failure

    def status(self) -> dict[str, Any]:
        return {"last complete tick": self.told}

    def close(self) -> None:
        if self._failure:  # nothing more goes onto the disk
            self._writer.abandon()
            return
        try:
            for topic in self._topics:
                topic.drain()
                topic.close()
            self._writer.close()
        except OSError as error:
            self._failed(error)

    def _drain(self) -> None:
        if not self.finished.done():
            with undivided():  # what was taken from the queues would be missing in the bag
                for topic in self._topics:
                    topic.drain()
            self.progress()

    def _flush(self) -> None:
        if not self.finished.done():
            try:
                with undivided():
                    for topic in self._topics:
                        topic.write()
                    self._writer.flush()
            except OSError as error:
                self._failed(error)

    def _time_is_up(self) -> None:
        if not self.finished.done():
            self.close()
            self.finish(self._progress)

    def _failed(self, error: OSError) -> None:
        if not self._failure:
            self._failure = error.strerror or str(error)
            self.get_logger().error(
                f"{self.settings.output}: {self._failure}: recording ends here; what was stored before is readable"
            )
            self.finish(self._progress, 2)


def main() -> int:
    """The executable."""
    return run_main(Recorder)


if __name__ == "__main__":
    raise SystemExit(main())
