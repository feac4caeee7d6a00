"""A transport delay beyond the model's."""

from __future__ import annotations

from hyst_control.chain.linear import Delay
from hyst_control.effects.effect import Effect, Parameter, Surroundings


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Delay up to 20 samples, 5 ms at most, in a record's surroundings `around`."""
    ts = around.sample_time
    upper = min(20.0 * ts, max(5e-3, 2.5 * ts))
    return (Parameter("tau", "s", 0.0, (0.3 * ts, 2.0 * ts), 0.0, upper, min(2.0 * ts, upper)),)


EFFECT = Effect(
    "delay",
    "drive",
    "Command or measurement come later than the model says; in open loop a skew between the channels is the same.",
    parameters,
    lambda values, around: Delay(values["tau"]),
    separating_record="the amplifier's output voltage",
)
