"""Where things are in a chain: its hysteresis, its mechanics, and the index at which an effect goes."""

from __future__ import annotations

from collections.abc import Sequence

from hyst_control.chain.chain import Parallel
from hyst_control.chain.linear import Delay, LinearStage, StateSpace, TransferFunction
from hyst_control.chain.stage import Stage
from hyst_control.effects.effect import PLACES
from hyst_control.effects.modifiers import Changed

HYSTERESES = (
    "play_operator",
    "prandtl_ishlinskii",
    "rate_dependent_prandtl_ishlinskii",
    "modified_prandtl_ishlinskii",
    "madelung",
    "softening_modal",
)
"""Stages that are a plant's hysteresis."""

FOLLOWERS = {
    "hysteresis": ("hysteresis_width", "hysteresis_shape", "hysteresis_rate"),
    "piezo": ("creep",),
    "mechanics": ("added_mass", "resonance", "coupled_resonance"),
    "motion": ("backlash", "softening_modes", "vibration"),
    "adc": ("sensor_noise", "flicker_noise", "quantization"),
    "transport": ("held_samples",),
}
"""Stages that belong to a place: what is inserted there goes behind them, what belongs to an earlier place before them."""


def hysteresis_index(stages: Sequence[Stage]) -> int | None:
    """Index of the hysteresis stage, or of the `parallel` that contains it; None where a chain has none.

    A `hysteresis_width` that stands in a chain without one is its hysteresis.
    """
    added = next((i for i, stage in enumerate(stages) if stage.name == "hysteresis_width"), None)
    return next((i for i, stage in enumerate(stages) if _has_hysteresis(stage)), added)


def mechanics_index(stages: Sequence[Stage]) -> int | None:
    """Index of the mechanics: the last transfer function or continuous state space behind the hysteresis; None where there is none."""
    behind = hysteresis_index(stages)
    for i in range(len(stages) - 1, -1 if behind is None else behind, -1):
        if is_mechanics(stages[i]):
            return i
    return None


def with_mechanics(stages: tuple[Stage, ...]) -> tuple[tuple[Stage, ...], int]:
    """The stages and the index of their mechanics; a chain without gets G = 1 behind what it has."""
    index = mechanics_index(stages)
    return (stages, index) if index is not None else ((*stages, TransferFunction((1.0,), (1.0,))), len(stages))


def is_mechanics(stage: Stage) -> bool:
    """Whether a stage may be a plant's mechanics."""
    return isinstance(stage, (TransferFunction, StateSpace, Changed)) and not getattr(stage, "discrete", False)


def insert(stages: tuple[Stage, ...], place: str, stage: Stage) -> tuple[Stage, ...]:
    """The stages with one more at a place of `PLACES`, behind those that are at that place already."""
    index = _index(stages, place, stage)
    return (*stages[:index], stage, *stages[index:])


def _index(stages: tuple[Stage, ...], place: str, stage: Stage) -> int:
    if place == "dac":
        return 0
    if place in ("sensor", "adc", "transport"):
        later = [name for other in PLACES[PLACES.index(place) + 1 :] for name in FOLLOWERS.get(other, ())]
        index = len(stages)
        while index and stages[index - 1].name in later:
            index -= 1
        return index
    hysteresis = hysteresis_index(stages)
    begin = _first_linear(stages) if hysteresis is None else hysteresis
    if place == "drive":
        # An amplifier's low-pass stands behind what limits the drive.
        while begin and stages[begin - 1].name == "amplifier_lowpass" and stage.name != "amplifier_lowpass":
            begin -= 1
        return begin
    behind = begin if hysteresis is None else hysteresis + 1
    behind = _over(stages, behind, FOLLOWERS["hysteresis"])
    if place == "hysteresis":
        return behind
    behind = _over(stages, behind, FOLLOWERS["piezo"])
    if place == "piezo":
        return behind
    mechanics = mechanics_index(stages)
    behind = _over(stages, behind if mechanics is None else mechanics + 1, FOLLOWERS["mechanics"])
    return behind if place == "mechanics" else _over(stages, behind, FOLLOWERS["motion"])


def _over(stages: Sequence[Stage], index: int, names: Sequence[str]) -> int:
    while index < len(stages) and stages[index].name in names:
        index += 1
    return index


def _first_linear(stages: Sequence[Stage]) -> int:
    """Where the hysteresis of a chain without one would be: before its first linear stage that is not the drive's own."""
    for i, stage in enumerate(stages):
        if isinstance(stage, (LinearStage, Parallel)) and not isinstance(stage, Delay) and stage.name != "amplifier_lowpass":
            return i
    return _over(stages, 0, ("dac_hold", "delay", "slew_limit", "saturation", "amplifier_lowpass"))


def _has_hysteresis(stage: Stage) -> bool:
    if isinstance(stage, Parallel):
        return any(_has_hysteresis(member) for branch in stage.branches for member in branch)
    return stage.name in HYSTERESES
