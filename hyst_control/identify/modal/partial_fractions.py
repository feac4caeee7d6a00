# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Linear dynamics as a sum of sections of first and second order, stable for every parameter vector.

    G(s) = e^(-tau s) [ d + Σ (g_i + h_i s/w_i) / (s²/w_i² + 2 z_i s/w_i + 1) + g_0 / (s/w_0 + 1) ]

A section has two real poles where z > 1, so a search crosses from modes to lags without a seam. `smooth` dynamics answer a jump without
a jump of velocity (two poles more than zeros): then the h of the fastest section follows from the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain import Parallel, Stage
from hyst_control.chain.linear.linear_stages import Delay, StateSpace, TransferFunction
from hyst_control.identify.modal.vector_fitting import Partial

MIN_DAMPING = 5e-4
SLOWEST = 0.005  # Rate of the slowest pole, in inverse lengths of the record: within this an integrator answers alike


@lru_cache(maxsize=4096)
def _section(direct: float, *numbers: float) -> StateSpace:
    """A section from its numerator and the denominator behind the leading 1, in states whose arithmetic loses nothing."""
    if len(numbers) == 2:
        num, rate = numbers
        return StateSpace([[-rate]], [[rate]], [[num / rate]], [[direct]])
    slope, num, damping, square = numbers
    w = float(np.sqrt(square))
    return StateSpace([[0.0, w], [-w, -damping]], [[0.0], [w]], [[num / square, slope / w]], [[direct]])


@dataclass(frozen=True)
class Sections:
    """Structure of the dynamics and the scales of its parameters.

    A parameter vector holds log(w), log(z), g, h of every section, log(w) and g of the lag, d, and the delay. Its g and h are of order one
    also for a pole at 0, whose static gain is infinite: they are counted in what the section answers at the inverse length of the record.
    """

    order: int
    direct: bool
    delay: bool
    smooth: bool
    gain: float  # Unit of gains: range of the measurement / range of the command, with its sign
    late: float  # Delay in s where it is not estimated; else its unit
    slowest: float
    fastest: float  # Bounds of w, rad/s

    @property
    def reference(self) -> float:
        """Inverse length of the longest record, 1/s."""
        return self.slowest / SLOWEST

    @property
    def pairs(self) -> int:
        """Number of sections of second order."""
        return self.order // 2

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 2 * self.order + self.direct + self.delay

    @property
    def parameters(self) -> int:
        """Number of free parameters."""
        return self.size - self.smooth

    def vector(self, partial: Partial, sample_time: float, delay: float) -> Array:
        """Parameters of partial fractions whose time is counted in samples; delay in s."""
        sections, lags = [], []
        for pole, residue in zip(partial.poles / sample_time, partial.residues / sample_time, strict=True):
            if pole.imag:
                w = abs(pole)
                sections.append(
                    (np.log(w), np.log(-pole.real / w), -2 * (residue * np.conj(pole)).real / w**2, 2 * residue.real / w)
                )
            else:
                lags.append((-pole.real, residue.real))
        lags.sort()
        lag = [lags.pop()] if self.order % 2 else []
        for (p1, r1), (p2, r2) in zip(lags[::2], lags[1::2], strict=True):
            w = np.sqrt(p1 * p2)
            sections.append((np.log(w), np.log((p1 + p2) / (2 * w)), (r1 * p2 + r2 * p1) / w**2, (r1 + r2) / w))
        found = [
            [a, b, *(np.array([g, h]) / self.gain / self._units(np.exp(np.array([a])), np.exp(b)).ravel())]
            for a, b, g, h in sections
        ]
        found += [[np.log(p), r / (p + self.reference) / self.gain] for p, r in lag]
        tail = [partial.direct / self.gain] * self.direct + ([delay / self.late] if self.delay else [])
        return self.limit(np.array([*(value for part in found for value in part), *tail]))

    def partial(self, vector: Array, sample_time: float) -> Partial:
        """Partial fractions of a vector, time counted in samples."""
        poles: list[complex] = []
        residues: list[complex] = []
        for num, den in self.terms(vector):
            if len(den) == 3 and abs(den[1] ** 2 - 4 * den[2]) < 1e-6 * den[2]:
                den = den * np.array([1.0, 1.0 + 1e-6, 1.0])  # a double pole has no residues
            for pole in np.roots(den):
                if pole.imag >= 0.0:
                    poles.append(complex(pole))
                    residues.append(complex(np.polyval(num, pole) / np.polyval(np.polyder(den), pole)))
        return Partial(np.array(poles) * sample_time, np.array(residues) * sample_time, self.direct_gain(vector), 0.0)

    def limit(self, vector: Array) -> Array:
        """The nearest parameters within the bounds."""
        limited = np.array(vector, dtype=float)
        section, lag = self._split(limited)
        low, high = np.log(self.slowest), np.log(self.fastest)
        section[:, 0] = np.clip(section[:, 0], low, high)
        section[:, 1] = np.clip(section[:, 1], np.log(MIN_DAMPING), self._max_log_damping(section[:, 0]))
        lag[:1] = np.clip(lag[:1], low, high)
        if self.delay:
            limited[-1] = max(limited[-1], 0.0)
        return limited

    def _max_log_damping(self, log_w: Array) -> Array:
        """Damping at which one of a section's two real poles reaches a bound of w."""
        nearest = np.minimum(log_w - np.log(self.slowest), np.log(self.fastest) - log_w)
        return np.asarray(np.log(np.cosh(np.maximum(nearest, 0.0))))

    def tau(self, vector: Array) -> float:
        """Delay, s."""
        return self.late * (max(float(vector[-1]), 0.0) if self.delay else 1.0)

    def direct_gain(self, vector: Array) -> float:
        """Direct path d."""
        return self.gain * float(vector[2 * self.order]) if self.direct else 0.0

    def static_gain(self, vector: Array) -> float:
        """Response to a constant command, over it."""
        return sum(float(num[-1] / den[-1]) for num, den in self.terms(vector)) + self.direct_gain(vector)

    def terms(self, vector: Array) -> list[tuple[Array, Array]]:
        """Numerator and denominator of every section, in powers of s with a denominator that begins with 1."""
        section, lag = self._split(vector)
        section = section.copy()
        w = np.exp(section[:, 0])
        section[:, 2:] *= self._units(w, np.exp(section[:, 1])).T
        lag = lag * np.array([1.0, 1.0 + self.reference * float(np.exp(-lag[:1]).sum())][: len(lag)])
        if self.smooth and len(w):
            last = int(np.argmax(w))
            others = float(np.delete(section[:, 3] * w, last).sum()) + float(np.exp(lag[:1]).sum() * lag[1:].sum())
            section[last, 3] = -others / w[last]
        found = [
            (self.gain * np.array([h * rate, g * rate**2]), np.array([1.0, 2 * np.exp(log_z) * rate, rate**2]))
            for rate, (_, log_z, g, h) in zip(w, section, strict=True)
        ]
        if len(lag):
            rate = float(np.exp(lag[0]))
            found.append((self.gain * np.array([lag[1] * rate]), np.array([1.0, rate])))
        return found

    def parts(self, vector: Array) -> list[StateSpace]:
        """The sections, the first one with the direct path."""
        terms, direct = self.terms(vector), self.direct_gain(vector)
        if not terms:  # a gain alone has one state, neither driven nor observed
            return [StateSpace([[-self.slowest]], [[0.0]], [[0.0]], [[direct]])]
        return [_section(0.0 if i else direct, *map(float, num), *map(float, den[1:])) for i, (num, den) in enumerate(terms)]

    def running(self, vector: Array, beside: Sequence[StateSpace] = ()) -> list[Stage]:
        """Chain of the dynamics as parts side by side: those of neighboring parameters share all but one; beside: further parts."""
        late, parts = self._delay(vector), [*self.parts(vector), *beside]
        return [Parallel(tuple((*late, part) for part in parts))] if len(parts) > 1 else [*late, *parts]

    def stages(self, vector: Array) -> list[Stage]:
        """Chain of the dynamics as a model file states it: the delay, then one `transfer_function`."""
        num: Array = np.zeros(1)
        den: Array = np.ones(1)
        for upper, lower in self.terms(vector):
            num = np.asarray(np.polyadd(np.polymul(num, lower), np.polymul(upper, den)), dtype=float)
            den = np.asarray(np.polymul(den, lower), dtype=float)
        num = np.asarray(np.polyadd(num, self.direct_gain(vector) * den), dtype=float)
        if self.smooth:
            num = num[-max(len(den) - 2, 1) :]
        return [*self._delay(vector), TransferFunction(np.trim_zeros(num, "f") if np.any(num) else np.zeros(1), den)]

    def _units(self, w: Array, z: Array) -> Array:
        """Units (2, pairs) of g and h."""
        answer = w**2 + 2.0 * z * w * self.reference + self.reference**2
        return np.array([answer / w**2, answer / (w * (w + self.reference))])

    def _delay(self, vector: Array) -> list[Stage]:
        tau = self.tau(vector)
        return [Delay(tau)] if tau > 0.0 else []

    def _split(self, vector: Array) -> tuple[Array, Array]:
        """Views of the sections (pairs, 4) and the lag (2,) or (0,)."""
        return vector[: 4 * self.pairs].reshape(-1, 4), vector[4 * self.pairs : 2 * self.order]
