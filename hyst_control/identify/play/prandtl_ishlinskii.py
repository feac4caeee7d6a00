# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The families of play operators: pi, hapi, rdpi and hampi."""

from __future__ import annotations

from collections.abc import Sequence

from hyst_control.identify.assess.assembly import AxisFit, fit_of
from hyst_control.identify.data.fit import Fit, check_records
from hyst_control.identify.families.estimator import Estimator, O, register
from hyst_control.identify.play import paper_hampi
from hyst_control.identify.play.hammerstein import (
    HammersteinOptions,
    OperatorOptions,
    PlayOptions,
    axis_problem,
    fit_dynamic,
    fit_rate_dependent,
    fit_static,
)
from hyst_control.identify.play.prandtl_ishlinskii_model import SENSOR_OFFSET, axis_fit
from hyst_control.records.record import Record


class _Operators(Estimator[O]):
    """Play operators, with the sensor's zero behind them."""

    suggested = True

    def fit(self, records: Sequence[Record], options: O) -> Fit:
        check_records(records)
        axes = [self.fit_axis(records, index, options) for index in range(len(records[0].axes))]
        title = f"{self.name}_{options.method}"
        return fit_of(records, axes, self.name, options.method, name=title, offset=SENSOR_OFFSET)


@register
class Play(_Operators[PlayOptions]):
    """Static play operators."""

    name = "pi"
    sentence = "Prandtl-Ishlinskii model without dynamics: play operators whose weights are a linear least-squares problem"
    Options = PlayOptions

    def fit_axis(self, records: Sequence[Record], index: int, options: PlayOptions) -> AxisFit:
        problem = axis_problem(records, index, options, one_sided=options.one_sided)
        return axis_fit(records, index, problem.operators, *fit_static(problem), dynamics=False)


class _Hammerstein(_Operators[HammersteinOptions]):
    """Play operators in front of dynamics."""

    Options = HammersteinOptions
    dynamic = False
    """Weights that follow the command's rate and level."""

    def fit_axis(self, records: Sequence[Record], index: int, options: HammersteinOptions) -> AxisFit:
        if options.method == "paper":
            return axis_fit(records, index, *paper_hampi.fit_axis(records, index, options, dynamic=self.dynamic))
        problem = axis_problem(records, index, options, one_sided=options.one_sided, dynamic=self.dynamic)
        return axis_fit(records, index, problem.operators, *fit_dynamic(problem, options.structure))


@register
class Hammerstein(_Hammerstein):
    """Play operators of static weights in front of dynamics."""

    name = "hapi"
    sentence = (
        "Prandtl-Ishlinskii model in front of dynamics G(s): for given G(s) the output is linear in the weights, so the search is over "
        "G(s) alone (variable projection), whose factors are chosen on held-out stretches"
    )


@register
class RateDependent(_Operators[OperatorOptions]):
    """Play operators whose thresholds widen with the rate."""

    name = "rdpi"
    sentence = "rate-dependent Prandtl-Ishlinskii model: thresholds that widen with the command's rate by one factor, searched for"
    Options = OperatorOptions

    def fit_axis(self, records: Sequence[Record], index: int, options: OperatorOptions) -> AxisFit:
        problem, solution, held_out = fit_rate_dependent(axis_problem(records, index, options))
        return axis_fit(records, index, problem.operators, solution, held_out, dynamics=False)


@register
class ModifiedHammerstein(_Hammerstein):
    """Play operators of dynamic weights in front of dynamics."""

    name = "hampi"
    sentence = "as hapi, with weights that follow the command's rate and level (m1, m2, k, b)"
    dynamic = True
