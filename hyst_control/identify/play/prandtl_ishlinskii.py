# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The families of play operators: pi, hapi, rdpi and hampi."""

from __future__ import annotations

from collections.abc import Sequence

from hyst_control.identify.data.dataset import Dataset, Fit, check_records
from hyst_control.identify.families.estimator import Estimator, register
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
from hyst_control.identify.play.prandtl_ishlinskii_model import assemble


@register
class Play(Estimator[PlayOptions]):
    """Static play operators."""

    name = "pi"
    sentence = "Prandtl-Ishlinskii model without dynamics: play operators whose weights are a linear least-squares problem"
    suggested = True
    Options = PlayOptions

    def fit(self, datasets: Sequence[Dataset], options: PlayOptions) -> Fit:
        check_records(datasets)
        problems = (axis_problem(datasets, axis, options, one_sided=options.one_sided) for axis in range(len(datasets[0].axes)))
        return assemble(datasets, self.name, options.method, [fit_static(problem) for problem in problems])


class _Hammerstein(Estimator[HammersteinOptions]):
    """Play operators in front of dynamics."""

    Options = HammersteinOptions
    suggested = True
    dynamic = False
    """Weights that follow the command's rate and level."""

    def fit(self, datasets: Sequence[Dataset], options: HammersteinOptions) -> Fit:
        check_records(datasets)
        if options.method == "paper":
            return paper_hampi.fit(datasets, self.name, options, dynamic=self.dynamic)
        axes = range(len(datasets[0].axes))
        problems = (axis_problem(datasets, axis, options, one_sided=options.one_sided, dynamic=self.dynamic) for axis in axes)
        return assemble(datasets, self.name, options.method, [fit_dynamic(problem, options.structure) for problem in problems])


@register
class Hammerstein(_Hammerstein):
    """Play operators of static weights in front of dynamics."""

    name = "hapi"
    sentence = (
        "Prandtl-Ishlinskii model in front of dynamics G(s): for given G(s) the output is linear in the weights, so the search is over "
        "G(s) alone (variable projection), whose factors are chosen on held-out stretches"
    )


@register
class RateDependent(Estimator[OperatorOptions]):
    """Play operators whose thresholds widen with the rate."""

    name = "rdpi"
    sentence = "rate-dependent Prandtl-Ishlinskii model: thresholds that widen with the command's rate by one factor, searched for"
    suggested = True
    Options = OperatorOptions

    def fit(self, datasets: Sequence[Dataset], options: OperatorOptions) -> Fit:
        check_records(datasets)
        problems = (axis_problem(datasets, axis, options) for axis in range(len(datasets[0].axes)))
        return assemble(datasets, self.name, options.method, [fit_rate_dependent(problem) for problem in problems])


@register
class ModifiedHammerstein(_Hammerstein):
    """Play operators of dynamic weights in front of dynamics."""

    name = "hampi"
    sentence = "as hapi, with weights that follow the command's rate and level (m1, m2, k, b)"
    dynamic = True
