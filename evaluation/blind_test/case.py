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
    """One case of the blind test.

    Parameters
    ----------
    name
        Name of the case.
    plant
        Truth plant.
    kind
        One of `KINDS`.
    excitation
        One of `EXCITATIONS`.
    noise
        Noise of the sensor, rms / stroke.
    seed
        Seed of the plant's scatter, noise and excitation.
    effects
        Effects of the plant, mappings that `load_plant` takes.
    off
        Scatter of the plant's coefficients, times their tolerance.
    label
        The answer: kind, effects, true gap.
    untuned
        True with an effect in a realization that tuning seeds never draw.
    duration
        Length of the rich record, s.
    """

    name: str
    plant: str
    kind: str
    excitation: str
    noise: float
    seed: int
    effects: tuple[Mapping[str, Any], ...] = ()
    off: float = 1.0
    label: Mapping[str, Any] = field(default_factory=dict)
    untuned: bool = False
    duration: float = 1.5

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(effect["name"] for effect in self.effects)


def as_document(case: Case) -> dict[str, Any]:
    """Convert a case with its label to JSON types.

    Parameters
    ----------
    case
        The case.

    Returns
    -------
    dict[str, Any]
        The document.
    """
    return {**asdict(case), "effects": [dict(effect) for effect in case.effects], "label": dict(case.label)}
