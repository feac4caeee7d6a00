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
from hyst_control.chain.c_code.texts import c_filled, c_texts
from hyst_control.control.feedback.pi import RunningPI

C = c_texts(__file__)
RAMPED = C["RAMPED"]
CLAMPING = (LARGER, SMALLER, C["CLAMPED"])


def resume(controller: RunningPI) -> str:
    """`RunningPI.resume` in C, of the arrays reference, measurement, feedforward, last, and the mask back."""
    return _text(C["RESUME"], controller)


def step(controller: RunningPI) -> str:
    """`RunningPI.step` for one tick in C, of the arrays reference, measurement, feedforward and feedback."""
    return _text(C["STEP"], controller)


def reset(controller: RunningPI) -> str:
    """`RunningPI.reset` of the filters in C."""
    return C["RESET"] if _filters(controller) else ""


def functions(controller: RunningPI) -> tuple[str, ...]:
    """Functions that `step` calls."""
    return (*CLAMPING, C["THROUGH"]) if _filters(controller) else CLAMPING


def sizes(controller: RunningPI) -> dict[str, int]:
    """Sizes that the texts name."""
    return {"BEFORE": len(controller.before), "FILTERS": _filters(controller)}


def _filters(controller: RunningPI) -> int:
    return len(controller.before) + len(controller.beside)


def _text(text: str, controller: RunningPI) -> str:
    kind = "FILTERED" if _filters(controller) else "PLAIN"
    # A loop over no filters would still be compiled, and a compiler may warn of what it reads.
    before = {f"BEFORE_{part}": C[f"EACH_{part}"] if len(controller.before) else "" for part in ("RESTING", "ERROR")}
    return c_filled(text, {**{name.removeprefix(f"{kind}_"): part for name, part in C.items()}, **before})


def constants(controller: RunningPI) -> Mapping[str, Member]:
    """Constants of the texts."""
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
    """State of the texts."""
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
