# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Error that a model states of itself (`discrepancy` in its file), tick by tick: the mean and the standard deviation, in Python and as C.

The rate is a difference about its tick and needs the command a little later: the stated error is late by `StatedError.late` ticks, and
exact. The mean begins at 0 where the filter has settled, as no tick knows the zero, drift and curvature of the record. An axis without a
learned error has the mean 0 and the stated rms.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array, Integers
from hyst_control.base.errors import InputError
from hyst_control.chain import Filter
from hyst_control.chain.c_code.c_code import CCode, integers, reals
from hyst_control.chain.c_code.texts import c_texts
from hyst_control.chain.command_features import (
    CREEPS,
    FEATURES,
    FEATURES_IN_C,
    FIRST_PLAY,
    PLAYS,
    POWERS,
    FeatureFilter,
    at_rest,
    feature_memory,
    features_of_tick,
)
from hyst_control.identify.model_error.learned_discrepancy import LearnedDiscrepancy
from hyst_control.model_file import Model

C = c_texts(__file__)


Constants = tuple[Array, Integers, Array, Array, Array, Array, Array]
"""Scale (A, 3): center and span, V, and the change of the scaled command over the rate's difference at the largest rate; ticks (A, 5);
half widths; factors of the low-passes (A, P); mean (A, F), factor (A, F, K) and rest (A,) of the error."""
State = tuple[Integers, Array, Array, Array, Array, Array]
"""Position in the ring, the ring (A, L), memories of the features, and the features where it has settled (A, F)."""


@njit(cache=True, error_model="numpy")
def stated_errors(command: Annotated[Array, "N A"], constants: Constants, state: State, error: Annotated[Array, "N 2 A"]) -> None:
    """Follow the features over a block and state the error."""
    scale, ticks, half_widths, keeps, mean, factor, rest = constants
    position, ring, turning, plays, slow, begin = state
    axes, length = ring.shape
    features = np.empty(mean.shape[1])
    for row in range(command.shape[0]):
        position[0] = position[0] + 1 if position[0] + 1 < length else 0
        for axis in range(axes):
            ring[axis, position[0]] = (command[row, axis] - scale[axis, 0]) / scale[axis, 1]
            now, width = position[0] + length - ticks[axis, 0], ticks[axis, 1]
            rate = (ring[axis, (now + width) % length] - ring[axis, (now - width) % length]) / scale[axis, 2]
            own, memory = (ticks[axis, 2:], half_widths, keeps[axis]), (turning[axis], plays[axis], slow[axis])
            features_of_tick(ring[axis], now, rate, own, memory, features)
            total = 0.0
            for f in range(features.size):
                features[f] -= begin[axis, f]
                total += features[f] * mean[axis, f]
            square = rest[axis] * rest[axis]
            for k in range(factor.shape[2]):
                part = 0.0
                for f in range(features.size):
                    part += features[f] * factor[axis, f, k]
                square += part * part
            error[row, axis] = total
            error[row, axes + axis] = math.sqrt(square)


class StatedError(Filter):
    """The error that a model states of itself, beside a command: means (A) and standard deviations (A) in one row."""

    hold = "zoh"

    def __init__(self, model: Model, sample_time: float) -> None:
        if not model.discrepancy:
            raise InputError("discrepancy: the model states no error of its own: identify it with hyst identify on clean records")
        axes = len(model.axes)
        learned = [
            None if one is None else LearnedDiscrepancy.from_document(one)
            for one in model.discrepancy.get("learned", [None] * axes)
        ]
        columns = max((one.factor.shape[1] for one in learned if one), default=1)
        self.mean, self.factor = np.zeros((axes, FEATURES)), np.zeros((axes, FEATURES, columns))
        self.rest = np.array(np.broadcast_to(np.asarray(model.discrepancy["rms"], dtype=float), axes))
        self.scale, self.ticks = np.ones((axes, 3)), np.zeros((axes, 5), dtype=np.int64)
        self.keeps = np.zeros((axes, len(CREEPS)))
        for axis, one in enumerate(learned):
            if one is not None:
                self.mean[axis], self.factor[axis, :, : one.factor.shape[1]] = one.mean, one.factor
                self.rest[axis] = one.rest
                features = FeatureFilter(one.features, sample_time)
                self.scale[axis] = one.features.center, one.features.span, features.crossing
                self.ticks[axis, 1:], self.keeps[axis] = (features.width, *features.lags), features.keeps
        self.late = int(self.ticks[:, 1].max())  # Ticks by which the stated error is late
        self.ticks[:, 0] = self.late
        length = self.late + int(self.ticks[:, 1:].max()) + 1
        self.position, self.ring = np.zeros(1, dtype=np.int64), np.zeros((axes, length))
        self.turning, self.plays, self.slow = np.zeros((axes, 3)), np.zeros((axes, len(PLAYS))), np.zeros((axes, len(CREEPS)))
        self.begin = np.zeros((axes, FEATURES))

    def settle(self, value: Array) -> Array:
        """Come to rest at the command `value` (A,); means of 0, and the standard deviations of the rest."""
        u = (np.array(value, dtype=float) - self.scale[:, 0]) / self.scale[:, 1]
        self.position[0] = 0
        for state in (self.ring, self.plays, self.slow):
            state[:] = u[:, None]
        self.turning[:] = np.stack([u, u, np.ones_like(u)], axis=1)
        self.begin[:] = at_rest(u)
        return np.concatenate([np.zeros_like(u), self.rest])

    def process(self, block: Array) -> Array:
        """Means and standard deviations (N, 2 A) for commands (N, A): those of the tick `late` ticks before."""
        error = np.empty((len(block), 2 * block.shape[1]))
        constants = (self.scale, self.ticks, np.array(PLAYS), self.keeps, self.mean, self.factor, self.rest)
        state = (self.position, self.ring, self.turning, self.plays, self.slow, self.begin)
        stated_errors(block, constants, state, error)
        return error

    def c_code(self) -> CCode:
        constants = {
            "scale": reals(self.scale, "center V, span V, change of the scaled command at the largest rate", wide=True),
            "ticks": integers(self.ticks[:, :2], "that all is late, and to either side of the rate's difference"),
            "lags": integers(self.ticks[:, 2:], "ticks of the lagged copies"),
            "half_widths": reals(PLAYS, "of the play operators, share of the span", wide=True),
            "keeps": reals(self.keeps, "factors of the low-passes in a tick", wide=True),
            "mean": reals(self.mean, "of the weights, measurement unit", wide=True),
            "factor": reals(self.factor, "of the weights' covariance, measurement unit", wide=True),
            "rest": reals(self.rest, "rms of what the features leave, measurement unit", wide=True),
        }
        axes, length = self.ring.shape
        state = {
            **feature_memory(axes, length),
            "begin": reals(self.begin, "features where it has settled", wide=True),
            "position": integers(0, "of the newest command in the ring"),
        }
        sizes = {
            "LENGTH": length,
            "COLUMNS": self.factor.shape[2],
            "FEATURES": FEATURES,
            "PLAYS": len(PLAYS),
            "POWERS": POWERS,
            "FIRST": FIRST_PLAY,
        }
        return CCode("stated error", C["STEP"], C["SETTLE"], sizes, constants, state, (FEATURES_IN_C,), outputs=2 * axes)
