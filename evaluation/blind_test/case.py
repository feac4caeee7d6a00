"""One case of the blind test: its excitation, and the label with its effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

EXCITATIONS = ("rich", "multisine", "sine", "closed_loop")

KINDS = ("single", "pair", "parameters", "none", "open_set")

NOISES = (5e-4, 3e-3)
"""Noise of the sensor, rms / stroke."""


@dataclass(frozen=True)
class Case:
    """One case of the blind test."""

    name: str  # Name of the case
    plant: str  # Truth plant
    kind: str  # One of `KINDS`
    excitation: str  # One of `EXCITATIONS`
    noise: float  # Noise of the sensor, rms / stroke
    seed: int  # Seed of the plant's scatter, noise and excitation
    effects: tuple[Mapping[str, Any], ...] = ()  # Effects of the plant, mappings that `load_plant` takes
    off: float = 1.0  # Scatter of the plant's coefficients, times their tolerance
    label: Mapping[str, Any] = field(default_factory=dict)  # The answer: kind, effects, true gap
    untuned: bool = False  # True with an effect in a realization that tuning seeds never draw
    duration: float = 1.5  # Length of the rich record, s

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(effect["name"] for effect in self.effects)


def as_document(case: Case) -> dict[str, Any]:
    """Convert a case with its label to JSON types."""
    return {**asdict(case), "effects": [dict(effect) for effect in case.effects], "label": dict(case.label)}
