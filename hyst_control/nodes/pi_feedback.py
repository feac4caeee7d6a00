"""Feedback node: adds PI feedback to the feedforward and keeps the command within its limits."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyst_control.control.pi import PI
from hyst_control.errors import InputError
from hyst_control.export.backend import CompiledPI
from hyst_control.nodes.base import SignalNode
from hyst_control.nodes.common_parameters import BACKEND, TIMER, C
from hyst_control.nodes.parameters import Setting
from hyst_control.nodes.run import main as run_main
from hyst_control.nodes.sensor_watch import MOTION, MeasurementWatch
from hyst_control.nodes.signal_ports import Input

Array = NDArray[np.float64]


class PiFeedback(SignalNode):
    """Node that publishes `command` = limited (`feedforward` + `feedback`), in V.

    With `feedback: true` it runs tick by tick, as measurements arrive; otherwise it passes on blocks of any length (open loop).
    When it is stopped or disabled, when the measurement is frozen or out of range, and under the timer with stale or conflicting
    inputs or with ticks that take too long, the command goes to `safe_command` at `safe_rate`. It returns by itself when the fault is
    over, or with `recovery: manual` after `~/reset`, in both cases without a jump.

    Parameters
    ----------
    name : str
        Name of the node.
    **options : object
        Passed on to `rclpy.node.Node`.
    """

    SETTINGS = (
        Setting("feedback", True, "", "close the loop"),
        Setting("kp", 0.0, "V per unit", "proportional gain", 0.0, 1e9),
        Setting("ki", 0.0, "V per unit and s", "integral gain", 0.0, 1e12),
        Setting("roll_off", 0.0, "Hz", "corner of a low-pass of the error, 0 for none (see hyst tune --roll-off)", 0.0, 1e9),
        Setting("tracking_time", 0.0, "s", "time constant of the anti-windup, 0 for kp / ki", 0.0, 1e6),
        Setting("lower", 0.0, "V", "lowest command", -1e6, 1e6),
        Setting("upper", 100.0, "V", "highest command", -1e6, 1e6),
        Setting("slew_limit", 0.0, "V/s", "greatest slope of the command, 0 for none", 0.0, 1e12),
        Setting(
            "start",
            "rest",
            "",
            "slew the first command from 0 V (rest), or let it be any (first_command)",
            choices=("rest", "first_command"),
        ),
        Setting("safe_command", (0.0,), "V", "command of a stopped loop, one value for all axes or one each", -1e6, 1e6),
        Setting(
            "safe_rate",
            1000.0,
            "V/s",
            "slope towards the safe command, and back where the integral action cannot take over",
            1e-6,
            1e12,
            live=True,
        ),
        Setting(
            "recovery",
            "automatic",
            "",
            "end of a fault: automatic, or manual by ~/reset",
            choices=("automatic", "manual"),
            live=True,
        ),
        Setting(
            "recovery_time",
            0.1,
            "s",
            "time without a fault after which the loop continues, with automatic recovery",
            0.0,
            1e6,
            live=True,
        ),
        Setting("measurement_lower", -1e6, "um or mrad", "a lower measurement is a fault", -1e12, 1e12),
        Setting("measurement_upper", 1e6, "um or mrad", "a higher measurement is a fault", -1e12, 1e12),
        Setting(
            "frozen_time",
            0.1,
            "s",
            "time after which a constant measurement is a fault if the command moves by 1 % of its range, 0 for never",
            0.0,
            1e6,
        ),
        BACKEND,
        Setting("saturation_time", 0.5, "s", "time after which a command at its limits is a warning", 1e-6, 1e6, live=True),
        Setting(
            "overrun_ticks",
            100,
            "ticks",
            "successive ticks longer than their interval that are a fault, 0 for never",
            0,
            1_000_000,
            live=True,
        ),
    )

    def __init__(self, name: str = "pi_feedback", **options: Any) -> None:
        super().__init__(name, **options)
        given, axes = self.settings, len(self.axes)
        try:
            description = PI(
                given.kp,
                given.ki,
                self.period,
                given.lower,
                given.upper,
                given.slew_limit,
                given.tracking_time,
                given.roll_off,
            )
        except InputError as error:
            raise InputError(f"{self.get_name()}: parameter {error}") from None
        if len(given.safe_command) not in (1, axes):
            raise InputError(f"{self.get_name()}: parameter safe_command: {len(given.safe_command)} values, {axes} axes")
        self._safe = np.clip(np.broadcast_to(np.array(given.safe_command), axes), given.lower, given.upper)
        try:
            self._controller = CompiledPI(description, axes) if given.backend == C else description.start(axes)
        except InputError as error:
            raise InputError(f"{self.get_name()}: parameter backend: {error}") from None
        self._controller.step(*np.zeros((3, 1, axes)))  # compiled before the first tick
        self._controller.pass_through(np.zeros((1, axes)))
        self._watch = MeasurementWatch(
            given.measurement_lower,
            given.measurement_upper,
            self._ticks_in(given.frozen_time),
            MOTION * (given.upper - given.lower),
        )
        self._newest: tuple[int, Array, Array] | None = None
        self._away = False
        self.command = self.output("command", "V")
        self.feedback = self.output("feedback", "V")
        self.feedforward = self.input("feedforward", "V")
        self.reference: Input | None = None
        self.measurement: Input | None = None
        if given.feedback:
            self.reference = self.input("reference", self.unit)
            self.measurement = self.input("measurement", self.unit)
        self._paced_by = self.measurement or self.feedforward
        self.reset()
        self.start_timer(0.5)

    def advance(self) -> None:
        rows = [signal.rows for signal in self.inputs]
        if any(not each.available for each in rows):
            return
        first = max(each.start for each in rows)
        if any(each.start != first for each in rows):  # one of them was restarted during a run
            for each in rows:
                each.skip_to(first)
        count = min(each.available for each in rows)
        if not count:
            return
        ahead = rows[0].take(count)
        others = [each.take(count) for each in rows[1:]]
        if self.measurement is None:
            if self._safe_now("", first, count):
                self._open_loop(first, ahead)
            return
        if count == 1:
            self._closed_loop(first, ahead, others[0], others[1])
            return
        for row in range(count):
            now = slice(row, row + 1)
            self._closed_loop(first + row, ahead[now], others[0][now], others[1][now])

    def tick(self, tick: int) -> None:
        self._fill(tick - self.tick_timer.missed)
        fault, rows = self._timing_fault(), self.feedforward.rows
        running = not np.isnan(self._controller.command).any()
        if self.measurement is None:
            out = self._newest[0] + 1 if self._newest else tick  # rows streamed ahead are already published
            first = max(tick, out)
            if self._safe_now(fault, first, max(tick + self.settings.block - first, 0) if running else 0):
                rows.skip_to(out)
                if rows.available:
                    self._open_loop(rows.start, rows.take(rows.available))
            else:
                rows.skip_to(tick + 1)
            return
        newest = [row[None] for signal in self.inputs if (row := signal.rows.newest(tick)) is not None]
        if len(newest) == len(self.inputs):
            self._closed_loop(tick, newest[0], newest[1], newest[2], fault)
        elif self._newest is not None:  # nothing came since a reset
            self._to_safety(tick, 1)

    def repeat(self, source: Input, tick: int) -> None:
        if source is self._paced_by:
            self.command.repeat(tick)
            self.feedback.repeat(tick)

    def reset(self) -> None:
        """Start a run, or continue after a fault; a published command is never left with a jump."""
        timed = self.settings.schedule == TIMER
        self._away = self._newest is not None and (timed or self._away)
        if self._away:
            self._controller.reset(self._controller.command)
        else:
            self._controller.reset(np.zeros(len(self.axes)) if timed or self.settings.start == "rest" else None)
            self._newest = None
        self._fault, self._well_ticks = "", 0
        self._saturated_ticks = self._longest_saturation = 0
        self.command.clear()
        self.feedback.clear()

    def trouble(self) -> str:
        """Present fault, or "saturated" when the command was at its limits for too long since the last call."""
        longest, self._longest_saturation = self._longest_saturation, self._saturated_ticks
        return self._fault or ("saturated" if longest >= self._ticks_in(self.settings.saturation_time) else "")

    def status(self) -> dict[str, Any]:
        return {"saturated samples": self._controller.saturated, "fault": self._fault or "none"}

    def _ticks_in(self, seconds: float) -> int:
        return int(np.ceil(seconds / self.period - 1e-9))

    def _timing_fault(self) -> str:
        """Fault of the inputs or of the timing, under the timer; "" when there is none."""
        stale = [signal.topic for signal in self.inputs if signal.age > self.settings.timeout]
        if stale:
            return f"no {' and no '.join(stale)} for {self.settings.timeout:g} s"
        now = time.monotonic()
        contradictory = [signal.topic for signal in self.inputs if now - signal.rows.conflicted < self.settings.timeout]
        if contradictory:
            return f"two sources of {' and '.join(contradictory)}"
        if 0 < self.settings.overrun_ticks <= self.tick_timer.overrun_streak:
            return "ticks take longer than their time"
        return ""

    def _safe_now(self, fault: str, tick: int, count: int) -> bool:
        """Return True when the loop may run; otherwise move the command towards its safe value for `count` ticks."""
        if fault and fault != self._fault:
            self.counts["faults"] += 1
            self.warn(fault, f"{fault}: the command goes to its safe value")
        self._well_ticks = 0 if fault else self._well_ticks + max(count, 1)
        if fault or self.settings.recovery == "automatic" and self._well_ticks >= self._ticks_in(self.settings.recovery_time):
            self._fault = fault
        if not self._fault and self.enabled:
            return True
        if count:
            self._to_safety(tick, count)
        return False

    def _to_safety(self, tick: int, count: int) -> None:
        self._away = True
        command = self._controller.ramp(self._safe, self._safe_rate, count)
        self._publish(tick, command, np.zeros_like(command))

    def _closed_loop(self, tick: int, ahead: Array, reference: Array, measurement: Array, fault: str = "") -> None:
        """Compute one tick with feedback; the arrays are (1, A)."""
        last = self._controller.command
        wrong = self._watch.check(measurement[0], last)
        if not self._safe_now(fault or wrong, tick, 1):
            return
        if self._away:
            self._controller.resume(last, reference[0], measurement[0], ahead[0])
        saturated = self._controller.saturated
        command, feedback = self._controller.step(reference, measurement, ahead)
        self._note_saturation(1 if self._controller.saturated > saturated else 0)
        if self._away and not self.settings.ki:  # no integral action to lead back
            wanted = command
            self._controller.resume(last, reference[0], measurement[0], ahead[0])
            command = self._controller.ramp(wanted[0], self._safe_rate)
            self._away = not np.array_equal(command, wanted)
        else:
            self._away = False
        self._publish(tick, command, feedback)

    def _open_loop(self, first: int, ahead: Array) -> None:
        """Publish feedforward rows (N, A) within the limits; after a fault, return to them at the safe rate."""
        while self._away and len(ahead):
            target = np.clip(ahead[0], self.settings.lower, self.settings.upper)
            command = self._controller.ramp(target, self._safe_rate)
            self._away = not np.array_equal(command[0], target)
            self._publish(first, command, np.zeros_like(command))
            first, ahead = first + 1, ahead[1:]
        if len(ahead):
            saturated = self._controller.saturated
            command, feedback = self._controller.pass_through(ahead)
            self._note_saturation(len(ahead) if self._controller.saturated > saturated else 0)
            self._publish(first, command, feedback)

    def _note_saturation(self, ticks: int) -> None:
        self._saturated_ticks = self._saturated_ticks + ticks if ticks else 0
        self._longest_saturation = max(self._longest_saturation, self._saturated_ticks)

    @property
    def _safe_rate(self) -> float:
        """V/s; never above the slew limit."""
        return float(min(self.settings.safe_rate, self.settings.slew_limit or np.inf))

    def _fill(self, first: int) -> None:
        """Publish the command that was held during missed ticks, so that the record is complete, under the timer."""
        missed = self.tick_timer.missed
        if missed and self._newest is not None and self._newest[0] + 1 == first:
            _, command, feedback = self._newest
            self._publish(first, np.repeat(command, missed, axis=0), np.repeat(feedback, missed, axis=0))

    def _publish(self, first: int, command: Array, feedback: Array) -> None:
        self.feedback.send(first, feedback)  # first: a node killed after the command could not send it any more
        self.command.send(first, command)
        self._newest = first + len(command) - 1, command[-1:], feedback[-1:]


def main() -> int:
    """Run the executable; its exit status."""
    return run_main(PiFeedback)


if __name__ == "__main__":
    raise SystemExit(main())
