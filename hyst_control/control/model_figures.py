# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Drawings of a model: beside a record, its frequency response, and the loop that a tuning gives it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hyst_control.base.arrays import Array, Complex
from hyst_control.base.errors import InputError
from hyst_control.control.linearization import linearized, sampled_response
from hyst_control.control.plant_cases import Plants
from hyst_control.control.state_space import Discrete, state_space
from hyst_control.control.tuning import Tuning, controller_response
from hyst_control.identify.assess.fit_report import residual
from hyst_control.identify.validation import check_pair, compared_stretches
from hyst_control.model_file import Model
from hyst_control.records.record import Record
from hyst_control.reporting.frequency_figures import Response, bode, measured_responses
from hyst_control.reporting.signal_figures import MAX_POINTS, Line, Panel, axis_title, thinned

DECADES, LINES = 4.0, 400  # Decades below half the sample rate, and frequencies, that a response is computed at
OF_DELAYS = 0.05  # Size of a root of a sampled system below which it belongs to a delay
CANCELED = 1e-6  # Distance of a pole and a zero that cancel
FAR = 1.5  # Distance of zeros that are not drawn, relative to the farthest pole
LAGS = 200  # Samples of the residual's correlations on either side


def frequencies(sample_time: float) -> Array:
    """Frequencies (F,), Hz, up to half the sample rate."""
    return np.asarray(0.5 / sample_time * np.logspace(-DECADES, 0.0, LINES))


def model_responses(model: Model, frequency: Array, sample_time: float | None = None) -> list[Response]:
    """Response of every axis to its own held command at frequencies (F,), Hz, the hysteresis replaced by its mean slope."""
    step = sample_time or model.sample_time
    z = np.exp(2j * np.pi * frequency * step)
    found = sampled_response(linearized(model), len(model.axes), step, z)
    several = len(model.axes) > 1
    return [
        Response(f"{model.name} {axis}" if several else model.name, frequency, found[:, index, index])
        for index, axis in enumerate(model.axes)
    ]


def bode_of(model: Model, record: Record | None = None) -> list[Panel]:
    """Bode plot of a model, over that of a record at the record's clock where one is given."""
    unit = f"{model.units['measurement']}/V"
    if record is None:
        return bode(model_responses(model, frequencies(model.sample_time)), unit)
    check_pair(model.name, model, record)
    step = record.sample_time
    measured = measured_responses(record)
    shown = np.concatenate([each.frequency for each in measured])
    frequency = np.geomspace(shown.min(), shown.max(), LINES) if len(shown) else frequencies(step)
    return bode([*measured, *model_responses(model, frequency, step)], unit)


def poles_and_zeros(model: Model) -> list[Panel]:
    """Poles and zeros of every axis in the plane of s, those of delays left out; the hysteresis is replaced by its mean slope.

    A root on the negative real axis of z is at plus and minus half the sample rate. Zeros far beyond the poles are counted, not drawn.
    Raises `InputError` where there is none to draw.
    """
    system = state_space(linearized(model), len(model.axes), model.sample_time)
    panels = []
    for index, axis in enumerate(model.axes):
        zeros, poles = _of_axis(system, index)
        lines, reach = [], np.inf
        for name, roots, marker in (("poles", poles, "x"), ("zeros", zeros, "o")):
            seen = roots[(np.abs(roots) > OF_DELAYS) & (np.abs(roots) < 1.0 / OF_DELAYS)]
            negative = (seen.real < 0.0) & (np.abs(seen.imag) <= 1e-9 * np.abs(seen))
            s = np.log(seen.astype(complex)) / (2.0 * np.pi * model.sample_time)
            s = np.concatenate([s, s[negative].conj()])
            inside = np.abs(s) <= reach
            label = name if inside.all() else f"{name} ({np.sum(~inside)} more beyond {reach:.3g} Hz)"
            lines.append(Line(label, s.real[inside], s.imag[inside], True, marker))
            reach = FAR * float(np.abs(s).max(initial=0.0)) or np.inf
        name = f" of {axis}" if len(model.axes) > 1 else ""
        panels.append(Panel(f"real part{name} / 2π [Hz]", f"imaginary part{name} / 2π [Hz]", tuple(lines)))
    if not any(len(line.x) for panel in panels for line in panel.lines):
        raise InputError(f"{model.name}: has neither poles nor zeros to draw: it is static, delays apart")
    return panels


def _of_axis(system: Discrete, index: int) -> tuple[Complex, Complex]:
    """Zeros and poles from the command of an axis to its own measurement, without what the other axes add."""
    from scipy.linalg import eigvals

    own, count = slice(index, index + 1), len(system.a)
    poles = np.linalg.eigvals(system.a).astype(complex)
    pencil = np.block([[system.a, system.b[:, own]], [system.c[own], system.d[own, own]]])
    zeros = eigvals(pencil, np.diag([*np.ones(count), 0.0]))
    zeros = zeros[np.isfinite(zeros)]
    for root in list(zeros):  # a mode that only other axes move is no part of this one
        if len(poles) and np.abs(poles - root).min() < CANCELED:
            poles = np.delete(poles, np.abs(poles - root).argmin())
            zeros = np.delete(zeros, np.abs(zeros - root).argmin())
    return zeros, poles


def beside(model: Model, record: Record) -> list[Panel]:
    """Measured against simulated signals, what is left, the loops, and how the rest correlates, of the record's longest stretch."""
    data = max(compared_stretches(record, model), key=lambda each: len(each.command))
    error = residual(model, data)
    begin = len(data.command) - len(error)
    time: Array = np.arange(begin, len(data.command), dtype=float) * data.sample_time
    measured, command = data.measurement[begin:], data.command[begin:]
    panels = []
    for index, axis in enumerate(data.axes):
        name, label = (f".{axis}", axis) if len(data.axes) > 1 else ("", "")
        y, simulated, rest = measured[:, index], measured[:, index] - error[:, index], error[:, index]
        step = max(1, len(y) // (10 * MAX_POINTS))  # a loop has no order: none of its points may be moved
        u = command[::step, index]
        correlations, bound = _correlations(rest, command[:, index])
        reach = len(correlations[0]) // 2
        lags: Array = np.arange(-reach, reach + 1, dtype=float) * data.sample_time * 1e3
        drive, output = axis_title("command", "V", label), axis_title("measurement", data.unit, label)
        panels += [
            Panel("time [s]", output, (Line("measured", *thinned(time, y)), Line("simulated", *thinned(time, simulated)))),
            Panel("time [s]", f"residual{name} [{data.unit}]", (Line("residual", *thinned(time, rest)),)),
            Panel(drive, output, (Line("measured", u, y[::step]), Line("simulated", u, simulated[::step]))),
            Panel(
                "lag [ms]",
                "correlation",
                (
                    Line("autocorrelation", lags, correlations[0]),
                    Line("cross-correlation with the command", lags, correlations[1]),
                    Line("99 % band of white noise", lags[[0, -1, -1, 0]], bound * np.array([1.0, 1.0, -1.0, -1.0])),
                ),
            ),
        ]
    return panels


def _correlations(rest: Array, command: Array) -> tuple[list[Array], float]:
    """Correlations (2 LAGS + 1,) of a residual with itself and with its command, and the size that 99 % of white noise stay within."""
    from scipy.signal import correlate

    count = len(rest)
    lags = min(LAGS, count - 1)
    a, b = rest - rest.mean(), command - command.mean()
    found = []
    for other in (a, b):
        whole = correlate(a, other, mode="full", method="fft") / max(float(np.linalg.norm(a) * np.linalg.norm(other)), 1e-300)
        found.append(whole[count - 1 - lags : count + lags])
    return found, float(2.58 / np.sqrt(count))


def tuning_panels(tuning: Tuning, model: Model, loop_delay: int = 0) -> list[Panel]:
    """Open loop with its margins, sensitivities and step of a tuned feedback, of every axis."""
    frequency = frequencies(tuning.sample_time)[:-1]
    z: Complex = np.exp(2j * np.pi * frequency * tuning.sample_time)
    plant = Plants.nominal(model, tuning.sample_time, loop_delay, z)
    controller = controller_response(tuning.law, z)
    loops = plant.loci * controller
    magnitude, phase = bode([Response(f"loop {axis}", frequency, loop) for axis, loop in zip(model.axes, loops, strict=True)], "1")
    nominal, worst = tuning.nominal, tuning.worst
    level = 10.0 ** (-nominal.gain_margin / 20.0)
    at = frequency[np.abs(loops + level).min(axis=0).argmin()]
    crossover = (
        f"crossover {nominal.crossover:.4g} Hz, phase margin {nominal.phase_margin:.0f} deg (worst {worst.phase_margin:.0f} deg)"
    )
    margin = f"{at:.4g} Hz, gain margin {nominal.gain_margin:.1f} dB (worst {worst.gain_margin:.1f} dB)"
    dots = [Line(crossover, np.array([nominal.crossover]), np.ones(1), True, "o")]
    dots += [Line(margin, np.array([at]), np.array([level]), True, "x")] if level > 0.0 else []
    magnitude = replace(magnitude, lines=(*magnitude.lines, *dots))
    phase = replace(phase, lines=(*phase.lines, Line("-180 deg", frequency[[0, -1]], np.full(2, -180.0))))
    labels = ["(greatest singular value)"] if plant.mixed else model.axes
    closed = [
        Line(f"{name} {label}", frequency, size)
        for label, *pair in zip(labels, *plant.sensitivities(controller), strict=True)
        for name, size in zip(("sensitivity", "complementary"), pair, strict=True)
    ]
    length = 400
    if np.isfinite(tuning.settling_time):
        length = int(np.clip(2.0 * tuning.settling_time / tuning.sample_time, 50, 200_000))
    step = tuning.step(model, length)
    time: Array = np.arange(length, dtype=float) * tuning.sample_time
    steps = tuple(Line(f"step {axis}", time, step[:, index]) for index, axis in enumerate(model.axes))
    return [magnitude, phase, Panel("frequency [Hz]", "magnitude", tuple(closed), "xy"), Panel("time [s]", "step response", steps)]
