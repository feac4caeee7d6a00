# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Model and report of a fit, the same for every family.

A family hands over, axis by axis, the chain as a function of its free parameters, where the search ended, and the numbers that a report
lists. The joint chain, standard errors, tolerances, uncertainty, noise and notes follow; every record is simulated once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from hyst_control.base.arrays import Array
from hyst_control.chain import Chain, Stage
from hyst_control.chain.hysteresis.creep_operators import CreepOperators
from hyst_control.chain.linear.linear_stages import Delay, StateSpace, TransferFunction
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.identify.assess.fit_report import (
    SPECTRUM_ROWS,
    command_bandwidth,
    error_rows,
    noise_sigma,
    residual_from,
    with_offset,
    with_own_rows,
    with_state,
)
from hyst_control.identify.assess.residual_lines import line_notes
from hyst_control.identify.data.excited_band import excited_band, highest_above
from hyst_control.identify.data.fit import Fit, Number, ParameterRow, Report, StructureRow
from hyst_control.identify.data.fit_windows import as_window
from hyst_control.identify.data.initial_memory import beginning_rows
from hyst_control.identify.solve.parameter_covariance import PRIOR, STEP, derivatives, uncertainty_of
from hyst_control.model_file import Model
from hyst_control.records.record import Beginning, Record
from hyst_control.records.stream.row_store import spread_parts

NEUTRAL: dict[type[Stage], Stage] = {
    Delay: Delay(0.0),
    TransferFunction: TransferFunction([1.0], [1.0]),
    CreepOperators: CreepOperators([1.0], [0.0]),
    Gain: Gain(1.0),
    Offset: Offset(0.0),
}
"""Stages that change nothing, for axes that lack one which another axis has."""


@dataclass(frozen=True)
class AxisFit:
    """Fit of one axis, or of all axes together."""

    stages: Callable[[Array], Sequence[Stage]]  # Chain of a parameter vector (P,)
    vector: Array  # Parameters (P,) of the fit
    covariance: Array  # Their covariance (P, P)
    numbers: Callable[[Array], Sequence[Number]]  # Numbers of the report
    held_out: float | None = None  # Mean square error on rows that were not fitted
    sizes: Array | None = None  # Sizes (P,) of the parameters; None: one
    tolerance: Mapping[str, float] = field(default_factory=dict)  # In place of that which follows from the covariance
    structure: str | None = None  # Of the dynamics, in words
    structures: Sequence[StructureRow] = ()  # That were compared
    notes: Callable[[Sequence[ParameterRow]], Sequence[str]] = lambda rows: ()  # On numbers that the data cannot tell
    steps: Mapping[str, Any] = field(default_factory=dict)  # Results of a paper's sequence

    def rows(self, axis: str) -> list[ParameterRow]:
        """The numbers with their standard errors, to first order in the parameters."""
        nominal = self.numbers(self.vector)
        steps = STEP * (np.ones(len(self.vector)) if self.sizes is None else self.sizes)
        jacobian = derivatives(lambda vector: {each.name: each.value for each in self.numbers(vector)}, self.vector, steps)
        errors = np.sqrt(np.maximum(np.einsum("ip,pq,iq->i", jacobian, self.covariance, jacobian), 0.0))
        rows: list[ParameterRow] = []
        for i, each in enumerate(nominal):
            error = float(errors[i]) if each.estimated and np.isfinite(errors[i]) else None
            rows.append({"name": each.name, "value": float(each.value), "standard_error": error, "unit": each.unit, "axis": axis})
            if each.threshold is not None:
                rows[-1]["threshold"] = each.threshold
        return rows


def _with_free_motion(model: Model, data: Record, error: Array) -> Array:
    """A residual without an estimated motion from before the record: a mode without damping would make a hum of it."""
    if not (isinstance(data.start, Beginning) and data.start.moving):
        return error
    return residual_from(model, replace(data, start=replace(data.start, moving=False)))


def side_by_side(chains: Sequence[Sequence[Stage]]) -> list[Stage]:
    """Chains of single axes as one, whose parameters are lists with one value per axis."""
    if len(chains) == 1:
        return list(chains[0])
    kinds: list[type[Stage]] = []
    for chain in chains:
        at = 0
        for kind in map(type, chain):
            if kind in kinds[at:]:
                at = kinds.index(kind, at)
            else:
                kinds.insert(at, kind)
            at += 1
    left = [list(chain) for chain in chains]
    return [_joined([chain.pop(0) if chain and type(chain[0]) is kind else NEUTRAL[kind] for chain in left]) for kind in kinds]


def _joined(stages: Sequence[Stage]) -> Stage:
    """Stages of one kind as one; what all have as it is by default stays so."""
    first = stages[0]
    if first.inner_chains:
        branches = zip(*(stage.inner_chains for stage in stages), strict=True)
        return first.with_inner_chains([side_by_side(each) for each in branches])
    values = {}
    for name, known in first.declarations().items():
        own = [getattr(stage, name) for stage in stages]
        if known.per_axis is not None and any(name in stage.parameters() for stage in stages):
            values[name] = own
    return replace(first, **values)


def chain_model(records: Sequence[Record], stages: Sequence[Stage], name: str) -> Model:
    """The model of a chain, valid where the records are."""
    first = records[0]
    return Model(
        name=name,
        axes=tuple(first.axes),
        units={"command": "V", "measurement": first.unit},
        sample_time=first.sample_time,
        hold=first.hold,
        chain=Chain(tuple(stages)),
        valid={
            "command": [min(float(data.command.min()) for data in records), max(float(data.command.max()) for data in records)],
            "frequency": [0.0, float(f"{_known_band(records, stages):.4g}")],
        },
    )


def _known_band(records: Sequence[Record], stages: Sequence[Stage]) -> float:
    """Frequency (Hz) up to which commands excite dynamics of every axis enough; without dynamics, below which nearly all power lies."""

    def excited(axis: int) -> float:
        return excited_band(
            [
                as_window(data.rows(part.start, part.stop), axis, 0)
                for data in records
                for part in spread_parts(len(data.command), SPECTRUM_ROWS)
            ]
        )

    power = max(command_bandwidth(data.command, data.sample_time) for data in records)
    if not any(isinstance(stage, TransferFunction | StateSpace) for stage in stages):
        return power  # a jump in slow loops tells nothing of dynamics that the model does not have
    return max(power, min(map(excited, range(len(records[0].axes)))))


def _motion_ends(records: Sequence[Record], residuals: Sequence[Array]) -> float:
    """Frequency (Hz) up to which the model's output on every axis is well above the residual."""

    def ends(axis: int) -> float:
        return max(
            highest_above(data.measurement[-len(error) :, axis][part] - error[part, axis], error[part, axis], data.sample_time)
            for data, error in zip(records, residuals, strict=True)
            for part in spread_parts(len(error), SPECTRUM_ROWS)
        )

    return min(map(ends, range(len(records[0].axes))))


def fit_of(
    records: Sequence[Record],
    axes: Sequence[AxisFit],
    family: str,
    method: str = "joint",
    *,
    name: str | None = None,
    offset: float | None = None,
    by_axis: bool = False,
    behind: Sequence[Stage] = (),
    rows: Sequence[ParameterRow] = (),
    more: Mapping[str, Any] | None = None,
) -> Fit:
    """Fit of a chain from those of its axes.

    offset: share of the range from which a common offset becomes the last stage (None: it is one already); by_axis: the noise is a list
    even of one axis; behind, rows: stages that follow the axes' chains, and numbers of theirs; more: further entries of the report.
    """
    first = records[0]
    labels = first.axes if len(axes) == len(first.axes) else [", ".join(first.axes)]
    vector, edges = np.concatenate([axis.vector for axis in axes]), np.cumsum([len(axis.vector) for axis in axes])[:-1]

    def stages_of(whole: Array) -> list[Stage]:
        return side_by_side([axis.stages(own) for axis, own in zip(axes, np.split(whole, edges), strict=True)])

    sizes = np.concatenate([np.ones(len(axis.vector)) if axis.sizes is None else axis.sizes for axis in axes])
    known = uncertainty_of(stages_of, vector, block_diag(*(axis.covariance for axis in axes)), first.axes, sizes)
    model = chain_model(records, [*stages_of(vector), *behind], name or family)
    begun = [with_state(model, with_own_rows(model, data)) for data in records]
    residuals = [residual_from(model, data) for data in begun]
    travel = np.max([data.span for data in records], axis=0)
    if offset is not None:
        model = with_offset(model, residuals, travel, offset)
    sigma = noise_sigma(residuals, records)
    stated = {key: [axis.tolerance[key] for axis in axes] for key in axes[0].tolerance}
    model = replace(
        model,
        tolerance=known.tolerance | {key: float(f"{min(np.median(values), PRIOR):.4g}") for key, values in stated.items()},
        uncertainty=known.document,
        noise={"sigma": sigma if len(sigma) > 1 or by_axis else sigma[0]},
    )
    found = [axis.rows(label) for axis, label in zip(axes, labels, strict=True)]
    report: Report = {
        "family": family,
        "method": method,
        "unit": first.unit,
        "records": error_rows(records, residuals),
        "parameters": [row for own in found for row in own] + list(rows),
        "notes": [
            *(note for axis, own in zip(axes, found, strict=True) for note in axis.notes(own)),
            *line_notes(begun, [_with_free_motion(model, data, error) for data, error in zip(begun, residuals, strict=True)]),
            *known.notes(f"The commands excite the motion up to {_motion_ends(records, residuals):.3g} Hz."),
        ],
        "beginnings": beginning_rows(begun),
    }
    held_out = [axis.held_out for axis in axes if axis.held_out is not None]
    if held_out:
        report["held_out_nrmse"] = [100.0 * float(np.sqrt(each) / span) for each, span in zip(held_out, travel, strict=True)]
    if any(axis.structure is not None for axis in axes):
        report["structure"] = [axis.structure or "" for axis in axes]
    if compared := [row for axis in axes for row in axis.structures]:
        report["structures"] = compared
    if any(axis.steps for axis in axes):
        report["steps"] = [dict(axis.steps) for axis in axes]
    return Fit(model, {**report, **(more or {})}, tuple(residuals))  # type: ignore[typeddict-item]
