"""The feedback node: adds PI feedback to the feedforward and keeps the command within its limits."""

from __future__ import annotations

from typing import Any

import numpy as np

from hyst_control.control.pi import PI
from hyst_control.errors import InputError
from hyst_control.nodes.base import TIMER, SignalNode
from hyst_control.nodes.ports import Input
from hyst_control.nodes.run import main as run_main
from hyst_control.nodes.settings import Setting


class PiFeedback(SignalNode):
    """`command` = limited (`feedforward` + `feedback`), in V.

    With `feedback: true` it goes tick by tick, as measurements come; without, it passes blocks of any length (open loop).
    Stopped, disabled, or with stale inputs under the timer, the command goes to `safe_command` at `safe_rate`; the way
    back has no jump.
    """

    SETTINGS = (
        Setting("feedback", True, "", "close the loop"),
        Setting("kp", 0.0, "V per unit", "proportional gain", 0.0, 1e9),
        Setting("ki", 0.0, "V per unit and s", "integral gain", 0.0, 1e12),
        Setting("tracking_time", 0.0, "s", "time constant of the anti-windup, 0 for kp / ki", 0.0, 1e6),
        Setting("lower", 0.0, "V", "least command", -1e6, 1e6),
        Setting("upper", 100.0, "V", "greatest command", -1e6, 1e6),
        Setting("slew_limit", 0.0, "V/s", "greatest slope of the command, 0 for none", 0.0, 1e12),
        Setting("start", "rest", "", "the first command is slewed from 0 V, or is free", choices=("rest", "first_command")),
        Setting("safe_command", (0.0,), "V", "command of a stopped loop, of all axes or of each", -1e6, 1e6),
        Setting("safe_rate", 1000.0, "V/s", "slope on the way to the safe command", 1e-6, 1e12),
    )

    def __init__(self, name: str = "pi_feedback", **options: Any) -> None:
        super().__init__(name, **options)
        given, axes = self.settings, len(self.axes)
        try:
            description = PI(given.kp, given.ki, self.period, given.lower, given.upper, given.slew_limit,
                             given.tracking_time)
        except InputError as error:
            raise InputError(f"{self.get_name()}: parameter {error}") from None
        if len(given.safe_command) not in (1, axes):
            raise InputError(f"{self.get_name()}: parameter safe_command: {len(given.safe_command)} values, {axes} axes")
        self._safe = np.clip(np.broadcast_to(np.array(given.safe_command), axes), given.lower, given.upper)
        self._controller = description.start(axes)
        self._controller.step(*np.zeros((3, 1, axes)))  # compiled before the first tick
        self._controller.pass_through(np.zeros((1, axes)))
        self._away = False
        self.command = self.output("command", "V")
        self.feedback = self.output("feedback", "V")
        self.feedforward = self.input("feedforward", "V")
        self.reference = self.measurement = None
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
        if any(each.start != first for each in rows):  # one of them was restarted in a run under way
            for each in rows:
                each.skip_to(first)
        count = min(each.available for each in rows)
        if not count:
            return
        ahead = rows[0].take(count)
        if not self.enabled:
            for each in rows[1:]:
                each.take(count)
            self._ramp(first, count)
        elif self.measurement is None:
            self._publish(first, *self._controller.pass_through(ahead))
        else:
            reference, measurement = rows[1].take(count), rows[2].take(count)
            if self._away:
                self._controller.resume(self._controller.command, reference[0], measurement[0], ahead[0])
                self._away = False
            self._publish(first, *self._controller.step(reference, measurement, ahead))

    def tick(self, tick: int) -> None:
        self._fill(tick - self.missed)
        stale = [signal.topic for signal in self.inputs if signal.age > self.settings.timeout]
        if stale:
            self.warn("stale", f"no {' and no '.join(stale)} for {self.settings.timeout:g} s: the command goes to its safe value")
        if stale or not self.enabled:
            if not np.isnan(self._controller.command).any():
                self._ramp(tick, self.settings.block)
            return
        if self.measurement is None:
            rows = self.feedforward.rows
            if rows.available:
                first = rows.start
                self._publish(first, *self._controller.pass_through(rows.take(rows.available)))
            return
        newest = [signal.rows.newest(tick) for signal in self.inputs]
        if any(row is None for row in newest):
            return
        ahead, reference, measurement = newest
        if self._away:
            self._controller.resume(self._controller.command, reference, measurement, ahead)
            self._away = False
        command, feedback = self._controller.step(reference, measurement, ahead)
        self._publish(tick, command[None], feedback[None])

    def repeat(self, source: Input) -> None:
        if source is self._paced_by:
            self.command.repeat()
            self.feedback.repeat()

    def reset(self) -> None:
        resting = self.settings.start == "rest" or self.settings.schedule == TIMER
        self._controller.reset(np.zeros(len(self.axes)) if resting else None)
        self._away = False
        self._newest: tuple[int, Any, Any] | None = None
        self.command.clear()
        self.feedback.clear()

    def status(self) -> dict[str, Any]:
        return {"saturated samples": self._controller.saturated}

    def _ramp(self, first: int, count: int) -> None:
        self._away = True
        command = self._controller.ramp(self._safe, self.settings.safe_rate, count)
        self._publish(first, command, np.zeros_like(command))

    def _fill(self, first: int) -> None:
        """Timer: in ticks that were missed the command before was held: say so, for whoever reads the record."""
        if self.missed and self._newest is not None and self._newest[0] + 1 == first:
            _, command, feedback = self._newest
            self._publish(first, np.repeat(command, self.missed, axis=0), np.repeat(feedback, self.missed, axis=0))

    def _publish(self, first: int, command: Any, feedback: Any) -> None:
        self.feedback.send(first, feedback)  # first: once the command is out, a killed node could not make up for it
        self.command.send(first, command)
        self._newest = first + len(command) - 1, command[-1:], feedback[-1:]


def main() -> int:
    """The executable."""
    return run_main(PiFeedback)


if __name__ == "__main__":
    raise SystemExit(main())
