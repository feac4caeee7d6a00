"""Motion of the other axis in the measurement."""

from __future__ import annotations

import numpy as np

from hyst_control.chain.linear import CrossCoupling
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Share of the other axis' motion, and corner of the low-pass it comes through, in a record's surroundings `around`."""
    nyquist = 0.5 / around.sample_time
    corner = Parameter(
        "corner", "Hz", 0.5 * nyquist, (0.1 * nyquist, 0.5 * nyquist), 3.0 / around.duration, 5.0 * nyquist, 1.5, True
    )
    return (Parameter("coupling", "", 0.0, (0.01,), -0.2, 0.2, 0.03), corner)


def stage(values: Values, around: Surroundings) -> CrossCoupling:
    """Onto every axis comes `coupling` of the next one (the last one's next is the first).

    Parameters
    ----------
    values
        Of the parameters, by name.
    around
        Record that the sizes are judged by.
    """
    axes = around.axes
    coupling = np.broadcast_to(np.array(values["coupling"], dtype=float), axes)
    matrix = np.eye(axes)
    for axis in range(axes if axes > 1 else 0):
        matrix[axis, (axis + 1) % axes] += coupling[axis]
    return CrossCoupling(matrix, values.get("corner"))


EFFECT = Effect(
    "cross_coupling",
    "motion",
    "A share of the other axis' motion comes in through a first-order low-pass.",
    parameters,
    stage,
    exercised=lambda around: around.axes > 1,
    couples=True,
    phrase="cross coupling of {coupling}",
)
