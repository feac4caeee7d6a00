# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Quantities for people: a few digits, a prefix where the unit takes one, shares in percent."""

from __future__ import annotations

import math

PREFIXED = ("s", "Hz", "V", "V/s")  # Units that take a prefix; displacements keep the unit of the record
PREFIXES = {-9: "n", -6: "u", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def quantity(value: float, unit: str, digits: int = 3) -> str:
    """Write a quantity."""
    if not math.isfinite(value):
        return f"{value} {unit}".rstrip()
    if unit == "":
        return f"{100 * value:.{digits}g} %"
    if unit not in PREFIXED or value == 0:
        return f"{value:.{digits}g} {unit}"
    rounded = float(f"{value:.{digits}g}")  # 999.9 is 1 k
    power = 3 * math.floor(math.log10(abs(rounded)) / 3)
    power = min(max(power, min(PREFIXES)), max(PREFIXES))
    return f"{rounded / 10.0**power:.{digits}g} {PREFIXES[power]}{unit}"
