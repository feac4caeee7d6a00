# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Live view node: the loop's signals, decimated for a page that shows them while it runs."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array, Integers
from hyst_control.nodes.execution.run import executable
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.nodes.signal_node.duration_histogram import Durations
from hyst_control.nodes.signal_node.message_io import Sender
from hyst_control.nodes.signal_node.parameters import Setting
from hyst_control.nodes.signal_node.watched_signal import WatchedSignal
from hyst_control.records.extremes import ExtremeRows

DRAIN_INTERVAL = 0.05  # s, between two polls of the subscriptions: their queues hold far more
TURN_EVERY = 4  # Polls between two messages on `live_turn`
REFERENCE_PATIENCE = 0.5  # s for which rows wait for a reference that has come before
TURN_ROWS = 500  # Most rows of a message on `live_turn`


class _Errors:
    """Rms and peak of the errors (N, A) since they were last taken; rows without a reference (NaN) are left out."""

    def __init__(self) -> None:
        self._count = 0
        self._squares: Array = np.zeros(1)
        self._peak: Array = np.zeros(1)

    def add(self, errors: Array) -> None:
        known = errors[np.isfinite(errors).all(axis=1)]
        if len(known):
            self._count += len(known)
            self._squares = self._squares + np.sum(known**2, axis=0)
            self._peak = np.maximum(self._peak, np.abs(known).max(axis=0))

    def take(self) -> dict[str, Array]:
        found = {"rms": np.sqrt(self._squares / self._count), "peak": self._peak} if self._count else {}
        self._count, self._squares, self._peak = 0, np.zeros(1), np.zeros(1)
        return found


class LiveView(SignalNode):
    """Node that publishes the loop's signals with fewer rows, for a page or for anybody who looks on.

    On `live` it publishes the ticks at which the reference, the command, the measurement or the error has its least or greatest value
    within `bin` s, so that every peak is there and every row holds values of one tick. On `live_turn` it publishes the newest `turn` s
    of command and measurement, evenly spaced, for a picture of the loop. It only listens: no other node waits for it. Composed with
    the loop it takes messages within the process, which costs the loop less than a subscription from outside.
    """

    SETTINGS = (
        Setting("bin", 0.05, "s", "time of which the rows with the extreme values are kept", 1e-4, 10.0),
        Setting("turn", 0.2, "s", "length of the newest stretch that is published for a picture of the loop", 1e-3, 100.0),
    )

    def __init__(self, name: str = "live_view", **options: Any) -> None:
        super().__init__(name, **options)
        units = {"reference": self.unit, "command": "V", "measurement": self.unit, "error": self.unit}
        named = {topic: [f"{topic}_{axis}[{unit}]" for axis in self.axes] for topic, unit in units.items()}
        self._live = Sender(self, "live", ",".join(["t[s]", *sum(named.values(), [])]), self.settings.message_objects)
        turn_columns = ["t[s]", *named["command"], *named["measurement"]]
        self._turn = Sender(self, "live_turn", ",".join(turn_columns), self.settings.message_objects)
        self._reference, self._command, self._measurement = (
            WatchedSignal(self, topic, units[topic], self.reset) for topic in ("reference", "command", "measurement")
        )
        self._extremes = ExtremeRows(max(round(self.settings.bin / self.period), 1))
        self._poll_times = Durations()  # Processor time of each poll, which a loop in the same process has to wait for
        self._forget()
        self.every(DRAIN_INTERVAL, self._poll)

    def reset(self) -> None:
        for signal in (self._reference, self._command, self._measurement):
            signal.rows.forget()
        self._forget()

    def status(self) -> dict[str, Any]:
        counted = {"rows seen": self._seen, "rows published": self._published, **self._poll_times.entries("poll")}
        return counted | self._error_figures()

    def _error_figures(self) -> dict[str, str]:
        """Rms and peak of the error of each axis since the last diagnostics; nothing without a reference."""
        return {
            f"{what} error {axis} [{self.unit}]": f"{value:.4g}"
            for what, values in self._errors.take().items()
            for axis, value in zip(self.axes, values)
        }

    def _forget(self) -> None:
        self._extremes.reset()
        self._errors = _Errors()
        self._newest: deque[Array] = deque()  # blocks (N, 1 + 2 A) of time, command and measurement
        self._newest_rows = self._polls = self._seen = self._published = 0

    def _poll(self) -> None:
        begun = time.thread_time()
        self._drain()
        self._poll_times.add(time.thread_time() - begun)

    def _drain(self) -> None:
        for signal in (self._reference, self._command, self._measurement):
            signal.drain()
        command, measurement = self._command.rows, self._measurement.rows
        if command.end is not None and measurement.end is not None:
            end = min(command.end, measurement.end)
            reference = self._reference.rows
            if reference.end is not None and time.monotonic() - reference.arrived < REFERENCE_PATIENCE:
                end = min(end, reference.end)
            (ticks, commands), (measured_ticks, measured) = command.take_before(end), measurement.take_before(end)
            references = reference.take_before(end)
            both, first, second = np.intersect1d(ticks, measured_ticks, assume_unique=True, return_indices=True)
            if len(both):
                self._look(both, self._matched(both, *references), commands[first], measured[second])

    def _matched(self, ticks: Integers, reference_ticks: Integers, references: Array) -> Array:
        """References (N, A) of ticks, NaN where there is none, as in open loop."""
        matched = np.full((len(ticks), len(self.axes)), np.nan)
        _, here, there = np.intersect1d(ticks, reference_ticks, assume_unique=True, return_indices=True)
        if len(here):
            matched[here] = references[there]
        return matched

    def _look(self, ticks: Integers, references: Array, commands: Array, measured: Array) -> None:
        """Publish the extremes of new rows (N, A) of the three signals, and now and then the newest stretch for the loop."""
        self._seen += len(ticks)
        self._polls += 1
        errors = references - measured
        self._errors.add(errors)
        kept, rows = self._extremes.add(ticks, np.hstack([references, commands, measured, errors]))
        if len(kept) and self._live.publisher.get_subscription_count():
            self._published += len(kept)
            self._live.send(np.column_stack([kept * self.period, rows]))
        self._keep(np.column_stack([ticks * self.period, commands, measured]))
        if self._polls % TURN_EVERY == 1 and self._turn.publisher.get_subscription_count():
            newest = np.concatenate(self._newest)[-self._turn_rows :]
            self._turn.send(newest[:: max(-(-len(newest) // TURN_ROWS), 1)])

    @property
    def _turn_rows(self) -> int:
        return max(int(round(self.settings.turn / self.period)), 2)

    def _keep(self, rows: Array) -> None:
        self._newest.append(rows)
        self._newest_rows += len(rows)
        while self._newest_rows - len(self._newest[0]) >= self._turn_rows:
            self._newest_rows -= len(self._newest.popleft())


main = executable(LiveView)

if __name__ == "__main__":
    raise SystemExit(main())
