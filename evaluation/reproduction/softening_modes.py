# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""One model for several levels of a periodic experiment: modes that soften with amplitude (`chain.softening_modal`).

Two fits by the output error of all levels, each weighing the same: first poles and input gains as functions of the slow amplitude; then,
with the softening force computed from the first model's elongation, that force and stop operators of the command as further inputs.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from evaluation.reproduction.periodic_fit import PeriodicProblem
from hyst_control.base.arrays import Array, Mask
from hyst_control.chain.hysteresis.softening_modal import SofteningModal
from hyst_control.identify.modal.frequency_response import excited_lines
from hyst_control.identify.modal.modal_fit import Problem
from hyst_control.identify.modal.modal_model import Layout, ModalModel, Spectra
from hyst_control.identify.solve import gauss_newton
from hyst_control.identify.solve.gauss_newton import Rules, Trial, solve_damped


@dataclass(frozen=True)
class Level:
    """One level: steady periods of command (N, m, R) in V and measurement (N, p, R) for R realizations."""

    command: Array
    measurement: Array

    @property
    def amplitude(self) -> float:
        """Rms of the command over samples, axes and realizations, V."""
        return float(np.sqrt(np.mean(self.command**2)))

    @property
    def weight(self) -> float:
        """Weight of its errors, so that all levels weigh the same."""
        return 1.0 / float(np.std(self.measurement))


@dataclass(frozen=True)
class Law:
    """Exponents of the softening force's terms, thresholds (V) of the stop operators of the command, products of elongations."""

    exponents: tuple[float, ...]
    stops: tuple[float, ...] = ()
    products: bool = False

    @property
    def name(self) -> str:
        """Text for tables."""
        force = "and force " + " + ".join(f"q|q|^{exponent:g}" for exponent in self.exponents)
        stops = "".join(f", stop operators of {1e3 * threshold:g} mV" for threshold in self.stops)
        return force + stops + (", products q q" if self.products else "")


@dataclass(frozen=True)
class Scheduled:
    """Modal parameters that move along one direction with g: θ = centre + g · change."""

    centre: ModalModel  # The model at g = 0
    change: Annotated[Array, "P"]  # Change (P,) of the parameters with g, in the layout of `modal_fit.Problem`

    def at(self, g: float) -> ModalModel:
        """Return the linear model at a value of the schedule."""
        return self.centre.moved(g * self.change, _layout(self.centre))


@dataclass(frozen=True)
class SofteningFit:
    """A softening stage and its fit."""

    stage: SofteningModal  # The stage
    scheduled: Scheduled  # The parameters of the stage
    parameters: int  # Number of free parameters
    seconds: float  # Time that the fit took, s
    # Standard deviations (M, 2) of the poles' decay and frequency (per sample), as far as the residual shows them
    sigma: Annotated[Array, "M 2"]

    @property
    def tolerance(self) -> dict[str, float]:
        """Median relative standard deviations of the stage's decays and frequencies: the smallest tolerance of a model file."""
        frequency = self.scheduled.centre.poles.imag
        pairs = frequency > 0
        relative = self.sigma[pairs] / np.abs(np.stack([self.stage.decay, frequency], axis=1)[pairs])
        return {"decay": float(np.median(relative[:, 0])), "frequency": float(np.median(relative[:, 1]))}


def schedule(amplitude: float, reference: float) -> float:
    """Schedule g of `SofteningModal`: 0 at the reference amplitude, -1 at half of it."""
    return float((np.sqrt(amplitude / reference) - 1.0) / (1.0 - np.sqrt(0.5)))


def fit_softening(
    levels: Sequence[Level],
    start: ModalModel | Scheduled,
    reference: float,
    sample_time: float,
    law: Law | None = None,
    *,
    memory: float = 0.1,
    iterations: tuple[int, int] = (14, 7),
    rounds: int = 2,
) -> SofteningFit:
    """Fit `SofteningModal` to several levels of a periodic experiment, without a softening force where no law is given."""
    # start: linear model of the level whose amplitude is the reference, or an earlier fit: without the softening force, or with a
    # part of what is fitted now
    began = time.perf_counter()
    g = [schedule(level.amplitude, reference) for level in levels]
    inputs = levels[0].command.shape[1]
    if isinstance(start, Scheduled):
        point, parameters, sigma = start, 0, np.zeros((len(start.centre.poles), 2))
    else:
        data = [spectra(level.command, level.measurement, level.weight) for level in levels]
        point, parameters, sigma = refine_scheduled(data, g, Scheduled(start, np.zeros(_layout(start).size)), inputs, iterations[0])
    known: dict[str, Any] = {"amplitude": reference, "memory": memory}
    further: dict[str, int] = {}
    if law is not None:
        # The elongation in volts of a slow command: the output divided by the gain of the low lines.
        low = point.centre.response(2 * np.pi * np.linspace(80.0, 230.0, 50) * sample_time).mean(axis=0).real
        known |= {"elongation": np.linalg.inv(low[:, :inputs]), "exponent": law.exponents}
        pairs = inputs * (inputs + 1) // 2 if law.products else 0
        further = {"force": inputs * len(law.exponents), "stop": inputs * len(law.stops), "product": pairs}
        point = _widened(point, inputs + sum(further.values()) - point.centre.inputs.shape[1])
        # The force follows the elongation that the commands alone cause in the model, so each fit changes it a little: fit again.
        for _ in range(rounds):
            terms, means = forces(levels, [point.at(value) for value in g], g, law, known["elongation"])
            # The force reaches lines that the command leaves out.
            data = [
                spectra(np.concatenate([level.command, term], axis=1), level.measurement, level.weight, every_line=True)
                for level, term in zip(levels, terms, strict=True)
            ]
            point, parameters, sigma = refine_scheduled(data, g, point, inputs, iterations[1])
        known |= means
    stage = stage_of(point, sample_time, further, known)
    return SofteningFit(stage, point, parameters, time.perf_counter() - began, sigma)


def forces(
    levels: Sequence[Level], models: Sequence[ModalModel], g: Sequence[float], law: Law, elongation: Array
) -> tuple[list[Array], dict[str, Array]]:
    """Terms of a law (N, K, R) by level, each without its average part, which belongs to the scheduled modes; and those parts."""
    strains = [_strain(model, level, elongation) for model, level in zip(models, levels, strict=True)]
    power = [np.sum(q**2, axis=(0, 2)) for q in strains]
    force_means = []  # in proportion to the strain: the rest is uncorrelated with it
    for e in law.exponents:
        bent = sum(np.sum(np.abs(q) ** (2 + e), axis=(0, 2)) for q in strains)
        force_means.append(bent / sum(part * level.amplitude**e for part, level in zip(power, levels, strict=True)))
    held = [stop_operators(level.command, law.stops) for level in levels]
    repeated = [np.concatenate([level.command[:, :0], *[level.command] * len(law.stops)], axis=1) for level in levels]
    nearest = min(range(len(levels)), key=lambda index: abs(g[index]))  # the level that is the reference, if any is
    squares = np.sum(repeated[nearest] ** 2, axis=(0, 2))
    stop_mean = np.sum(held[nearest] * repeated[nearest], axis=(0, 2)) / np.maximum(squares, 1e-300)
    first, second = np.triu_indices(levels[0].command.shape[1] if law.products else 0)
    drive = sum(level.amplitude**2 * q.shape[0] * q.shape[2] for q, level in zip(strains, levels, strict=True))
    product_mean = sum(np.sum(q[:, first] * q[:, second], axis=(0, 2)) for q in strains) / drive
    terms = []
    for level, q, stop, command in zip(levels, strains, held, repeated, strict=True):
        own = [
            q * (np.abs(q) ** e - part[:, None] * level.amplitude**e) for e, part in zip(law.exponents, force_means, strict=True)
        ]
        own += [stop - stop_mean[:, None] * command]
        own += [q[:, first] * q[:, second] - product_mean[:, None] * level.amplitude**2]
        terms.append(np.concatenate(own, axis=1))
    means: dict[str, Array] = {"force_mean": np.concatenate(force_means)}
    if law.stops:
        means |= {"stop_threshold": np.array(law.stops), "stop_mean": stop_mean}
    return terms, means | ({"product_mean": product_mean} if law.products else {})


def stop_operators(command: Array, thresholds: Sequence[float]) -> Array:
    """Stop operators of periodic commands in the periodic steady state."""
    found = [np.zeros((len(command), 0, command.shape[2]))]
    for threshold in thresholds:
        held, stopped = np.zeros(command.shape[1:]), np.empty_like(command)
        for _ in range(2):  # in the second period no memory is older than the period
            for row, value in enumerate(command):
                held = np.minimum(np.maximum(held, value - threshold), value + threshold)
                stopped[row] = value - held
        found.append(stopped)
    return np.concatenate(found, axis=1)


def _strain(model: ModalModel, level: Level, elongation: Array) -> Array:
    """Elongation (N, p, R) in V that the commands cause in the linear part of a model, in the periodic steady state."""
    samples = len(level.command)
    lines = np.arange(1, samples // 2)
    spectrum = np.zeros((samples // 2 + 1, *level.measurement.shape[1:]), dtype=complex)
    response = model.response(2 * np.pi * lines / samples)[:, :, : level.command.shape[1]]
    spectrum[lines] = response @ np.fft.rfft(level.command, axis=0)[lines]
    found: Array = np.einsum("ij,njr->nir", elongation, np.fft.irfft(spectrum, samples, axis=0))
    return found


def refine_scheduled(
    data: Sequence[Spectra], g: Sequence[float], start: Scheduled, inputs: int, iterations: int, tolerance: float = 2e-5
) -> tuple[Scheduled, int, Array]:
    """Fit the center, and the changes of the poles and of the first `inputs` inputs' gains, by damped Gauss-Newton."""
    problems: list[Problem] = [PeriodicProblem([part], start.centre) for part in data]
    layout, free = problems[0].layout, problems[0].free
    n, m = start.centre.inputs.shape
    moving = np.concatenate([layout.indices("pole", n, 2).ravel(), layout.indices("b", 2, n, m)[:, :, :inputs].ravel()])
    moving = moving[free[moving]]
    all_free = np.concatenate([free, np.ones(len(moving), dtype=bool)])
    rules = Rules(
        damping=1e-4,
        raised=lambda damping: damping * 8,
        eased=lambda damping: max(damping / 5, 1e-9),
        small=lambda before, after: before - after <= tolerance * before,
        steps=iterations,
        rejections=8,
    )
    search = _Search(problems, g, moving, all_free)
    found = gauss_newton.minimize(search, search.linearize(_Point(start)), rules)
    last = found.point if found.linearized else search.linearize(found.point)
    pairs = int(np.count_nonzero(start.centre.poles.imag))
    # c and b of a mode share one complex (or real) factor that changes nothing.
    count = int(all_free.sum()) - n - pairs
    variance = last.cost / max(sum(2 * part.measurement.size for part in data) - count, 1)
    return last.scheduled, count, _pole_sigma(last.matrix, all_free, variance, layout.indices("pole", n, 2))


@dataclass(frozen=True)
class _Point:
    """Parameters with their cost, and JᵀJ and Jᵀr where they were last taken."""

    scheduled: Scheduled
    cost: float = np.inf
    matrix: Array = field(default_factory=lambda: np.zeros((0, 0)))
    vector: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class _Search:
    """The least-squares problem of all levels: parameters of the center (P,), then the changes of those that are `moving`."""

    problems: Sequence[Problem]
    g: Sequence[float]
    moving: NDArray[np.intp]
    free: Mask

    def place(self, point: Scheduled) -> None:
        for problem, value in zip(self.problems, self.g, strict=True):
            problem.model = point.centre
            problem.apply(value * point.change)

    def cost(self, point: _Point) -> float:
        return point.cost

    def linearize(self, point: _Point) -> _Point:
        self.place(point.scheduled)
        moving, size, total = self.moving, self.problems[0].layout.size, len(self.free)
        matrix, vector, cost = np.zeros((total, total)), np.zeros(total), 0.0
        for problem, value in zip(self.problems, self.g, strict=True):
            own, gradient, part = problem.normal_equations()
            matrix[:size, :size] += own
            matrix[:size, size:] += value * own[:, moving]
            matrix[size:, :size] += value * own[moving]
            matrix[size:, size:] += value**2 * own[np.ix_(moving, moving)]
            vector[:size] += gradient
            vector[size:] += value * gradient[moving]
            cost += part
        return _Point(point.scheduled, cost, matrix, vector)

    def step(self, point: _Point, damping: float) -> Trial[_Point]:
        first = self.problems[0]
        step = solve_damped(point.matrix, point.vector, self.free, damping)
        change = point.scheduled.change.copy()
        change[self.moving] += step[first.layout.size :]
        first.model = point.scheduled.centre
        first.apply(step[: first.layout.size])
        trial = _bounded(Scheduled(first.model, change), first, max(abs(value) for value in self.g))
        self.place(trial)
        return Trial(replace(point, scheduled=trial, cost=sum(problem.cost() for problem in self.problems)))


def _pole_sigma(matrix: Array, free: np.ndarray, variance: float, at: Array) -> Array:
    """Standard deviations (n, 2) of the poles' a and w, which stand at `at`, from JᵀJ and the residual's variance."""
    index = np.flatnonzero(free)
    scale = np.sqrt(np.maximum(np.diag(matrix)[index], 1e-300))
    # The factor that c and b of a mode share leaves JᵀJ singular: a trace on the diagonal, and the poles are untouched.
    scaled = matrix[np.ix_(index, index)] / scale / scale[:, None] + 1e-9 * np.eye(len(index))
    sigma = np.zeros(len(free))
    sigma[index] = np.sqrt(variance * np.maximum(np.diag(np.linalg.inv(scaled)), 0.0)) / scale
    found: Array = sigma[at]
    return found


def spectra(command: Array, measurement: Array, weight: float, every_line: bool = False) -> Spectra:
    """Transform periodic records at their excited lines; sums of squares are those of the samples times weight²."""
    u, y = np.fft.rfft(command, axis=0), np.fft.rfft(measurement, axis=0)
    lines = np.arange(1, (len(command) + 1) // 2) if every_line else excited_lines(np.sum(np.abs(u) ** 2, axis=(1, 2)))
    scale = weight * np.sqrt(2.0 / len(command))
    return Spectra(2 * np.pi * lines / len(command), scale * u[lines], scale * y[lines], True)


def stage_of(scheduled: Scheduled, sample_time: float, further: Mapping[str, int], known: Mapping[str, Any]) -> SofteningModal:
    """Construct the stage from its modes, the numbers of `further` inputs by what drives them, and parameters that are known."""
    model = scheduled.centre
    n, m = model.inputs.shape
    outputs = len(model.feedthrough)
    layout = _layout(model)
    pole = scheduled.change[layout.slices["pole"]].reshape(n, 2)

    def pair(values: np.ndarray) -> Array:
        return np.stack([values.real, values.imag])

    parts: dict[str, Any] = {}
    begin = outputs
    for name, count in further.items():
        if count:
            parts[f"{name}_inputs"] = pair(model.inputs[:, begin : begin + count] / sample_time)
            parts[f"{name}_feedthrough"] = model.feedthrough[:, begin : begin + count]
        begin += count
    return SofteningModal(
        decay=np.log(-model.poles.real / sample_time),
        frequency=model.poles.imag / sample_time,
        outputs=pair(model.outputs),
        inputs=pair(model.inputs[:, :outputs] / sample_time),
        feedthrough=model.feedthrough[:, :outputs],
        decay_change=pole[:, 0],
        frequency_change=pole[:, 1] / sample_time,
        inputs_change=scheduled.change[layout.indices("b", 2, n, m)][:, :, :outputs] / sample_time,
        **parts,
        **known,
    )


def _bounded(point: Scheduled, problem: Problem, reach: float) -> Scheduled:
    """The point with its poles' changes held where no pole leaves its bounds for |g| up to `reach`."""
    poles = point.centre.poles
    change = point.change.copy()
    at = problem.layout.indices("pole", len(poles), 2)
    decay = np.maximum(np.log(-poles.real) - problem.slowest, 0.0) / reach
    frequency = np.where(poles.imag == 0, 0.0, np.minimum(np.pi - poles.imag, poles.imag)) / reach
    change[at[:, 0]] = np.clip(change[at[:, 0]], -decay, decay)
    change[at[:, 1]] = np.clip(change[at[:, 1]], -frequency, frequency)
    return Scheduled(point.centre, change)


def _layout(model: ModalModel) -> Layout:
    outputs, inputs = model.feedthrough.shape
    return Layout.of(len(model.poles), inputs, outputs, 0, 0, True, False)


def _widened(scheduled: Scheduled, count: int) -> Scheduled:
    """The same with `count` further inputs, of no effect yet."""
    model, old = scheduled.centre, _layout(scheduled.centre)
    (n, p), inputs = model.outputs.shape, model.inputs.shape[1]
    wide = replace(
        model,
        inputs=np.hstack([model.inputs, np.zeros((n, count))]),
        feedthrough=np.hstack([model.feedthrough, np.zeros((p, count))]),
        delay=np.concatenate([model.delay, np.zeros(count)]),
    )
    new = _layout(wide)
    change = np.zeros(new.size)
    change[new.slices["pole"]] = scheduled.change[old.slices["pole"]]
    change[new.indices("b", 2, n, inputs + count)[:, :, :inputs]] = scheduled.change[old.indices("b", 2, n, inputs)]
    return Scheduled(wide, change)
