# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Feedback node: adds PI feedback to the feedforward and keeps the command within its limits."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
from rclpy.duration import Duration

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.control.feedback.filters import Filters
from hyst_control.control.feedback.pi import PI, RunningPI
from hyst_control.control.feedback.safe_loop import SafeLoop, Safety, ticks_in
from hyst_control.control.feedback.sensor_watch import MOTION, MeasurementWatch
from hyst_control.control.feedback.slope_demand import SlopeDemand
from hyst_control.nodes.execution.run import executable
from hyst_control.nodes.loop.rival_watch import RivalWatch
from hyst_control.nodes.loop.slope_warning import warn_of_slope
from hyst_control.nodes.loop.takeover import Takeover
from hyst_control.nodes.signal_node.common_parameters import BACKEND, TIMER, C
from hyst_control.nodes.signal_node.managed import AUTOSTART, ManagedNode
from hyst_control.nodes.signal_node.parameters import settings_of
from hyst_control.nodes.signal_node.signal_ports import Input
from hyst_control.records.actuator_following import CLOSE
from hyst_control.records.stream.signal_message import label_for

ENDING, RIVAL = "the node is ending", "another node publishes command"
NOT_FOLLOWED = "the actuator does not follow the command: the feedback tracks what is applied"
LAW = ("kp", "ki", "roll_off", "tracking_time", "lower", "upper", "slew_limit")  # Parameters of the controller's law
FILTERS = tuple(field.name for field in fields(Filters))  # Parameters of its filters, which are set at the start
TAKEOVER_INTERVAL = 0.01  # s, between two looks whether the present command was heard
LONGEST_RAMP = 100_000  # rows, in lockstep


class PiFeedback(ManagedNode):
    """Node that publishes `command` = limited (`feedforward` + `feedback`), in V.

    With `feedback: true` it runs tick by tick, as measurements arrive; otherwise it passes on blocks of any length (open loop).
    When it is stopped, disabled or ended, when the measurement of an axis is frozen or out of range, when another node publishes
    `command`, and under the timer with stale or conflicting inputs or with ticks that take too long, the command goes to
    `safe_command` at `safe_rate`. It returns by itself when the fault is over, or with `recovery: manual` after `~/reset`, in both
    cases without a jump. A node that is started during a run takes over from what the plant says on `applied`. `control.safe_loop` has
    the states.
    """

    SETTINGS = (*settings_of("pi_feedback"), BACKEND, AUTOSTART)

    def __init__(self, name: str = "pi_feedback", **options: Any) -> None:
        super().__init__(name, **options)
        given, axes = self.settings, len(self.axes)
        try:
            self.check_change({})
            description = self._described(vars(given))
            controller = _compiled(description, axes) if given.backend == C else description.start(axes)
        except InputError as error:
            raise InputError(f"{self.get_name()}: parameter {error}") from None
        controller.step(*np.zeros((3, 1, axes)))  # compiled before the first tick
        controller.pass_through(np.zeros((1, axes)))
        self.loop = SafeLoop(controller, self._watch(), self._safety())
        self._newest: tuple[int, Array, Array] | None = None
        self._ending = False
        self._reported = 0  # faults that were told
        self.command = self.output("command", "V")
        self.feedback = self.output("feedback", "V")
        self.feedforward = self.input("feedforward", "V")
        self.reference: Input | None = None
        self.measurement: Input | None = None
        if given.feedback:
            self.reference = self.input("reference", self.unit)
            self.measurement = self.input("measurement", self.unit, replace=True)
        self._paced_by = self.measurement or self.feedforward
        self._takeover = Takeover(self)
        self._rivals = RivalWatch(self, self.command, label_for(self.axes, "V"))
        self._from = 0  # earliest tick that is computed, in lockstep
        self._waiting = True  # for the command to take over
        self._waking = self.every(TAKEOVER_INTERVAL, self._wake) if self.lockstep else None
        self.reset()
        self.begin()
        self.schedule.start(0.5)

    def advance(self) -> None:
        if not self.ever_active:
            return
        rows = [signal.rows for signal in self.inputs]
        for each in rows:  # once per tick: written for speed
            if not each.available:
                return
        self._yield_to_rival()  # before any row is taken: the plant may wait for the command that follows from it
        starts = [each.start for each in rows]
        first = max(self._from, *starts)
        if self._waiting:
            if not self._begins(first):
                if self._rival_active:
                    self._skip_answered_rows()
                return
            first = max(self._from, first)
            self._waiting = False
        if min(starts) != first:  # one of them was restarted during a run
            for each in rows:
                each.skip_to(first)
        count = min([each.available for each in rows])
        if not count:
            return
        fault = self._fault_of_loop()
        ahead = rows[0].take(count)
        others = [each.take(count) for each in rows[1:]]
        self._ask(first, ahead, others[0] if others else None)
        if self.measurement is None:
            self._publish(first, *self.loop.open(ahead, fault))
        else:
            for row in range(count):
                now = slice(row, row + 1)
                self._publish(first + row, *self.loop.closed(others[0][now], others[1][now], ahead[now], fault))
        self._report()

    def tick(self, tick: int) -> None:
        self._yield_to_rival()
        self._fill(tick - self.timer.missed)
        rows = self.feedforward.rows
        if self._waiting:
            if any(signal.rows.end is None for signal in self.inputs) or not self._takes_over():
                for signal in self.inputs:
                    signal.rows.skip_to(tick)
                return
            self._waiting = False
        if self.measurement is None:
            self._tick_open(tick)
        else:
            newest = [row[None] for signal in self.inputs if (row := signal.rows.newest(tick)) is not None]
            fault = self._timing_fault(tick)
            if len(newest) == len(self.inputs):
                self._ask(tick - rows.behind(tick), newest[0], newest[1])
                self.loop.applied = self._takeover.apart(self.command.sent, CLOSE * (self.settings.upper - self.settings.lower))
                self._publish(tick, *self.loop.closed(newest[1], newest[2], newest[0], fault))
            elif self._newest is not None:  # nothing came since a reset
                self._publish(tick, *self.loop.stopped_by(fault, 1))
        self._report()

    def _tick_open(self, tick: int) -> None:
        """One tick in open loop: the command of every row that has come, which may be ahead of the tick or behind it."""
        rows = self.feedforward.rows
        due = self._newest[0] + 1 if self._newest else 0
        fault = self._timing_fault(tick)
        stopped = bool(fault) or not self.loop.enabled
        late = rows.newest(due - 1)
        rows.skip_to(due)
        if rows.available and not stopped:
            start, ahead = rows.start, rows.take(rows.available)
            self._ask(start, ahead)
            self._publish(start, *self.loop.open(ahead))
            return
        rows.skip_to(tick + 1)
        first = max(tick, due)
        count = max(tick + self.settings.block - first, 0)
        if self._newest is None or not count or not (stopped or self.loop.faults.any):
            return
        if stopped or late is None:
            self._publish(first, *self.loop.stopped_by(fault, count))
        else:  # rows come later than their ticks, for which commands are out already: the newest of them ends the stop
            self._publish(first, *self.loop.open(np.repeat(late[None], count, axis=0)))

    def repeat(self, source: Input, tick: int) -> None:
        if source is self._paced_by:
            self.command.repeat(tick)
            self.feedback.repeat(tick)

    def reset(self) -> None:
        """Start a run, or continue after a fault; a published command is never left with a jump."""
        timed = self.settings.schedule == TIMER
        if self._newest is not None and (timed or self.loop.away):
            self.loop.restart(self.loop.controller.command, away=True)
        else:
            self.loop.restart(np.zeros(len(self.axes)) if timed or self.settings.start == "rest" else None, away=False)
            self._newest, self._from = None, 0
        self._demand = SlopeDemand(
            None if self.loop.away or np.isnan(self.loop.controller.command).any() else self.loop.controller.command
        )
        self.loop.enabled = self.working
        self._saturated = self._saturated_ticks = self._longest_saturation = 0
        self.command.clear()
        self.feedback.clear()

    def check_change(self, values: Mapping[str, Any]) -> None:
        """Refuse values that do not go together, and gains that are compiled in."""
        new = {**vars(self.settings), **values}
        self._described(new)
        if len(new["safe_command"]) not in (1, len(self.axes)):
            raise InputError(f"safe_command: {len(new['safe_command'])} values, {len(self.axes)} axes")
        compiled = sorted({*LAW} & {*values}) if new["backend"] == C else []
        if compiled:
            raise InputError(f"{compiled[0]}: is compiled in with backend: {C}: set it at the start, or use backend: python")

    def changed(self, name: str, value: Any) -> None:
        self.loop.safety = self._safety()
        self.loop.watch.judge_by(self._watch())
        if name in LAW:
            new = self._described(vars(self.settings))
            if self.measurement is None:  # the gains have no effect
                old = self.loop.controller.description
                new = replace(new, kp=old.kp, ki=old.ki, roll_off=old.roll_off, tracking_time=old.tracking_time)
            self.loop.change(new)

    def wind_down(self) -> None:
        self._ending = True
        if self.lockstep and self._newest is not None:  # no measurement will come any more
            way = np.abs(self.loop.controller.command - self.loop.safety.command).max()
            ticks = min(int(np.ceil(way / (self.loop.rate * self.period))) + 1, LONGEST_RAMP)
            self._publish(self._newest[0] + 1, *self.loop.stopped_by(ENDING, ticks))

    def close(self) -> None:
        if self._ending and self._newest is not None:  # what was sent last must arrive, or the way to the safe value is cut short
            self.command.publisher.wait_for_all_acked(Duration(seconds=1))

    @property
    def wound_down(self) -> bool:
        return self._newest is None or self.lockstep or self.loop.at_safe_value

    def trouble(self) -> str:
        """Present fault, or "saturated" when the command was at its limits for too long since the last call."""
        longest, self._longest_saturation = self._longest_saturation, self._saturated_ticks
        if fault := self._present_fault:
            return fault
        if self._rival_active:
            return RIVAL
        if self.loop.applied is not None:
            return NOT_FOLLOWED
        return "saturated" if longest >= ticks_in(self.settings.saturation_time, self.period) else ""

    def status(self) -> dict[str, Any]:
        return {
            "saturated samples": self.loop.controller.saturated,
            "fault": self._present_fault or "none",
            "axes with a fault": ", ".join(axis for axis, fault in zip(self.axes, self.loop.faults.present) if fault) or "none",
        }

    @property
    def _present_fault(self) -> str:
        """The faults that stop axes, each once; with the axes where it is not that of all."""
        present = self.loop.faults.present
        if len(set(present)) == 1:
            return present[0]
        return ", ".join(f"{axis}: {fault}" for axis, fault in zip(self.axes, present) if fault)

    @property
    def _rival_active(self) -> bool:
        return bool(self.settings.rival != "warn" and self._rivals.silent_for < self.settings.rival_time)

    def _described(self, values: Mapping[str, Any]) -> PI:
        filters = Filters(**{name: values[name] for name in FILTERS})
        return PI(sample_time=self.period, filters=filters, **{name: values[name] for name in LAW})

    def _watch(self) -> MeasurementWatch:
        given, limits = self.settings, (self.settings.lower, self.settings.upper)
        motion, frozen = MOTION * (given.upper - given.lower), ticks_in(given.frozen_time, self.period)
        return MeasurementWatch(given.measurement_lower, given.measurement_upper, frozen, motion, limits)

    def _safety(self) -> Safety:
        given = self.settings
        return Safety(
            np.broadcast_to(np.array(given.safe_command, dtype=float), len(self.axes)),
            given.safe_rate,
            ticks_in(given.recovery_time, self.period),
            given.recovery == "manual",
            given.axis_fault == "all",
        )

    def _begins(self, first: int) -> bool:
        """True when the node may begin, in lockstep: the first rows are those of a new run, or it has taken a run over."""
        if first == 0 and not self._rival_active:
            if self.measurement is not None and (self.measurement.rows.end or 0) <= 1:
                return True
            if self.measurement is None and self._takeover.ready(0.0) and self._takeover.command is None:
                return True
        return self._takes_over()

    def _takes_over(self) -> bool:
        """Begin from what is on the actuator, once that was heard or listened for long enough; False while the node has to wait."""
        ready = self._takeover.ready(self.settings.takeover_time)
        if self._rival_active or not ready:
            return False
        command = self._takeover.command
        if command is None:
            command = self._rivals.newest
        if command is not None:
            self.loop.restart(command, away=True)
            if self.lockstep:
                self._from = self._takeover.tick + 1
        return True

    def _wake(self) -> None:
        """Look again whether the present command was heard, in lockstep, until the node computes."""
        if self._waiting:
            self.advance()
        elif self._waking is not None:
            self._waking.cancel()

    def _fault_of_loop(self) -> str:
        """Fault of the loop as a whole; "" when there is none."""
        self.loop.enabled = self.working
        if self._ending:
            return ENDING
        return RIVAL if self._rival_active else ""

    def _timing_fault(self, tick: int) -> str:
        """Fault of the loop as a whole, of its inputs or of the timing, under the timer; "" when there is none."""
        fault, longest = self._fault_of_loop(), self.timer.longest_age
        if fault:
            return fault
        stale = [signal.topic for signal in self.inputs if signal.age > longest]
        if stale:
            return f"no {' and no '.join(stale)} for {longest:g} s"
        old = [signal.topic for signal in self.inputs if signal.rows.behind(tick) * self.period > longest]
        if old:
            return f"{' and '.join(old)} older than {longest:g} s"
        now = time.monotonic()
        contradictory = [signal.topic for signal in self.inputs if now - signal.rows.conflicted < longest]
        if contradictory:
            return f"two sources of {' and '.join(contradictory)}"
        if 0 < self.settings.overrun_ticks <= self.timer.overrun_streak:
            return "ticks take longer than their time"
        return ""

    def _report(self) -> None:
        """Count and log the faults that have begun."""
        raised = self.loop.faults.raised
        if raised != self._reported:
            self.counts["faults"] += 1
            self._reported = raised
            self.warn(self._present_fault, f"{self._present_fault}: the command goes to its safe value")

    def _ask(self, first: int, ahead: Array, reference: Array | None = None) -> None:
        """Warn once of a reference that asks for more slope than the slew limit, by its feedforward and by the proportional part."""
        asked = ahead if reference is None else ahead + self.settings.kp * reference
        warn_of_slope(self, self._demand.exceeds(first, asked, self.settings.slew_limit * self.period))

    def _fill(self, first: int) -> None:
        """Publish the command that was held during missed ticks, so that the record is complete, under the timer."""
        missed = self.timer.missed
        if missed and self._newest is not None and self._newest[0] + 1 == first:
            _, command, feedback = self._newest
            self._publish(first, np.repeat(command, missed, axis=0), np.repeat(feedback, missed, axis=0))

    def _publish(self, first: int, command: Array, feedback: Array) -> None:
        count = len(command)
        saturated = self.loop.controller.saturated
        if saturated != self._saturated:
            self._saturated, self._saturated_ticks = saturated, self._saturated_ticks + count
            self._longest_saturation = max(self._longest_saturation, self._saturated_ticks)
        else:
            self._saturated_ticks = 0
        self._newest = first + count - 1, command[-1:], feedback[-1:]
        if self._rivals.listening:
            self._rivals.sent(self.command.with_times(first, command))
        self.feedback.send(first, feedback)  # first: a node killed after the command could not send it any more
        self.command.send(first, command)

    def _yield_to_rival(self) -> None:
        """Publish nothing more while another node publishes `command`, where the parameter rival asks for that."""
        if self._waiting or self.settings.rival != "silent" or not self._rival_active:
            return
        self._newest, self._waiting = None, True
        self._takeover.forget()  # later it begins from what is applied
        if self._waking is not None:
            self._waking.reset()
        self.counts["faults"] += 1
        self.warn(RIVAL, f"{RIVAL}: nothing is published until it is silent")

    def _skip_answered_rows(self) -> None:
        """Drop the rows that another publisher has answered: only the newest measurement still needs a command."""
        if self.measurement is not None and self.measurement.rows.end:
            for signal in self.inputs:
                signal.rows.skip_to(self.measurement.rows.end - 1)


def _compiled(description: PI, axes: int) -> RunningPI:
    from hyst_control.export.backend import CompiledPI  # imports every stage, for which a feedback in Python would wait

    return CompiledPI(description, axes)


main = executable(PiFeedback)

if __name__ == "__main__":
    raise SystemExit(main())
