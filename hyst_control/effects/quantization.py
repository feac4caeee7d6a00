# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The value grid of the measurement's converter."""

from __future__ import annotations

from hyst_control.chain.memoryless import Quantization
from hyst_control.effects.effect import Effect, Parameter, RecordCheck

EFFECT = Effect(
    "quantization",
    "adc",
    "The measurement is quantized.",
    lambda around: (Parameter("step", "unit", 0.0, (0.003 * around.stroke,), 0.0, 0.1 * around.stroke, 0.003 * around.stroke),),
    lambda values, around: Quantization(values["step"]),
    waveform=False,
    record_check=RecordCheck.VALUE_LATTICE,
    phrase="quantization in steps of {step}",
)
