# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Learned residual: the part of a model's error that follows the command, added to its output."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import CCode, integers, reals
from hyst_control.chain.c_code.texts import c_texts
from hyst_control.chain.chain import Parallel
from hyst_control.chain.command_features import (
    FEATURES,
    FEATURES_IN_C,
    FIRST_PLAY,
    PLAYS,
    CommandFeatures,
    FeatureFilter,
    feature_memory,
)
from hyst_control.chain.memoryless import Gain
from hyst_control.chain.parameter import ScalarPerAxis, Scattering, VectorPerAxis, scalar, vector
from hyst_control.chain.stage import Filter, Modifier, Role, Sampling, Stage, per_axis, per_axis_scalars, register

C = c_texts(__file__)


@register
@dataclass(frozen=True)
class LearnedResidual(Modifier):
    """Adds constant + Σ weights φ_k to the output of the whole chain before it, φ the features of the chain's command.

    The features are those of `hyst_control.chain.command_features`: level, rate, distance from the last reversal, play operators and
    lagged copies, with the scales below. Nothing is known of them beyond the commands that they were learned on.
    """

    name: ClassVar[str] = "learned_residual"
    place: ClassVar[str] = "transport"
    center: ScalarPerAxis = scalar("V", "middle of the commands that it was learned on", scatter=Scattering.NONE)
    span: ScalarPerAxis = scalar("V", "their range", above=0.0, scatter=Scattering.NONE)
    rate: ScalarPerAxis = scalar("V/s", "their largest rate", above=0.0, scatter=Scattering.NONE)
    lag: ScalarPerAxis = scalar("s", "time in which they cross a 64th of their range", above=0.0, scatter=Scattering.NONE)
    duration: ScalarPerAxis = scalar("s", "their longest record", above=0.0, scatter=Scattering.NONE)
    weights: VectorPerAxis = vector("measurement unit", "of the features", scatter=Scattering.NONE)
    constant: ScalarPerAxis = scalar("measurement unit", "added", default=0.0, scatter=Scattering.NONE)

    @classmethod
    def of(cls, features: CommandFeatures, weights: Annotated[Array, "F"], constant: float) -> LearnedResidual:
        """Make the stage of one axis."""
        return cls(**features.document(), weights=tuple(map(float, weights)), constant=constant)

    def check(self) -> None:
        count = len(self.weights[0]) if isinstance(self.weights[0], tuple) else len(self.weights)
        if count != FEATURES:
            raise InputError(f"weights: has {count} entries, {FEATURES} features need one each: learn the residual again")

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        return (Parallel((before or (Gain(1.0),), (FromCommand(self),))),)


@dataclass(frozen=True)
class FromCommand(Stage):
    """The added part alone, from the command; part of a started chain only."""

    ROLES: ClassVar[Role] = Role.CHANGES_WITH_TIME

    of: LearnedResidual

    def filter(self, sampling: Sampling) -> Filter:
        return FromCommandFilter(self.of, sampling)


class FromCommandFilter(Filter):
    """Streaming `FromCommand`."""

    def __init__(self, stage: LearnedResidual, sampling: Sampling) -> None:
        axes = sampling.axes
        self.hold = sampling.hold
        scales = zip(*per_axis_scalars(stage, axes, *CommandFeatures.__dataclass_fields__), strict=True)
        self.features = [FeatureFilter(CommandFeatures(*map(float, values)), sampling.sample_time) for values in scales]
        self.weights = np.array(per_axis(stage.weights, axes, 1, "weights"))
        (self.constant,) = per_axis_scalars(stage, axes, "constant")

    def settle(self, value: Array) -> Array:
        return np.array([self._added(i, running.settle(float(value[i]))[None])[0] for i, running in enumerate(self.features)])

    def process(self, block: Array) -> Array:
        columns = [self._added(i, running.process(np.ascontiguousarray(block[:, i]))) for i, running in enumerate(self.features)]
        return np.stack(columns, axis=1)

    def _added(self, axis: int, features: Array) -> Array:
        total = np.full(len(features), self.constant[axis])
        for weight, column in zip(self.weights[axis], features.T, strict=True):  # summed alike however the signal is cut
            total = total + weight * column
        return total

    def c_code(self) -> CCode:
        all_of, axes = self.features, len(self.features)
        scale = np.array([[one.features.center, one.features.span, one.crossing] for one in all_of])
        length = max(len(one.ring) for one in all_of)
        return CCode(
            "learned residual",
            C["STEP"],
            C["SETTLE"],
            {"LENGTH": length, "FEATURES": FEATURES, "FIRST": FIRST_PLAY, "PLAYS": len(PLAYS)},
            {
                "scale": reals(scale, "center V, span V, change of the scaled command at the largest rate", wide=True),
                "rate_ticks": integers([one.ticks[0] for one in all_of], "of the rate's difference"),
                "lags": integers(np.stack([one.lags for one in all_of]), "ticks of the lagged copies"),
                "half_widths": reals(PLAYS, "of the play operators, share of the span", wide=True),
                "keeps": reals(np.stack([one.keeps for one in all_of]), "factors of the low-passes in a tick", wide=True),
                "weights": reals(self.weights, "measurement unit", wide=True),
                "added": reals(self.constant, "measurement unit", wide=True),
            },
            {**feature_memory(axes, length), "position": integers(0, "of the newest command in the ring")},
            (FEATURES_IN_C,),
        )
