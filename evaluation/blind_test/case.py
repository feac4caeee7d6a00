# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The table of cases: a row says what is in a record, how the record is made, and what a diagnosis should say of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from evaluation.data_files import frozen
from hyst_control.base.arrays import Array
from hyst_control.model_file import Model
from hyst_control.records.record import Record

EXCITATIONS = ("rich", "multisine", "sine", "closed_loop")

KINDS = ("single", "pair", "parameters", "none", "open_set")

NOISES = (5e-4, 3e-3)
"""Noise of the sensor, rms / stroke."""

VERDICTS = {
    "single": ("effect", "ambiguous"),
    "pair": ("effect", "ambiguous"),
    "parameters": ("parameters",),
    "none": ("no_gap", "parameters"),
    "open_set": ("unknown",),
}
"""Verdicts that are right, by kind, where the label has none of its own."""

DIGITS = 6
"""Of a label's numbers: the last digits of a simulated gap come from the processor's mathematics library."""


@dataclass(frozen=True)
class Label:
    """Answer of a case: what a diagnosis should say, and how large the gap is. None: as for every simulated case."""

    kind: str  # One of `KINDS`: that of the case, or "none" where nobody could see its gap
    names: tuple[str, ...]  # Effects to name
    gap_rms: float = 0.0  # True gap, measurement unit
    noise_rms: float = 0.0  # Noise, or the error of the model where that hides a gap, measurement unit
    distance: float | None = None  # Distance of the gap from any change of gain and offset, standard deviations
    hidden: tuple[str, ...] | None = None  # What is in the case where nobody could see it
    shown: tuple[str, ...] | None = None  # Effects of a pair that are visible beside the other
    accepted: tuple[tuple[str, ...], ...] | None = None  # Names that are right for each effect
    ignored: tuple[str, ...] | None = None  # Names that are neither right nor wrong
    verdicts: tuple[str, ...] | None = None  # Verdicts that are right
    truth: Mapping[str, tuple[float, ...]] | None = None  # True parameters of the first effect, by axis


@dataclass(frozen=True)
class Case:
    """One row of the table of cases."""

    name: str  # Name of the case
    plant: str  # Reference simulation, or machine
    kind: str  # One of `KINDS`
    excitation: str  # One of `EXCITATIONS`, or the machine's record
    noise: float  # Noise of the sensor, rms / stroke; 0 of a measured record
    seed: int  # Seed of the plant's scatter, noise and excitation; of an injected case that of the run
    effects: tuple[Mapping[str, Any], ...] = ()  # Effects that are put in, with their sizes and realizations
    off: float = 1.0  # Scatter of the plant's coefficients, times their tolerance
    label: Label | None = None  # The answer; None until the case is made
    untuned: bool = False  # True with an effect in a realization that tuning seeds never draw
    duration: float = 1.5  # Length of the rich record, s
    source: str = "simulated"  # "simulated", "injected" into a record, or "withheld" from the model
    regime: str = "none"  # Baseline records beside the new one: none, of another command, of the same command
    multiple: float = 0.0  # Size of each injected effect, times the model discrepancy
    axes: tuple[str, ...] = ()  # Axes of the label's true parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its effects."""
        return tuple(effect["name"] for effect in self.effects)

    @property
    def answer(self) -> Label:
        """The label of a case that was made."""
        assert self.label is not None, self.name
        return self.label


@dataclass(frozen=True)
class Made:
    """Content of a case's files: records and model; and the answer, which is kept apart."""

    record: Record  # The record to diagnose
    model: Model  # The model to diagnose it with
    label: Label  # The answer
    effects: tuple[Mapping[str, Any], ...]  # What was put in, with the sizes that were found
    beside: tuple[Record, ...] = ()  # Baseline records
    warm_up: float = 0.0  # Begin of the records that does not count, s
    coming: Array | None = None  # Command of a later session, for which the reduction is predicted

    def of(self, case: Case) -> Case:
        """The case with its answer."""
        return replace(case, label=self.label, effects=self.effects)


def as_document(case: Case) -> dict[str, Any]:
    """Convert a case with its label to JSON types, its numbers rounded; what its label does not say is left out."""
    document = asdict(case)
    document["label"] = {name: value for name, value in document["label"].items() if value is not None}
    rounded: dict[str, Any] = _rounded(document)
    return rounded


def from_document(document: Mapping[str, Any]) -> Case:
    """Read a case as `as_document` writes it."""
    whole = frozen(document)
    return replace(Case(**{**whole, "label": None}), label=Label(**whole["label"]))


def _rounded(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(item) for item in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
