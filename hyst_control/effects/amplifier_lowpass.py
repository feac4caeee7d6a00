"""The amplifier's bandwidth, in front of the hysteresis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hyst_control.chain.stage import register
from hyst_control.effects.effect import Effect
from hyst_control.effects.lowpass import Lowpass, cutoff_parameters


@register
@dataclass(frozen=True)
class AmplifierLowpass(Lowpass):
    """A low-pass (see `Lowpass`) of a held command.

    In front of a hysteresis its output, which bends between the samples, is handed on held at its exact mean over each
    interval: no half sample is lost, and an infinite cutoff is the held command itself.
    """

    name: ClassVar[str] = "amplifier_lowpass"
    averaged: ClassVar[bool] = True


EFFECT = Effect(
    "amplifier_lowpass",
    "drive",
    "The amplifier is slower than the model says: first-order low-passes, as many as `order`, before the hysteresis.",
    cutoff_parameters,
    lambda values, around: AmplifierLowpass(values["cutoff"], values.get("order", 1)),
)
