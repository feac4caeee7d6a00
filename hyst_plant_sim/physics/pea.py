"""The truth PEA: amplifier, polarisation with hysteresis and drag, flexure mechanics, capacitive sensor.

The path of a command, each part in continuous time, stepped at 400 kHz or finer:

1. drive: a transport delay (converter, isolation), then the amplifier, a first-order low-pass; its output is the voltage v.
2. hysteresis: an elastic slope and an ensemble of elastic-slip elements. Element i follows v with a slack of half-width r_i
   and adds w_i times its position; r_i fill (0, r_max] evenly, w_i follow a density that falls off exponentially. The sum Y0 is
   bent by a single-valued saturation Y = Y0 - β Y0² / stroke.
3. drag: domain walls move against viscous drag that grows with the polarisation P already reached, more while it rises than
   while it falls: P' = (Y - P) / T(Y), T = T_rise or T_fall times Y / (Y + drag_level). Slow loops do not show it; fast ones
   turn and widen, the more the higher the drive.
4. mechanics: one flexure mode, and a viscoelastic share that arrives late (the slow pole-zero pair of HAMPI paper Eq. 7).
5. sensor: first-order low-pass, white noise.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hyst_plant_sim.physics import exact

Array = NDArray[np.float64]

INTERNAL_RATE = 400e3
"""Least rate (Hz) at which the physics is stepped."""


class PlantError(ValueError):
    """A plant description that makes no sense: one line with field and remedy."""


@dataclass(frozen=True)
class PeaParameters:
    """Physical parameters of the truth PEA; units in the comments of config/plants/pea.yaml."""

    delay: float
    amplifier_cutoff: float
    elastic_slope: float
    slip_slope: float
    slip_elements: int
    slip_range: float
    slip_decay: float
    stroke: float
    saturation: float
    drag_rise: float
    drag_fall: float
    drag_level: float
    mode_frequency: float
    mode_damping: float
    slow_share: float
    slow_time: float
    sensor_cutoff: float
    noise: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value) or value < 0:
                raise PlantError(f"{field.name}: {value!r}: a number that is not negative is due")
        for name in ("amplifier_cutoff", "elastic_slope", "slip_range", "slip_decay", "stroke", "mode_frequency", "slow_time",
                     "sensor_cutoff", "drag_level"):
            if getattr(self, name) == 0:
                raise PlantError(f"{name}: must be positive")


class Pea:
    """A running truth PEA, one axis. `reset` it, then `step` it with commands in V; measurements in um."""

    axes = ("x",)

    def __init__(self, parameters: PeaParameters, sample_time: float, seed: int, rating: tuple[float, float], slew_limit: float,
                 name: str = "pea", refinement: int = 1) -> None:
        """refinement: divides the internal step further, to check that it is fine enough."""
        p = self.parameters = parameters
        self.name, self.sample_time, self.seed, self.rating, self.slew_limit = name, sample_time, seed, rating, slew_limit
        self.units = {"command": "V", "measurement": "um"}
        self.substeps = int(np.ceil(sample_time * INTERNAL_RATE - 1e-9)) * refinement
        self.internal_step = sample_time / self.substeps
        self._follow = 1.0 - np.exp(-2 * np.pi * p.amplifier_cutoff * self.internal_step)
        count = int(p.slip_elements)
        self._slack = p.slip_range * (np.arange(count) + 0.5) / max(count, 1)
        density = np.exp(-self._slack / p.slip_decay)
        self._slip_weights = p.slip_slope * density / density.sum() if count else density
        system = exact.series(exact.series(exact.oscillator(2 * np.pi * p.mode_frequency, p.mode_damping),
                                           exact.slow_share(p.slow_share, p.slow_time)),
                              exact.lag(2 * np.pi * p.sensor_cutoff))
        self._a, self._b, self._c, _ = system
        self._phi, self._from, self._to = exact.ramp_step(self._a, self._b, self.internal_step)
        self._late = int(round(p.delay / self.internal_step))
        self._past = np.zeros(-(-self._late // self.substeps) + 1)
        self._constants = np.array([self._follow, p.elastic_slope, p.saturation / p.stroke, p.drag_rise, p.drag_fall,
                                    p.drag_level, self.internal_step])
        self.reset(np.zeros(1))

    def reset(self, command: Array) -> Array:
        """Settle at the command (1,) V, reached from 0 V on the virgin curve; measurement[0] (1,) in um."""
        value = float(np.asarray(command, dtype=float).reshape(-1)[0])
        self._noise = np.random.default_rng(self.seed)
        self._slip = np.clip(0.0, value - self._slack, value + self._slack)
        bare = self.parameters.elastic_slope * value + float(self._slip_weights @ self._slip)
        polarisation = bare - self.parameters.saturation / self.parameters.stroke * bare * bare
        self._state = np.array([value, polarisation])
        self._past[:] = value
        self._linear = exact.rest(self._a, self._b, polarisation)
        return self._sensed(np.array([[float(self._c @ self._linear)]]))[0]

    def step(self, commands: Array) -> Array:
        """Commands (N, 1) V, each held for one sample; measurements (N, 1) um at the ticks that follow them."""
        commands = np.ascontiguousarray(commands, dtype=float)
        output = np.empty((len(commands), 1))
        _advance(commands, self._past, self._late, self.substeps, self._constants, self._slack, self._slip_weights, self._phi, self._from, self._to, self._c,
                 self._state, self._slip, self._linear, output)
        return self._sensed(output)

    def _sensed(self, clean: Array) -> Array:
        return clean + self.parameters.noise * self._noise.standard_normal(clean.shape)


@njit(cache=True, error_model="numpy")
def _advance(commands, past, late, substeps, constants, slack, weights, phi, ramp_from, ramp_to, read, state, slip, linear, output):
    follow, elastic, bend, rise, fall, level, step = constants
    voltage, polarisation = state
    order = linear.size
    fresh = np.empty(order)
    for k in range(commands.shape[0]):
        for i in range(past.size - 1):
            past[i] = past[i + 1]
        past[-1] = commands[k, 0]
        for part in range(substeps):
            # Whole intervals back to the command that acts now; past holds the newest at its end.
            target = past[past.size - 1 + (part - late) // substeps]
            voltage += (target - voltage) * follow
            bare = elastic * voltage
            for i in range(slack.size):
                position = slip[i]
                if position > voltage + slack[i]:
                    position = voltage + slack[i]
                elif position < voltage - slack[i]:
                    position = voltage - slack[i]
                slip[i] = position
                bare += weights[i] * position
            wanted = bare - bend * bare * bare
            time = (rise if wanted > polarisation else fall) * abs(wanted) / (abs(wanted) + level)
            before = polarisation
            if time > 1e-3 * step:
                polarisation += (wanted - polarisation) * (1.0 - np.exp(-step / time))
            else:
                polarisation = wanted
            for i in range(order):
                value = ramp_from[i] * before + ramp_to[i] * polarisation
                for j in range(order):
                    value += phi[i, j] * linear[j]
                fresh[i] = value
            for i in range(order):
                linear[i] = fresh[i]
        value = 0.0
        for i in range(order):
            value += read[i] * linear[i]
        output[k, 0] = value
    state[0], state[1] = voltage, polarisation
