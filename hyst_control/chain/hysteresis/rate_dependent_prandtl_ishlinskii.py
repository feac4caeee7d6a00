# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rate-dependent Prandtl-Ishlinskii model (RDPI): play operators whose thresholds widen with the command's rate.

    y = w0 u + Σ w_i H_i[u],   H_i[k] = max(u - r_i(u̇), min(u + r_i(u̇), H_i[k-1])),   r_i(u̇) = r_i + β |u̇|

the form of Al Janaideh, Rakheja and Su (Smart Materials and Structures 17, 2008; IEEE/ASME Trans. Mechatronics 16, 2011), in
which every threshold grows with the rate's magnitude; the linear dependence is that of Al Janaideh and Krejčí (IEEE/ASME
Trans. Mechatronics 18, 2013), r_i = α i + β |u̇|, with the thresholds at rest free instead of equally spaced.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.chain.c_code.c_code import CCode, reals
from hyst_control.chain.c_code.texts import c_texts
from hyst_control.chain.hysteresis.prandtl_ishlinskii import SETTLE, OperatorFilter, OperatorModel
from hyst_control.chain.parameter import ScalarPerAxis, VectorPerAxis, scalar, vector
from hyst_control.chain.stage import Sampling, per_axis_scalar, per_axis_scalars, register, scaled

C = c_texts(__file__)


Operators = tuple[Array, Array, Array, Array]  # Thresholds and weights (A, n), weight of the command and widening (A,)
State = tuple[Array, Array]  # Command one sample before (A,), and the operators (A, n); updated


@njit(cache=True, error_model="numpy")
def rate_dependent_prandtl_ishlinskii(
    command: Annotated[Array, "N A"], rate_factor: float, operators: Operators, state: State, output: Annotated[Array, "N A"]
) -> None:
    """Advance the model over a block, all axes."""
    thresholds, weights, w0, beta = operators
    previous, state_of = state
    for row in range(command.shape[0]):
        for axis in range(command.shape[1]):
            u = command[row, axis]
            widening = beta[axis] * abs(u - previous[axis]) * rate_factor
            previous[axis] = u
            value = w0[axis] * u
            for i in range(thresholds.shape[1]):
                low = u - thresholds[axis, i] - widening
                high = u + thresholds[axis, i] + widening
                h = state_of[axis, i]
                h = high if h > high else h
                h = low if h < low else h
                state_of[axis, i] = h
                value += weights[axis, i] * h
            output[row, axis] = value


class RateDependentFilter(OperatorFilter):
    """Streaming rate-dependent Prandtl-Ishlinskii model."""

    def __init__(self, stage: RateDependentPrandtlIshlinskii, sampling: Sampling) -> None:
        super().__init__(sampling, stage.thresholds, stage.weights)
        self.w0, self.beta = per_axis_scalars(stage, sampling.axes, "w0", "beta")

    def process(self, block: Array) -> Array:
        output = np.empty_like(block)
        operators, state = (self.thresholds, self.weights, self.w0, self.beta), (self.previous, self.state)
        rate_dependent_prandtl_ishlinskii(block, self.rate_factor, operators, state, output)
        return output

    def c_code(self) -> CCode:
        return CCode(
            "rate dependent play operators",
            C["STEP"],
            SETTLE,
            {"COUNT": self.thresholds.shape[1]},
            {
                "thresholds": reals(self.thresholds, "V, at rest"),
                "weights": reals(self.weights, "output unit / V"),
                "w0": reals(self.w0, "output unit / V, weight of the command itself"),
                "beta": reals(self.beta, "s, widening of every threshold, V per V/s"),
                "rate_factor": reals(self.rate_factor, "1/s, of two samples' difference"),
            },
            {"operators": reals(self.state, "V"), "previous": reals(self.previous, "V, input before")},
        )


@register
@dataclass(frozen=True)
class RateDependentPrandtlIshlinskii(OperatorModel):
    """Rate-dependent Prandtl-Ishlinskii model (RDPI): play operators whose thresholds widen with the command's rate."""

    name: ClassVar[str] = "rate_dependent_prandtl_ishlinskii"
    equation: ClassVar[str] = (
        r"y = \mathrm{w0}\, u + \sum_i \mathrm{weights}_i\, H_i[u], \quad H_i \text{ a play operator of half-width } "
        r"\mathrm{thresholds}_i + \mathrm{beta}\, |\dot{u}|"
    )
    thresholds: VectorPerAxis = vector("V", "of the operators at rest, increasing", lower=0.0)
    beta: ScalarPerAxis = scalar("s", "widening of every threshold, V per V/s of the command's rate", lower=0.0)
    w0: ScalarPerAxis = scalar("output unit / V", "weight of the command itself", default=0.0)

    def with_rate_part(self, factor: Array) -> RateDependentPrandtlIshlinskii | None:
        if not np.any(per_axis_scalar(self.beta, len(factor), "beta")):
            return None
        return replace(self, beta=scaled(self.beta, factor, 0, "beta"))

    def filter(self, sampling: Sampling) -> RateDependentFilter:
        return RateDependentFilter(self, sampling)
