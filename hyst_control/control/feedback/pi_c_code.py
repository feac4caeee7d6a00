# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""PI feedback in C, with what the feedback node adds to it: see `export.controller` for the whole.

The order of every expression is that of `control.pi`, so that both give the same bits.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

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

RESUME = """
for (int i = 0; i < AXES; i++) {
    if (back[i] != 0) {
        @RESTING@
        s->integral[i] = isfinite(integral) ? integral : R(0.0);
        s->command[i] = last[i];
        s->rolled[i] = @ROLLED@;
    }
}
"""

STEP = """
for (int i = 0; i < AXES; i++) {
    @ERROR@
    if (p->passed < R(1.0)) {
        error = s->rolled[i] + (p->passed * (error - s->rolled[i]));
    }
    real integral = s->integral[i] + (p->ki_step * error);
    @CORRECTION@
    const real wanted = feedforward[i] + correction;
    const real limited = clamped_command(wanted, s->command[i], p->lower, p->upper, p->step);
    const int limits = limited != wanted;
    if (limits) {
        integral += (limited - wanted) * p->share;
    }
    if (!isfinite(wanted) || !isfinite(@TOTAL@)) {
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
        s->command[i] = limited;@MOVED@
    }
}
"""

PLAIN = {
    "RESTING": "const real error = reference[i] - measurement[i];\n        const real integral = (p->ki_step != R(0.0)) ? "
    "((last[i] - feedforward[i]) - ((p->kp + p->ki_step) * error)) : R(0.0);",
    "ROLLED": "isfinite(error) ? error : R(0.0)",
    "ERROR": "real error = reference[i] - measurement[i];",
    "CORRECTION": "const real correction = (p->kp * error) + integral;",
    "TOTAL": "integral",
    "MOVED": "",
}
"""Parts of the texts without filters."""

FILTERED = {
    "RESTING": """double error = (double)(reference[i] - measurement[i]);
        double rest = isfinite(error) ? error : 0.0;
        for (int n = 0; n < BEFORE; n++) {
            s->memory[2 * n][i] = p->filter[n][6] * rest;
            s->memory[(2 * n) + 1][i] = p->filter[n][7] * rest;
            rest = p->filter[n][5] * rest;
            error = p->filter[n][5] * error;
        }
        double settled = 0.0;
        if (p->ki_step != R(0.0)) {
            const double without = last[i] - feedforward[i];
            const double gain = p->kp + p->ki_step;
            settled = without - (gain * error);
        }
        for (int n = BEFORE; n < FILTERS; n++) {
            s->memory[2 * n][i] = p->filter[n][6] * rest;
            s->memory[(2 * n) + 1][i] = p->filter[n][7] * rest;
            if (p->ki_step != R(0.0)) {
                settled = settled - (p->filter[n][5] * rest);
            }
        }
        const real integral = (real)settled;""",
    "ROLLED": "(real)rest",
    "ERROR": """double moved[2 * FILTERS];
    double passing = (double)(reference[i] - measurement[i]);
    for (int n = 0; n < BEFORE; n++) {
        passing = filtered(p->filter[n], passing, s->memory[2 * n][i], s->memory[(2 * n) + 1][i], &moved[2 * n]);
    }
    real error = (real)passing;""",
    "CORRECTION": """double together = (double)((p->kp * error) + integral);
    for (int n = BEFORE; n < FILTERS; n++) {
        together = together + filtered(p->filter[n], (double)error, s->memory[2 * n][i], s->memory[(2 * n) + 1][i], &moved[2 * n]);
    }
    double total = 0.0;
    for (int n = 0; n < (2 * FILTERS); n++) {
        total = total + moved[n];
    }
    const real correction = (real)together;""",
    "TOTAL": "(double)integral + total",
    "MOVED": """
        for (int n = 0; n < (2 * FILTERS); n++) {
            s->memory[n][i] = moved[n];
        }""",
}
"""The same with filters, always in double."""

THROUGH = """
/* Output of a filter of second order; its two states go on to moved. */
static double filtered(const double section[8], double value, double first, double second, double moved[2])
{
    const double output = (section[0] * value) + first;
    moved[0] = ((section[1] * value) - (section[3] * output)) + second;
    moved[1] = (section[2] * value) - (section[4] * output);
    return output;
}
"""

RESET = """
for (int n = 0; n < (2 * FILTERS); n++) {
    for (int i = 0; i < AXES; i++) {
        s->memory[n][i] = 0.0;
    }
}
"""


def resume(controller: RunningPI) -> str:
    """`RunningPI.resume` in C, of the arrays reference, measurement, feedforward, last, and the mask back."""
    return _text(RESUME, controller)


def step(controller: RunningPI) -> str:
    """`RunningPI.step` for one tick in C, of the arrays reference, measurement, feedforward and feedback."""
    return _text(STEP, controller)


def reset(controller: RunningPI) -> str:
    """`RunningPI.reset` of the filters in C."""
    return RESET.lstrip() if _filters(controller) else ""


def functions(controller: RunningPI) -> tuple[str, ...]:
    """Functions that `step` calls."""
    return (*CLAMPING, THROUGH) if _filters(controller) else CLAMPING


def sizes(controller: RunningPI) -> dict[str, int]:
    """Sizes that the texts name."""
    return {"BEFORE": len(controller.before), "FILTERS": _filters(controller)}


def _filters(controller: RunningPI) -> int:
    return len(controller.before) + len(controller.beside)


def _text(text: str, controller: RunningPI) -> str:
    for name, part in (FILTERED if _filters(controller) else PLAIN).items():
        text = text.replace(f"@{name}@", part)
    return text.strip()


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
    law = {name: reals(value, text) for (name, text), value in zip(texts.items(), controller.constants, strict=True)}
    filters = np.concatenate([controller.before, controller.beside])
    return {**law, "filter": reals(filters, "b0, b1, b2, a1, a2, and y, m1, m2 at rest", wide=True)} if len(filters) else law


def state(controller: RunningPI) -> Mapping[str, Member]:
    """State of the texts above."""
    zero: Array = controller.command
    count = _filters(controller)
    return {
        "integral": reals(zero, "V"),
        "command": reals(zero, "V, the last command"),
        "rolled": reals(zero, "measurement unit, error behind the roll-off"),
        "overflowed": reals(zero, "1 where the arithmetic left the finite and the command was held"),
        **({"memory": reals(np.zeros((2 * count, controller.axes)), "states of the filters", wide=True)} if count else {}),
        "saturated": integers(0, "commands that were limited, counted over all axes"),
    }
