# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The family "linear": stable linear dynamics with a sub-sample delay, from records of any excitation.

Vector fitting finds poles for every number of states without a guess, the simulation error from the command is minimized from there
(`simulation_error`; offset, drift and initial state of every record are estimated along), and the smallest model that is as good as any
on held-out rows is taken. Axes that drive each other are fitted to their spectra (`coupled_linear`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.identify.assess.assembly import AxisFit, fit_of
from hyst_control.identify.assess.fit_report import MOVING, residual_energy
from hyst_control.identify.data.fit import Fit, Number, OrderRow, ParameterRow, check_records
from hyst_control.identify.data.fit_windows import as_window
from hyst_control.identify.data.initial_memory import begins_at_rest
from hyst_control.identify.families.estimator import Estimator, register
from hyst_control.identify.modal import coupled_linear
from hyst_control.identify.modal.linear_candidate import Candidate
from hyst_control.identify.modal.linear_options import LinearOptions
from hyst_control.identify.modal.linear_search import search
from hyst_control.records.record import Record

UNSURE = 0.1  # Relative standard deviation of the static gain from which a note says it


@register
class Linear(Estimator[LinearOptions]):
    """Stable linear dynamics with a delay."""

    name = "linear"
    sentence = (
        "stable linear dynamics with a sub-sample delay, on the simulation error from the command, from vector fitting of every order; the "
        "number of states is chosen on held-out data; one axis or several"
    )
    frees_states = True
    Options = LinearOptions

    def is_promising(self, axes: int, linear: bool) -> bool:
        return linear or axes > 1  # which may drive each other

    def fit(self, records: Sequence[Record], options: LinearOptions) -> Fit:
        first = checked(records)
        if len(first.axes) > 1 and options.coupled is not False:
            return coupled_linear.fit(records, options)
        still = all(map(begins_at_rest, records))
        found = _fitted(records, options, still=still)
        if still and any(row["assumed"] == MOVING for row in found.report["beginnings"]):
            # A hysteresis that a linear model lacks resembles such a motion: what is left in the end decides.
            found = min(found, _fitted(records, options, still=False), key=lambda fit: residual_energy(fit.residuals))
        return found


def _fitted(records: Sequence[Record], options: LinearOptions, *, still: bool) -> Fit:
    """Every axis fitted by itself; still: the records begin at rest."""
    first = records[0]
    axes = len(first.axes)
    fits: list[AxisFit] = []
    table: list[OrderRow] = []
    states = 0
    for axis, name in enumerate(first.axes):
        windows = [as_window(data, axis, number) for number, data in enumerate(records)]
        candidate, rows = search(windows, options, still=still)
        fits.append(_axis_fit(candidate, name, first.unit, f"[{name}]" if axes > 1 else ""))
        table += [{**row, "axis": name} if axes > 1 else row for row in rows]
        states += candidate.sections.order
    more = {"orders": table, "states": states}
    return fit_of(records, fits, Linear.name, options.method, offset=0.0, by_axis=True, more=more)


def _axis_fit(candidate: Candidate, axis: str, unit: str, suffix: str) -> AxisFit:
    """The fit of one axis: frequency and damping of every pole, the delay and, last, the static gain."""
    sections, solution = candidate.sections, candidate.solution

    def numbers(vector: Array) -> list[Number]:
        found: list[Number] = []
        poles = np.concatenate([np.zeros(0), *(np.roots(den) for _, den in sections.terms(vector))])
        for i, pole in enumerate(sorted((pole for pole in poles if pole.imag >= 0), key=abs)):
            found.append(Number(f"frequency[{i}]{suffix}", float(abs(pole)) / (2 * np.pi), "Hz"))
            if pole.imag:
                found.append(Number(f"damping[{i}]{suffix}", float(-pole.real / abs(pole))))
        if sections.tau(vector) > 0.0 and sections.delay:
            found.append(Number(f"delay[0]{suffix}", sections.tau(vector), "s"))
        return [*found, Number(f"static_gain{suffix}", sections.static_gain(vector), f"{unit}/V")]

    def notes(rows: Sequence[ParameterRow]) -> list[str]:
        gain = rows[-1]
        share = abs((gain["standard_error"] or 0.0) / gain["value"]) if gain["value"] else np.inf
        if share <= UNSURE:
            return []
        doubt = f"± {100 * share:.0f} %" if share < 1.0 else "no better than its size"
        return [
            f"axis {axis}: static gain known to {doubt}: the record is too short for its slowest motion: hold the command longer"
        ]

    return AxisFit(sections.stages, solution.parameters, solution.covariance, numbers, candidate.search_error, notes=notes)


def checked(records: Sequence[Record]) -> Record:
    """The first record, if all agree in axes, unit, hold and sample time, and move on every axis; else an `InputError`."""
    for data in records:
        first = records[0]
        if data.hold != first.hold:
            raise InputError(
                f"{data.name}: hold {data.hold}, but {first.name} has {first.hold}: give a linear fit records of one hold"
            )
        if abs(data.sample_time - first.sample_time) > 1e-9 * first.sample_time:
            raise InputError(
                f"{data.name}: sample time {data.sample_time:g} s, but {first.name} has {first.sample_time:g} s: "
                "give a linear fit records of one sample time"
            )
    check_records(records, 32)
    return records[0]
