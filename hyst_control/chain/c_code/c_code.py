# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""C of a running filter, as the filter itself gives it beside its kernel; `hyst_control.export` makes a source file of it.

The texts are bodies of C99 functions. They are given `p`, the constants, `s`, the state, and the arrays `in` and `out`, one value per
axis; `sizes` are known in them as integer constants. `real` is double or float, `R(0.5)` is a literal of it and `M(fabs)` the function
of math.h for it. `number` is `real`, or double where `wide` says that float would lose too much. Every expression stands in the
order of the kernel, so that both give the same bits in double.

TINY, LAST_DIGIT and RESOLUTION are limits of searches and states, as the kernels have them in double and wider in float.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hyst_control.base.arrays import Array, Integers
from hyst_control.chain.c_code.texts import c_texts

C = c_texts(__file__)
MAXIMUM, MINIMUM, LARGER, SMALLER, COMPLEX = (C[name] for name in ("MAXIMUM", "MINIMUM", "LARGER", "SMALLER", "COMPLEX"))

Values = Array | Integers


@dataclass(frozen=True)
class Member:
    """A constant, or a part of the state."""

    value: Values  # Of the constant; of a state only shape and type count
    text: str  # What it is, with its unit
    wide: bool = False  # Whether it is a `number` instead of a `real`; for numbers that are no integers


def integers(value: object, text: str) -> Member:
    """A member of whole numbers."""
    return Member(np.asarray(value, dtype=np.int64), text)


def reals(value: object, text: str, wide: bool = False) -> Member:
    """A member of real numbers."""
    return Member(np.asarray(value, dtype=float), text, wide)


@dataclass(frozen=True)
class CCode:
    """C of a running filter; see the module."""

    title: str  # One or two words, from which its names in C are made
    step: str  # Body of the function that advances by one sample
    # Body of the function that comes to rest at a constant input; "" where that is `step`. `SELF_step(s, in, out)` calls `step`
    settle: str = ""
    sizes: Mapping[str, int] = field(default_factory=dict)  # Integer constants by name
    constants: Mapping[str, Member] = field(default_factory=dict)
    state: Mapping[str, Member] = field(default_factory=dict)
    # Functions that the bodies call, those called first in front; the same text is written once for all filters
    functions: tuple[str, ...] = ()
    parts: tuple[CCode, ...] = ()  # Filters inside, called as `PART0_step(&s->part0, in, out)`
    outputs: int = 0  # Length of `out`; 0: one value per axis
    wide: bool = False  # Whether `number` is double also where `real` is float


def each_axis(
    expression: str,
    title: str,
    constants: Mapping[str, tuple[object, str]],
    functions: Sequence[str] = (),
    wide: Mapping[str, tuple[object, str]] | None = None,
) -> CCode:
    """C of a function without memory."""
    step = f"""
for (int i = 0; i < AXES; i++) {{
    const real u = in[i];
    out[i] = {expression};
}}
"""
    members = {name: reals(value, text) for name, (value, text) in constants.items()}
    members.update((name, reals(value, text, wide=True)) for name, (value, text) in (wide or {}).items())
    return CCode(title, step, constants=members, functions=tuple(functions))


def series(parts: Sequence[CCode]) -> CCode:
    """Filters one after the other."""

    def body(work: str) -> str:
        lines, last = [], len(parts) - 1
        signals = ["in", *(f"signal{i}" for i in range(last)), "out"]
        for i in range(last):
            lines.append(f"real signal{i}[AXES];")
        lines += [f"PART{i}_{work}(&s->part{i}, {signals[i]}, {signals[i + 1]});" for i in range(len(parts))]
        return "\n".join(lines)

    return CCode("series", body("step"), body("settle"), parts=tuple(parts))


def parallel(parts: Sequence[CCode]) -> CCode:
    """Filters fed alike, outputs added."""

    def body(work: str) -> str:
        add = "\nfor (int i = 0; i < AXES; i++) {\n    out[i] = out[i] + more[i];\n}"
        lines = ["real more[AXES];"] if len(parts) > 1 else []
        lines.append(f"PART0_{work}(&s->part0, in, out);")
        lines += [f"PART{i}_{work}(&s->part{i}, in, more);{add}" for i in range(1, len(parts))]
        return "\n".join(lines)

    return CCode("parallel", body("step"), body("settle"), parts=tuple(parts))
