# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parts that modifiers share: linear stages whose systems they change, and stages beside each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, cast

from hyst_control.base.errors import InputError
from hyst_control.chain.chain import Parallel
from hyst_control.chain.linear.linear_stages import LinearStage, LinearSystem
from hyst_control.chain.stage import Role, Stage
from hyst_control.effects.placement import mechanics_index


def beside_mechanics(name: str, before: tuple[Stage, ...], make: Callable[[LinearStage], Stage]) -> tuple[Stage, ...]:
    """The stages with what `make` adds to the mechanics as they are, beside all that leads to them."""
    index = mechanics_index(before)
    if index is not None:
        added = make(cast(LinearStage, before[index]))
        return (Parallel((before[: index + 1], (*before[:index], added))), *before[index + 1 :])
    for i, stage in enumerate(before):
        main = stage.branches[0] if isinstance(stage, Parallel) else ()
        if main and mechanics_index(main) == len(main) - 1:
            added = make(cast(LinearStage, main[-1]))
            return (*before[:i], Parallel((*cast(Parallel, stage).branches, (*main[:-1], added))), *before[i + 1 :])
    raise InputError(f"{name}: no mechanics before it (transfer function or continuous state space): put it behind them")


@dataclass(frozen=True)
class Changed(LinearStage):
    """A linear stage whose systems a modifier changes: change(systems, axes) -> systems; part of a started chain only."""

    ROLES: ClassVar[Role] = LinearStage.ROLES | Role.MECHANICS

    base: LinearStage
    change: Callable[[list[LinearSystem], int], list[LinearSystem]]
    modifier: str

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name in a message."""
        return f"{self.modifier} of {self.base.name}"

    @property
    def mixes_axes(self) -> bool:
        return self.base.mixes_axes

    def systems(self, axes: int) -> list[LinearSystem]:
        return self.change(self.base.systems(axes), axes)
