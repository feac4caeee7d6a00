# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reference generator node: streams a signal of `records.excitation`, or an array from a file, at the pace of the plant."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.yaml_files import read_yaml
from hyst_control.nodes.execution.run import executable
from hyst_control.nodes.loop.takeover import DISCOVERY
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.nodes.signal_node.parameters import Setting, settings_of
from hyst_control.nodes.signal_node.signal_ports import Input
from hyst_control.nodes.signal_node.signal_settings import NOT_GIVEN, signal_settings
from hyst_control.records.excitation import excitation
from hyst_control.records.excitation.signal_change import ChangingSignal
from hyst_control.records.stream.foreign_rows import LARGEST_VALUE
from hyst_control.records.stream.row_repetition import KEPT_ROWS
from hyst_control.records.tables.array_files import read_array


class ReferenceGenerator(SignalNode):
    """Node that publishes `reference` in messages of `block` rows, at least `lead` rows ahead of the newest `measurement`.

    The rows do not depend on the measurement, which only paces them; under the timer the first one is where they begin. They begin at
    rest (`ramp_time`) and may end at rest (`end_ramp_time`). After its end the signal keeps its last value, or starts again with
    `repeat`. A kind of signal has parameters of its own (`hyst excite --list`), which are parameters of the node as well; when they are
    changed while it runs, the signal goes over into the new one within `transition` without a jump (`records.signal_change`).
    """

    FURTHER = "and the parameters of the kind of signal, live: hyst excite --list"
    SETTINGS = settings_of("reference_generator")

    def __init__(self, name: str = "reference_generator", signal: Array | None = None, **options: Any) -> None:
        """Create the node."""
        self._next: Array | None = None  # signal of parameters that are being changed
        super().__init__(name, **options)
        rows = self._checked(self._described() if signal is None else signal)
        ramps = (round(seconds / self.period) for seconds in (self.settings.ramp_time, self.settings.end_ramp_time))
        self._signal = ChangingSignal(rows, self.settings.repeat, *ramps)
        self._signal.begin_at(np.zeros(len(self.axes)))
        self._waiting_since: float | None = None  # s, for a position to begin at, under the timer
        self._end = 0
        self._origin: int | None = None
        self._sent = 0  # rows of the signal, under the timer
        self.reference = self.output("reference", self.unit)
        self.measurement = self.input("measurement", self.unit, every_row=False)
        if self.lockstep:
            self.every(self.settings.retry, self._start_off)
        self.schedule.start(0.1)

    def rows(self, first: int, count: int) -> Array:
        """Rows of the signal."""
        return self._signal.rows(first, count)

    def advance(self) -> None:
        arrived = self.measurement.rows
        if arrived.awaited > self._end:  # first measurement, or restarted during a run: no node lacks earlier rows
            self._end = arrived.awaited - 1
        if arrived.available:
            arrived.take(arrived.available)
        while self._end < arrived.awaited + self.settings.lead:
            self._publish()

    def repeat(self, source: Input, tick: int) -> None:
        self._send_again(max(0, min(tick, source.rows.awaited - 2 * self.settings.block)))

    def tick(self, tick: int) -> None:
        position = self.measurement.rows.newest(tick)
        self.measurement.rows.skip_to(tick)  # only lockstep is paced by it
        if not self.enabled:
            self._origin = self._waiting_since = None
            return
        if self._origin is None:
            if not self._begins_at(position):
                return
            self._origin = tick
        lead, block = self.settings.lead, self.settings.block
        first = max(tick - self.timer.missed, self._origin)
        self._sent = tick + block - self._origin
        self.reference.send(first + lead, self.rows(first - self._origin, tick + block - first))

    def reset(self) -> None:
        self._end, self._origin, self._waiting_since = 0, None, None
        self.reference.clear()

    def _begins_at(self, position: Array | None) -> bool:
        """Begin where the stage is, under the timer; False while that is waited for, no longer than a plant takes to be discovered."""
        now = time.monotonic()
        self._waiting_since = now if self._waiting_since is None else self._waiting_since
        if self.settings.ramp_from == "position" and self.settings.ramp_time:
            if position is None and now - self._waiting_since < DISCOVERY:
                return False
            self._signal.begin_at(np.zeros(len(self.axes)) if position is None else position.copy())
        return True

    def _start_off(self) -> None:
        if self.measurement.rows.end is None:
            self._send_again(0)
            while self._end <= self.settings.lead:
                self._publish()

    def _send_again(self, first: int) -> None:
        count = min(self._end - first, KEPT_ROWS)
        if count > 0:
            self.reference.repeat_rows(first, self.rows(first, count))

    def _publish(self) -> None:
        block = self.settings.block
        self.reference.send(self._end, self.rows(self._end, block))
        self._end += block

    def further_settings(self, given: SimpleNamespace) -> Iterable[Setting]:
        """Parameters of the kind of signal."""
        return signal_settings(given.signal) if given.signal in excitation.KINDS else ()

    def check_change(self, values: Mapping[str, Any]) -> None:
        """Build the signal that new values describe."""
        self._next = self._checked(self._described(values)) if set(values) & self._names else None

    def changed(self, name: str, value: Any) -> None:
        if self._next is not None:
            fade = max(round(self.settings.transition / self.period), 1)
            self._signal.replace(self._next, self._sent_rows, fade)
            self._next = None

    @property
    def _sent_rows(self) -> int:
        """Number of the signal's rows that were sent."""
        return self._end if self.lockstep else self._sent if self._origin is not None else 0

    @property
    def _names(self) -> set[str]:
        """Names of the parameters of the kind of signal."""
        return {setting.name for setting in self.further_settings(self.settings)}

    def _described(self, changes: Mapping[str, Any] | None = None) -> Any:
        """The signal of the present parameters, or of these with `changes`."""
        signal = self.settings.signal
        try:
            if signal.endswith(".npy"):
                return read_array(signal)
            if signal.endswith((".yaml", ".yml")):
                spec = read_yaml(signal, "give an existing file")
            else:
                values = {**vars(self.settings), **(changes or {})}
                given = {name: values[name] for name in sorted(self._names) if values[name] != NOT_GIVEN}
                spec = {
                    "signal": signal,
                    **{name: list(value) if isinstance(value, tuple) else value for name, value in given.items()},
                }
            return excitation.build(spec, self.period, len(self.axes))
        except OSError as error:
            raise InputError(f"{self.get_name()}: signal {signal}: {error.strerror}: give an existing file") from None
        except ValueError as error:
            raise InputError(f"{self.get_name()}: signal {signal}: {' '.join(str(error).split())}") from None

    def _checked(self, signal: Any) -> Array:
        rows = np.asarray(signal, dtype=np.float64)
        rows = rows[:, None] if rows.ndim == 1 else rows
        if rows.ndim != 2 or rows.shape[1] != len(self.axes) or not len(rows):
            raise InputError(f"{self.get_name()}: signal: must be rows by {len(self.axes)} axes, got shape {rows.shape}")
        if not np.isfinite(rows).all():
            row = np.argwhere(~np.isfinite(rows))[0, 0]
            raise InputError(f"{self.get_name()}: signal: contains NaN or infinity in row {row}")
        if np.abs(rows).max() > LARGEST_VALUE:
            row = np.argwhere(np.abs(rows) > LARGEST_VALUE)[0, 0]
            raise InputError(
                f"{self.get_name()}: signal: row {row} is beyond {LARGEST_VALUE:g} {self.unit}: give values in {self.unit}"
            )
        if self.settings.model:
            from hyst_control.control.feedforward.reachable_stroke import check_reachable  # these import every stage, and numba
            from hyst_control.model_file import load_model

            limits = self.settings.limits
            try:
                check_reachable(load_model(self.settings.model), rows, limits if limits[0] != limits[-1] else None)
            except InputError as error:
                raise InputError(f"{self.get_name()}: signal {self.settings.signal}: {error}") from None
        return np.ascontiguousarray(rows)


main = executable(ReferenceGenerator)

if __name__ == "__main__":
    raise SystemExit(main())
