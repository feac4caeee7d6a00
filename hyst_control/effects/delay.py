# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A transport delay beyond the model's."""

from __future__ import annotations

from hyst_control.chain.linear.linear_stages import Delay
from hyst_control.effects.effect import Effect, Parameter, Surroundings

USUAL = 4.0  # Samples that a converter or a bus usually takes


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Delay up to a period of the slowest excited line, usually of a few samples."""
    ts = around.sample_time
    upper = max(1.0 / around.lowest_frequency, 2.5 * ts)
    few = tuple(samples * ts for samples in (0.3, 1.0, 2.0, 4.0, 8.0) if samples * ts < upper)
    starts = (*few, *(share * upper for share in (0.003, 0.01, 0.03, 0.1, 0.25, 0.5)))
    return (Parameter("tau", "s", 0.0, starts, 0.0, upper, min(0.1 * upper, USUAL * ts), smooth=0.1 * ts),)


EFFECT = Effect(
    "delay",
    "drive",
    "Command or measurement come later than the model says; in open loop a skew between the channels is the same.",
    parameters,
    lambda values, around: Delay(values["tau"]),
    separating_record="the amplifier's output voltage",
    also_beside_clean=("sensor",),
    separate_sizes=True,
    phrase="a delay of {tau}",
)
