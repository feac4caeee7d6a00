# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Uncertain numbers of a chain by name, as `uncertainty` of a model file lists them.

A name is `stage.parameter`, with an index where the parameter is a list and the axis where there are several: `delay.tau (x)`,
`modified_prandtl_ishlinskii.weights[3]`, `transfer_function.damping[0] (y)`. The second stage of one name is `delay(2).tau`. What the
parameters of a stage are in which its uncertainty is stated is said by the stage (`Stage.coordinates`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from hyst_control.chain.parameter import Coordinate
from hyst_control.chain.stage import Stage

Place = tuple[int, ...]


def chain_coordinates(stages: Sequence[Stage], axes: Sequence[str]) -> dict[str, Coordinate]:
    """Every number of a chain that may scatter."""
    found = {}
    for title, _, stage in _titled(stages):
        for (name, axis), coordinate in stage.coordinates(len(axes)).items():
            found[_label(title, name, axis, axes)] = coordinate
    return found


def with_coordinates(stages: Sequence[Stage], values: Mapping[str, float], axes: Sequence[str]) -> tuple[Stage, ...]:
    """A chain with other values of some of its numbers."""
    changed: dict[Place, Stage] = {}
    for title, place, stage in _titled(stages):
        labels = {key: _label(title, *key, axes) for key in stage.coordinates(len(axes))}
        own = {key: values[label] for key, label in labels.items() if label in values}
        if own:
            changed[place] = stage.with_coordinates(own, len(axes))
    return tuple(_rebuilt(stage, (i,), changed) for i, stage in enumerate(stages))


def _label(title: str, name: str, axis: int | None, axes: Sequence[str]) -> str:
    return f"{title}.{name}" + (f" ({axes[axis]})" if axis is not None and len(axes) > 1 else "")


def _titled(stages: Sequence[Stage]) -> Iterator[tuple[str, Place, Stage]]:
    """Stages that have no chains inside, with their name, counted from the second one on, and their place."""
    seen: Counter[str] = Counter()
    for place, stage in _places(stages, ()):
        seen[stage.name] += 1
        yield stage.name + (f"({seen[stage.name]})" if seen[stage.name] > 1 else ""), place, stage


def _places(stages: Sequence[Stage], before: Place) -> Iterator[tuple[Place, Stage]]:
    for i, stage in enumerate(stages):
        if not stage.inner_chains:
            yield (*before, i), stage
        for branch, chain in enumerate(stage.inner_chains):
            yield from _places(chain, (*before, i, branch))


def _rebuilt(stage: Stage, place: Place, changed: Mapping[Place, Stage]) -> Stage:
    if not stage.inner_chains:
        return changed.get(place, stage)
    if not any(other[: len(place)] == place for other in changed):
        return stage
    return stage.with_inner_chains(
        [
            [_rebuilt(member, (*place, branch, m), changed) for m, member in enumerate(chain)]
            for branch, chain in enumerate(stage.inner_chains)
        ]
    )
