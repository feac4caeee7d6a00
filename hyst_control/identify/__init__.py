# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identification: models from records. `identify` is the one entry the command line, the node and scripts use."""

from __future__ import annotations

from collections.abc import Sequence

from hyst_control.base import progress
from hyst_control.base.errors import InputError
from hyst_control.identify.data.fit import Fit, check_records
from hyst_control.identify.data.initial_memory import with_beginning
from hyst_control.identify.families.estimator import Estimator, estimator_of, estimators, register
from hyst_control.identify.families.options import Options, option
from hyst_control.records.record import Record

LEAST = 32
"""Samples from which on the beginning and the drift of a record are looked for."""


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
    return estimator.fit([with_beginning(data) for data in records], chosen)


__all__ = ["Estimator", "Fit", "Options", "estimator_of", "estimators", "identify", "option", "register"]
