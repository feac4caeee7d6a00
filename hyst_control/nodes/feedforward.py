# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Base of the feedforward nodes: reference rows in, compensator rows out, each labeled with its own tick."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.control.feedback.loop import Compensator
from hyst_control.control.feedback.slope_demand import SlopeDemand
from hyst_control.control.feedforward.compensator import FROM_MODEL, KINDS, build_compensator
from hyst_control.control.feedforward.static_gain import Proportional
from hyst_control.export.backend import CompiledFeedforward
from hyst_control.export.controller import Feedforward as WithC
from hyst_control.model_file import load_model
from hyst_control.nodes.loop import feedforward_learning
from hyst_control.nodes.loop.feedforward_learning import FeedforwardLearning
from hyst_control.nodes.loop.slope_warning import warn_of_slope
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.nodes.signal_node.common_parameters import BACKEND, C
from hyst_control.nodes.signal_node.parameters import Setting, settings_of
from hyst_control.nodes.signal_node.signal_ports import Input
from hyst_control.records.stream.foreign_rows import LARGEST_VALUE

RATE_FILTER = Setting(
    "rate_filter",
    FROM_MODEL,
    "s^2, s, 1",
    "mhl: denominator of N(s), descending powers of s; a single 0: without; a single -1: below the model's first resonance",
    -1.0,
    1e12,
)


def settings_of_kind(kind: str) -> tuple[Setting, ...]:
    """Parameters of a feedforward node whose usual compensator is of a kind."""
    own = Setting("kind", kind, "", "kind of compensator", choices=(*KINDS, "proportional"))
    return (*feedforward_learning.SETTINGS, own, *settings_of("feedforward"), RATE_FILTER, BACKEND)


class Feedforward(SignalNode):
    """Node that streams `reference` through a compensator to `feedforward` (V).

    A compensator with a preview of q ticks gives row k once row k + q of the reference is there, so the generator's
    `lead` must be q at least. After a start or reset it is at rest at the first reference it meets. With `learning` it adds what it
    learns from `measurement` and `feedback`, and publishes that by itself as `learned` (V).
    """

    KIND = "proportional"
    NAME = f"{KIND}_feedforward"
    SETTINGS = settings_of_kind(KIND)

    def __init_subclass__(cls, **options: Any) -> None:
        """Give a subclass the parameters of its `KIND`."""
        super().__init_subclass__(**options)
        cls.SETTINGS = settings_of_kind(cls.KIND)
        cls.NAME = f"{cls.KIND}_feedforward"

    def __init__(self, name: str = "", compensator: Compensator | None = None, **options: Any) -> None:
        """Create the node, by default under the name of its kind."""
        super().__init__(name or self.NAME, **options)
        self._compensator = compensator or self._described()
        if self.settings.backend == C:
            self._compensator = self._compiled(self._compensator)
        self._compensator.settle(np.zeros(len(self.axes)))  # compiled before the first tick
        self._compensator.process(np.zeros((1, len(self.axes))))
        if ahead := self._compensator.preview:
            self.REMEDIES = {
                "reference": f"the inverse looks {ahead} ticks ahead: give reference_generator a lead of {ahead} at least"
            }
        self._next: int | None = None  # tick of the next row out of the compensator
        self._due = 0
        self._demand = SlopeDemand()
        self.feedforward = self.output("feedforward", "V")
        self.reference = self.input("reference", self.unit)
        try:
            learner = feedforward_learning.described_learner(self.settings, len(self.axes), self.period)
        except InputError as error:
            raise InputError(f"{self.get_name()}: parameter {error}") from None
        self._learning = FeedforwardLearning(self, learner, self._publish) if learner else None
        self.schedule.start(0.3)

    def advance(self) -> None:
        if self.reference.rows.available:
            self._compensate()
        if self._learning:
            self._learning.advance()

    def _compensate(self) -> None:
        arrived = self.reference.rows
        first, start = self._next, arrived.start
        rows = arrived.take(arrived.available)
        if self._learning:
            self._learning.add_reference(start, rows)
        if first is None:
            self._due, first = start, start - self._compensator.preview
            self._compensator.settle(rows[0])
        output = self._compensator.process(rows)
        self._next = first + len(output)
        if self._next > self._due:  # rows before the first reference are the compensator's filling
            start = max(first, self._due)
            output = output[start - first :]
            if self._learning:
                self._learning.add(start, output)
            else:
                self._publish(start, output)

    def _publish(self, start: int, rows: Array) -> None:
        """Send rows within what other nodes take: in lockstep they would wait for ever for one that they dropped."""
        warn_of_slope(self, self._demand.exceeds(start, rows, self.settings.slew_limit * self.period))
        self.feedforward.send(start, np.clip(rows, -LARGEST_VALUE, LARGEST_VALUE))

    def tick(self, tick: int) -> None:
        if self.enabled:
            arrived = self.reference.rows
            if arrived.available and self._next is not None:  # missed ticks leave a gap in time, not in the state
                self._next = arrived.start - self._compensator.preview
            self.advance()
        else:
            self.reference.rows.skip_to(tick)

    def repeat(self, source: Input, tick: int) -> None:
        self.feedforward.repeat(tick)
        if self._learning:
            self._learning.learned.repeat(tick)

    def reset(self) -> None:
        self._next = None
        self._demand = SlopeDemand()
        self.feedforward.clear()
        if self._learning:
            self._learning.reset()

    def status(self) -> dict[str, Any]:
        return {"preview [ticks]": self._compensator.preview, **(self._learning.status() if self._learning else {})}

    def _compiled(self, compensator: Compensator) -> Compensator:
        try:
            return CompiledFeedforward(cast(WithC, compensator), len(self.axes), self.period)
        except InputError as error:
            raise InputError(f"{self.get_name()}: parameter backend: {error}") from None

    def _described(self) -> Compensator:
        axes = len(self.axes)
        if self.settings.kind == "proportional":
            gain, offset = self.settings.gain, self.settings.offset
            for name, value in (("gain", gain), ("offset", offset)):
                if len(value) not in (1, axes):
                    raise InputError(f"{self.get_name()}: parameter {name}: {len(value)} values for {axes} axes")
            return Proportional(np.broadcast_to(np.array(gain), axes), np.broadcast_to(np.array(offset), axes))
        if not self.settings.model:
            raise InputError(f"{self.get_name()}: parameter model: give the model file to invert, or kind: proportional")
        model = load_model(self.settings.model)
        self.check_fits(f"{self.get_name()}: {self.settings.model}", model.axes, model.units)
        given = self.settings
        try:
            return build_compensator(
                model,
                given.kind,
                sample_time=self.period,
                inverse=given.inverse,
                discretisation=given.discretisation,
                preview=given.preview,
                limits=given.limits if given.limits[0] != given.limits[-1] else None,
                iterations=given.iterations if given.iterations >= 0 else None,
                smoothing=given.smoothing,
                rate_filter=given.rate_filter if any(given.rate_filter) else None,
                inverse_model=load_model(given.inverse_model) if given.inverse_model else None,
            )
        except InputError as error:
            raise InputError(f"{self.get_name()}: {given.model}: {error}") from None
