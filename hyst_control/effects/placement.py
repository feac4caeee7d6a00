# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Places in a chain: its hysteresis, its mechanics, and the index at which an effect goes."""

from __future__ import annotations

from collections.abc import Sequence

from hyst_control.chain.chain import Parallel
from hyst_control.chain.linear.linear_stages import LinearStage, TransferFunction
from hyst_control.chain.stage import Stage
from hyst_control.effects.effect import PLACES

DRIVE = ("dac", "drive")  # Places before the hysteresis


def hysteresis_index(stages: Sequence[Stage]) -> int | None:
    """Index of the hysteresis stage, or of the `parallel` that contains it, or of one that adds it; None where a chain has none."""
    added = next((i for i, stage in enumerate(stages) if stage.adds_hysteresis), None)
    return next((i for i, stage in enumerate(stages) if stage.is_hysteresis), added)


def mechanics_index(stages: Sequence[Stage]) -> int | None:
    """Index of the mechanics: the last transfer function or continuous state space behind the hysteresis; None where there is none."""
    behind = hysteresis_index(stages)
    for i in range(len(stages) - 1, -1 if behind is None else behind, -1):
        if stages[i].is_mechanics:
            return i
    return None


def with_mechanics(stages: tuple[Stage, ...]) -> tuple[tuple[Stage, ...], int]:
    """The stages and the index of their mechanics; a chain without gets G = 1 behind what it has."""
    index = mechanics_index(stages)
    return (stages, index) if index is not None else ((*stages, TransferFunction((1.0,), (1.0,))), len(stages))


def insert(stages: tuple[Stage, ...], place: str, stage: Stage) -> tuple[Stage, ...]:
    """Insert a stage at a place, behind those that are at that place already."""
    index = _index(stages, place, stage)
    return (*stages[:index], stage, *stages[index:])


def _index(stages: tuple[Stage, ...], place: str, stage: Stage) -> int:
    if place == "dac":
        return 0
    if place in ("sensor", "adc", "transport"):
        later = PLACES[PLACES.index(place) + 1 :]
        index = len(stages)
        while index and stages[index - 1].place in later:
            index -= 1
        return index
    hysteresis = hysteresis_index(stages)
    begin = _first_linear(stages) if hysteresis is None else hysteresis
    if place == "drive":
        while begin and _is_last(stages[begin - 1], place) and not _is_last(stage, place):
            begin -= 1
        return begin
    behind = begin if hysteresis is None else hysteresis + 1
    behind = _over(stages, behind, "hysteresis")
    if place == "hysteresis":
        return behind
    behind = _over(stages, behind, "piezo")
    if place == "piezo":
        return behind
    mechanics = mechanics_index(stages)
    behind = _over(stages, behind if mechanics is None else mechanics + 1, "mechanics")
    return behind if place == "mechanics" else _over(stages, behind, "motion")


def _is_last(stage: Stage, place: str) -> bool:
    return stage.place == place and stage.last_at_place


def _over(stages: Sequence[Stage], index: int, *places: str) -> int:
    while index < len(stages) and stages[index].place in places:
        index += 1
    return index


def _first_linear(stages: Sequence[Stage]) -> int:
    """Index at which the hysteresis of a chain without one would be: before its first linear stage that is not the drive's own."""
    for i, stage in enumerate(stages):
        if isinstance(stage, (LinearStage, Parallel)) and stage.place not in DRIVE:
            return i
    return _over(stages, 0, *DRIVE)
