# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Coverage of an identification's intervals: how often the truth lies within the 90 % interval of an identified model.

A case is a plant of the fitted family with parameters drawn anew for every run, a short record with its own noise, and one identification.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from scipy.signal import lfilter

from hyst_control.base.arrays import Array
from hyst_control.base.parallel import map_forked
from hyst_control.chain import Chain, Stage
from hyst_control.chain.coordinates import chain_coordinates, with_coordinates
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import Delay, TransferFunction
from hyst_control.chain.linear.rational_factors import rational
from hyst_control.identify import identify
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import sampled_record
from hyst_control.reporting.tables import Limit, Table

RUNS = 200
QUANTILE = 1.6449
"""Of the normal distribution: 90 % lie within it on both sides."""
RATE = 10e3  # Hz
THRESHOLDS = (2.0, 6.0, 12.0, 20.0)  # V
SIGMA = 0.01  # um


@dataclass(frozen=True)
class Case:
    """A kind of identification."""

    name: str  # Name of the case
    family: str  # Model family, which is the plant's
    dynamics: str  # Structure of G(s), as in the option; "" for none
    # Noise (N,) of a generator and a number of samples, um
    noise: Callable[[np.random.Generator, int], Array]
    step: float = 0.0  # Rounding of the measurement, um; 0 for none


def white(random: np.random.Generator, count: int) -> Annotated[Array, "N"]:
    """White noise of `SIGMA`."""
    return random.normal(0.0, SIGMA, count)


def colored(random: np.random.Generator, count: int, pole: float = 0.95) -> Annotated[Array, "N"]:
    """Noise of `SIGMA` below a corner, 80 Hz at 10 kHz."""
    start = random.normal()
    driven = lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], random.normal(size=count), zi=[pole * start])[0]
    return SIGMA * np.asarray(driven, dtype=float)


def faint(random: np.random.Generator, count: int) -> Annotated[Array, "N"]:
    """White noise of a tenth of `SIGMA`."""
    return 0.1 * white(random, count)


CASES = (
    Case("play operators, white noise", "pi", "", white),
    Case("play operators, colored noise", "pi", "", colored),
    Case("play operators, 10-bit rounding", "pi", "", faint, 0.02),
    Case("with a mode and a delay, white noise", "hapi", "modes=1,delay", white),
    Case("with a mode and a delay, colored noise", "hapi", "modes=1,delay", colored),
)


def run(table: Table, runs: int = RUNS) -> None:
    """Measure the coverage of every case."""
    each = max(runs // len(CASES), 1)
    inside: list[Array] = []
    for index, case in enumerate(CASES):
        found = coverage(case, index, each)
        hits = {name: values[:, 0] for name, values in found.items()}
        inside.append(np.concatenate(list(hits.values())))
        error, bound = 100.0 * np.sqrt(np.mean(np.square(np.concatenate(list(found.values()))[:, 1:]), axis=0))
        limit = None if np.isnan(bound) else Limit(bound, "Cramér-Rao bound")
        table.add("error of an identified number", case.name, case.family, "rms_error", "%", error, n=each, limit=limit)
        table.add("coverage of the 90 % intervals", case.name, case.family, "coverage", "%", _percent(inside[-1]), n=each)
        for name, values in hits.items():
            table.add("coverage by number", case.name, name, "coverage", "%", _percent(values), n=each)
    share = _percent(np.concatenate(inside))
    table.add("coverage of the 90 % intervals", "all", "all", "coverage", "%", share, n=each * len(CASES))


def _percent(hits: Array) -> float:
    return 100.0 * float(np.mean(hits))


def coverage(case: Case, seed: int, runs: int) -> dict[str, Annotated[Array, "N 3"]]:
    """Identify plants of a case: for each number and run whether its interval holds the truth, its error, and the least possible one."""
    found = list(map_forked(lambda index: _judged(case, np.random.default_rng([seed, index])), runs))
    return {name: np.array([judged[name] for judged in found]) for name in found[0]}


def _judged(case: Case, random: np.random.Generator) -> dict[str, tuple[float, float, float]]:
    """By number: 1 if its interval holds the truth, its error, and the bound of Cramér and Rao for it, relative to the truth."""
    stages = tuple(_plant(random, bool(case.dynamics)))
    truth = Model("truth", ("x",), {"command": "V", "measurement": "um"}, 1.0 / RATE, Chain(stages))
    command = excitation(random)[:, None]
    measured = simulate(truth, command) + case.noise(random, len(command))[:, None]
    if case.step:
        measured = case.step * np.rint(measured / case.step)
    data = sampled_record("run", command, measured, 1.0 / RATE, ("x",), "um", start="settled")
    options: dict[str, Any] = {"structure": case.dynamics} if case.dynamics else {}
    fit = identify([data], case.family, thresholds=(0.0, *THRESHOLDS), **options)
    known = {name: each.value for name, each in chain_coordinates(stages, ("x",)).items()}
    values = chain_coordinates(fit.model.chain.stages, ("x",))
    uncertainty = fit.model.uncertainty
    errors = {name: float(np.linalg.norm(row)) for name, row in zip(uncertainty["parameters"], uncertainty["factor"], strict=True)}
    stated = [name for name in errors if name in known]
    away = np.array([abs(values[name].value - known[name]) for name in stated])
    held = away <= QUANTILE * np.array([errors[name] for name in stated])
    bounds = cramer_rao(truth, command, stated) if case.noise is white else np.full(len(stated), np.nan)
    size = np.abs([known[name] for name in stated])
    return dict(zip(stated, zip(held, away / size, bounds / size, strict=True), strict=True))


def cramer_rao(truth: Model, command: Array, names: Sequence[str]) -> Annotated[Array, "P"]:
    """Least standard deviation of unbiased estimates of these numbers from one record with white noise of `SIGMA`."""
    stages, columns = truth.chain.stages, []
    for name in names:
        value = chain_coordinates(stages, truth.axes)[name].value
        step = 1e-4 * abs(value)
        moved = [with_coordinates(stages, {name: value + side * step}, truth.axes) for side in (-1.0, 1.0)]
        ends = [simulate(truth.with_stages(each), command) for each in moved]
        columns.append((ends[1] - ends[0]).ravel() / (2.0 * step))
    slopes = np.array(columns)
    return SIGMA * np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T)))


def _plant(random: np.random.Generator, dynamics: bool) -> list[Stage]:
    def about(value: float) -> float:
        return value * float(random.uniform(0.8, 1.2))

    stages: list[Stage] = [PrandtlIshlinskii(THRESHOLDS, [about(w) for w in (0.012, 0.010, 0.008, 0.006)], w0=about(0.06))]
    if dynamics:
        w = 2 * np.pi * about(700.0)
        num, den = rational(np.array([w**2]), np.array([1.0, 2 * about(0.1) * w, w**2]), {"gain": 1.0})
        stages += [Delay(about(1.2e-4)), TransferFunction(num, den)]
    return stages


def excitation(random: np.random.Generator) -> Annotated[Array, "N"]:
    """A step, and loops of several amplitudes at 20 to 90 Hz between rests: a third of a second."""
    parts = [np.zeros(50), np.full(300, 10.0), np.zeros(200)]
    for frequency, peak in ((20.0, 60.0), (40.0, 35.0), (60.0, 50.0), (90.0, 20.0)):
        count = round(2 * RATE / frequency)
        height = 0.5 * peak * random.uniform(0.9, 1.1)
        parts += [height * (1.0 - np.cos(4 * np.pi * np.arange(count) / count)), np.zeros(100)]
    return np.concatenate(parts)
