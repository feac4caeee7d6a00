# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A ratio of polynomials as an engineer reads it: gain, frequencies and dampings, corner frequencies, lead times.

    G(s) = gain · s^n · Π (s²/ω² + 2 ζ s/ω + 1) · Π (lead · s + 1) / [ Π (s²/ω² + 2 ζ s/ω + 1) · Π (s/ω + 1) ]

Coefficients of a polynomial depend so strongly on each other that none is known by itself, and a little scatter of each makes unstable
dynamics; these numbers may scatter one by one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.bounded_cache import remembered
from hyst_control.chain.parameter import Coordinate

CLOSE = 4.0
"""Ratio of two real roots of one sign below which they count as a pair of damping above 1: as they meet, only the pair's frequency and
damping stay smooth."""
LEAST = 0.05  # Least share of its nominal value to which a frequency or damping scatters, so that no pole leaves its half-plane


@remembered
def factors(num: Array, den: Array) -> dict[str, Coordinate]:
    """Factor num(s) / den(s)."""
    num, den = np.trim_zeros(np.asarray(num, dtype=float), "f"), np.trim_zeros(np.asarray(den, dtype=float), "f")
    if not len(num):
        return {}
    ends = [poly[np.flatnonzero(poly)[-1]] for poly in (num, den)]
    found = {"gain": Coordinate(float(ends[0] / ends[1]), abs(float(ends[0] / ends[1])), "gain", "num")}
    pairs, singles = _roots(den)
    fastest = max((w for w, _ in pairs), default=0.0)
    fastest = max([fastest, *np.abs(singles)])
    for i, (w, damping) in enumerate(pairs):
        found[f"frequency[{i}]"] = Coordinate(w / (2 * np.pi), w / (2 * np.pi), "Hz", "den")
        found[f"damping[{i}]"] = Coordinate(damping, abs(damping), "", "den")
    for i, root in enumerate(singles):
        found[f"corner[{i}]"] = Coordinate(-root / (2 * np.pi), abs(root) / (2 * np.pi), "Hz", "den")
    pairs, singles = _roots(num)
    for i, (w, damping) in enumerate(pairs):
        found[f"zero_frequency[{i}]"] = Coordinate(w / (2 * np.pi), w / (2 * np.pi), "Hz", "num")
        # The phase at the zeros, not their damping, is of a size: a damping of 0 is known as well as another.
        found[f"zero_damping[{i}]"] = Coordinate(damping, max(abs(damping), 0.05), "", "num")
    for i, root in enumerate(singles):
        # A zero far beyond all poles is of no account, wherever it is.
        found[f"lead[{i}]"] = Coordinate(-1.0 / root, max(1.0 / abs(root), 1.0 / fastest if fastest else 0.0), "s", "num")
    return found


def rational(num: Array, den: Array, values: Mapping[str, float]) -> tuple[Array, Array]:
    """Put other values in the place of some factors of num(s) / den(s)."""
    # values: by the names of `factors`. Frequencies and dampings of poles keep their sign, and a twentieth of their size at least
    nominal = {name: coordinate.value for name, coordinate in factors(num, den).items()}
    num, den = np.trim_zeros(np.asarray(num, dtype=float), "f"), np.trim_zeros(np.asarray(den, dtype=float), "f")
    known = dict(nominal)
    for name, value in values.items():
        least = LEAST * abs(nominal[name])
        held = name.startswith(("frequency", "damping", "corner", "zero_frequency"))
        known[name] = np.sign(nominal[name]) * max(value * np.sign(nominal[name]), least) if held and nominal[name] else value
    upper, lower = np.array([known.get("gain", 0.0)]), np.ones(1)
    for name, value in known.items():
        kind, _, index = name.partition("[")
        if kind in ("frequency", "zero_frequency"):
            w = 2 * np.pi * value
            factor = np.array([1.0 / w**2, 2.0 * known[f"{kind.replace('frequency', 'damping')}[{index}"] / w, 1.0])
        elif kind == "corner":
            factor = np.array([1.0 / (2 * np.pi * value), 1.0])
        elif kind == "lead":
            factor = np.array([value, 1.0])
        else:
            continue
        if kind.startswith(("zero", "lead")):
            upper = np.convolve(upper, factor)
        else:
            lower = np.convolve(lower, factor)
    upper, lower = (np.append(each, np.zeros(len(poly) - len(each))) for each, poly in ((upper, num), (lower, den)))
    scale = den[0] / lower[0]
    return upper * scale, lower * scale


def _roots(poly: Array) -> tuple[list[tuple[float, float]], list[float]]:
    """Pairs (rad/s, damping) and single real roots of a polynomial, in rising order; roots at 0 are left out."""
    roots = np.roots(poly[: np.flatnonzero(poly)[-1] + 1])
    pairs = [(float(abs(root)), float(-root.real / abs(root))) for root in roots if root.imag > 0.0]
    real = sorted((float(root.real) for root in roots if root.imag == 0.0), key=abs)
    singles: list[float] = []
    for root in real:
        if singles and singles[-1] * root > 0.0 and abs(root) < CLOSE * abs(singles[-1]):
            other = singles.pop()
            w = float(np.sqrt(root * other))
            pairs.append((w, -0.5 * (root + other) / w))
        else:
            singles.append(root)
    return sorted(pairs), singles
