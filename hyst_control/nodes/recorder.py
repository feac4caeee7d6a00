"""The recorder: writes the signal topics to a rosbag2 MCAP bag that is readable at any moment, also when it is killed."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from std_msgs.msg import Int64

from hyst_control.bag_writer import BagWriter
from hyst_control.errors import InputError
from hyst_control.nodes.base import SignalNode
from hyst_control.nodes.messages import QUEUE, receive
from hyst_control.nodes.ports import tick_of
from hyst_control.nodes.rows import DUPLICATE
from hyst_control.nodes.run import main as run_main
from hyst_control.nodes.settings import Setting
from hyst_control.signal_message import Encoder

SIGNALS = ("reference", "feedforward", "feedback", "command", "measurement")
PROGRESS_INTERVAL = 64  # ticks


class Recorder(SignalNode):
    """Stores every row of `topics` once, by tick; rows repeated by the lockstep protocol are left out.

    Publishes on `recorded` the last tick up to which every topic is complete, for a plant that waits for it. With `ticks`
    it stores that many rows of every topic and ends. Values are stored as they come, a NaN too: it is evidence. `merge`
    stores several rows of a topic in one message of the same layout, which makes bags small and writing cheap.
    """

    SETTINGS = (
        Setting("output", "", "", "directory of the bag, which must not exist yet"),
        Setting("topics", SIGNALS, "", "topics to record"),
        Setting("merge", 1, "rows", "rows of a topic stored in one message at least, unless 0.5 s pass", 1, 65536),
        Setting("ticks", 0, "ticks", "rows of every topic after which the recorder ends, 0 for endless", 0, 2**52),
    )

    def __init__(self, name: str = "recorder", **options: Any) -> None:
        super().__init__(name, **options)
        if not self.settings.output:
            raise InputError(f"{self.get_name()}: parameter output: give the directory of the bag")
        self.ends = self.settings.ticks > 0
        self._writer = BagWriter(self.settings.output)
        self._progress = self.create_publisher(Int64, "recorded", QUEUE)
        self.told = -1
        self._topics = [_Topic(self, topic) for topic in self.settings.topics]
        self._flushed = 0
        self.every(0.5, self._flush)

    def store(self, topic: str, message: bytes) -> None:
        """Write a serialized message; a full disk ends the recorder with what is on it."""
        try:
            self._writer.write(topic, message, time.time_ns())
        except OSError as error:
            self._failed(error)

    def progress(self, repeat: bool = False) -> None:
        """Tell how far every topic is complete, unless that is little more than what was told last."""
        ends = [topic.end for topic in self._topics]
        if None in ends:
            return
        last = min(ends) - 1
        done = self.ends and (last >= self.settings.ticks - 1 if self.lockstep else
                              all(topic.arrived >= self.settings.ticks for topic in self._topics))
        if repeat or done or last - self.told >= (PROGRESS_INTERVAL if self.told >= 0 else 1):
            self.told = last
            self._progress.publish(Int64(data=last))
        if done and not self.finished.done():
            self.close()
            self.finish(self._progress)

    def status(self) -> dict[str, Any]:
        return {"last complete tick": self.told}

    def close(self) -> None:
        try:
            for topic in self._topics:
                topic.store()
            self._writer.close()
        except OSError as error:
            self._failed(error)

    def _flush(self) -> None:
        if not self.finished.done():
            try:
                for topic in self._topics:
                    topic.store()
                self._writer.flush()
            except OSError as error:
                self._failed(error)

    def _failed(self, error: OSError) -> None:
        if not self.finished.done():
            self.get_logger().error(f"{self.settings.output}: {error.strerror}: recording ends here")
            self.finish(self._progress, 2)


class _Topic:
    """One recorded topic: which ticks are stored."""

    def __init__(self, recorder: Recorder, topic: str) -> None:
        self._recorder, self._encoder = recorder, None
        self.end: int | None = None
        self.arrived = 0
        self._pending: list[NDArray[Any]] = []
        self._pending_rows = 0
        subscription = receive(recorder, topic, self._receive, lambda reason: recorder.drop(topic, "unreadable", reason),
                               recorder.settings.message_objects)
        self.name = subscription.topic_name
        recorder._writer.add_topic(self.name)

    def _receive(self, label: str, block: NDArray[Any]) -> None:
        recorder = self._recorder
        if recorder.finished.done():
            return
        try:
            if self._encoder is None or self._encoder.label != label:
                self.store()
                self._encoder = Encoder(label)
        except InputError as error:
            recorder.drop(self.name, "wrong label", str(error))
            return
        tick = tick_of(block, recorder.period) if len(block) else None
        if tick is None:
            recorder.drop(self.name, "off the clock", f"its times are not successive multiples of the period "
                                                      f"{recorder.period:g} s: is rate_hz the same everywhere?")
            return
        if recorder.lockstep and recorder.ends:
            block = block[:max(recorder.settings.ticks - tick, 0)]
            if not len(block):
                return
        if self.end is not None:
            if tick + len(block) <= self.end:
                recorder.counts[f"{self.name}: {DUPLICATE}"] += 1
                if recorder.lockstep:
                    recorder.progress(repeat=True)
                return
            if tick > self.end:
                recorder.counts[f"{self.name}: missed ticks"] += tick - self.end
                if recorder.lockstep:
                    recorder.warn(self.name, f"{self.name}: ticks {self.end} to {tick - 1} are lost: was their node killed?")
                self.store()  # the rows of one message are successive
            block = block[max(self.end - tick, 0):]
            tick = max(self.end, tick)
        self._pending.append(block)
        self._pending_rows += len(block)
        if self._pending_rows >= recorder.settings.merge:
            self.store()
        self.end = end = tick + len(block)
        self.arrived += len(block)
        complete = recorder.ends and max(end, self.arrived) >= recorder.settings.ticks
        if complete or recorder.told < 0 or end - recorder.told >= PROGRESS_INTERVAL:
            recorder.progress()

    def store(self) -> None:
        """Write the rows that wait to be merged."""
        if self._pending:
            rows = self._pending[0] if len(self._pending) == 1 else np.concatenate(self._pending)
            self._pending, self._pending_rows = [], 0
            self._recorder.store(self.name, self._encoder.encode(rows))


def main() -> int:
    """The executable."""
    return run_main(Recorder)


if __name__ == "__main__":
    raise SystemExit(main())
