# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Model and report of a Prandtl-Ishlinskii fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, cast

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain import Stage
from hyst_control.chain.hysteresis.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from hyst_control.chain.hysteresis.rate_dependent_prandtl_ishlinskii import RateDependentPrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import Delay, TransferFunction
from hyst_control.identify.assess.assembly import assembled, chain_model
from hyst_control.identify.data.dataset import Dataset, Fit, ParameterRow, StructureRow
from hyst_control.identify.data.excited_band import REACH
from hyst_control.identify.solve.bounded_least_squares import covariance
from hyst_control.identify.solve.gram_sums import Operators
from hyst_control.identify.solve.parameter_covariance import Uncertainty, independent_axes
from hyst_control.identify.solve.stable_dynamics import Structure
from hyst_control.identify.solve.variable_projection import Solution

SENSOR_OFFSET = 0.01
"""Share of the range from which an offset is the sensor's; a smaller one is as well the session's remanence or an error of the model."""


@dataclass(frozen=True)
class AxisFit:
    """Fit of one axis."""

    solution: Solution  # Solution on all rows
    operators: Operators  # The play operators
    held_out: float  # Mean square error on the stretches held out
    rate_dependent: bool = False  # Thresholds that widen with the command's rate
    dynamics: bool = True  # Dynamics behind the operators were looked for
    # Solutions of the structures that were compared, on the rows of the selection
    tried: tuple[Solution, ...] = ()


def assemble(datasets: Sequence[Dataset], family: str, method: str, axes: Sequence[AxisFit]) -> Fit:
    """Assemble the model of all axes, with standard errors as tolerances, and its report."""
    first = datasets[0]
    model = chain_model(datasets, merge_axes([axis_stages(axis) for axis in axes]), f"{family}_{method}")
    travel = [max(float(data.range[i]) for data in datasets) for i in range(len(first.axes))]
    parameters: list[ParameterRow] = []
    notes: list[str] = []
    for axis, name, span in zip(axes, first.axes, travel, strict=True):
        own = [{**row, "axis": name} for row in parameter_rows(axis, first)]
        parameters += own  # type: ignore[arg-type]
        notes += unresolved_parameters(axis, name, parameters, span)
    compared = [row for axis, name, span in zip(axes, first.axes, travel, strict=True) for row in structure_rows(axis, name, span)]
    return assembled(
        datasets,
        model,
        uncertainty(axes, first.axes),
        parameters,
        notes,
        family=family,
        method=method,
        held_out=[axis.held_out for axis in axes],
        offset=SENSOR_OFFSET,
        more={"structure": [axis.solution.structure.describe() for axis in axes]} | ({"structures": compared} if compared else {}),
    )


def structure_rows(axis: AxisFit, name: str, span: float) -> list[StructureRow]:
    """List the structures of G(s) that were compared for one axis."""
    best: dict[Structure, Solution] = {}
    for solution in axis.tried:
        known = best.get(solution.structure)
        if known is None or solution.held_out < known.held_out:
            best[solution.structure] = solution
    return [
        {
            "axis": name,
            "structure": structure.describe(),
            "parameters": len(solution.theta) + structure.size,
            "held_out_nrmse": 100.0 * float(np.sqrt(solution.held_out)) / span,
            "chosen": structure == axis.solution.structure,
        }
        for structure, solution in best.items()
    ]


def axis_covariance(axis: AxisFit) -> Array:
    """Covariance of the parameters of one axis: linear ones, then those of G(s)."""
    solution = axis.solution
    size = solution.structure.size
    spread = covariance(solution.grams.blocks, np.concatenate([solution.theta, np.zeros(size), solution.nuisances]))
    free = len(solution.theta) + size
    return spread[:free, :free]


def uncertainty(axes: Sequence[AxisFit], names: Sequence[str]) -> Uncertainty:
    """Uncertainty of the model of all axes, which are fitted independently."""

    def stages_of(vectors: Sequence[Array]) -> Sequence[Stage]:
        chains = []
        for axis, vector in zip(axes, vectors, strict=True):
            theta, parameters = np.split(vector, [len(axis.solution.theta)])
            chains.append(axis_stages(replace(axis, solution=replace(axis.solution, theta=theta, parameters=parameters))))
        return merge_axes(chains)

    vectors = [np.concatenate([axis.solution.theta, axis.solution.parameters]) for axis in axes]
    # Weights are compared with all of them, and the dynamic ones with what moves the output as much.
    sizes = [np.concatenate([parameter_sizes(axis), np.ones(axis.solution.structure.size)]) for axis in axes]
    parts = [(vector, axis_covariance(axis)) for vector, axis in zip(vectors, axes, strict=True)]
    return independent_axes(parts, stages_of, names, sizes)


def parameter_sizes(axis: AxisFit) -> Array:
    """Sizes (J,) of the linear parameters of one axis, by the columns that they multiply."""
    columns = len(axis.solution.theta)
    power = np.sqrt(np.maximum(np.diag(axis.solution.grams.fitted + axis.solution.grams.held_out), 0.0))
    found: Array = power[-1] / np.maximum(power[:columns], 1e-12 * power[:columns].max()) / columns
    return found


def axis_stages(axis: AxisFit) -> list[Stage]:
    """Construct the chain of one axis: hysteresis, then its delay and dynamics."""
    operators, theta = axis.operators, axis.solution.theta
    thresholds, weights = operators.thresholds, theta[: len(operators.thresholds)]
    if axis.operators.dynamic:
        m1, m2, k = theta[len(thresholds) :]
        # b adds to every weight alike, so the data cannot separate it from them: it is set so that k u + b vanishes at mid-drive,
        # where the weights then are the static ones.
        hysteresis: Stage = ModifiedPrandtlIshlinskii(
            thresholds, weights, m1=m1, m2=m2, k=k, b=-k * operators.center, one_sided=operators.one_sided
        )
    else:
        straight = thresholds[0] == 0.0
        w0 = weights[0] if straight else 0.0
        thresholds, weights = (thresholds[1:], weights[1:]) if straight else (thresholds, weights)
        if axis.rate_dependent:
            # With rate-dependent thresholds the operator that starts at 0 is not a straight line: it stays an operator.
            hysteresis = RateDependentPrandtlIshlinskii(
                operators.thresholds, theta[: len(operators.thresholds)], beta=operators.rate_gain
            )
        else:
            hysteresis = PrandtlIshlinskii(thresholds, weights, w0=w0, one_sided=operators.one_sided)
    return [hysteresis, *axis.solution.structure.stages(axis.solution.parameters)]


def merge_axes(chains: Sequence[Sequence[Stage]]) -> tuple[Stage, ...]:
    """Merge chains of single axes into one with per-axis parameters; missing delays are 0, missing dynamics 1."""
    if len(chains) == 1:
        return tuple(chains[0])
    merged: list[Stage] = []
    hysteresis = [chain[0] for chain in chains]
    values = {
        key: [stage.parameters().get(key, getattr(stage, key)) for stage in hysteresis]
        for key in {name for stage in hysteresis for name in stage.parameters()} - {"one_sided"}
    }
    shared = {key: value for key, value in hysteresis[0].parameters().items() if key == "one_sided"}
    merged.append(type(hysteresis[0])(**values, **shared))
    delays = [next((cast(float, stage.tau) for stage in chain if isinstance(stage, Delay)), 0.0) for chain in chains]
    if any(delays):
        merged.append(Delay(delays))
    dynamics = [
        next((stage for stage in chain if isinstance(stage, TransferFunction)), TransferFunction([1.0], [1.0])) for chain in chains
    ]
    num = [cast(Sequence[float], stage.num) for stage in dynamics]
    den = [cast(Sequence[float], stage.den) for stage in dynamics]
    if any(len(each) > 1 for each in den):
        merged.append(TransferFunction(num, den))
    return tuple(merged)


def parameter_rows(axis: AxisFit, data: Dataset) -> list[ParameterRow]:
    """List every parameter with its value, unit and standard error (None where the data cannot give one)."""
    solution, operators = axis.solution, axis.operators
    spread = axis_covariance(axis)
    errors = np.sqrt(np.maximum(np.diag(spread), 0.0))
    count, columns = len(operators.thresholds), operators.columns
    rows: list[ParameterRow] = [
        {
            "name": f"weights[{i}]",
            "value": float(solution.theta[i]),
            "standard_error": float(errors[i]),
            "unit": f"{data.unit}/V",
            "threshold": float(operators.thresholds[i]),
        }
        for i in range(count)
    ]
    if axis.operators.dynamic:
        for i, (name, unit) in enumerate((("m1", "s/V^2"), ("m2", "s/V^2"), ("k", "/V^2"))):
            rows.append(
                {
                    "name": name,
                    "value": float(solution.theta[count + i]),
                    "standard_error": float(errors[count + i]),
                    "unit": f"{data.unit} {unit}" if unit[0] != "/" else f"{data.unit}{unit}",
                }
            )
        rows.append(
            {
                "name": "b",
                "value": float(-solution.theta[count + 2] * operators.center),
                "standard_error": None,
                "unit": f"{data.unit}/V",
            }
        )
    if axis.rate_dependent:
        rows.append({"name": "beta", "value": operators.rate_gain, "standard_error": None, "unit": "s"})
    if solution.structure.size:
        block = spread[columns : columns + solution.structure.size, columns : columns + solution.structure.size]
        rows += dynamics_rows(solution, block)
    return rows


def dynamics_rows(solution: Solution, spread: Annotated[Array, "P P"]) -> list[ParameterRow]:
    """List the coefficients of G and the delay, with errors propagated from the parameters of the search."""
    structure, parameters = solution.structure, solution.parameters

    def coefficients(vector: Array) -> Array:
        num, den = structure.rational(vector)
        return np.concatenate([num, den[1:], [structure.tau(vector)]])

    nominal = coefficients(parameters)
    jacobian = np.array([(coefficients(parameters + 1e-5 * unit) - nominal) / 1e-5 for unit in np.eye(structure.size)]).T
    errors = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", jacobian, spread, jacobian), 0.0))
    num, den = structure.rational(parameters)
    names = [f"num[{i}]" for i in range(len(num))] + [f"den[{i + 1}]" for i in range(len(den) - 1)] + ["tau"]
    units = [""] * (len(names) - 1) + ["s"]
    if len(den) == 1:
        names, units, nominal, errors = names[-1:], units[-1:], nominal[-1:], errors[-1:]
    if not structure.delay:
        names, units, nominal, errors = names[:-1], units[:-1], nominal[:-1], errors[:-1]
    return [
        {"name": name, "value": float(value), "standard_error": float(error), "unit": unit}
        for name, value, error, unit in zip(names, nominal, errors, units, strict=True)
    ]


def unresolved_parameters(axis: AxisFit, name: str, parameters: Sequence[ParameterRow], span: float) -> list[str]:
    """Parameters that the data cannot determine, with the sizes that say so; span: range of the measurement."""
    notes = []
    own = [row for row in parameters if row["axis"] == name]
    weights = [row for row in own if row["name"].startswith("weights")]
    whole = abs(sum(row["value"] for row in weights))
    unsure = [row for row in weights if (row["standard_error"] or 0.0) > max(abs(row["value"]), 1e-3 * whole)]
    if unsure:
        listed = ", ".join(f"{row['name']} {row['value']:.2g} ± {row['standard_error']:.2g}" for row in unsure[:3])
        more = f" and {len(unsure) - 3} more" if len(unsure) > 3 else ""
        notes.append(
            f"axis {name}: {len(unsure)} of {len(weights)} weights are not identifiable: {listed}{more} {weights[0]['unit']}"
        )
    structure, solution = axis.solution.structure, axis.solution
    if axis.dynamics and not structure.modes and np.isfinite(structure.highest):
        notes.append(
            f"axis {name}: no resonance is identifiable ({structure.describe()}): the command moves the stage up to "
            f"{structure.highest / REACH:.3g} Hz"
        )
    if axis.operators.dynamic:
        count = len(axis.operators.thresholds)
        left = 100.0 * np.sqrt(solution.fitted) / span
        moved = np.sqrt(np.diag(solution.grams.fitted + solution.grams.held_out) / max(sum(solution.grams.rows), 1)) / span
        for index, key in enumerate(("m1", "m2")):
            row = next(row for row in own if row["name"] == key)
            error = row["standard_error"] or 0.0
            if row["value"] == 0.0 or error > abs(row["value"]):
                effect = 100.0 * float(moved[count + index]) * max(abs(row["value"]), error)
                notes.append(
                    f"axis {name}: {key} is not identifiable: {row['value']:.2g} ± {error:.2g} {row['unit']}, an effect of at most "
                    f"{effect:.2g} % of the range where {left:.2g} % are left"
                )
    return notes
