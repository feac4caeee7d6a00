"""Effects in the piezo: its hysteresis, and creep."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyst_plant_sim.physics import exact_discretization
from hyst_plant_sim.physics.effects.effect import Context, Effect
from hyst_plant_sim.physics.parts import Held
from hyst_plant_sim.physics.signal_path import Frame, Part

Array = NDArray[np.float64]

CREEP_BEGIN, CREEP_PER_DECADE, CREEP_DECADES = 0.1, 2, 4


class Shape:
    """A part plus a parabola of the voltage that is 0 at both ends of the rating.

    Parameters
    ----------
    part
        The part.
    amount
        Height of the parabola / settled stroke.
    frame
        Common data of the plant.
    """

    def __init__(self, part: Part, amount: float, frame: Frame) -> None:
        self._part, self._lower, self._span = part, frame.rating[0], frame.rating[1] - frame.rating[0]
        self._height = amount * (part.settle(frame.rating[1]) - part.settle(frame.rating[0]))

    def _bend(self, voltage: Array) -> Array:
        share = (voltage - self._lower) / self._span
        return np.asarray(self._height * 4.0 * share * (1.0 - share), dtype=np.float64)

    def settle(self, value: float) -> float:
        """Settle the part and add the parabola at a constant voltage.

        Parameters
        ----------
        value
            Constant input, V.

        Returns
        -------
        float
            First output, output unit of the part.
        """
        return float(self._part.settle(value) + self._bend(np.array(value)))

    def process(self, block: Array) -> Array:
        """Add the parabola of a block's voltage to the part's output.

        Parameters
        ----------
        block
            Next inputs (M,), V.

        Returns
        -------
        ndarray
            Outputs (M,), output unit of the part.
        """
        return self._part.process(block) + self._bend(block)


class Scheduled:
    """A part whose memory grows with the averaged voltage: times 1 + amount · (voltage's place in the rating, 0 to 1).

    Parameters
    ----------
    part
        The part.
    mean
        The same part without memory.
    amount
        Relative growth over the rating.
    tau
        Time constant of the average, s.
    frame
        Common data of the plant.
    """

    def __init__(self, part: Part, mean: Part, amount: float, tau: float, frame: Frame) -> None:
        self._part, self._mean, self._amount = part, mean, amount
        self._lower, self._span = frame.rating[0], frame.rating[1] - frame.rating[0]
        self._average = Held(exact_discretization.lag(1.0 / tau), frame.step)

    def settle(self, value: float) -> float:
        """Settle part and average at a constant voltage.

        Parameters
        ----------
        value
            Constant input, V.

        Returns
        -------
        float
            First output, output unit of the part.
        """
        share = (self._average.settle(value) - self._lower) / self._span
        whole = self._part.settle(value)
        return float(whole + self._amount * share * (whole - self._mean.settle(value)))

    def process(self, block: Array) -> Array:
        """Scale the part's memory by the averaged voltage over a block.

        Parameters
        ----------
        block
            Next inputs (M,), V.

        Returns
        -------
        ndarray
            Outputs (M,), output unit of the part.
        """
        share = (self._average.process(block) - self._lower) / self._span
        whole = self._part.process(block)
        return whole + self._amount * share * (whole - self._mean.process(block))


def hysteresis(parts: Any, changes: Mapping[str, float], frame: Frame) -> Part:
    """Construct an axis' hysteresis with changes.

    Parameters
    ----------
    parts
        Constructor of the axis' parts by place, from changes of the hysteresis and of the mechanics.
    changes
        Changes by name.
    frame
        Common data of the plant.

    Returns
    -------
    Part
        The part.
    """
    inner = {name: value for name, value in changes.items() if name in ("width", "rate")}
    part = parts(inner, {})["hysteresis"][0]
    if changes.get("schedule", 0.0):
        mean = parts({**inner, "width": -1.0}, {})["hysteresis"][0]
        part = Scheduled(part, mean, changes["schedule"], changes["schedule_tau"], frame)
    return Shape(part, changes["amount"], frame) if changes.get("amount", 0.0) else part


def _creep(values: Mapping[str, float], context: Context) -> Held:
    """y + gamma Σ log10(q) (share of y that has come after time constant τ_i): after a step about gamma log10(1 + t / 0.1 s).

    τ_i = 0.1 s q^(i + 1/2), q = 10^(1/2), i = 0 … 7: two elements per decade from 0.1 to 1000 s.
    """
    count = CREEP_PER_DECADE * CREEP_DECADES
    rates = 1.0 / (CREEP_BEGIN * 10.0 ** ((np.arange(count) + 0.5) / CREEP_PER_DECADE))
    return Held((np.diag(-rates), rates, np.full(count, values["gamma"] / CREEP_PER_DECADE), 1.0), context.period)


EFFECTS = {
    "hysteresis_width": Effect(
        "hysteresis",
        "hysteresis",
        {"width": 0.0},
        lambda v, c: {"width": v["width"]},
        "The memory part is scaled by 1 + width; the mean curve (play operators: slope times voltage; Madelung: "
        "mean of the major branches; Bouc-Wen: without z) stays.",
        {"width": ""},
    ),
    "hysteresis_shape": Effect(
        "hysteresis",
        "hysteresis",
        {"amount": 0.0},
        lambda v, c: {"amount": v["amount"]},
        "A parabola of the voltage is added: 0 at the ends of the rating, `amount` of the stroke midway.",
        {"amount": ""},
    ),
    "hysteresis_rate": Effect(
        "hysteresis",
        "hysteresis",
        {"factor": 1.0},
        lambda v, c: {"rate": v["factor"]},
        "The rate part (m1 and m2, k1, drag, relaxation) is scaled by `factor`; 1 leaves it.",
        {"factor": ""},
    ),
    "gain_scheduled_hysteresis": Effect(
        "hysteresis",
        "hysteresis",
        {"amount": 0.0},
        lambda v, c: {"schedule": v["amount"], "schedule_tau": v["tau"]},
        "The memory part grows with the voltage averaged over tau.",
        {"amount": "", "tau": "s"},
        {"tau": 0.05},
    ),
    "creep": Effect(
        "insert",
        "piezo",
        {"gamma": 0.0},
        _creep,
        "After a step the output grows on by gamma log10(1 + t / 0.1 s) of it: a ladder of two elements per decade, 0.1 to 1000 s.",
        {"gamma": "1/decade"},
    ),
}
