# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""PI feedback added to a feedforward, with filters, output limits, slew limit and anti-windup, sample by sample.

For every tick k and axis, with e = reference - measurement behind the notches of `filters`:

    rolled_k    = rolled_{k-1} + (1 - exp(-2 pi roll_off T)) (e_k - rolled_{k-1})   (e_k itself without a roll-off)
    integral_k  = integral_{k-1} + ki T rolled_k
    feedback_k  = kp rolled_k + integral_k + (derivative and damping of `filters`, of rolled_k)
    wanted_k    = feedforward_k + feedback_k
    command_k   = wanted_k clamped to [lower, upper] and to command_{k-1} -+ slew_limit T
    integral_k += (command_k - wanted_k) min(1, T / tracking_time)        (back-calculation)

(backward Euler; Astrom and Hagglund, PID Controllers, 1995, section 3.5). Without ki the integral stays 0. The roll-off is a pole of
the controller above its crossover: it takes the height from a resonance there, for which the integral may then be greater. Roll-off
and notches stand before the integral, so that whatever the limits do, they hold averages of errors and cannot wind up.

Inputs so large that a sum or product overflows leave the state of their axis as it was: the command is held, the feedback is 0, and
`overflowed` names the axis.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array, Mask
from hyst_control.base.errors import InputError
from hyst_control.control.feedback.filters import Filters, low_pass_share
from hyst_control.control.feedback.filters import constants_of as filter_constants


@dataclass(frozen=True)
class PI:
    """Description of the controller; `start` makes a running one.

    kp: V per measurement unit; ki: V per measurement unit and s; sample_time: s; lower, upper: V; slew_limit: V/s,
    0 for none; tracking_time: s, of the anti-windup, 0 for kp / ki (or a single sample where that is 0); roll_off: Hz, corner of a
    first-order low-pass of the error, 0 for none; filters: notches, derivative and damping.
    Raises `InputError` when a value makes no sense.
    """

    kp: float
    ki: float
    sample_time: float
    lower: float
    upper: float
    slew_limit: float = 0.0
    tracking_time: float = 0.0
    roll_off: float = 0.0
    filters: Filters = Filters()

    def __post_init__(self) -> None:
        for name in NUMBERS:
            value = getattr(self, name)
            if not np.isfinite(value):
                raise InputError(f"{name}: {value!r} is not a finite number")
        if self.sample_time <= 0:
            raise InputError(f"sample_time: {self.sample_time:g} s must be positive")
        if self.lower >= self.upper:
            raise InputError(f"lower: {self.lower:g} V must be below upper, {self.upper:g} V")
        for name in ("kp", "ki", "slew_limit", "tracking_time", "roll_off"):
            if getattr(self, name) < 0:
                raise InputError(f"{name}: {getattr(self, name):g} must not be negative")
        self.filters.notches(self.sample_time)

    @property
    def roll_off_share(self) -> float:
        """Share of a change of the error that the roll-off lets pass within one sample; 1 without a roll-off."""
        return low_pass_share(self.roll_off, self.sample_time)

    def start(self, axes: int) -> RunningPI:
        """A running controller for this many axes, reset."""
        return RunningPI(self, axes)


NUMBERS = tuple(field.name for field in fields(PI) if field.name != "filters")


def constants_of(description: PI) -> Array:
    """Constants (7,) of the law: kp, ki T, lower, upper, greatest step, share of the anti-windup, share of the roll-off."""
    tracking_time = description.tracking_time or (description.kp / description.ki if description.ki else 0.0)
    share = 0.0 if not description.ki else min(1.0, description.sample_time / tracking_time) if tracking_time else 1.0
    gains, limits = (description.kp, description.ki * description.sample_time), (description.lower, description.upper)
    step = description.slew_limit * description.sample_time if description.slew_limit else np.inf
    return np.array([*gains, *limits, step, share, description.roll_off_share])


class RunningPI:
    """The controller's state: integral, last command and filtered error per axis; any cutting into blocks gives the same bits."""

    def __init__(self, description: PI, axes: int) -> None:
        self.description = description
        self.axes = axes
        self._constants = constants_of(description)
        self._previous: Array | None = None  # constants before a change that has not come into effect yet
        filters, period = description.filters, description.sample_time
        self.before, self.beside = filter_constants(filters.notches(period)), filter_constants(filters.beside(period))
        """Constants (S, 8) of the filters before the controller, and of those beside it."""
        self._state = np.empty((4 + 2 * (len(self.before) + len(self.beside)), axes))
        """Integral, last command, rolled-off error, 1 where the arithmetic has overflowed, and the filters' states, of each axis."""
        self.saturated = 0
        self.overflowed: tuple[int, ...] = ()
        """Axes whose arithmetic overflowed in the last call; their commands were held."""
        self.reset()

    @property
    def constants(self) -> Array:
        """Constants of the law (7,): kp, ki T, lower, upper, greatest step, share of the anti-windup, share of the roll-off."""
        return self._constants.copy()

    @property
    def command(self) -> Array:
        """The last command (A,) in V; NaN before the first one."""
        return np.array(self._state[1])

    def reset(self, command: Array | None = None) -> None:
        """Forget the integral. The first command keeps the slew limit from `command` (A,) V, or is free when None.

        A command beyond the limits counts as at the limit: what is published lies within them from the first row on.
        """
        self._previous = None
        self._state[:] = 0.0
        self._state[1] = np.nan if command is None else np.clip(command, self.description.lower, self.description.upper)
        self.saturated, self.overflowed = 0, ()

    def change(self, description: PI) -> None:
        """Go on with other gains, limits or filters, a description of the same sample time and filters, without a jump.

        At the next tick the integral takes up what the proportional part gives up, so that the command differs from what it
        would have been by no more than (ki_new - ki_old) T e and by what other limits cut off. Without integral action there is
        nothing to take it up: then the integral is forgotten, and whoever calls has to lead the command (`control.safe_loop`
        does).
        """
        if self._previous is None:
            self._previous = self._constants.copy()
        self.description = description
        self._constants[:] = constants_of(description)

    def limit(self, lower: float, upper: float) -> None:
        """Go on with the limits `lower` and `upper`, V."""
        self.description = replace(self.description, lower=lower, upper=upper)
        self._constants[2:4] = lower, upper

    def _take_over(self, error: Array) -> None:
        """Bring a change into effect at a tick with this error (A,), measurement unit."""
        assert self._previous is not None
        kp_before, passed_before = self._previous[0], self._previous[6]
        kp, ki_step, passed = self._constants[0], self._constants[1], self._constants[6]
        with np.errstate(all="ignore"):
            for section, memory in zip(self.before, self._state[4::2]):
                error = section[0] * error + memory
            rolled = self._state[2].copy() if passed_before < 1.0 else error
            before = rolled + passed_before * (error - rolled)
            now = rolled + passed * (error - rolled)
            integral = self._state[0] + kp_before * before - kp * now if ki_step else np.zeros(self.axes)
        usable = np.isfinite(integral) & np.isfinite(rolled)
        self._state[0][usable] = integral[usable]
        self._state[2][usable] = rolled[usable]
        self._previous = None

    def resume(
        self, command: Array, reference: Array, measurement: Array, feedforward: Array, axes: Mask | slice = slice(None)
    ) -> None:
        """Take over without a jump: with these inputs the next command is `command`.

        Command and feedforward (A,) in V, reference and measurement (A,) in their unit, axes a mask (A,) of those that are
        resumed. Without integral action nothing would lead back from there: then only the slew limit holds.
        """
        kp, ki_step = self._constants[:2]
        with np.errstate(all="ignore"):
            error = reference - measurement
            if self._previous is not None:
                self._take_over(error)
            at_rest, memory = np.where(np.isfinite(error), error, 0.0), self._state[4:]
            for section in self.before:
                memory[0][axes], memory[1][axes] = (section[6] * at_rest)[axes], (section[7] * at_rest)[axes]
                at_rest, error, memory = section[5] * at_rest, section[5] * error, memory[2:]
            integral = np.asarray(command, dtype=float) - feedforward - (kp + ki_step) * error if ki_step else np.zeros(self.axes)
            for section in self.beside:
                memory[0][axes], memory[1][axes] = (section[6] * at_rest)[axes], (section[7] * at_rest)[axes]
                integral, memory = integral - section[5] * at_rest if ki_step else integral, memory[2:]
        self._state[0][axes] = np.where(np.isfinite(integral), integral, 0.0)[axes]
        self._state[1][axes] = command[axes]
        self._state[2][axes] = at_rest[axes]

    def step(self, reference: Array, measurement: Array, feedforward: Array) -> tuple[Array, Array]:
        """Command and feedback of the next ticks, both shaped like the inputs: (A,) for one tick or (N, A) for N.

        reference, measurement: measurement unit; feedforward, command, feedback: V.
        """
        if feedforward.ndim == 1:
            one = [row.reshape(1, -1) for row in (reference, measurement, feedforward)]
            command, feedback = self.step(*one)
            return command[0], feedback[0]
        if self._previous is not None:
            self._take_over((reference - measurement)[0])
        command, feedback = np.empty(feedforward.shape), np.empty(feedforward.shape)
        signals = reference, measurement, feedforward
        saturated, overflowed = _run(*signals, self._constants, self.before, self.beside, self._state, command, feedback)
        self.saturated += saturated
        self.overflowed = self._overflowed() if overflowed else ()
        return command, feedback

    def pass_through(self, feedforward: Array) -> tuple[Array, Array]:
        """The open loop: feedforward (N, A) in V within the limits, and a feedback of zeros."""
        command, feedback = np.empty(feedforward.shape), np.zeros(feedforward.shape)
        saturated, overflowed = _limit(feedforward, self._constants, self._state, command)
        self.saturated += saturated
        self.overflowed = self._overflowed() if overflowed else ()
        return command, feedback

    def _overflowed(self) -> tuple[int, ...]:
        axes = tuple(np.flatnonzero(self._state[3]).tolist())
        self._state[3] = 0.0
        return axes

    def hold(self, command: Array) -> None:
        """Take `command` (A,) in V as the last one, without any change of the integral."""
        self._state[1] = command

    def ramp(self, target: Array, rate: Array | float, ticks: int = 1) -> Array:
        """Commands (ticks, A) that go from the last one to `target` (A,) in V at no more than `rate` V/s, of all axes or of each."""
        step = rate * self.description.sample_time
        start = np.where(np.isnan(self._state[1]), target, self._state[1])
        way = target - start
        moved = np.minimum(np.arange(1, ticks + 1)[:, None] * step, np.abs(way))
        commands: Array = np.clip(start + np.sign(way) * moved, self.description.lower, self.description.upper)
        self._state[1] = commands[-1]
        return commands


@njit(cache=True)
def _clamped(wanted: float, last: float, constants: Array) -> float:
    value: float = min(max(wanted, constants[2]), constants[3])
    if not np.isnan(last):
        value = min(max(value, last - constants[4]), last + constants[4])
    return value


@njit(cache=True)
def _held(last: float, constants: Array) -> float:
    return min(max(0.0, constants[2]), constants[3]) if np.isnan(last) else last


@njit(cache=True)
def _through(section: Array, value: float, memory: Array, axis: int, moved: Array) -> float:
    """Output of a filter; its states (2, A) of the axis go on to `moved` (2,)."""
    output: float = section[0] * value + memory[0, axis]
    moved[0] = section[1] * value - section[3] * output + memory[1, axis]
    moved[1] = section[2] * value - section[4] * output
    return output


@njit(cache=True)
def _run(
    reference: Array,
    measurement: Array,
    feedforward: Array,
    constants: Array,
    before: Array,
    beside: Array,
    state: Array,
    command: Array,
    feedback: Array,
) -> tuple[int, int]:
    kp, ki_step, share, passed = constants[0], constants[1], constants[5], constants[6]
    saturated = overflowed = 0
    memory, first = state[4:], 2 * before.shape[0]
    moved = np.empty(memory.shape[0])
    for k in range(command.shape[0]):
        for axis in range(command.shape[1]):
            error = reference[k, axis] - measurement[k, axis]
            for n in range(before.shape[0]):
                error = _through(before[n], error, memory[2 * n : 2 * n + 2], axis, moved[2 * n : 2 * n + 2])
            if passed < 1.0:
                error = state[2, axis] + passed * (error - state[2, axis])
            integral = state[0, axis] + ki_step * error
            correction = kp * error + integral
            for n in range(beside.shape[0]):
                at = first + 2 * n
                correction += _through(beside[n], error, memory[at : at + 2], axis, moved[at : at + 2])
            wanted = feedforward[k, axis] + correction
            limited = _clamped(wanted, state[1, axis], constants)
            limits = limited != wanted
            if limits:
                integral += (limited - wanted) * share
            total = 0.0
            for n in range(memory.shape[0]):
                total += moved[n]
            if not (np.isfinite(wanted) and np.isfinite(integral + total)):
                overflowed += 1
                state[3, axis] = 1.0
                feedback[k, axis] = 0.0
                command[k, axis] = state[1, axis] = _held(state[1, axis], constants)
                continue
            if limits:
                saturated += 1
            if passed < 1.0:
                state[2, axis] = error
            for n in range(memory.shape[0]):
                memory[n, axis] = moved[n]
            feedback[k, axis] = correction
            command[k, axis] = limited
            state[0, axis] = integral
            state[1, axis] = limited
    return saturated, overflowed


@njit(cache=True)
def _limit(feedforward: Array, constants: Array, state: Array, command: Array) -> tuple[int, int]:
    saturated = overflowed = 0
    for k in range(command.shape[0]):
        for axis in range(command.shape[1]):
            if np.isfinite(feedforward[k, axis]):
                command[k, axis] = _clamped(feedforward[k, axis], state[1, axis], constants)
                if command[k, axis] != feedforward[k, axis]:
                    saturated += 1
            else:
                overflowed += 1
                state[3, axis] = 1.0
                command[k, axis] = _held(state[1, axis], constants)
            state[1, axis] = command[k, axis]
    return saturated, overflowed
