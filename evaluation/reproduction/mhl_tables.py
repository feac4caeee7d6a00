# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The MHL paper's tables, and the figures' numbers, as rows beside the published values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, cast

import numpy as np

from evaluation.reproduction.mhl_runs import Part
from evaluation.reproduction.papers import MHL
from evaluation.reproduction.signals import add_deviation, fundamental, lag, loop_area
from hyst_control.base.arrays import Array, Complex
from hyst_control.chain.chain import Parallel
from hyst_control.chain.linear.linear_stages import RateCorrection
from hyst_control.identify.data.fit import Fit
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record
from hyst_control.reporting.tables import Table

GIVEN = MHL.published
TRADITIONAL = "traditional composite"
PUBLISHED = "proposed composite, N as published"
MOVED = "proposed composite, N at 1 kHz"
WITHOUT = "proposed composite, without N"
AHEAD = "proposed composite, N without phase"
SLOWER = "proposed composite, k2' as published, without N"
PLAIN = ", PI without roll-off"
"""Ending of the names of what runs with the paper's PI."""
OWN_LOOP = PUBLISHED + PLAIN
"""The composite to which the published figures belong."""
COMPOSITES = (PUBLISHED, MOVED, WITHOUT, AHEAD, SLOWER, "whole inverse", OWN_LOOP)


def rival_of(name: str) -> str:
    """The traditional composite with the same feedback as the composite `name`."""
    return TRADITIONAL + PLAIN if name.endswith(PLAIN) else TRADITIONAL


def against_traditional(name: str) -> str:
    """Subject of the rows that compare the composite `name` with the traditional one."""
    return f"{name} against the traditional one"


def errors(wanted: Annotated[Array, "N"], actual: Annotated[Array, "N"]) -> tuple[float, ...]:
    """Compute NME and NRMSE in % of the wanted range (paper Eq. 10, 11), and the NRMSE with the means removed."""
    error, span = actual - wanted, float(np.ptp(wanted))
    return tuple(100.0 * float(value) / span for value in (np.abs(error).max(), np.sqrt(np.mean(error**2)), error.std()))


def parallel_of(model: Model) -> Parallel:
    """The first parallel stage of a model."""
    return next(stage for stage in model.chain.stages if isinstance(stage, Parallel))


def rate_correction_of(inverse: Model) -> RateCorrection:
    """Ψ' of an inverse: the first stage of its parallel stage's second branch."""
    correction = parallel_of(inverse).branches[1][0]
    assert isinstance(correction, RateCorrection), f"{correction.name} is no rate correction"
    return correction


def parameters(table: Table, fit: Fit, inverse: Model) -> None:
    """Add Tables 1 and 2 and Fig. 5, with the curves normalized to end at 1; the published values are of another mirror."""
    core = parallel_of(fit.model).branches[0][0]
    inverted = parallel_of(inverse)
    curves, correction = inverted.branches[0][0], rate_correction_of(inverse)
    k1, b1, k2 = (cast(Sequence[float], value) for value in (correction.k1, correction.b1, correction.k2))  # per axis
    for index, axis in enumerate(fit.model.axes):
        rows = {row["name"]: row["value"] for row in fit.report["parameters"] if row["axis"] == axis}
        for branch, published in GIVEN["table_1"].items():
            curve, kind = branch.split()
            own = np.array(getattr(core if kind == "model" else curves, curve)[index], dtype=float)
            normalized, subject = (own / own.sum(), np.array(published) / sum(published)), f"{kind}, axis {axis}"
            for power, value, theirs in zip(range(5, 0, -1), *normalized, strict=True):
                table.add("MHL Table 1", f"{curve}, power {power}", subject, "coefficient", "", value, published=theirs)
            ends = [np.polyval([*curve_of, 0.0], np.linspace(0.0, 1.0, 201)) for curve_of in normalized]
            farthest = 100 * abs(ends[0] - ends[1]).max()
            table.add("MHL Table 1", curve, subject, "farthest from the published curve", "%", farthest)
        full, name = float(rows["output_scale"]), f"axis {axis}"
        for subject, key, unit, value in (
            ("model", "k1", "s", rows["k1"] * RATING_OVER / full),
            ("model", "b1", "", rows["b1"] / full),
            ("model", "k2", "s", rows["k2"]),
            ("inverse", "k1'", "s", k1[index] * full / RATING_OVER),
            ("inverse", "b1'", "", b1[index] / RATING_OVER),
            ("inverse", "k2'", "s", k2[index]),
        ):
            table.add("MHL Table 2", name, subject, key, unit, value, published=GIVEN["table_2"][key])
        delay = fit.report["steps"][index]["delay"]["tau"]
        table.add("MHL Fig. 5", name, "model", "delay", "us", 1e6 * delay, published=68.0)


RATING_OVER = 100.0
"""V, at which the paper's input is 1."""


def widening(table: Table, data: Record) -> None:
    """Add Fig. 1b: area of the measured loop relative to its box, for the first full slow loop and for the sweep's last at 100 Hz."""
    for index, axis in enumerate(data.axes):
        command, measurement = data.command[:, index], data.measurement[:, index]
        top = np.flatnonzero(command >= 0.999 * command.max())
        # The sweep's last whole cycle is the shortest between two tops.
        turns = top[np.flatnonzero(np.diff(top, prepend=-10) > 1)]
        last = turns[-2:]
        slow = int(round(1.0 / data.sample_time))
        for case, rows in (("1 Hz", slice(top[0], top[0] + slow)), ("100 Hz", slice(last[0], last[1]))):
            u, y = command[rows], measurement[rows]
            table.add("MHL Fig. 1", case, f"mirror, axis {axis}", "loop area over its box", "%", loop_area(u, y))


def predictions(
    table: Table, models: Mapping[str, Model], static: tuple[Record, list[slice]], multi: tuple[Record, list[slice]]
) -> None:
    """Add Figs. 9 and 11: prediction errors on held-out records, after the drive has been at the top of the major loop."""
    for title, (data, scored), published in (("MHL Fig. 9", static, (0.96, 0.25)), ("MHL Fig. 11", multi, (2.66, 0.85))):
        for method, model in models.items():
            predicted = simulate(model, data.command, data.sample_time)
            for index, axis in enumerate(model.axes):
                found = errors(data.measurement[scored[index], index], predicted[scored[index], index])
                add_errors(table, title, f"axis {axis}", f"MHL, {method}", found, published)


def fast(table: Table, model: Model, data: Record, places: Sequence[tuple[float, slice, slice]]) -> None:
    """Add Table 3: errors on sines of 10 V about mid-drive."""
    predicted = simulate(model, data.command, data.sample_time)
    for frequency, *scored in places:
        for index, (axis, rows) in enumerate(zip(model.axes, scored, strict=True)):
            found = errors(data.measurement[rows, index], predicted[rows, index])
            add_errors(table, "MHL Table 3", f"{frequency:g} Hz, axis {axis}", "MHL, paper", found, GIVEN["table_3"][frequency])


def open_loop(table: Table, model: Model, data: Record) -> None:
    """Add Fig. 10: the model's response relative to the measured one, 60 to 3500 Hz (the sweep's ends are windowed away).

    The relative error of the response, rms over the frequencies. Beside it stands the largest NRMSE of Table 3. Over a sine, that is an
    error relative to twice the amplitude; times 2 √2 it is a relative error of the response.
    """
    for index, axis in enumerate(model.axes):
        frequency, measured, modelled = open_loop_responses(model, data, index)
        inside = (frequency > 60.0) & (frequency < 3500.0)
        ratio = (modelled / measured)[inside]
        theirs = 2.0 * np.sqrt(2.0) * max(nrmse for _, nrmse in GIVEN["table_3"].values())
        case = f"60 to 3500 Hz, axis {axis}"
        off, what = 100 * np.sqrt(np.mean(np.abs(ratio - 1) ** 2)), "relative error of the response, rms"
        table.add("MHL Fig. 10", case, "MHL, paper", what, "%", off, published=theirs)
        add_deviation(table, "MHL Fig. 10", case, "MHL, paper", ratio)


def add_errors(
    table: Table, title: str, case: str, subject: str, found: Sequence[float], published: tuple[float, float] | None
) -> None:
    """Add NME, NRMSE, and the NRMSE with the means removed."""
    for quantity, value, known in zip(("nme", "nrmse", "nrmse, means removed"), found, (*(published or (None, None)), None)):
        table.add(title, case, subject, quantity, "%", value, published=known)


def tracking(table: Table, tracked: Mapping[str, Mapping[str, Array]], parts: Mapping[str, Part]) -> None:
    """Add Table 4, the reductions of §4.4, and the spiral of Fig. 17."""
    for case, published in GIVEN["table_4"].items():
        found = {}
        for name, signals in tracked.items():
            found[name] = errors(*parts[case].tracked(signals))
            theirs = published["proposed composite"] if name in COMPOSITES else published.get(name.removesuffix(PLAIN))
            add_errors(table, "MHL Table 4", case, name, found[name], theirs)
        for name in COMPOSITES:
            for quantity, at, published_lower in (("nme", 0, GIVEN["nme_lower"]), ("nrmse", 1, GIVEN["lower"])):
                lower = 100.0 * (1.0 - found[name][at] / found[rival_of(name)][at])
                known = published_lower[case] if name.startswith("proposed") else None
                table.add("MHL Table 4", case, against_traditional(name), f"{quantity} lower by", "%", lower, published=known)
    for name, signals in tracked.items():
        for index, axis in enumerate("xy"):
            add_errors(table, "MHL Fig. 17", f"spiral, axis {axis}", name, errors(*parts["spiral"].tracked(signals, index)), None)


def feedback_effort(table: Table, tracked: Mapping[str, Mapping[str, Array]], parts: Mapping[str, Part]) -> None:
    """Add the rms of the PI feedback's output, axis x, mean removed (paper §3: 40 % less with the proposed composite)."""
    for case in GIVEN["table_4"]:
        rows = slice(parts[case].scored, parts[case].end)
        effort = {name: float(np.std(signals["feedback"][rows, 0])) for name, signals in tracked.items()}
        for name in (TRADITIONAL, TRADITIONAL + PLAIN, *COMPOSITES):
            table.add("MHL feedback", case, name, "output of the PI feedback, rms", "V", effort[name])
        for name in COMPOSITES:
            subject, lower = against_traditional(name), 100.0 * (1.0 - effort[name] / effort[rival_of(name)])
            known = GIVEN["pi_lower"] if name.startswith("proposed") else None
            table.add("MHL feedback", case, subject, "output of the PI feedback lower by", "%", lower, published=known)


def phases(table: Table, data: Record, scored: Sequence[slice], inverse: Model, rate_filter: Sequence[float]) -> None:
    """Add the lags of §4.4 at 100 Hz: of the mirror under the drive of Fig. 11, of the identified Ψ', and of N(s)."""
    # data: record under the drive of Fig. 11
    k2 = cast(Sequence[float], rate_correction_of(inverse).k2)  # per axis
    s = 2j * np.pi * 100.0
    for index, axis in enumerate(data.axes):
        rows = slice(scored[index].stop - int(round(0.4 / data.sample_time)), scored[index].stop)
        late = lag(data.measurement[rows, index], data.command[rows, index], 100.0, data.sample_time)
        lead = np.degrees(np.angle(s / (k2[index] * s + 1.0)))
        table.add("MHL lags", f"100 Hz, axis {axis}", "mirror", "open loop", "deg", late, published=GIVEN["lags"]["open loop"])
        table.add("MHL lags", f"100 Hz, axis {axis}", "inverse", "lead of Ψ'", "deg", lead, published=GIVEN["lags"]["lead of Ψ'"])
    late = -np.degrees(np.angle(1.0 / np.polyval(np.asarray(rate_filter, dtype=float), s)))
    table.add("MHL lags", "100 Hz", "N(s) as published", "lag of N(s)", "deg", late, published=GIVEN["lags"]["lag of N(s)"])


def closed_loop(table: Table, tracked: Mapping[str, Mapping[str, Array]], parts: Mapping[str, Part], sample_time: float) -> None:
    """Add Fig. 18: bandwidth, peak, gain and phase at 100 Hz, settling time."""
    for name, signals in tracked.items():
        frequency, value = response(signals, parts["response"], sample_time)
        reference, measurement = parts["single"].tracked(signals)
        at = fundamental(measurement, reference, 100.0, sample_time)
        for case, quantity, unit, found, published in (
            ("closed loop", "bandwidth", "Hz", bandwidth(frequency, value), 1500.0),
            ("closed loop", "peak", "dB", 20 * np.log10(np.abs(value).max()), 5.22 if name in (WITHOUT, SLOWER) else 2.94),
            ("100 Hz", "gain", "dB", 20 * np.log10(abs(at)), 0.2),
            ("100 Hz", "lag", "deg", -np.degrees(np.angle(at)), 0.69),
            ("step", "settling_time", "ms", 1e3 * settling_time(signals, parts["step"], sample_time), 2.0),
        ):
            known = published if name in COMPOSITES else None
            table.add("MHL Fig. 18", case, name, quantity, unit, found, published=known)
        for case in (case for case in parts if case.startswith("step of")):
            table.add("MHL Fig. 18", case, name, "settling_time", "ms", 1e3 * settling_time(signals, parts[case], sample_time))


def open_loop_responses(model: Model, data: Record, axis: int) -> tuple[Array, Complex, Complex]:
    """Compute measured and modeled responses by cross spectra of an axis' small sweep."""
    command = data.command[:, axis]
    own = slice(axis * len(command) // len(data.axes), (axis + 1) * len(command) // len(data.axes))
    moving = np.flatnonzero(np.abs(np.diff(command[own])) > 0)
    last = own.start + int(moving[-1]) - int(0.1 / data.sample_time)
    part = slice(last - int(1.0 / data.sample_time), last)
    found = []
    for y in (data.measurement, simulate(model, data.command, data.sample_time, data.hold)):
        frequency, value = cross_spectrum(command[part] - command[part].mean(), y[part, axis], data.sample_time)
        found.append(value)
    return frequency, found[0], found[1]


def cross_spectrum(u: Annotated[Array, "N"], y: Annotated[Array, "N"], sample_time: float) -> tuple[Array, Complex]:
    """Estimate a frequency response from 30 to 4000 Hz in 109 logarithmic bands."""
    window = np.hanning(len(u))
    spectra = [np.fft.rfft(window * (signal - signal.mean())) for signal in (u, y)]
    frequency = np.fft.rfftfreq(len(u), sample_time)
    edges = np.geomspace(30.0, 4000.0, 110)
    index = np.digitize(frequency, edges)
    cross, power = (
        np.array([values[index == band].sum() for band in range(1, len(edges))])
        for values in (spectra[1] * spectra[0].conj(), np.abs(spectra[0]) ** 2)
    )
    kept = power > 0
    return np.sqrt(edges[1:] * edges[:-1])[kept], (cross[kept] / power[kept])


def response(signals: Mapping[str, Array], part: Part, sample_time: float, period: float = 0.2) -> tuple[Array, Complex]:
    """Compute the response from reference to measurement of axis x, from the small multisine."""
    count = int(round(period / sample_time))
    r, y = (np.fft.rfft(rows.reshape(-1, count).mean(axis=0)) for rows in part.tracked(signals))
    line = np.flatnonzero(np.abs(r) > 1e-3 * np.abs(r[1:]).max())
    line = line[line > 0]
    return line / period, y[line] / r[line]


def bandwidth(frequency: Annotated[Array, "F"], value: Complex) -> float:
    """Find the first frequency at which the gain, as a mean of three neighboring lines, falls below -3 dB."""
    size = np.sqrt(np.convolve(np.abs(value) ** 2, np.ones(3) / 3.0, "valid"))
    below = np.flatnonzero(size < np.sqrt(0.5))
    return float(frequency[1:-1][below[0]]) if len(below) else float(frequency[-1])


def settling_time(signals: Mapping[str, Array], part: Part, sample_time: float) -> float:
    """Find the time after the step from which the measurement stays within 2 % of the step's height."""
    reference, measurement = part.tracked(signals)  # all rows of a step are scored
    height = reference[-1] - reference[0]
    start = int(np.flatnonzero(reference != reference[0])[0])
    outside = np.flatnonzero(np.abs(measurement[start:] - reference[-1]) > 0.02 * abs(height))
    return sample_time * float(outside[-1] + 1 if len(outside) else 0)
