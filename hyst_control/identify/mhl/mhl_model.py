# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Model and report of a fit of the modified Hammerstein-like model (`mhl`) from the fits of its axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar, cast

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain import Parallel, Stage
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.linear.linear_stages import Delay, RateCorrection, TransferFunction
from hyst_control.chain.memoryless import Gain
from hyst_control.identify.assess.assembly import assembled
from hyst_control.identify.assess.assembly import chain_model as model_of_chain
from hyst_control.identify.data.dataset import Dataset, Fit, ParameterRow
from hyst_control.identify.mhl.coupling import Coupling
from hyst_control.identify.mhl.madelung import merged, range_notes
from hyst_control.identify.mhl.madelung_curves import curve_errors
from hyst_control.identify.mhl.mhl_axis import AxisFit
from hyst_control.identify.solve.parameter_covariance import PRIOR, independent_axes
from hyst_control.model_file import Model

T = TypeVar("T")


def chain_stages(axes: Sequence[AxisFit]) -> list[Stage]:
    """The axes' chains side by side as one chain with per-axis parameters."""

    def per_axis(values: Sequence[T]) -> T | list[T]:
        return values[0] if len(values) == 1 else list(values)

    chains = [axis.axis.stages(axis.vector, axis.offset) for axis in axes]
    delays = [next((cast(float, stage.tau) for stage in chain if isinstance(stage, Delay)), 0.0) for chain in chains]
    dynamics = [
        next((stage for stage in chain if isinstance(stage, TransferFunction)), TransferFunction([1.0], [1.0])) for chain in chains
    ]
    parallel = [next(stage for stage in chain if isinstance(stage, Parallel)) for chain in chains]
    rates = [stage.branches[1][0] for stage in parallel]
    rate = RateCorrection(**{key: per_axis([getattr(stage, key) for stage in rates]) for key in ("k1", "k2", "b1")})
    stages: list[Stage] = [Delay(per_axis(delays))] if any(delays) else []
    hysteresis = merged([cast(Madelung, stage.branches[0][0]) for stage in parallel])
    stages.append(Parallel(((hysteresis,), (rate,))))
    num = per_axis([cast(Sequence[float], stage.num) for stage in dynamics])
    den = per_axis([cast(Sequence[float], stage.den) for stage in dynamics])
    stages.append(TransferFunction(num, den))
    if any(axis.axis.sign < 0 for axis in axes):
        stages.append(Gain(per_axis([axis.axis.sign for axis in axes])))
    return stages


def chain_model(datasets: Sequence[Dataset], axes: Sequence[AxisFit], method: str) -> Model:
    """Model of the fitted axes, without noise and tolerances, which the report adds."""
    return model_of_chain(datasets, chain_stages(axes), f"mhl_{method}")


def assemble(datasets: Sequence[Dataset], method: str, axes: Sequence[AxisFit], coupling: Coupling | None) -> Fit:
    """Model and report of a fit."""
    model = chain_model(datasets, axes, method)
    if coupling is not None:
        model = model.with_stages([*model.chain.stages, coupling.stage])
    parameters: list[ParameterRow] = []
    relative: dict[str, list[float]] = {}
    for axis, name in zip(axes, datasets[0].axes, strict=True):
        for row in [*curve_rows(axis, relative), *other_rows(axis, datasets[0].unit, relative)]:
            parameters.append({**row, "axis": name})
    if coupling is not None:
        parameters += coupling.rows(datasets[0].axes)
    known = independent_axes(
        [(axis.vector, axis.covariance) for axis in axes],
        lambda vectors: chain_stages([replace(axis, vector=vector) for axis, vector in zip(axes, vectors, strict=True)]),
        datasets[0].axes,
    )
    physical = {key: value for key, value in known.tolerance.items() if key in ("num", "den")}
    extra = [axis.extra for axis in axes]
    return assembled(
        datasets,
        model,
        known,
        parameters,
        range_notes(datasets, axes) + unresolved_parameters(parameters),
        family="mhl",
        method=method,
        held_out=[axis.held_out for axis in axes],
        tolerance={key: float(f"{min(np.median(values), PRIOR):.4g}") for key, values in relative.items()} | physical,
        more={"structure": [axis.axis.structure.describe() for axis in axes]} | ({"steps": extra} if any(extra) else {}),
    )


def curve_rows(axis: AxisFit, relative: dict[str, list[float]]) -> list[ParameterRow]:
    """Report rows of the coefficients of the curves of `axis`, with their errors; their tolerance is added to `relative`."""
    rows, tolerance = curve_errors(axis.axis.curves, axis.axis.split(axis.vector)[0], axis.covariance)
    for name in ("ascending", "descending"):
        relative.setdefault(name, []).append(tolerance)
    return rows


def other_rows(axis: AxisFit, unit: str, relative: dict[str, list[float]]) -> list[ParameterRow]:
    """Report rows of scale, rate part, delay and G(s), with the errors that follow from the covariance of the search."""
    structure, n = axis.axis.structure, axis.axis.curves.size

    def values(vector: Array) -> Array:
        num, den = structure.rational(vector[n + 2 :])
        full = axis.axis.output_scale * axis.axis.curves.full(vector[:n])
        return np.concatenate([[full], axis.axis.rate(vector), [structure.tau(vector[n + 2 :])], num, den[1:]])

    nominal = values(axis.vector)
    jacobian = np.array([(values(axis.vector + 1e-6 * unit_) - nominal) / 1e-6 for unit_ in np.eye(len(axis.vector))]).T
    errors = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", jacobian, axis.covariance, jacobian), 0.0))
    num, den = structure.rational(axis.vector[n + 2 :])
    names = ["output_scale", "k1", "k2", "tau", *(f"num[{i}]" for i in range(len(num))), *(f"den[{i}]" for i in range(1, len(den)))]
    units = [unit, f"{unit} s/V", "s", "s"] + [""] * (len(names) - 4)
    rows: list[ParameterRow] = []
    for name, value, error, given in zip(names, nominal, errors, units, strict=True):
        if name == "tau" and not structure.delay:
            continue
        rows.append({"name": name, "value": float(value), "standard_error": float(error), "unit": given})
        if value and error:
            relative.setdefault(name.split("[")[0], []).append(abs(float(error / value)))
    rows.append({"name": "b1", "value": float(axis.offset), "standard_error": None, "unit": unit})
    return rows


def unresolved_parameters(parameters: Sequence[ParameterRow]) -> list[str]:
    """Parameters that the data cannot tell, with their standard errors."""
    return [
        f"axis {row['axis']}: {row['name']} is not identifiable: {row['value']:.2g} ± {row['standard_error']:.2g} {row['unit']}".rstrip()
        for row in parameters
        if row["name"] in ("k1", "k2", "tau", "num[0]", "den[1]") and (row["standard_error"] or 0.0) > 0.5 * abs(row["value"])
    ]
