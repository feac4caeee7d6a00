"""A linear dynamics G(s) of unit static gain, parametrised so that it is stable for every parameter vector.

    G(s) = e^(-tau s) · Π_i (1 + b_i-polynomial) / Π (s²/ω² + 2ζ s/ω + 1) · Π 1/(s/ω_f + 1) · (s/z + 1)/(s/p + 1)

The factors are optional; together they are the structure. The static gain is left to the weights of the hysteresis, from which
it could not be told apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hyst_control.chain.linear import (
    Delay,
    Discretised,
    LinearSystem,
    TransferFunction,
    discretise,
    transfer_function_system,
)
from hyst_control.chain.stage import Array, Sampling, Stage

TAU_UNIT = 1e-4
"""The delay's unit (s) in the parameter vector, so that every entry is of order one."""


@dataclass(frozen=True)
class Structure:
    """Factors of G(s): modes (second order), lags (first order), zeros of the numerator, a slow pair, a delay."""

    modes: int = 0
    lags: int = 0
    zeros: int = 0
    slow_pair: bool = False
    delay: bool = False

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 2 * self.modes + self.lags + self.zeros + 2 * self.slow_pair + self.delay

    @property
    def static(self) -> bool:
        """Absence of any dynamics."""
        return self.size == 0

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
        """Read a structure from a text such as "modes=1,zeros=2,delay". Raises `ValueError` for any other; a structure stays itself."""
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

    def start(self, frequency: float) -> Array:
        """A parameter vector to begin with: modes and lags near `frequency` (Hz), everything else neutral."""
        w = 2 * np.pi * frequency
        values: list[float] = []
        for mode in range(self.modes):
            values += [np.log(w * 1.7**mode), np.log(0.5)]
        values += [np.log(2 * w)] * self.lags + [0.0] * self.zeros
        if self.slow_pair:
            values += [np.log(8.0), 0.02]
        return np.array(values + [0.3] * self.delay)

    def grow(self, smaller: Structure, parameters: Array, frequency: float) -> Array:
        """The parameters of a smaller structure carried over to this one, new factors neutral."""
        old, new = smaller.split(parameters), self.split(self.start(frequency))
        for name, values in old.items():
            if name == "modes" and len(values) < len(new[name]):
                new[name][len(values) :, 0] = values[-1, 0] + 0.7 if len(values) else new[name][len(values) :, 0]
            new[name][: len(values)] = values
        if self.modes > smaller.modes and smaller.modes == 0 and smaller.lags:
            new["lags"][:] += 1.0
        return np.concatenate([part.ravel() for part in new.values()])

    def split(self, parameters: Array) -> dict[str, Array]:
        """The parameter vector by factor; modes (n, 2)."""
        counts = [2 * self.modes, self.lags, self.zeros, 2 * self.slow_pair, int(self.delay)]
        parts = np.split(np.array(parameters, dtype=float), np.cumsum(counts)[:-1])
        return dict(zip(("modes", "lags", "zeros", "slow_pair", "delay"), (parts[0].reshape(-1, 2), *parts[1:]), strict=True))

    def rational(self, parameters: Array) -> tuple[Array, Array]:
        """num and den, descending powers of s, unit static gain."""
        parts = self.split(parameters)
        den, num = np.ones(1), np.ones(1)
        scale = np.inf
        for log_w, log_damping in parts["modes"]:
            w = np.exp(log_w)
            den = np.polymul(den, [1 / w**2, 2 * np.exp(log_damping) / w, 1.0])
            scale = min(scale, w)
        for log_w in parts["lags"]:
            den = np.polymul(den, [np.exp(-log_w), 1.0])
            scale = min(scale, np.exp(log_w))
        if self.zeros:
            num = np.append(parts["zeros"][::-1] / scale ** np.arange(self.zeros, 0, -1), 1.0)
        if self.slow_pair:
            pole = np.exp(parts["slow_pair"][0])
            num = np.polymul(num, [np.exp(-parts["slow_pair"][1]) / pole, 1.0])
            den = np.polymul(den, [1.0 / pole, 1.0])
        return num / den[0], den / den[0]

    def tau(self, parameters: Array) -> float:
        """Delay in s, never negative."""
        return TAU_UNIT * max(float(parameters[-1]), 0.0) if self.delay else 0.0

    def stages(self, parameters: Array) -> list[Stage]:
        """The dynamics as stages of a chain: the delay, then the rest."""
        stages: list[Stage] = []
        if self.delay and self.tau(parameters) > 0:
            stages.append(Delay(self.tau(parameters)))
        if self.modes + self.lags + self.slow_pair:
            num, den = self.rational(parameters)
            stages.append(TransferFunction(num, den))
        return stages

    def discretised(self, parameters: Array, sampling: Sampling) -> tuple[Discretised, int]:
        """One exact step of the sampled dynamics, and its delay in whole samples."""
        samples = self.tau(parameters) / sampling.sample_time
        whole = int(np.floor(samples + 1e-9))
        if self.modes + self.lags + self.slow_pair:
            system = transfer_function_system(*self.rational(parameters))
        else:
            system = LinearSystem(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)), np.zeros(1))
        return discretise(system, np.array([max(samples - whole, 0.0)]), sampling), whole

    def limit(self, parameters: Array, sample_time: float) -> Array:
        """The parameters held where the data can tell something: rates below the sampling rate, damping 0.002…5.

        A slow pair moves a tenth of the stroke at most: it stands for creep, not for a hysteresis that the operators miss.
        """
        parts = self.split(parameters)
        fastest = np.log(2 * np.pi * 1.5 / sample_time)
        parts["modes"][:, 0] = np.minimum(parts["modes"][:, 0], fastest)
        parts["modes"][:, 1] = np.clip(parts["modes"][:, 1], np.log(0.002), np.log(5.0))
        parts["lags"] = np.minimum(parts["lags"], fastest)
        parts["delay"] = np.maximum(parts["delay"], 0.0)
        if self.slow_pair:
            parts["slow_pair"] = np.clip(parts["slow_pair"], [np.log(0.3), -0.1], [np.log(60.0), 0.1])
        return np.concatenate([part.ravel() for part in parts.values()])
