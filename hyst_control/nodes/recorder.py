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
from hyst_control.nodes.interrupts import undivided
from hyst_control.nodes.messages import QUEUE
from hyst_control.nodes.ports import REPEAT_INTERVAL, Joining, tick_of
from hyst_control.nodes.rows import DUPLICATE
from hyst_control.nodes.run import main as run_main
from hyst_control.nodes.settings import Setting
from hyst_control.signal_message import Encoder

Array = NDArray[np.float64]

SIGNALS = ("reference", "feedforward", "feedback", "command", "measurement")
PROGRESS_INTERVAL = 64  # ticks
PATIENCE = 5.0
"""s, for which rows that are missing in lockstep are waited for: the plant repeats what it sent long before that."""
DRAIN_INTERVAL = {"lockstep": 0.005, "timer": 0.02}
"""s, between two looks at what has arrived: the queues hold far more, and a callback for every message would cost ten times as much."""


class Recorder(SignalNode):
    """Stores every row of `topics` once, by tick; rows repeated by the lockstep protocol are left out.

    In lockstep rows behind missing ones are held until these are sent again: under load the middleware may lose a message. What does
    not come for `PATIENCE` s is a gap in the bag.

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
    """Why the bag could not be written any further."""

    def __init__(self, name: str = "recorder", **options: Any) -> None:
        super().__init__(name, **options)
        if not self.settings.output:
            raise InputError(f"{self.get_name()}: parameter output: give the directory of the bag")
        self.ends = self.settings.ticks > 0 or self.settings.duration > 0
        self._writer = BagWriter(self.settings.output)
        self._progress = self.create_publisher(Int64, "recorded", QUEUE)
        self.told = -1
        self._repeated = 0.0  # s, monotonic clock: when it was told again last
        self._topics = [_Topic(self, topic) for topic in self.settings.topics]
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

    def progress(self, repeat: bool = False) -> None:
        """Tell how far every topic is complete, unless that is little more than what was told last; `repeat`: tell it again."""
        if not all(topic.joined for topic in self._topics):
            return
        last = min(topic.end for topic in self._topics) - 1
        wanted = self.settings.ticks
        done = wanted and (last >= wanted - 1 if self.lockstep else all(topic.arrived >= wanted for topic in self._topics))
        now = time.monotonic()
        repeat = repeat and now - self._repeated > REPEAT_INTERVAL
        if repeat or done or last - self.told >= (PROGRESS_INTERVAL if self.told >= 0 else 1):
            self.told, self._repeated = last, now
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
                        topic.store()
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
            self.get_logger().error(f"{self.settings.output}: {self._failure}: recording ends here; what was stored before is "
                                    "readable")
            self.finish(self._progress, 2)


class _Topic:
    """One recorded topic: which ticks are stored.

    Until it is known to be heard from its first row on, its rows are held back; and those behind a gap until it is filled.
    """

    def __init__(self, recorder: Recorder, topic: str) -> None:
        self._recorder, self._encoder = recorder, None
        self.end: int | None = None
        self.joined = False
        self._joining = Joining()
        self._begin = 0  # tick of the first row that was heard
        self.arrived = 0
        self._pending: list[Array] = []
        self._pending_rows = 0
        self._behind: dict[int, Array] = {}  # rows behind a gap, by the tick of the first of them
        self._gap_since = 0.0  # s, monotonic clock
        self._stamp = 0  # ns, of the reception of the newest rows
        self._intake = recorder.intake(topic)
        self.name = self._intake.subscription.topic_name
        recorder._writer.add_topic(self.name)

    def drain(self) -> None:
        """Take everything that has arrived."""
        recorder = self._recorder
        for label, block, stamp in self._intake.take(self._refused, recorder.settings.merge > 1):
            self._stamp = stamp
            if not self._take_at_once(label, block):
                self._receive(label, block)
        if self._behind:
            self._go_on_behind_the_gap()

    def _refused(self, reason: str) -> None:
        self._recorder.drop(self.name, "unreadable", reason)

    def _take_at_once(self, label: str, block: Array) -> bool:
        """Take a block that is what is due, as it mostly is; False when it is not."""
        recorder = self._recorder
        if not self.joined or label != self._encoder.label:
            return False
        ticks = block[:, 0] / recorder.period
        if not np.all(np.abs(ticks - np.arange(self.end, self.end + len(block))) < 1e-3):
            return False
        if recorder.settings.ticks and recorder.lockstep and self.end + len(block) > recorder.settings.ticks:
            return False
        self._append(block)
        return True

    def _receive(self, label: str, block: Array) -> None:
        recorder = self._recorder
        breaks = np.flatnonzero(~(np.abs(np.diff(block[:, 0]) / recorder.period - 1.0) < 1e-3)) + 1
        if len(breaks):  # of several messages, with a gap or a repetition between them
            for part in np.split(block, breaks):
                self._receive(label, part)
            return
        try:
            if self._encoder is None or self._encoder.label != label:
                encoder = Encoder(label)
                if self._encoder is not None:
                    self.close()
                self._encoder = encoder
        except InputError as error:
            recorder.drop(self.name, "wrong label", str(error))
            return
        tick = tick_of(block, recorder.period) if len(block) else None
        if tick is None:
            recorder.drop(self.name, "off the clock", f"its times are not successive multiples of the period "
                                                      f"{recorder.period:g} s: is rate_hz the same everywhere?")
            return
        if recorder.lockstep and recorder.settings.ticks:
            block = block[:max(recorder.settings.ticks - tick, 0)]
            if not len(block):
                return
        if self.end is None:
            self._begin = tick
        if not self.joined:
            self.joined = not recorder.lockstep or self._joining.complete(tick)
            if tick < self._begin:  # a repetition, in which all that was heard comes again
                self._begin, self.end, self.arrived = tick, tick, 0
                self._pending, self._pending_rows = [], 0
        if self.end is not None:
            if tick + len(block) <= self.end:
                recorder.counts[f"{self.name}: {DUPLICATE}"] += 1
                if recorder.lockstep:
                    recorder.progress(repeat=True)
                return
            if tick > self.end:
                if recorder.lockstep:
                    self._hold(tick, block)
                    return
                self._leave_gap(tick)
            block = block[max(self.end - tick, 0):]
            tick = max(self.end, tick)
        self.end = tick
        self._append(block)

    def _hold(self, tick: int, block: Array) -> None:
        if not self._behind:
            self._gap_since = time.monotonic()
        self._behind[tick] = max(block, self._behind.get(tick, block), key=len)

    def _go_on_behind_the_gap(self, give_up: bool = False) -> None:
        """Take the rows behind a gap once it is filled, or was waited for long enough, or too many rows wait."""
        recorder = self._recorder
        give_up |= time.monotonic() - self._gap_since > PATIENCE or sum(map(len, self._behind.values())) > recorder.settings.most_waiting
        for tick in sorted(self._behind):
            if tick > self.end:
                if not give_up:
                    return
                recorder.warn(self.name, f"{self.name}: ticks {self.end} to {tick - 1} are lost: was their node killed?")
                self._leave_gap(tick)
            rows = self._behind.pop(tick)[self.end - tick:]
            if len(rows):
                self._append(rows)
                self._gap_since = time.monotonic()  # of the next one

    def _leave_gap(self, tick: int) -> None:
        """Go on with this tick; those before it are missing in the bag."""
        self._recorder.counts[f"{self.name}: missed ticks"] += tick - self.end
        self.joined = True
        self.store()  # the rows of one message are successive
        self.end = tick

    def _append(self, block: Array) -> None:
        self._pending.append(block)
        self._pending_rows += len(block)
        self.end += len(block)
        self.arrived += len(block)
        if self._pending_rows >= self._recorder.settings.merge:
            self.store()

    def close(self) -> None:
        """Write all that has been heard, whatever it waits for."""
        if self._behind:
            self._go_on_behind_the_gap(give_up=True)
        self.joined = True
        self.store()

    def store(self) -> None:
        """Write the rows that wait to be merged."""
        if self._pending and self.joined:
            rows = self._pending[0] if len(self._pending) == 1 else np.concatenate(self._pending)
            self._pending, self._pending_rows = [], 0
            self._recorder.store(self.name, self._encoder.encode(rows), self._stamp)


def main() -> int:
    """The executable."""
    return run_main(Recorder)


if __name__ == "__main__":
    raise SystemExit(main())
