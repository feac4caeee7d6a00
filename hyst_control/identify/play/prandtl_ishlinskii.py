# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The families of play operators: pi, hapi, rdpi and hampi; chain, numbers and notes of their fits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain import Stage
from hyst_control.chain.hysteresis.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from hyst_control.chain.hysteresis.rate_dependent_prandtl_ishlinskii import RateDependentPrandtlIshlinskii
from hyst_control.chain.memoryless import Gain
from hyst_control.identify.assess.assembly import AxisFit, fit_of
from hyst_control.identify.data.excited_band import REACH
from hyst_control.identify.data.fit import Fit, Number, ParameterRow, StructureRow, check_records
from hyst_control.identify.data.fit_windows import as_window, response_sign, turned_over
from hyst_control.identify.families.estimator import Estimator, O, register
from hyst_control.identify.play import paper_hampi
from hyst_control.identify.play.hammerstein import (
    DynamicWeightOptions,
    HammersteinOptions,
    OperatorOptions,
    PlayOptions,
    axis_problem,
    finer_operators,
    fit_dynamic,
    fit_rate_dependent,
    fit_static,
)
from hyst_control.identify.solve.bounded_least_squares import covariance
from hyst_control.identify.solve.gram_sums import Operators
from hyst_control.identify.solve.parameter_covariance import untold
from hyst_control.identify.solve.stable_dynamics import Structure
from hyst_control.identify.solve.variable_projection import Solution
from hyst_control.records.record import Record

SENSOR_OFFSET = 0.01
"""Share of the range from which an offset is the sensor's; a smaller one is as well the session's remanence or an error of the model."""


class _Operators(Estimator[O]):
    """Play operators, with the sensor's zero behind them."""

    suggested = True

    def fit(self, records: Sequence[Record], options: O) -> Fit:
        check_records(records)
        axes = [self._either_way(records, index, options) for index in range(len(records[0].axes))]
        title = f"{self.name}_{options.method}"
        return fit_of(records, axes, self.name, options.method, name=title, offset=SENSOR_OFFSET)

    def _either_way(self, records: Sequence[Record], index: int, options: O) -> AxisFit:
        """The fit of one axis or, where the measurement falls as the command rises, of its measurement turned over, if that is better."""
        found = self.fit_axis(records, index, options)
        if response_sign([as_window(data, index, number) for number, data in enumerate(records)]) > 0.0:
            return found
        # Beyond a resonance that of a stage of positive gain falls, too: rows held out tell which it is.
        other = self.fit_axis([turned_over(data) for data in records], index, options)
        if (other.held_out or 0.0) >= (found.held_out or 0.0):
            return found
        return replace(other, stages=lambda at: [*other.stages(at), Gain(-1.0)])


@register
class Play(_Operators[PlayOptions]):
    """Static play operators."""

    name = "pi"
    sentence = "Prandtl-Ishlinskii model without dynamics: play operators whose weights are a linear least-squares problem"
    Options = PlayOptions

    def fit_axis(self, records: Sequence[Record], index: int, options: PlayOptions) -> AxisFit:
        problem = axis_problem(records, index, options, one_sided=options.one_sided)
        return axis_fit(records, index, *fit_static(problem, finer_operators(problem, options)), dynamics=False)


class _Hammerstein(_Operators[O]):
    """Play operators in front of dynamics."""

    dynamic = False  # Weights that follow the command's rate and level

    def fit_axis(self, records: Sequence[Record], index: int, options: O) -> AxisFit:
        assert isinstance(options, HammersteinOptions)
        if options.method == "paper":
            return axis_fit(records, index, *paper_hampi.fit_axis(records, index, options, dynamic=self.dynamic))
        problem = axis_problem(records, index, options, one_sided=options.one_sided, dynamic=self.dynamic)
        finer = finer_operators(problem, options, levels=isinstance(options, DynamicWeightOptions) and options.levels)
        return axis_fit(records, index, *fit_dynamic(problem, options.structure, finer))


@register
class Hammerstein(_Hammerstein[HammersteinOptions]):
    """Play operators of static weights in front of dynamics."""

    name = "hapi"
    sentence = (
        "Prandtl-Ishlinskii model in front of dynamics G(s): for given G(s) the output is linear in the weights, so the search is over "
        "G(s) alone (variable projection), whose factors are chosen on held-out stretches"
    )
    Options = HammersteinOptions


@register
class RateDependent(_Operators[OperatorOptions]):
    """Play operators whose thresholds widen with the rate."""

    name = "rdpi"
    sentence = "rate-dependent Prandtl-Ishlinskii model: thresholds that widen with the command's rate by one factor, searched for"
    Options = OperatorOptions

    def fit_axis(self, records: Sequence[Record], index: int, options: OperatorOptions) -> AxisFit:
        return axis_fit(records, index, *fit_rate_dependent(axis_problem(records, index, options)), dynamics=False)


@register
class ModifiedHammerstein(_Hammerstein[DynamicWeightOptions]):
    """Play operators of dynamic weights in front of dynamics."""

    name = "hampi"
    sentence = "as hapi, with weights that follow the command's rate and level (m1, m2, k, b, or `levels`, one per operator)"
    Options = DynamicWeightOptions
    dynamic = True


def axis_fit(
    records: Sequence[Record],
    index: int,
    operators: Operators,
    solution: Solution,
    held_out: float,
    tried: Sequence[Solution] = (),
    *,
    dynamics: bool = True,
) -> AxisFit:
    """The fit of one axis; tried: solutions of the structures that were compared; dynamics: whether any were looked for."""
    unit, name, span = records[0].unit, records[0].axes[index], max(float(data.span[index]) for data in records)
    linear, structure = len(solution.theta), solution.structure
    vector = np.concatenate([solution.theta, solution.parameters])
    coefficients = np.concatenate([solution.theta, np.zeros(structure.size), solution.nuisances])
    blocks = solution.grams.blocks
    spread = (covariance(blocks, coefficients) + untold(blocks.sum(axis=0)))[: len(vector), : len(vector)]
    # Weights are compared with all of them, and the dynamic ones with what moves the output as much.
    power = np.sqrt(np.maximum(np.diag(solution.grams.fitted + solution.grams.held_out), 0.0))
    sizes = power[-1] / np.maximum(power[:linear], 1e-12 * power[:linear].max()) / linear

    def numbers(at: Array, structure: Structure = structure) -> list[Number]:
        return _numbers(operators, structure, at, unit)

    def notes(_: Sequence[ParameterRow]) -> list[str]:
        if not dynamics or structure.modes or not np.isfinite(structure.highest):
            return []
        return [
            f"axis {name}: no resonance is identifiable ({structure.describe()}): the command moves the stage up to "
            f"{structure.highest / REACH:.3g} Hz"
        ]

    return AxisFit(
        lambda at: [_hysteresis(operators, at[:linear]), *structure.stages(at[linear:])],
        vector,
        spread,
        numbers,
        held_out,
        np.concatenate([sizes, np.ones(structure.size)]),
        structure=structure.describe(),
        structures=_structure_rows(solution, tried, name, span, numbers),
        notes=notes,
    )


def _hysteresis(operators: Operators, theta: Array) -> Stage:
    thresholds, (weights, levels, rest) = operators.thresholds, operators.split(theta)
    if operators.reach:
        m1, m2 = rest
        return ModifiedPrandtlIshlinskii(
            thresholds, weights, m1=m1, m2=m2, levels=levels, center=operators.center, one_sided=operators.one_sided
        )
    if operators.dynamic:
        m1, m2, k = rest
        # b adds to every weight alike, so the data cannot separate it from them: it is set so that k u + b vanishes at mid-drive,
        # where the weights then are the static ones.
        return ModifiedPrandtlIshlinskii(
            thresholds, weights, m1=m1, m2=m2, k=k, b=-k * operators.center, one_sided=operators.one_sided
        )
    if operators.rate_gain is not None:
        # With rate-dependent thresholds the operator that starts at 0 is not a straight line: it stays an operator.
        return RateDependentPrandtlIshlinskii(thresholds, weights, beta=operators.rate_gain)
    straight = int(thresholds[0] == 0.0)
    return PrandtlIshlinskii(
        thresholds[straight:], weights[straight:], w0=weights[0] if straight else 0.0, one_sided=operators.one_sided
    )


def _numbers(operators: Operators, structure: Structure, vector: Array, unit: str) -> list[Number]:
    weights, levels, rest = operators.split(vector[: operators.columns])
    slope, rates = f"{unit}/V", [f"{unit} s/V^2"] * 2
    at = [float(threshold) for threshold in operators.thresholds]
    found = [Number(f"weights[{i}]", weight, slope, threshold=at[i]) for i, weight in enumerate(weights)]
    if operators.reach:
        found += [Number(f"levels[{i}]", level, f"{unit}/V^2", threshold=at[i]) for i, level in enumerate(levels)]
    if operators.dynamic:
        found += [Number(name, value, unit) for name, value, unit in zip(("m1", "m2", "k"), rest, [*rates, f"{unit}/V^2"])]
    if operators.dynamic and not operators.reach:
        found.append(Number("b", -rest[2] * operators.center, slope, estimated=False))
    if operators.rate_gain is not None:
        found.append(Number("beta", operators.rate_gain, "s", estimated=False))
    return found + structure.numbers(vector[operators.columns :])


def _structure_rows(
    solution: Solution, tried: Sequence[Solution], name: str, span: float, numbers: Callable[[Array, Structure], Sequence[Number]]
) -> list[StructureRow]:
    """The structures of G(s) that were compared, each with its best solution; `numbers`: those that the report has of one."""
    best: dict[Structure, Solution] = {}
    for each in tried:
        known = best.get(each.structure)
        if known is None or each.held_out < known.held_out:
            best[each.structure] = each
    return [
        {
            "axis": name,
            "structure": structure.describe(),
            "parameters": len(numbers(np.concatenate([solution.theta, each.parameters]), structure)),
            "held_out_nrmse": 100.0 * float(np.sqrt(each.held_out)) / span,
            "chosen": structure == solution.structure,
        }
        for structure, each in best.items()
    ]
