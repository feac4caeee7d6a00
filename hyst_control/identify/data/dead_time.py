# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Delays of many samples: taken out of the records before a fit, which finds only what is near its start, and put into the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import Delay, LinearStage
from hyst_control.identify.data.fit import Fit, ParameterRow
from hyst_control.records.record import Record
from hyst_control.records.validity.findings import Finding

LEFT, LEFT_SHARE = 5, 0.03  # samples, and share, of a found delay that are left to the fit: a resonance makes it look longer


def lateness(remarks: Sequence[Finding], records: Sequence[Record]) -> int:
    """Samples by which the measurement of every record and axis is late, less what the fit finds itself; 0 where one is not."""
    found = {(each.record, each.axis): each.value for each in remarks if each.name == "late_measurement"}
    moving = [(data.name, name) for data in records for name, span in zip(data.axes, np.ptp(data.command, axis=0)) if span > 0]
    if not moving or not all(each in found for each in moving):
        return 0
    samples = round(min(found[each] for each in moving) / records[0].sample_time)
    return max(int(samples - max(LEFT, LEFT_SHARE * samples)), 0)


def taken_earlier(data: Record, samples: int) -> Record:
    """A record whose measurement is taken earlier by some samples."""
    if samples == 0:
        return data
    return data.rows(0, len(data) - samples).with_values(measurement=data.measurement[samples:])


def with_delay(fit: Fit, seconds: float) -> Fit:
    """A fit whose model is later by some time."""
    if seconds == 0.0:
        return fit
    chain = list(fit.model.chain.stages)
    at = next((index for index, stage in enumerate(chain) if isinstance(stage, Delay)), None)
    if at is None:
        at = next((index for index, stage in enumerate(chain) if isinstance(stage, LinearStage)), len(chain))
        chain.insert(at, Delay(seconds))
    else:
        own = chain[at]
        assert isinstance(own, Delay)
        chain[at] = replace(own, tau=np.asarray(own.tau) + seconds)
    rows = list(fit.report["parameters"])
    own_rows = [index for index, row in enumerate(rows) if row["unit"] == "s" and row["name"].split("[")[0] in ("tau", "delay")]
    for index in own_rows:
        rows[index] = {**rows[index], "value": rows[index]["value"] + seconds}
    added = [ParameterRow(name="tau", value=seconds, standard_error=None, unit="s", axis=name) for name in fit.model.axes]
    report: Any = {**fit.report, "parameters": rows if own_rows else [*rows, *added]}
    return replace(fit, model=replace(fit.model, chain=Chain(tuple(chain))), report=report)
