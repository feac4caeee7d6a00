# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Linear dynamics G(s) of unit static gain, parametrized so that it is stable for every parameter vector.

    G(s) = e^(-tau s) · Π_i (1 + b_i-polynomial) / Π (s²/ω² + 2ζ s/ω + 1) · Π 1/(s/ω_f + 1) · (s/z + 1)/(s/p + 1)

The factors are optional; together they are the structure. The static gain is part of the weights of the hysteresis, from which
it could not be separated.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.linear.linear_stages import (
    Delay,
    Discretised,
    TransferFunction,
    discretise,
    transfer_function_system,
)
from hyst_control.chain.stage import Sampling, Stage
from hyst_control.identify.data.fit import Number

MIN_DAMPING, MAX_DAMPING = 0.002, 5.0
NEAR = 0.01  # Relative distance from a bound at which a parameter is at it
SLOW = 60.0  # Highest rate (1/s) of a slow pole, at records of 10 kHz or faster
TAU_UNIT = 1e-4
"""The delay's unit in the parameter vector, so that every entry is of order one: seconds, or the sample time of slower records."""


def pace(sample_time: float) -> float:
    """Factor by which the delays and modes of a record are looked for at longer times than those of a record at 10 kHz or faster."""
    return max(sample_time / TAU_UNIT, 1.0)


@dataclass(frozen=True)
class Structure:
    """Factors of G(s)."""

    modes: int = 0  # Number of second-order modes
    lags: int = 0  # Number of first-order lags
    zeros: int = 0  # Number of zeros of the numerator
    slow_pair: bool = False  # A slow pole and zero, for creep
    delay: bool = False  # A delay
    pace: float = field(default=1.0, compare=False)  # Unit of the delay, in `TAU_UNIT`
    # Highest frequency (Hz) of a pole that the records could tell; structures are equal whatever it is
    highest: float = field(default=np.inf, compare=False)
    # Lowest rate (1/s) of a slow pole that the records could tell from a drift
    slowest: float = field(default=0.3, compare=False)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 2 * self.modes + self.lags + self.zeros + 2 * self.slow_pair + self.delay

    def describe(self) -> str:
        """The structure in words."""
        parts = [
            f"{self.modes} mode{'s' if self.modes > 1 else ''}" * bool(self.modes),
            f"{self.lags} lag{'s' if self.lags > 1 else ''}" * bool(self.lags),
            f"{self.zeros} zero{'s' if self.zeros > 1 else ''}" * bool(self.zeros),
            "slow pole-zero pair" * self.slow_pair,
            "delay" * self.delay,
        ]
        return ", ".join(part for part in parts if part) or "no dynamics"

    @classmethod
    def parse(cls, text: object) -> Structure:
        """Parse a text such as "modes=1,zeros=2,delay"; a structure stays itself."""
        if isinstance(text, Structure):
            return text
        if not isinstance(text, str):
            raise ValueError
        values: dict[str, int | bool] = {}
        for part in text.split(","):
            name, equals, value = part.strip().partition("=")
            if name in ("modes", "lags", "zeros"):
                values[name] = int(value)
            elif name in ("slow_pair", "delay") and not equals:
                values[name] = True
            else:
                raise ValueError
        if min(values.values()) < 0:
            raise ValueError
        return cls(**values)  # type: ignore[arg-type]  # bool or int as the field is

    def extensions(self) -> list[Structure]:
        """The structures with one factor more, in the order of preference when they do equally well."""
        options: list[Structure] = []
        if not self.delay:
            options.append(replace(self, delay=True))
        if self.modes == 0:
            options.append(replace(self, modes=1))
        if self.lags == 0:
            options.append(replace(self, lags=1))
        if self.zeros + 1 < 2 * self.modes + self.lags:
            options.append(replace(self, zeros=self.zeros + 1))
        if not self.slow_pair and self.modes:
            options.append(replace(self, slow_pair=True))
        if self.lags == 0 and self.zeros + 2 <= 2 * self.modes:
            # A lag lets a part of the motion arrive late only together with zeros: alone it delays all of it.
            options.append(replace(self, lags=1, zeros=self.zeros + 2))
        if self.modes == 1:
            options.append(replace(self, modes=2))
        return options

    def start(self, frequency: float) -> Annotated[Array, "P"]:
        """Initial parameters: modes and lags near a frequency, all other factors neutral."""
        w = 2 * np.pi * frequency
        values: list[float] = []
        for mode in range(self.modes):
            values += [np.log(w * 1.7**mode), np.log(0.5)]
        values += [np.log(2 * w)] * self.lags + [0.0] * self.zeros
        if self.slow_pair:
            values += [np.log(8.0), 0.02]
        return np.array(values + [0.3] * self.delay)

    def grow(self, smaller: Structure, parameters: Array, frequency: float) -> Annotated[Array, "P"]:
        """Convert the parameters of a smaller structure to this one, new factors neutral."""
        old, new = smaller.split(parameters), self.split(self.start(frequency))
        for name, values in old.items():
            if name == "modes" and len(values) < len(new[name]):
                new[name][len(values) :, 0] = values[-1, 0] + 0.7 if len(values) else new[name][len(values) :, 0]
            new[name][: len(values)] = values
        if self.modes > smaller.modes and smaller.modes == 0 and smaller.lags:
            new["lags"][:] += 1.0
        return np.concatenate([part.ravel() for part in new.values()])

    def with_last_mode(self, parameters: Array, frequency: float, damping: float) -> Annotated[Array, "P"]:
        """Parameters whose last mode is another one."""
        parts = self.split(parameters)
        parts["modes"][-1] = np.log(2 * np.pi * frequency), np.log(damping)
        return np.concatenate([part.ravel() for part in parts.values()])

    def without_slow_pair(self, parameters: Array) -> Annotated[Array, "P"]:
        """Parameters of the same structure without its slow pair."""
        return np.concatenate([part.ravel() for name, part in self.split(parameters).items() if name != "slow_pair"])

    def split(self, parameters: Annotated[Array, "P"]) -> dict[str, Array]:
        """Split a parameter vector by factor."""
        counts = [2 * self.modes, self.lags, self.zeros, 2 * self.slow_pair, int(self.delay)]
        parts = np.split(np.array(parameters, dtype=float), np.cumsum(counts)[:-1])
        return dict(zip(("modes", "lags", "zeros", "slow_pair", "delay"), (parts[0].reshape(-1, 2), *parts[1:]), strict=True))

    def rational(self, parameters: Annotated[Array, "P"]) -> tuple[Array, Array]:
        """Rational part of G(s), with unit static gain."""
        parts = self.split(parameters)
        den, num = np.ones(1), self.numerator(parameters)
        for log_w, log_damping in parts["modes"]:
            w = np.exp(log_w)
            den = np.convolve(den, [1 / w**2, 2 * np.exp(log_damping) / w, 1.0])
        for log_w in parts["lags"]:
            den = np.convolve(den, [np.exp(-log_w), 1.0])
        if self.slow_pair:
            pole = np.exp(parts["slow_pair"][0])
            num = np.convolve(num, [np.exp(-parts["slow_pair"][1]) / pole, 1.0])
            den = np.convolve(den, [1.0 / pole, 1.0])
        return num / den[0], den / den[0]

    def numerator(self, parameters: Annotated[Array, "P"]) -> Array:
        """Polynomial of the zeros, without that of the slow pair."""
        parts = self.split(parameters)
        scale = np.exp(np.concatenate([parts["modes"][:, 0], parts["lags"]]).min(initial=np.inf))
        return np.append(parts["zeros"][::-1] / scale ** np.arange(self.zeros, 0, -1), 1.0)

    def tau(self, parameters: Annotated[Array, "P"]) -> float:
        """Delay of G(s), never negative."""
        return TAU_UNIT * self.pace * max(float(parameters[-1]), 0.0) if self.delay else 0.0

    def numbers(self, parameters: Annotated[Array, "P"]) -> list[Number]:
        """Coefficients of the rational part, and the delay, as a report lists them."""
        num, den = self.rational(parameters)
        found = [Number(f"num[{i}]", value) for i, value in enumerate(num)] if len(den) > 1 else []
        found += [Number(f"den[{i}]", value) for i, value in enumerate(den) if i]
        return found + ([Number("tau", self.tau(parameters), "s")] if self.delay else [])

    def stages(self, parameters: Annotated[Array, "P"]) -> list[Stage]:
        """Construct the stages of the dynamics: the delay, then the rational part."""
        stages: list[Stage] = []
        if self.delay and self.tau(parameters) > 0:
            stages.append(Delay(self.tau(parameters)))
        if self.modes + self.lags + self.slow_pair:
            num, den = self.rational(parameters)
            stages.append(TransferFunction(num, den))
        return stages

    def discretized(self, parameters: Annotated[Array, "P"], sampling: Sampling) -> tuple[Discretised, int]:
        """Discretize the dynamics exactly."""
        samples = self.tau(parameters) / sampling.sample_time
        whole = int(np.floor(samples + 1e-9))
        system = transfer_function_system(*self.rational(parameters))
        return discretise(system, np.array([max(samples - whole, 0.0)]), sampling), whole

    def limit(self, parameters: Annotated[Array, "P"], sample_time: float) -> Annotated[Array, "P"]:
        """Move parameters into the range that data can resolve: rates below the sampling rate, damping 0.002 ... 5.

        A slow pair moves a tenth of the stroke at most: it stands for creep, not for a hysteresis that the operators miss.
        """
        parts = self.split(parameters)
        fastest = self._fastest(sample_time)
        parts["modes"][:, 0] = np.minimum(parts["modes"][:, 0], fastest)
        parts["modes"][:, 1] = np.clip(parts["modes"][:, 1], np.log(MIN_DAMPING), np.log(MAX_DAMPING))
        parts["lags"] = np.minimum(parts["lags"], fastest)
        parts["delay"] = np.maximum(parts["delay"], 0.0)
        if self.slow_pair:
            lowest, highest = self._slow_rates()
            parts["slow_pair"] = np.clip(parts["slow_pair"], [lowest, -0.1], [highest, 0.1])
        return np.concatenate([part.ravel() for part in parts.values()])

    def at_limit(self, parameters: Annotated[Array, "P"], sample_time: float) -> bool:
        """Report whether a pole is as fast or slow as it may be, or a damping at a bound: then the data tell no such factor."""
        parts = self.split(parameters)
        rates = np.concatenate([parts["modes"][:, 0], parts["lags"]])
        damping = parts["modes"][:, 1]
        bounded = (damping <= np.log(MIN_DAMPING) + NEAR) | (damping >= np.log(MAX_DAMPING) - NEAR)
        slow = np.any(parts["slow_pair"][:1] <= self._slow_rates()[0] + NEAR)
        return bool(slow or np.any(rates >= self._fastest(sample_time) - NEAR) or np.any(bounded))

    def _slow_rates(self) -> tuple[float, float]:
        """Logarithms of the lowest and the highest rate (1/s) of the slow pole."""
        highest = SLOW / self.pace
        return float(np.log(min(max(self.slowest, 1e-300), highest))), float(np.log(highest))

    def _fastest(self, sample_time: float) -> float:
        """Logarithm of the fastest rate (1/s) of a pole."""
        return float(np.log(2 * np.pi * max(min(1.5 / sample_time, self.highest), 1e-300)))  # 0: nothing is excited
