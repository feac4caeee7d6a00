# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The hysteresis benchmark of the identification community: Noël & Schoukens, "Hysteretic benchmark with a dynamic nonlinearity".

A simulated oscillator with a hysteretic restoring force, 750 Hz: five periods of a multisine with sensor noise for the fit; a multisine and
a sine sweep without noise, which a model is to simulate from the force alone. The force has no content above 150 Hz, so it is known
between its samples: records are interpolated before a model is fitted or simulated. The mean of periods 2 to 5 is fitted, preceded by
itself. In the model files the force is in V for N and the displacement in um.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from evaluation.reproduction.figures import write_page
from evaluation.reproduction.measured_data import data_folder, read_array
from hyst_control.base import progress
from hyst_control.base.arrays import Array
from hyst_control.identify import identify
from hyst_control.identify.data.fit import Fit
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record, sampled_record
from hyst_control.reporting.tables import Table

SAMPLE_TIME = 1.0 / 750.0
PERIOD = 8192
REFINEMENT = 10
"""Points of interpolation per sample; 20 change no error by 1e-7 m."""
PADDING = 4000
"""Zeros before and behind a record that is not periodic, while it is interpolated."""
PUBLISHED = (1.2e-5, 5.4e-5)
"""Simulation error, m: best and worst of the polynomial state-space models of Noël et al., arXiv 1610.09138 (-98.3 and -85.3 dB)."""
EQUATIONS = {"mass": 2e-6, "damping": 1e-5, "stiffness": 0.05, "alpha": 0.05, "beta": 8e-4, "gamma": -1.1e-3, "exponent": 1.0}
"""Parameters of the benchmark's equations in V (N), um and s; nothing but the table is told of them."""


@dataclass(frozen=True)
class Candidate:
    """A family with its options, and its name in the tables."""

    subject: str
    family: str
    options: dict[str, object] = field(default_factory=dict)


CANDIDATES = (
    Candidate("Bouc-Wen oscillator, gray box", "bouc_wen"),
    Candidate("Duhem oscillator, generic", "duhem_oscillator"),
    Candidate("Duhem oscillator, 12 knots, none at 0", "duhem_oscillator", {"table_size": 12}),
    Candidate("play operators and dynamics (hapi)", "hapi"),
    Candidate("linear", "linear"),
)


@dataclass(frozen=True)
class Test:
    """A record for scoring: force (N,) in N and displacement (N,) in um, and whether it is one period of a steady state."""

    name: str
    force: Array
    displacement: Array
    periodic: bool


def interpolated(signal: Annotated[Array, "N"], factor: int) -> Array:
    """Interpolate a period of a periodic signal without content at or above half its sample rate."""
    spectrum = np.zeros(len(signal) * factor // 2 + 1, dtype=complex)
    lines = np.fft.rfft(signal)
    spectrum[: len(lines)] = lines
    if len(signal) % 2 == 0 and factor > 1:
        spectrum[len(lines) - 1] *= 0.5
    fine: Array = factor * np.fft.irfft(spectrum, len(signal) * factor)
    return fine


def load() -> tuple[Array, list[Test]]:
    """Load the records."""
    folder, found = data_folder("bouc_wen"), []
    for name, samples in (("multisine_train", 5 * PERIOD), ("multisine_test", PERIOD), ("sinesweep_test", 153_000)):
        found.append(read_array(folder / f"{name}.npy", samples, 2) * np.array([1.0, 1e6]))
    train, multisine, sweep = found
    tests = [Test("multisine", multisine[:, 0], multisine[:, 1], True), Test("sine sweep", sweep[:, 0], sweep[:, 1], False)]
    return train.reshape(5, PERIOD, 2), tests


def training_record(periods: Annotated[Array, "5 8192 2"], refinement: int = REFINEMENT) -> Record:
    """Mean of the steady periods, interpolated; it begins amid a motion and is preceded by itself."""
    force, displacement = (interpolated(signal, refinement)[:, None] for signal in periods[1:].mean(axis=0).T)
    return sampled_record("multisine_train", force, displacement, SAMPLE_TIME / refinement, ("x",), "um", "foh", "unknown")


def predict(model: Model, test: Test) -> Annotated[Array, "N"]:
    """Simulate a record from its force alone, from rest or in the steady state."""
    refinement = round(SAMPLE_TIME / model.sample_time)
    if test.periodic:  # twice, of which the second time counts
        force = np.tile(interpolated(test.force, refinement), 2)
        first = len(test.force)
    else:
        force = interpolated(np.pad(test.force, PADDING), refinement)
        first = PADDING
    return simulate(model, force[:, None])[::refinement, 0][first : first + len(test.force)]


def error_of(model: Model, test: Test) -> float:
    """Simulation error of a model on a record."""
    return 1e-6 * float(np.sqrt(np.mean((test.displacement - predict(model, test)) ** 2)))


def run(figures: str | None = None, candidates: Sequence[Candidate] = CANDIDATES, refinement: int = REFINEMENT) -> Table:
    """Identify every candidate on the training record, score it on both tests and return the table."""
    periods, tests = load()
    record = training_record(periods, refinement)
    table = Table("reproduce bouc-wen")
    fits = []
    for candidate in candidates:
        progress.step(f"identify {candidate.subject}")
        began = time.perf_counter()
        fit = identify([record], candidate.family, "joint", **candidate.options)
        report(table, candidate.subject, fit, tests, periods, time.perf_counter() - began)
        fits.append(fit)
    report_parameters(table, candidates[0].subject, fits[0])
    if figures is not None:
        write_page(figures, table)
    return table


ERRORS = "Simulation error on the records for scoring"


def report(
    table: Table, subject: str, fit: Fit, tests: Sequence[Test], periods: Annotated[Array, "5 8192 2"], seconds: float
) -> None:
    """Add the errors of one model."""
    for test in tests:
        error, rms = error_of(fit.model, test), float(np.sqrt(np.mean(test.displacement**2)))
        table.add(ERRORS, test.name, subject, "rms_error", "m", error, published=PUBLISHED[0])
        table.add(ERRORS, test.name, subject, "rms_error_level", "dB re 1 m", 20.0 * np.log10(error))
        table.add(ERRORS, test.name, subject, "relative_error", "% of rms", 1e8 * error / rms)
    mean = periods[1:].mean(axis=0)
    trained = Test("multisine_train", mean[:, 0], mean[:, 1], periodic=True)
    table.add(ERRORS, trained.name, subject, "rms_error", "m", error_of(fit.model, trained))
    noise = 1e-6 * float(np.std(periods[1:, :, 1] - mean[:, 1], ddof=0)) / np.sqrt(3.0)
    table.add(ERRORS, trained.name, subject, "noise_of_the_mean_period", "m", noise)
    table.add(ERRORS, "fit", subject, "numbers_in_the_model", "", len({row["name"] for row in fit.report["parameters"]}))
    table.add(ERRORS, "fit", subject, "fit_time", "s", seconds)


def report_parameters(table: Table, subject: str, fit: Fit) -> None:
    """Add the fitted parameters beside those of the benchmark's equations, with the 95 % interval."""
    for row in fit.report["parameters"]:
        if row["name"] in EQUATIONS:
            value, half, name = row["value"], 1.96 * (row["standard_error"] or 0.0), row["name"]
            known: dict[str, Any] = {"published": EQUATIONS[name], "ci95": (value - half, value + half)}
            table.add("Parameters found, and those of the benchmark's equations", name, subject, name, row["unit"], value, **known)
