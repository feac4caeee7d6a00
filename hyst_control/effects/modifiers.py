"""What modifiers share: stages replaced wherever they stand, parameters scaled axis by axis, a curve beside the hysteresis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from hyst_control.chain.chain import Parallel
from hyst_control.chain.linear import LinearStage, LinearSystem
from hyst_control.chain.memoryless import StaticFilter
from hyst_control.chain.stage import Array, Filter, Sampling, Stage, frozen, per_axis, per_axis_scalar


def replaced(stages: Sequence[Stage], change: Callable[[Stage], Stage | None]) -> tuple[Stage, ...] | None:
    """The stages with every one, also inside `parallel`, for which `change` gives another replaced by it; None if it never does."""
    found, result = False, []
    for stage in stages:
        if isinstance(stage, Parallel):
            branches = [replaced(branch, change) for branch in stage.branches]
            if any(branch is not None for branch in branches):
                found = True
                stage = Parallel(tuple(new or old for new, old in zip(branches, stage.branches, strict=True)))
        elif (other := change(stage)) is not None:
            found, stage = True, other
        result.append(stage)
    return tuple(result) if found else None


def scaled(value: Any, factor: Array, due: int, field: str) -> Any:
    """A parameter of `due` dimensions per axis, times a factor (A,) per axis."""
    return frozen([item * share for item, share in zip(per_axis(value, len(factor), due, field), factor, strict=True)])


def beside(stage: Stage, added: Stage) -> Parallel:
    """Both stages fed alike, outputs added."""
    return Parallel(((stage,), (added,)))


@dataclass(frozen=True)
class Memoryless(Stage):
    """A function of the input (N, A) or (A,), all axes at once; part of a started chain only, never of a model file."""

    function: Any

    def filter(self, sampling: Sampling) -> Filter:
        return StaticFilter(self.function, sampling.hold)


@dataclass(frozen=True)
class Changed(LinearStage):
    """A linear stage whose systems a modifier changes: change(systems, axes) -> systems; part of a started chain only."""

    base: Any
    change: Any
    modifier: str

    @property
    def name(self) -> str:
        """What it is in a message."""
        return f"{self.modifier} of {self.base.name}"

    @property
    def coupled(self) -> bool:
        """Whether the stage it stands for mixes axes."""
        return self.base.mixes_axes or getattr(self.base, "coupled", False)

    def systems(self, axes: int) -> list[LinearSystem]:
        return self.change(self.base.systems(axes), axes)


def settled(stage: Stage, value: Array) -> Array:
    """Output (A,) of a stage at rest at a constant input (A,)."""
    return Parallel(((stage,),)).filter(Sampling(1e-4, len(value))).settle(value)


def numbers(stage: Stage, axes: int, *names: str) -> list[Array]:
    """Parameters of a stage that are numbers, each as an array (A,)."""
    return [per_axis_scalar(getattr(stage, name), axes, name) for name in names]
