# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""PI feedback in C, with what the feedback node adds to it: see `export.controller` for the whole.

The order of every expression is that of `control.pi`, so that both give the same bits.
"""

from __future__ import annotations

from collections.abc import Mapping

from hyst_control.base.arrays import Array
from hyst_control.chain.c_code.c_code import LARGER, SMALLER, Member, integers, reals
from hyst_control.control.feedback.pi import RunningPI

CLAMPED = """
/* Within [lower, upper], and no farther from the last command than a step. */
static real clamped_command(real wanted, real last, real lower, real upper, real step)
{
    real value = smaller_of(larger_of(wanted, lower), upper);
    if (!isnan(last)) {
        value = smaller_of(larger_of(value, last - step), last + step);
    }
    return value;
}
"""

RAMPED = """
/* From the last command towards a target by no more than a step. */
static real ramped_command(real last, real target, real lower, real upper, real step)
{
    const real start = isnan(last) ? target : last;
    const real way = target - start;
    const real moved = smaller_of(step, M(fabs)(way));
    const real sign = (way > R(0.0)) ? R(1.0) : ((way < R(0.0)) ? R(-1.0) : R(0.0));
    return smaller_of(larger_of(start + (sign * moved), lower), upper);
}
"""

CLAMPING = (LARGER, SMALLER, CLAMPED)
FUNCTIONS = (*CLAMPING, RAMPED)

RESUME = """
for (int i = 0; i < AXES; i++) {
    if (back[i] != 0) {
        const real error = reference[i] - measurement[i];
        const real integral = (p->ki_step != R(0.0)) ? ((last[i] - feedforward[i]) - ((p->kp + p->ki_step) * error)) : R(0.0);
        s->integral[i] = isfinite(integral) ? integral : R(0.0);
        s->command[i] = last[i];
        s->rolled[i] = isfinite(error) ? error : R(0.0);
    }
}
"""
"""`RunningPI.resume` in C, of the arrays reference, measurement, feedforward, last, and the mask back."""

STEP = """
for (int i = 0; i < AXES; i++) {
    real error = reference[i] - measurement[i];
    if (p->passed < R(1.0)) {
        error = s->rolled[i] + (p->passed * (error - s->rolled[i]));
    }
    real integral = s->integral[i] + (p->ki_step * error);
    const real correction = (p->kp * error) + integral;
    const real wanted = feedforward[i] + correction;
    const real limited = clamped_command(wanted, s->command[i], p->lower, p->upper, p->step);
    const int limits = limited != wanted;
    if (limits) {
        integral += (limited - wanted) * p->share;
    }
    if (!isfinite(wanted) || !isfinite(integral)) {
        s->overflowed[i] = R(1.0);
        feedback[i] = R(0.0);
        if (isnan(s->command[i])) {
            s->command[i] = smaller_of(larger_of(R(0.0), p->lower), p->upper);
        }
    } else {
        if (limits) {
            s->saturated = (s->saturated < 1000000000) ? (s->saturated + 1) : s->saturated;
        }
        if (p->passed < R(1.0)) {
            s->rolled[i] = error;
        }
        feedback[i] = correction;
        s->integral[i] = integral;
        s->command[i] = limited;
    }
}
"""
"""`RunningPI.step` for one tick in C, of the arrays reference, measurement, feedforward and feedback."""


def constants(controller: RunningPI) -> Mapping[str, Member]:
    """Constants of the texts above."""
    texts = {
        "kp": "V / measurement unit",
        "ki_step": "V / measurement unit, of the integral in a step",
        "lower": "V, least command",
        "upper": "V, greatest command",
        "step": "V, greatest change of the command in a step",
        "share": "of what was cut off that leaves the integral in a step",
        "passed": "share of the error's change that the roll-off passes in a step",
    }
    return {name: reals(value, text) for (name, text), value in zip(texts.items(), controller.constants, strict=True)}


def state(controller: RunningPI) -> Mapping[str, Member]:
    """State of the texts above."""
    zero: Array = controller.command
    return {
        "integral": reals(zero, "V"),
        "command": reals(zero, "V, the last command"),
        "rolled": reals(zero, "measurement unit, error behind the roll-off"),
        "overflowed": reals(zero, "1 where the arithmetic left the finite and the command was held"),
        "saturated": integers(0, "commands that were limited, counted over all axes"),
    }
