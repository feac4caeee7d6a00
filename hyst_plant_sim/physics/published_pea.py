"""The published HAMPI model as a plant of its own code: what the simulator's chain is held against.

Play operators in the form of HAMPI paper Eq. 3, dynamic weights of Eq. 4-6 with the backward difference of the held command,
the dynamics G(s) of Eq. 7 with the slow pole-zero pair, stepped exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hyst_plant_sim.physics import exact
from hyst_plant_sim.physics.pea import PlantError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PublishedPeaParameters:
    """thresholds V, weights um/V per unit of G's static gain, m1 and m2 s/V, k 1/V, b, num and den of G(s), noise um rms."""

    thresholds: Sequence[float]
    weights: Sequence[float]
    m1: float
    m2: float
    k: float
    b: float
    num: Sequence[float]
    den: Sequence[float]
    noise: float = 0.0

    def __post_init__(self) -> None:
        if len(self.thresholds) != len(self.weights):
            raise PlantError(f"weights: {len(self.weights)} for {len(self.thresholds)} thresholds: give one each")


class PublishedPea:
    """A running published HAMPI; see `Pea` for what `reset` and `step` do."""

    axes = ("x",)

    def __init__(self, parameters: PublishedPeaParameters, sample_time: float, seed: int, rating: tuple[float, float],
                 slew_limit: float, name: str = "pea_published") -> None:
        self.parameters, self.sample_time, self.seed, self.name = parameters, sample_time, seed, name
        self.rating, self.slew_limit = rating, slew_limit
        self.units = {"command": "V", "measurement": "um"}
        self._a, self._b, self._c = observer_form(np.array(parameters.num, dtype=float), np.array(parameters.den, dtype=float))
        self._phi, self._gamma = exact.held_step(self._a, self._b, sample_time)
        self._r, self._w = np.array(parameters.thresholds, dtype=float), np.array(parameters.weights, dtype=float)
        self._law = np.array([parameters.m1, parameters.m2, parameters.k, parameters.b])
        self.reset(np.zeros(1))

    def reset(self, command: Array) -> Array:
        """Settle at the command (1,) V; measurement[0] (1,) in um."""
        value = float(np.asarray(command, dtype=float).reshape(-1)[0])
        self._noise = np.random.default_rng(self.seed)
        self._h = np.clip(0.0, value - self._r, value + self._r)
        self._last = np.array([value])
        drive = float(((self._w + self._law[2] * value + self._law[3]) * self._h).sum())
        self._x = exact.rest(self._a, self._b, drive)
        return self._sensed(np.array([[float(self._c @ self._x)]]))[0]

    def step(self, commands: Array) -> Array:
        """Commands (N, 1) V, each held for one sample; measurements (N, 1) um at the ticks that follow."""
        commands = np.ascontiguousarray(commands, dtype=float)
        drive = np.empty(len(commands))
        _dynamic_weights(commands[:, 0], self._last, self.sample_time, self._r, self._w, self._law, self._h, drive)
        output = np.empty((len(commands), 1))
        _exact(drive, self._phi, self._gamma, self._c, self._x, output)
        return self._sensed(output)

    def _sensed(self, clean: Array) -> Array:
        return clean + self.parameters.noise * self._noise.standard_normal(clean.shape)


def observer_form(num: Array, den: Array) -> tuple[Array, Array, Array]:
    """(a, b, c) of a strictly proper num(s)/den(s), descending powers, as partial sums of modes scaled to unit size."""
    den, num = den / den[0], num / den[0]
    n = len(den) - 1
    num = np.concatenate([np.zeros(n - len(num)), num])
    size = abs(den[-1]) ** (1.0 / n)
    a, b = np.zeros((n, n)), np.zeros(n)
    for i in range(n):
        a[i, 0] = -den[i + 1] / size ** i
        b[i] = num[i] / size ** i
        if i + 1 < n:
            a[i, i + 1] = size
    return a, b, np.eye(n)[0]


@njit(cache=True, error_model="numpy")
def _dynamic_weights(command, last, sample_time, r, w, law, h, drive):
    for k in range(command.size):
        u = command[k]
        rate = (u - last[0]) / sample_time
        last[0] = u
        extra = law[2] * u + law[3] + (-law[0] if rate >= 0.0 else law[1]) * rate
        total = 0.0
        for i in range(r.size):
            h[i] = max(u - r[i], min(u + r[i], h[i]))
            total += (w[i] + extra) * h[i]
        drive[k] = total


@njit(cache=True, error_model="numpy")
def _exact(drive, phi, gamma, read, x, output):
    fresh = np.empty(x.size)
    for k in range(drive.size):
        for i in range(x.size):
            value = gamma[i] * drive[k]
            for j in range(x.size):
                value += phi[i, j] * x[j]
            fresh[i] = value
        for i in range(x.size):
            x[i] = fresh[i]
        output[k, 0] = (read * x).sum()
