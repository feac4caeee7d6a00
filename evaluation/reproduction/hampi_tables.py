# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The HAMPI paper's tables, and the figures' numbers, as rows beside the published values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from evaluation.reproduction.papers import HAMPI
from evaluation.reproduction.signals import add_deviation, fundamental, lag, loop_area
from hyst_control.base.arrays import Array, Complex
from hyst_control.chain.hysteresis.prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import LinearStage
from hyst_control.chain.stage import Sampling
from hyst_control.control.feedforward.inverse_dynamics import METHODS, invert_dynamics, sampled_systems
from hyst_control.control.linearization import sampled_response
from hyst_control.identify.assess.fit_report import residual
from hyst_control.identify.data.record_segmentation import select_stretches
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record
from hyst_control.reporting.tables import Table

GIVEN = HAMPI.published
SCORED_CYCLES = 4
"""Whole cycles of every held-out loop that count: its last ones."""
METHODS_TABLE = "HAMPI models: identified jointly and in the paper's sequence"


@dataclass(frozen=True)
class Place:
    """Rows begin…end of a record that are scored: loops of `height` (V of a drive, um of a reference) at `frequency` Hz."""

    height: float
    frequency: float
    begin: int
    end: int

    @property
    def rows(self) -> slice:
        """The rows as a slice."""
        return slice(self.begin, self.end)


def dynamics(model: Model) -> list[LinearStage]:
    """Select the linear stages of a model."""
    return [stage for stage in model.chain.stages if isinstance(stage, LinearStage)]


def response(model: Model, frequency: Annotated[Array, "F"]) -> Complex:
    """Compute the frequency response of a model's linear stages from held command to sample, with gain 1 at rest."""
    z = np.exp(2j * np.pi * frequency * model.sample_time)
    found = sampled_response(dynamics(model), 1, model.sample_time, np.append(z, 1.0 + 1e-9j))[:, 0, 0]
    scaled: Complex = found[:-1] / abs(found[-1])
    return scaled


def phase_lags(table: Table, model: Model, data: Record, places: Sequence[Place]) -> None:
    """Add Table 1: lags of G(s) and of the actuator relative to the lowest frequency, which removes the hysteresis' own.

    At that frequency itself both are 0 by definition and have no row.
    """
    frequencies = [place.frequency for place in places]
    driven = [(data.measurement[place.rows, 0], data.command[place.rows, 0], place.frequency) for place in places]
    lags: dict[str, Sequence[float]] = {
        "LTI model": list(-np.degrees(np.angle(response(model, np.array(frequencies))))),
        "actuator": [lag(*each, data.sample_time) for each in driven],
    }
    for index, frequency in list(enumerate(frequencies))[1:]:
        for (subject, own), published in zip(lags.items(), GIVEN["table_1"][frequency], strict=True):
            value = own[index] - own[0]
            table.add("HAMPI Table 1", f"{frequency:g} Hz", subject, "phase lag", "deg", value, published=published)


BEFORE = (0.001, 0.02)
"""s of rest before the step that belong to it: little, and all of the record's."""


def step_response(model: Model, data: Record, before: float = BEFORE[0]) -> tuple[Array, Array, Array]:
    """Compute the measured step and that of G(s), with the gain that fits best."""
    step = select_stretches([data], 0, "step")[0]
    rows = slice(max(step.begin - round(before / data.sample_time), 0), step.end)
    answer = simulate(model.with_stages(dynamics(model)), data.command[rows], data.sample_time, data.hold)[:, 0]
    measured = data.measurement[rows, 0]
    time = np.asarray(data.sample_time * np.arange(len(measured)), dtype=np.float64)
    return time, measured, answer * (answer @ measured) / (answer @ answer)


def step_fit(table: Table, model: Model, data: Record) -> None:
    """Add Fig. 2: the fit 100 (1 - |y - model| / |y - mean|) of the step of 10 V."""
    # The record begins at rest: what it scatters there no model can fit.
    begin = select_stretches([data], 0, "step")[0].begin
    noise = float(np.std(data.measurement[: begin - 1, 0]))
    for before in BEFORE:
        _, measured, answer = step_response(model, data, before)
        spread, left = float(measured.std()), float(np.sqrt(np.mean((measured - answer) ** 2)))
        case = f"step of 10 V, from {1e3 * before:g} ms before it"
        table.add("HAMPI Fig. 2", case, "LTI model", "fit", "%", 100.0 * (1.0 - left / spread), published=GIVEN["figure_2"])
        table.add("HAMPI Fig. 2", case, "noise at rest alone", "fit", "%", 100.0 * (1.0 - noise / spread))


def bode(table: Table, model: Model) -> None:
    """Add Fig. 3: "in the range of 1 to 500 Hz the amplitude first decreases and then increases, the phase continues to decrease" (§2)."""
    frequency = np.geomspace(1.0, 500.0, 400)
    value = response(model, frequency)
    gain, phase = 20 * np.log10(np.abs(value)), np.degrees(np.unwrap(np.angle(value)))
    case = "1 to 500 Hz"
    table.add("HAMPI Fig. 3", case, "LTI model", "fall of the gain from 1 Hz to its least", "dB", gain[0] - gain.min())
    table.add("HAMPI Fig. 3", case, "LTI model", "rise of the gain from its least to 500 Hz", "dB", gain[-1] - gain.min())
    # Without the slow pair, whose lag comes and goes below 10 Hz in Eq. 1 too.
    rise = max(np.diff(phase[frequency >= 10.0]).max(), 0.0)
    table.add("HAMPI Fig. 3", "10 to 500 Hz", "LTI model", "largest rise of the phase", "deg", rise)


def dynamic_weights(table: Table, model: Model) -> None:
    """Add Table 2 and §3.2: m1, m2, k and b of step 3.

    The published values belong to the paper's actuator and units; their signs do not.
    """
    core = next(stage for stage in model.chain.stages if isinstance(stage, ModifiedPrandtlIshlinskii))
    for name, unit in (("m1", "s/V"), ("m2", "s/V"), ("k", "1/V"), ("b", "")):
        value, published = float(np.ravel(getattr(core, name))[0]), GIVEN["table_2"][name]
        table.add("HAMPI Table 2", "dynamic weights", "HAMPI, paper's sequence", name, unit, value, published=published)


def rotation(table: Table, models: Mapping[str, Model], data: Record, places: Sequence[Place]) -> None:
    """Add Figs. 1 and 6: rotation and widening of the highest loops with the rate, measured and simulated.

    Tilt (the part of the motion in phase with the drive) and stroke are relative to the slowest loops, area is relative to the loop's box.
    """
    own = [place for place in places if place.height == max(place.height for place in places)]
    series = {"actuator": data.measurement[:, 0]}
    series |= {name: simulate(model, data.command, data.sample_time, data.hold)[:, 0] for name, model in models.items()}
    for name, values in series.items():
        title = "HAMPI Fig. 1" if name == "actuator" else "HAMPI Fig. 6"
        for place in own:
            u, y = data.command[place.rows, 0], values[place.rows]
            case = f"{place.height:g} V, {place.frequency:g} Hz"
            stroke = float(np.ptp(y) / np.ptp(values[own[0].rows]))
            tilt = in_phase(u, y) / in_phase(data.command[own[0].rows, 0], values[own[0].rows])
            table.add(title, case, name, "tilt over that of the slowest loops", "", tilt)
            table.add(title, case, name, "stroke over that of the slowest loops", "", stroke)
            table.add(title, case, name, "loop area over its box", "%", loop_area(u, y, SCORED_CYCLES))


def in_phase(command: Annotated[Array, "N"], measurement: Annotated[Array, "N"]) -> float:
    """Slope of the line that fits a loop best: its tilt."""
    moving = command - command.mean()
    return float(moving @ measurement / (moving @ moving))


def compensated(model: Model, sample_time: float, frequency: Annotated[Array, "F"]) -> dict[str, Complex]:
    """Compute Fig. 8: inverse times G(s), without the preview, by inversion method."""
    z = np.exp(2j * np.pi * frequency * sample_time)
    sampling = Sampling(sample_time, 1, "zoh")
    plant = sampled_systems(dynamics(model), sampling)[0].response(z)
    found = {}
    for method in METHODS:
        inverse = invert_dynamics(dynamics(model), sampling, method)
        found[method] = inverse.systems[0].response(z) * z**inverse.preview * plant
    return found


def inverses(table: Table, model: Model, sample_time: float) -> None:
    """Add Fig. 8: the largest deviations of the compensated dynamics' gain and phase from 1 between 10 and 500 Hz."""
    for method, value in compensated(model, sample_time, np.linspace(10.0, 500.0, 200)).items():
        add_deviation(table, "HAMPI Fig. 8", "10 to 500 Hz", method, value)


def errors(model: Model, data: Record, places: Sequence[Place]) -> list[tuple[float, float, float]]:
    """Compute a model's errors on every scored stretch (paper Eq. 25 and 26)."""
    error = residual(model, data)[:, 0]
    found = []
    for place in places:
        rmse, span = float(np.sqrt(np.mean(error[place.rows] ** 2))), float(np.ptp(data.measurement[place.rows, 0]))
        found.append((rmse, 100.0 * rmse / span, 100.0 * float(np.std(error[place.rows])) / span))
    return found


def predictions(table: Table, models: Mapping[str, Model], data: Record, places: Sequence[Place], where: str | None = None) -> None:
    """Add Table 4 and Figs. 11, 12: errors on held-out loops; the paper gives figures for 140 V alone."""
    for name, model in models.items():
        for place, (rmse, nrmse, _) in zip(places, errors(model, data, places), strict=True):
            title = where or {50.0: "HAMPI Fig. 11", 100.0: "HAMPI Fig. 12"}.get(place.height, "HAMPI Table 4")
            case, rows = f"{place.height:g} V, {place.frequency:g} Hz", place.end - place.begin
            for quantity, unit, value, known in (("nrmse", "%", nrmse, "table_4"), ("rmse", data.unit, rmse, "table_4_rmse")):
                at = GIVEN["frequencies"].index(place.frequency) if title == "HAMPI Table 4" else None
                published = None if at is None else GIVEN[known][name][at]
                table.add(title, case, name, quantity, unit, value, published=published, n=rows)


def methods(table: Table, joint: Mapping[str, Model], sequence: Mapping[str, Model], data: Record, places: Sequence[Place]) -> None:
    """Add the joint identification beside the paper's sequence, on the same held-out loops."""
    for name in (name for name in sequence if name in joint and name != "RDPI"):
        model = sequence[name]
        for place, ours, theirs in zip(places, errors(joint[name], data, places), errors(model, data, places), strict=True):
            case = f"{place.height:g} V, {place.frequency:g} Hz"
            table.add(METHODS_TABLE, case, f"{name}, joint", "nrmse", "%", ours[1])
            table.add(METHODS_TABLE, case, f"{name}, paper's sequence", "nrmse", "%", theirs[1])


def pooled(
    table: Table, compared: Sequence[tuple[Mapping[str, Model], Mapping[str, Model], Sequence[Place]]], data: Record
) -> None:
    """Add joint identification and the paper's sequence over all held-out loops together: rms of the NRMSE.

    The mean of a loop moves with its rate and with the drive's past height, which neither HAPI nor HAMPI can express. The errors with
    means removed therefore compare the loops' shape, which both models describe.
    """
    for name in ("HAPI", "HAMPI"):
        for subject in ("joint", "paper's sequence"):
            found = []
            for joint, sequence, places in compared:
                if places:
                    found += errors((joint if subject == "joint" else sequence)[name], data, places)
            together = np.sqrt(np.mean(np.array(found) ** 2, axis=0))
            for quantity, value in (("nrmse", together[1]), ("nrmse, means removed", together[2])):
                what = f"{quantity}, rms over loops"
                table.add(METHODS_TABLE, "all held-out loops", f"{name}, {subject}", what, "%", float(value), n=len(found))


def attenuation(table: Table, tracked: Mapping[str, Mapping[str, Array]], places: Sequence[Place], sample_time: float) -> None:
    """Add Figs. 15 and 16: amplitude of the tracked sine relative to the reference; uncompensated rotation reduces it."""
    for name, signals in tracked.items():
        for place in places:
            tracked_rows, reference = (signals[key][place.rows, 0] for key in ("measurement", "reference"))
            gain = abs(fundamental(tracked_rows, reference, place.frequency, sample_time))
            table.add("HAMPI Fig. 15", f"{place.frequency:g} Hz", name, "amplitude over the reference's", "", gain)


def tracking(
    table: Table, tracked: Mapping[str, Mapping[str, Array]], places: Sequence[Place], stroke: float, title: str = "HAMPI Table 5"
) -> None:
    """Add Table 5: open-loop tracking errors, means kept; the published values are of the paper's own sequence."""
    for name, signals in tracked.items():
        error = (signals["measurement"] - signals["reference"])[:, 0]
        published = GIVEN["table_5"][name.split(",")[0]]
        for place in places:
            rmse = float(np.sqrt(np.mean(error[place.rows] ** 2)))
            case = f"{place.frequency:g} Hz"
            table.add(title, case, name, "nrmse", "%", 100.0 * rmse / stroke, published=published[place.frequency][1])
            table.add(title, case, name, "rmse", "um", rmse, published=published[place.frequency][0])
