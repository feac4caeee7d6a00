"""Effects between the command and the voltage at the stack: converter, transport, driver, amplifier."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hyst_plant_sim.physics import exact_discretization
from hyst_plant_sim.physics.effects.effect import Context, Effect, Pointwise
from hyst_plant_sim.physics.parts import Clip, Held, LateReading, Straight

Array = NDArray[np.float64]


class Hold:
    """Every n-th command is taken and held.

    Parameters
    ----------
    samples
        n.
    step
        Step to whose multiples commands are rounded, V; 0: not rounded.
    """

    def __init__(self, samples: int, step: float) -> None:
        self._samples, self._step = samples, step

    def _rounded(self, values: Array) -> Array:
        return np.rint(values / self._step) * self._step if self._step else values

    def settle(self, value: float) -> float:
        """Take the input as the first command and hold it.

        Parameters
        ----------
        value
            Constant input, V.

        Returns
        -------
        float
            First output, V.
        """
        self._count, self._held = 0, float(self._rounded(np.array([value]))[0])
        return self._held

    def process(self, block: Array) -> Array:
        """Hold each n-th command of a block until the next, rounded to the step.

        Parameters
        ----------
        block
            Next inputs (M,), V.

        Returns
        -------
        ndarray
            Outputs (M,), V.
        """
        taken = np.arange(self._count, self._count + len(block)) // self._samples * self._samples - self._count
        output = np.where(taken < 0, self._held, self._rounded(block)[np.maximum(taken, 0)])
        self._count += len(block)
        self._held = float(output[-1]) if len(output) else self._held
        return output


class Slew:
    """Limit of the voltage's rate; the output is the mean over a step.

    Parameters
    ----------
    rate
        The limit, V/s.
    step
        The step, s.
    """

    def __init__(self, rate: float, step: float) -> None:
        self._most, self._last = rate * step, np.zeros(1)

    def settle(self, value: float) -> float:
        """Rest at a voltage.

        Parameters
        ----------
        value
            Constant input, V.

        Returns
        -------
        float
            First output, V.
        """
        self._last[0] = value
        return value

    def process(self, block: Array) -> Array:
        """Limit the rate of a block; each output is the mean over its step.

        Parameters
        ----------
        block
            Next inputs (M,), V.

        Returns
        -------
        ndarray
            Outputs (M,), V.
        """
        output = np.empty(block.size)
        _slew(block, self._most, self._last, output)
        return output


class SlowClock:
    """Slow clock of the drive: a command is late by a fraction of the time since the start.

    Parameters
    ----------
    share
        The fraction.
    context
        Location of the effect.
    """

    def __init__(self, share: float, context: Context) -> None:
        self._share, self._context = share, context

    def settle(self, value: float) -> float:
        """Restart at a constant command, which also holds before the first sample.

        Parameters
        ----------
        value
            Constant command, V.

        Returns
        -------
        float
            First output, V.
        """
        self._first, self._past, self._count = value, np.zeros(0), 0
        return value

    def process(self, block: Array) -> Array:
        """Divide fractions of a step between the two held values, as in a constant delay.

        Parameters
        ----------
        block
            Commands (M,), V.

        Returns
        -------
        Array
            Late commands (M,), V.
        """
        known = np.concatenate([self._past, block])
        oldest = self._count - len(self._past)
        times = self._context.times(self._count, len(block))
        now = np.arange(self._count, self._count + len(block))
        late = now - self._share * np.maximum(times - self._context.start, 0.0) / self._context.period
        whole = np.floor(late).astype(np.int64)
        share = late - whole

        def at(index: NDArray[np.int64]) -> Array:
            return np.where(index < 0, self._first, known[np.clip(index - oldest, 0, len(known) - 1)])

        output = share * at(whole + (share > 0)) + (1.0 - share) * at(whole)
        self._count += len(block)
        self._past = known[max(int(whole[-1]) - oldest - 1, 0) :].copy() if len(block) else self._past
        return output


@njit(cache=True, error_model="numpy")
def _slew(block: Array, most: float, last: Array, output: Array) -> None:
    value = last[0]
    for k in range(block.size):
        way = block[k] - value
        if abs(way) < most:  # there before the step is over
            output[k] = value + way * (1.0 - 0.5 * abs(way) / most)
            value = block[k]
        else:
            way = most if way > 0.0 else -most
            output[k] = value + 0.5 * way
            value += way
    last[0] = value


def _dead_band(values: Mapping[str, float], context: Context) -> Pointwise:
    center, half = 0.5 * sum(context.frame.rating), values["half_width"]

    def lost(voltage: Array) -> Array:
        distance = voltage - center
        return voltage - np.clip(distance, -half, half)

    return Pointwise(lost)


def low_pass(values: Mapping[str, float], context: Context) -> Held | Straight:
    """Construct equal first-order low-passes in series.

    Parameters
    ----------
    values
        "cutoff" in Hz, and "order", their number.
    context
        Location of the effect.

    Returns
    -------
    Held | Straight
        The part.
    """
    system = single = exact_discretization.lag(2 * np.pi * values["cutoff"])
    for _ in range(int(values["order"]) - 1):
        system = exact_discretization.series(system, single)
    return (Straight if context.place == "sensor" else Held)(system, context.period)


def gain_factor(values: Mapping[str, float], context: Context) -> Pointwise:
    """Construct the factor 1 + gain.

    Parameters
    ----------
    values
        "gain".
    context
        Location of the effect.

    Returns
    -------
    Pointwise
        The part.
    """
    return Pointwise(lambda block: (1.0 + values["gain"]) * block)


def _delay(values: Mapping[str, float], context: Context) -> LateReading | dict[str, float]:
    return LateReading(values["tau"], context.period) if context.place == "sensor" else {"delay": values["tau"]}


EFFECTS = {
    "dac_hold": Effect(
        "insert",
        "dac",
        {"samples": 1, "step": 0.0},
        lambda v, c: Hold(int(v["samples"]), v["step"]),
        "Every n-th command is taken and held; or commands are rounded to a lattice.",
        {"samples": "", "step": "V"},
    ),
    "clock_rate_mismatch": Effect(
        "insert",
        "drive",
        {"share": 0.0},
        lambda v, c: SlowClock(v["share"], c),
        "The drive's clock runs slow: commands come later and later.",
        {"share": ""},
    ),
    "delay": Effect("delay", "drive", {"tau": 0.0}, _delay, "A transport delay; `at: sensor` puts it there.", {"tau": "s"}),
    "slew_limit": Effect(
        "insert",
        "drive",
        {"rate": np.inf},
        lambda v, c: Slew(v["rate"], c.period),
        "The driver follows no faster.",
        {"rate": "V/s"},
    ),
    "saturation": Effect(
        "insert",
        "drive",
        {"lower": -np.inf, "upper": np.inf},
        lambda v, c: Clip(v["lower"], v["upper"]),
        "The driver clips.",
        {"lower": "V", "upper": "V"},
    ),
    "crossover_dead_band": Effect(
        "insert",
        "drive",
        {"half_width": 0.0},
        _dead_band,
        "Around the middle of the rating the drive does not answer; beyond, it falls short by as much.",
        {"half_width": "V"},
    ),
    "amplifier_lowpass": Effect(
        "insert",
        "amplifier",
        {"cutoff": np.inf},
        low_pass,
        "Equal first-order low-passes in a row, as many as `order`, before the hysteresis.",
        {"cutoff": "Hz", "order": ""},
        {"order": 1},
    ),
}
