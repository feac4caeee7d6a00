# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Model and report of a fit, the same for every family: simulated once, scored, with its noise, uncertainty and notes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hyst_control.chain import Chain, Stage
from hyst_control.identify.assess.fit_report import command_bandwidth, error_rows, noise_sigma, with_offset
from hyst_control.identify.assess.fit_report import residual as residual_of
from hyst_control.identify.data.dataset import Dataset, Fit, ParameterRow, Report
from hyst_control.identify.solve.parameter_covariance import Uncertainty
from hyst_control.model_file import Model


def chain_model(datasets: Sequence[Dataset], stages: Sequence[Stage], name: str) -> Model:
    """The model of a chain, valid where the records are."""
    first = datasets[0]
    return Model(
        name=name,
        axes=tuple(first.axes),
        units={"command": "V", "measurement": first.unit},
        sample_time=first.sample_time,
        hold=first.hold,
        chain=Chain(tuple(stages)),
        valid={
            "command": [min(float(data.command.min()) for data in datasets), max(float(data.command.max()) for data in datasets)],
            "frequency": [0.0, max(command_bandwidth(data) for data in datasets)],
        },
    )


def assembled(
    datasets: Sequence[Dataset],
    model: Model,
    known: Uncertainty,
    parameters: Sequence[ParameterRow],
    notes: Sequence[str],
    *,
    family: str,
    method: str,
    held_out: Sequence[float] = (),
    tolerance: Mapping[str, float] | None = None,
    offset: float | None = None,
    by_axis: bool = False,
    more: Mapping[str, Any] | None = None,
) -> Fit:
    """Fit of a chain whose parameters are known.

    held_out: mean square error on held-out rows by axis; tolerance: other than that of `known`; offset: share of the range from which a
    common offset becomes the last stage (None: it is one already); by_axis: the noise is a list even of one axis; more: further entries
    of the report.
    """
    if offset is not None:
        model, residuals = with_offset(model, datasets, offset)
    else:
        residuals = [residual_of(model, data) for data in datasets]
    sigma = noise_sigma(residuals, datasets)
    model = replace(
        model,
        tolerance=dict(known.tolerance if tolerance is None else tolerance),
        uncertainty=known.document,
        noise={"sigma": sigma if len(sigma) > 1 or by_axis else sigma[0]},
    )
    report: Report = {
        "family": family,
        "method": method,
        "unit": datasets[0].unit,
        "records": error_rows(datasets, residuals),
        "parameters": list(parameters),
        "notes": [*notes, *known.notes(f"the commands' power ends at {model.valid['frequency'][1]:.3g} Hz")],
    }
    if held_out:
        travel = [max(float(data.range[axis]) for data in datasets) for axis in range(len(held_out))]
        report["held_out_nrmse"] = [100.0 * float(np.sqrt(each)) / span for each, span in zip(held_out, travel, strict=True)]
    return Fit(model, {**report, **(more or {})}, tuple(residuals))  # type: ignore[typeddict-item]
