# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Units of signals: voltages, lengths and angles in radians become V, um and mrad, all others stay as the user writes them."""

from __future__ import annotations

import re

PREFIXES = {
    "": 1.0, "p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "\u03bc": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6, "G": 1e9,
}  # fmt: skip
CONVERTED = {"V": ("V", 1.0), "m": ("um", 1e6), "rad": ("mrad", 1e3)}
"""Unit without a prefix: unit of the record, and how many of them one is."""

WITH_PREFIX = ("A", "N", "Pa", "bar", "g", "Hz", "s", "W", "J", "C", "F", "T", "H", "K", "Ohm", "Ω", "bit", "Nm")
ALONE = (
    "%", "ppm", "deg", "arcmin", "arcsec", "counts", "LSB", "digit", "div", "px", "dB", "°C", "°F", "degC", "degF", "min", "h", "rpm",
    "in", "1",
)  # fmt: skip
NAMES = {
    "°": "deg",
    "volt": "V", "volts": "V", "micron": "um", "microns": "um", "micrometer": "um", "micrometers": "um", "nanometer": "nm",
    "nanometers": "nm", "millimeter": "mm", "millimeters": "mm", "meter": "m", "meters": "m", "radian": "rad", "radians": "rad",
    "degree": "deg", "degrees": "deg", "percent": "%", "count": "counts", "cts": "counts", "digits": "digit", "ampere": "A",
    "amperes": "A", "amp": "A", "amps": "A", "newton": "N", "newtons": "N", "seconds": "s", "sec": "s",
}  # fmt: skip
RAW = ("V", "mV", "uV", "A", "mA", "%", "counts", "count", "LSB", "digit", "bit", "1")
"""What a sensor hands out: behind a number and a slash ("5um/V") the unit of the file, not a part of the record's unit."""

_SCALED = re.compile(r"(?P<scale>[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)\s*\*?\s*(?P<unit>[^\d\s].*)")
_FACTOR = re.compile(r"(?P<atom>[^\d^*/·\s²³]+|1)\s*(\^?[-+]?\d|[²³])?")


def unit_of(text: str) -> tuple[str, float] | None:
    """Unit of the record and the factor to it, of a unit such as "nm", "deg" or "m/s^2"; None where it is not known."""
    text = NAMES.get(text.strip().lower() if len(text.strip()) > 2 else text.strip(), text.strip())
    for base, (unit, size) in CONVERTED.items():
        if text.endswith(base) and text[: -len(base)] in PREFIXES:
            return unit, PREFIXES[text[: -len(base)]] * size
    factors = [_FACTOR.fullmatch(factor.strip()) for factor in re.split(r"[*/·]", text)]
    return (text, 1.0) if all(factor and _is_atom(factor["atom"]) for factor in factors) else None


def scaled_unit(text: str) -> tuple[str, float] | None:
    """The same of a number and a unit: "5um/V" is ("um", 5), what one in the file stands for."""
    match = _SCALED.fullmatch(text.strip())
    if match is None:
        return unit_of(text)
    unit, slash, below = match["unit"].partition("/")
    known = unit_of(unit if slash and below.strip() in RAW else match["unit"])
    return known and (known[0], known[1] * float(match["scale"]))


def refusal_of_unit(text: str, usual: str) -> str | None:
    """Reason why a signal or a model may not be in this unit, of which `usual` are the common ones; None where it may."""
    if unit_of(text) == (text, 1.0):
        return None
    return f"{text!r}, {usual} is due, or another unit that hyst import keeps (deg, A, N, m/s^2, counts, %)"


def _is_atom(text: str) -> bool:
    bases = (*WITH_PREFIX, *CONVERTED)
    return text in ALONE or text in NAMES or any(text.endswith(base) and text[: -len(base)] in PREFIXES for base in bases)
