"""Learned residual: the part of a model's error that follows the command, added to its output."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.chain import Parallel
from hyst_control.chain.command_features import FEATURES, CommandFeatures, FeatureFilter
from hyst_control.chain.memoryless import Gain
from hyst_control.chain.parameter import Array, ScalarPerAxis, Scattering, VectorPerAxis, scalar, vector
from hyst_control.chain.stage import Filter, Modifier, Sampling, Stage, per_axis, per_axis_scalars, register
from hyst_control.errors import InputError


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
    def of(cls, features: CommandFeatures, weights: Array, constant: float) -> LearnedResidual:
        """Make the stage of one axis.

        Parameters
        ----------
        features : CommandFeatures
            Scales.
        weights : ndarray, shape (F,)
            Measurement unit.
        constant : float
            Measurement unit.

        Returns
        -------
        LearnedResidual
        """
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

    of: LearnedResidual

    @property
    def commutes_with_delay(self) -> bool:
        return False

    def filter(self, sampling: Sampling) -> Filter:
        return FromCommandFilter(self.of, sampling)


class FromCommandFilter(Filter):
    """Streaming `FromCommand`."""

    def __init__(self, stage: LearnedResidual, sampling: Sampling) -> None:
        axes = sampling.axes
        self.hold = sampling.hold
        scales = zip(*per_axis_scalars(stage, axes, *CommandFeatures.__dataclass_fields__), strict=True)
        self.features = [FeatureFilter(CommandFeatures(*map(float, values)), sampling.sample_time) for values in scales]
        self.weights = per_axis(stage.weights, axes, 1, "weights")
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
