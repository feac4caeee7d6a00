# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Preparation of records: cut, resample, filter, detrend, merge, remove outliers. Each step leaves a line in the record's history."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TypeVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.quantity import Quantity
from hyst_control.records.outliers import THRESHOLD, WINDOW, outlying
from hyst_control.records.record import Record, Signal

MEASUREMENT = ("measurement",)
ORDER = Quantity("order", 4, "", "order of the filter", lower=1)
BEYOND = 0.01  # Of its range, by which a filter may take the command out of it without a note
MAX_PPM = 1e5  # Largest difference of two clocks
MAX_FACTOR = 1000  # Largest numerator and denominator of the ratio of two rates

Edited = TypeVar("Edited", bound="EditableRecord")


@dataclass(frozen=True)
class EditableRecord(Record):
    """A record with the steps of its preparation."""

    def cut(self: Edited, begin: float | None = None, end: float | None = None) -> Edited:
        """The part of the record between two sample times.

        Parameters
        ----------
        begin, end
            First and last sample time, s; None for the record's own.

        Returns
        -------
        Record
            The part, with its own times.
        """
        cut = self.between(begin, end)
        return cut if cut is self else cut._noted(f"cut to {_time(begin, 'its begin')} … {_time(end, 'its end')}")

    def resample(self: Edited, rate: float) -> Edited:
        """The record at another sample rate, by a polyphase filter that keeps out what the new rate cannot carry.

        Command and measurement pass the same filter, so the linear relation between them stays. Between samples the filtered command is
        smooth (hold "foh"); only a held command at a higher rate stays held.

        Parameters
        ----------
        rate
            New sample rate, Hz.

        Returns
        -------
        Record
            The record at that rate.
        """
        from scipy.signal import resample_poly

        step = self._clock()[0]
        ratio = Fraction(rate * step).limit_denominator(MAX_FACTOR) if 0 < rate * step <= MAX_FACTOR else Fraction(0)
        if not ratio or abs(ratio / (rate * step) - 1) > 1e-9:
            raise InputError(f"rate: must be a ratio of whole numbers up to {MAX_FACTOR} of {1 / step:g} Hz, got {rate!r} Hz")
        up, down = ratio.numerator, ratio.denominator
        held = self.hold == "zoh" and up > down

        def resampled(topic: str, values: Array) -> Array:
            if held and topic not in MEASUREMENT:
                return np.asarray(values[np.arange(-(-len(values) * up // down)) * down // up])
            return np.asarray(resample_poly(values, up, down, axis=0, padtype="line"))

        done = self._changed(self.signals, resampled, 1.0 / rate)
        done = replace(done, hold="zoh" if held else "foh", states_hold=True, notes=(*done.notes, *self._ringing(done)))
        return done._noted(f"resampled from {1 / step:g} to {rate:g} Hz")

    def reclock(self: Edited, ppm: float) -> Edited:
        """The record with its measurement brought to the command's clock, by cubic interpolation from the common first sample on.

        Parameters
        ----------
        ppm
            How much slower the measurement's clock is, parts per million, within ±100,000; below 0: faster. Record checks find it.

        Returns
        -------
        Record
            The record by one clock; of a measurement that ends early, without the last commands.
        """
        from hyst_control.records.validity.time_shift import at_rate

        if not abs(ppm) <= MAX_PPM:
            raise InputError(f"ppm (--clock): must be from {-MAX_PPM:g} to {MAX_PPM:g} parts per million, got {ppm!r}")

        def changed(topic: str, values: Array) -> Array:
            measured = int((len(values) - 1) * (1.0 + 1e-6 * ppm)) + 1  # rows up to the measurement's end
            if topic in MEASUREMENT:
                values = np.column_stack([at_rate(column, 1e-6 * ppm) for column in values.T])
            return values[:measured]

        return self._changed(self.signals, changed)._noted(f"measurement brought to the command's clock ({ppm:g} ppm)")

    def filter(self: Edited, low_pass: float | None = None, high_pass: float | None = None, *, order: int = 4) -> Edited:
        """Filter every signal by a Butterworth filter forward and backward, without phase.

        Command and measurement pass the same filter, so the linear relation between them stays.

        Parameters
        ----------
        low_pass, high_pass
            Corners, Hz, at which the magnitude is one half; None: no such filter.
        order
            Order of the filter, which runs twice.

        Returns
        -------
        Record
            The filtered record.
        """
        from scipy.signal import butter, sosfiltfilt

        step = self._clock()[0]
        ORDER.checked(order)
        corners = {"high_pass": high_pass, "low_pass": low_pass}
        given = {name: corner for name, corner in corners.items() if corner is not None}
        for name, corner in given.items():
            if not 0 < corner < 0.5 / step:
                raise InputError(f"{name}: must be > 0 and < {0.5 / step:g} Hz, half the sample rate, got {corner!r}")
        if not given or list(given.values()) != sorted(given.values()):
            raise InputError("low_pass, high_pass: give one of them, or both with the low-pass above the high-pass")
        kind = "bandpass" if len(given) == 2 else "lowpass" if low_pass is not None else "highpass"
        sections = butter(order, np.squeeze(list(given.values())), kind, fs=1.0 / step, output="sos")
        try:
            done = self._changed(self.signals, lambda _, values: sosfiltfilt(sections, values, axis=0))
        except ValueError:
            raise InputError(f"{self.source}: is too short for this filter: choose a lower order or a longer record") from None
        words = " and ".join(f"{name.replace('_', '-')} {corner:g} Hz" for name, corner in given.items())
        done = replace(done, hold="foh", states_hold=True, notes=(*done.notes, *self._ringing(done)))
        return done._noted(f"filtered: {words}, order {order} without phase")

    def detrend(self: Edited, kind: str = "linear", *, topics: Sequence[str] = MEASUREMENT) -> Edited:
        """Remove the mean or the straight line of best fit, which of a measurement is offset and drift.

        Parameters
        ----------
        kind
            "linear" or "constant".
        topics
            Signals to change.

        Returns
        -------
        Record
            The record without them.
        """
        from scipy.signal import detrend

        if kind not in ("linear", "constant"):
            raise InputError(f"kind: must be linear or constant, got {kind!r}")
        done = self._changed(topics, lambda _, values: detrend(values, axis=0, type=kind))
        return done._noted(f"{kind} trend removed from {', '.join(topics)}")

    def remove_outliers(
        self: Edited, threshold: float = THRESHOLD, *, window: int = WINDOW, topics: Sequence[str] = MEASUREMENT
    ) -> Edited:
        """Replace samples that jump away from both neighbors and from the running median by the line between their neighbors.

        Steps and turning points stay: the median follows the former, and the latter are no steeper than the motion around them. So do
        samples next to a jump of the command.

        Parameters
        ----------
        threshold
            Size of the jump, in standard deviations of the signal's roughness there and in the whole record.
        window
            Samples of the running median, odd.
        topics
            Signals to change.

        Returns
        -------
        Record
            The record without outliers; the history has their number.
        """
        if not threshold > 0:
            raise InputError(f"threshold (--outliers): must be > 0 standard deviations, got {threshold!r}")
        if window < 3 or window % 2 == 0:
            raise InputError(f"window: must be odd and >= 3 samples, got {window!r}")
        found = 0

        def cleaned(topic: str, values: Array) -> Array:
            nonlocal found
            answers = topic in MEASUREMENT and "command" in self.signals
            command = self.aligned(list(self.signals))[0].command if answers else np.zeros((len(values), 1))
            standing_out = outlying(values, command, threshold, window)
            found += int(standing_out.any(axis=1).sum())
            done, rows = values.copy(), np.arange(len(values))
            for axis, bad in enumerate(standing_out.T):
                done[bad, axis] = np.interp(rows[bad], rows[~bad], values[~bad, axis])
            return done

        done = self._changed(topics, cleaned)
        return done._noted(f"{found} outliers removed from {', '.join(topics)} (beyond {threshold:g} standard deviations)")

    def merge(self: Edited, *others: Record) -> Edited:
        """Append records of the same machine, each behind a gap of one sample, so that nothing takes them for one motion.

        Parameters
        ----------
        *others
            Records with the same axes, units, sample rate and hold.

        Returns
        -------
        Record
            The common signals of all; commands use it with `--allow-gaps`, `identify` with `allow_gaps=True`.
        """
        step = self._clock()[0]
        topics = [topic for topic in self.signals if all(topic in other.signals for other in others)]
        signals = {topic: self.signals[topic] for topic in topics}
        for other in others:
            theirs = other.common_step(topics)
            if abs(theirs / step - 1) > 1e-6:
                raise InputError(f"{other.source}: has {1 / theirs:g} Hz, {self.source} {1 / step:g} Hz: resample it")
            if other.hold != self.hold:
                raise InputError(
                    f"{other.source}: has hold {other.hold}, {self.source} {self.hold}: filter or resample both, or none"
                )
            end = max(float(signal.time[-1]) for signal in signals.values())
            shift = end + 2 * step - min(float(other.signal(topic).time[0]) for topic in topics)
            for topic in topics:
                own, more = signals[topic], other.signal(topic)
                if (own.axes, own.unit) != (more.axes, more.unit):
                    raise InputError(f"{other.source}: {topic} has other axes or another unit than that of {self.source}")
                time = np.rint(np.concatenate([own.time, more.time + shift]) / step) * step
                signals[topic] = replace(own, time=time, values=np.concatenate([own.values, more.values]))
        return replace(self, signals=signals)._noted(f"merged with {', '.join(other.source for other in others)}")

    def _clock(self) -> tuple[float, float]:
        """Sample time and first sample time (s) of the record's signals, which share them."""
        if not self.signals:
            raise InputError(f"{self.source}: has no signals: record again")
        topics = list(self.signals)
        return self.common_step(topics), max(float(self.signal(topic).time[0]) for topic in topics)

    def _changed(self: Edited, topics: Collection[str], change: Callable[[str, Array], Array], step: float | None = None) -> Edited:
        """Change signals on the ticks that all signals share, to another step where one is given; a record with gaps is refused."""
        own, begin = self._clock()
        for topic in topics:
            self.signal(topic)
        [data] = self.aligned(list(self.signals))
        signals = {}
        for topic, signal in self.signals.items():
            values = np.asarray(change(topic, data.signal(topic).values) if topic in topics else data.signal(topic).values)
            time = begin + np.arange(len(values)) * (step or own)
            signals[topic] = Signal(time.astype(np.float64), np.ascontiguousarray(values), signal.axes, signal.unit)
        return replace(self, signals=signals)

    def _ringing(self, done: Record) -> list[str]:
        """A note where a filter took the command out of the range that it had."""
        if "command" not in self.signals:
            return []
        before, after = self.command, done.command
        beyond = np.maximum(before.min(axis=0) - after.min(axis=0), after.max(axis=0) - before.max(axis=0)).max()
        if not beyond > BEYOND * np.ptp(before, axis=0).max() > 0:
            return []
        ranges = [f"{values.min():.4g} to {values.max():.4g}" for values in (after, before)]
        return [
            f"{self.source}: the command now runs from {ranges[0]} {self.command_unit}, out of its {ranges[1]}: filters ring at steps"
        ]

    def _noted(self: Edited, step: str) -> Edited:
        return replace(self, history=(*self.history, step))


def _time(value: float | None, otherwise: str) -> str:
    return otherwise if value is None else f"{value:g} s"
