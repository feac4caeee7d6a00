"""What a recorder keeps of one topic: every row once, by tick, also where messages came twice, late, or not at all."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hyst_control.errors import InputError
from hyst_control.nodes.rows import DUPLICATE
from hyst_control.nodes.signal_ports import Joining, tick_of
from hyst_control.records.signal_message import Encoder

if TYPE_CHECKING:
    from hyst_control.nodes.recorder import Recorder

Array = NDArray[np.float64]

PATIENCE = 5.0
"""s, for which rows that are missing in lockstep are waited for: the plant repeats what it sent long before that."""


class RecordedTopic:
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
            recorder.drop(
                self.name,
                "off the clock",
                f"its times are not successive multiples of the period {recorder.period:g} s: is rate_hz the same everywhere?",
            )
            return
        if recorder.lockstep and recorder.settings.ticks:
            block = block[: max(recorder.settings.ticks - tick, 0)]
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
            block = block[max(self.end - tick, 0) :]
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
        give_up |= (
            time.monotonic() - self._gap_since > PATIENCE or sum(map(len, self._behind.values())) > recorder.settings.most_waiting
        )
        for tick in sorted(self._behind):
            if tick > self.end:
                if not give_up:
                    return
                recorder.warn(self.name, f"{self.name}: ticks {self.end} to {tick - 1} are lost: was their node killed?")
                self._leave_gap(tick)
            rows = self._behind.pop(tick)[self.end - tick :]
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
