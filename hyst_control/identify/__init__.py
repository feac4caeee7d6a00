# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identification: models from records. `identify` is the one entry the command line, the node and scripts use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from hyst_control.base import progress
from hyst_control.base.errors import InputError
from hyst_control.identify.assess.fit_report import error_rows, residual, residual_energy, residual_from, with_state
from hyst_control.identify.assess.free_motion import ending_dynamics
from hyst_control.identify.data.fit import Fit, check_records
from hyst_control.identify.data.initial_memory import beginning_rows, begins_at_rest, with_beginning
from hyst_control.identify.families.estimator import Estimator, estimator_of, estimators, register
from hyst_control.identify.families.options import Options, option
from hyst_control.model_file import Model
from hyst_control.records.record import Beginning, Record

LEAST = 32  # Samples from which on the beginning and the drift of a record are looked for
REFITS, GAIN = 4, 0.9
"""Most repetitions of a fit to records that begin amid a motion, and the share of the energy that each leaves at most."""
LINEAR_ROWS = 2**14  # First rows of each record to which a linear model is fitted
LITTLE = 0.3  # Error (% of range) above which a linear model of any order looks for a motion from before


def identify(records: Sequence[Record], family: str, method: str = "joint", **options: object) -> Fit:
    """Identify a model of a family.

    Parameters
    ----------
    records
        Records of one plant without gaps, as `Record.aligned` makes them.
    family
        Name of the model family, one of `estimators()`.
    method
        "joint": from all records at once; "paper", where the family has it: in its paper's sequence.
    **options
        The family's options, as values or texts: `estimator_of(family).declared`.

    Returns
    -------
    Fit
        Model and report.

    Raises
    ------
    InputError
        The family, the method or an option is unknown, or the records do not determine the model.
    """
    estimator = estimator_of(family)
    chosen = estimator.options(method=method, **options)
    progress.step(f"identify {family} ({method}) from {sum(len(data.command) for data in records)} samples")
    try:
        check_records(records, least=LEAST)
    except InputError:
        return estimator.fit(records, chosen)  # which says what it asks of records
    begun = [with_beginning(data) for data in records]
    found = estimator.fit(begun, chosen)
    return found if estimator.frees_states else _fitted_amid_motion(estimator, begun, chosen, found)


def _fitted_amid_motion(estimator: Estimator[Any], records: Sequence[Record], options: Any, found: Fit) -> Fit:
    """The fit, repeated without the motion that goes on from before the records, as long as this leaves clearly less."""
    first = records[0]
    dynamics = ending_dynamics(found.model, first.sample_time, first.hold)
    if dynamics is None:
        return found
    begun = [with_state(found.model, data) for data in records]
    moving = any(map(_is_moving, begun))
    if len(first.axes) > 1 or all(map(begins_at_rest, begun)):
        return _without_motion(estimator, records, options, found, found.model)
    # A linear model, whose fit knows of the motion, is not led astray by it. Mostly its order is the one that the fit has found.
    early = [data.rows(0, LINEAR_ROWS) for data in records]
    if moving:
        source = identify(early, "linear", order=dynamics.a.shape[1]).model
        found = _without_motion(estimator, records, options, found, source)
    if max(row["nrmse_own_zero"] for row in found.report["records"]) > LITTLE:
        found = _without_motion(estimator, records, options, found, identify(early, "linear").model)
    return found


def _without_motion(estimator: Estimator[Any], records: Sequence[Record], options: Any, found: Fit, source: Model) -> Fit:
    """The fit, repeated without the motion that a model sees at first, as long as this leaves clearly less."""
    begun = [with_state(source, data) for data in records]
    if not any(map(_is_moving, begun)):
        return found
    least = residual_energy([residual(found.model, data) for data in records])
    for _ in range(REFITS):
        again = estimator.fit([_still(source, data) for data in begun], options)
        known = [with_state(again.model, data) for data in records]
        residuals = [residual_from(again.model, data) for data in known]
        if residual_energy(residuals) > GAIN * least:
            break
        report: Any = {**again.report, "records": error_rows(records, residuals), "beginnings": beginning_rows(known)}
        found, begun, least, source = Fit(again.model, report, tuple(residuals)), known, residual_energy(residuals), again.model
    return found


def _is_moving(data: Record) -> bool:
    return isinstance(data.start, Beginning) and data.start.moving


def _still(model: Model, data: Record) -> Record:
    """A record whose measurement is without the motion from before, as a model has it; the beginning is that of its memory."""
    if not (isinstance(data.start, Beginning) and data.start.moving):
        return data
    plain = replace(data, start=replace(data.start, moving=False))
    moved, still = residual_from(model, plain), residual_from(model, data)
    measurement = data.measurement.copy()
    measurement[len(measurement) - len(still) :] -= moved - still
    return plain.with_values(measurement=measurement)


__all__ = ["Estimator", "Fit", "Options", "estimator_of", "estimators", "identify", "option", "register"]
