# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A measured fast steering mirror: the CubeSpec benchmark.

Floren, Peri, De Maeyer, De Munter, Vandepitte, Noel, "Data-driven state-space identification and nonlinearity assessment of the
CubeSpec Fine Steering Mirror", ISMA-USD 2024.

Three piezo actuators, three displacement sensors, three levels, six realizations of random-phase orthogonal multisines
with two steady periods each. Models are fitted on realizations 1-4, chosen (number of states, law of the softening
force) by their error on the fifth, and tested on the sixth, which takes part in nothing else. Every test is a simulation
from the command alone: the period is run twice and the second run counts, so 8192 samples of initial transient are left
out. The error is rms error / rms measurement, all three sensors and both measured periods together.

Beside a linear model per level stands one model for all levels, whose modes soften with amplitude
(`chain.softening_modal`); its parts' shares of the gap and what it leaves are tables of their own.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from evaluation.reproduction import softening_modes
from evaluation.reproduction.fsm_cubespec_records import FIT, SAMPLE_TIME, SELECT, Level, load_levels, model_of
from evaluation.reproduction.fsm_cubespec_tables import (
    ALL,
    draw,
    report_across,
    report_laws,
    report_linear,
    report_nonparametric,
    report_one,
    report_residual,
    report_shares,
)
from evaluation.reproduction.periodic_fit import refined
from hyst_control.base import progress
from hyst_control.base.parallel import executor
from hyst_control.chain.chain import Chain
from hyst_control.identify.modal.modal_candidate import Candidate, error_of
from hyst_control.identify.modal.modal_fit import subspace
from hyst_control.identify.modal.modal_model import ModalModel
from hyst_control.model_file import Model, save_model
from hyst_control.reporting.tables import Table

ORDERS = (46, 58, 64)


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


LAWS = (Law((0.5,)), Law((0.5, 1.0)), Law((0.5, 1.0), (0.03,)), Law((0.5, 1.0), (0.03,), True))
"""Laws of the softening force and of the actuators' hysteresis among which the fifth realization chooses; each has what the one before
has, and its fit starts there.
"""


def fit_level(level: Level, order: int) -> Candidate:
    """Fit a level's linear model on realizations 1-4 and evaluate it on the fifth."""
    data = [level.spectra(FIT)]
    fit = refined(data, subspace(data, [order], np.zeros(3), "zoh")[0], 25)
    return replace(fit, held_out=error_of(fit.model, [level.spectra(SELECT)]))


def smallest_first(found: Sequence[Candidate]) -> list[Candidate]:
    """Put the chosen candidate first: the smallest one within 1 % of the best on the fifth realization."""
    good = 1.01 * min(fit.held_out for fit in found)
    return sorted(found, key=lambda fit: (fit.held_out > good, fit.model.states))


def fit_all(levels: Sequence[Level], order: int, hold: str = "zoh") -> Candidate:
    """Fit one linear model for all levels, with the same weight for every level's relative error."""
    data = [level.spectra(FIT, 1.0 / float(np.std(level.measurement))) for level in levels]
    start = subspace(data, [order], np.zeros(3), hold)[0]
    return refined(data, start, 25)


def run(json_path: str | Path | None = None, figures_dir: str | Path | None = None) -> Table:
    """Compare every model on every level and return the table."""
    levels = load_levels()
    table = Table("reproduce fsm-cubespec")
    began = time.perf_counter()
    progress.step("fit every level by itself and all together, in two processes")
    with executor(2, "fork") as pool:
        jobs = [(level, order) for order in sorted(ORDERS, reverse=True) for level in levels]
        candidates = list(pool.map(fit_level, *zip(*jobs, strict=True)))
        fits = [smallest_first(candidates[i :: len(levels)]) for i in range(len(levels))]
        # The model of all levels starts from the middle level's own.
        middle = fits[1]
        pending = pool.submit(fit_all, levels, middle[0].model.states)
        mean = soften(levels, middle[0].model, None)
        forced, last = [], mean
        for law in LAWS:
            progress.step(law.name)
            found = soften(levels, last.scheduled, law)
            last = replace(found, seconds=last.seconds + found.seconds)
            forced.append(last)
        linear = pending.result()
    largest = max(float(np.abs(level.command).max()) for level in levels)
    models = [
        model_of(found[0].model, f"fsm_{level.name}", float(np.abs(level.command).max()))
        for found, level in zip(fits, levels, strict=True)
    ]
    report_linear(table, levels, fits, models)
    report_nonparametric(table, levels)
    report_across(table, levels, models)
    report_one(
        table,
        levels,
        "linear",
        model_of(linear.model, "fsm_linear", largest),
        linear.model.states,
        linear.model.parameters,
        linear.seconds,
    )
    chosen: tuple[float, Model, str] | None = None
    for subject, found in zip(("softening modes", *(law.name for law in LAWS)), (mean, *forced), strict=True):
        model = softening_model(found, levels)
        selected = report_one(table, levels, subject, model, states_of(found), found.parameters, found.seconds)
        if chosen is None or selected < chosen[0]:
            chosen = selected, model, subject
    assert chosen is not None, "no model of all levels"
    table.add(ALL, "all", f"chosen on realization 5: {chosen[2]}", "relative_error_select", "% of rms", chosen[0], n=1)
    report_laws(table, levels, [found[0].model for found in fits])
    report_shares(table, levels, chosen[1])
    report_residual(table, levels, chosen[1])
    table.add(ALL, "all", "everything", "elapsed", "s", time.perf_counter() - began)
    if figures_dir is not None:
        folder = Path(figures_dir)
        draw(folder, levels, models)
        save_model(chosen[1], folder / "fsm_cubespec.yaml")
    if json_path is not None:
        table.write(json_path)
    return table


def soften(levels: Sequence[Level], start: ModalModel | softening_modes.Scheduled, law: Law | None) -> softening_modes.SofteningFit:
    """Fit one model for all levels on realizations 1-4, with or without a softening force and hysteresis of the actuators."""
    periods = [
        softening_modes.Level(level.command[:, :, FIT].mean(axis=3), level.measurement[:, :, FIT].mean(axis=3)) for level in levels
    ]
    steps = (20, 8)
    if law is None:
        return softening_modes.fit_softening(periods, start, periods[1].amplitude, SAMPLE_TIME, force=False, iterations=steps)
    return softening_modes.fit_softening(
        periods,
        start,
        periods[1].amplitude,
        SAMPLE_TIME,
        exponent=law.exponents,
        stops=law.stops,
        products=law.products,
        iterations=steps,
    )


def softening_model(found: softening_modes.SofteningFit, levels: Sequence[Level]) -> Model:
    """Convert a fit to the content of a model file, with the median noise of one period over all realizations.

    The median, because the periods of realizations 2 and 3 at 100 mV differ six times as much as those of the others.
    """
    largest = max(float(np.abs(level.command).max()) for level in levels)
    differences = np.concatenate([level.measurement[..., 0] - level.measurement[..., 1] for level in levels], axis=2)
    sigma = np.sqrt(np.median(np.mean(differences**2, axis=0), axis=1) / 2.0)
    return replace(
        model_of(found.scheduled.centre, "fsm_cubespec", largest),
        chain=Chain((found.stage,)),
        noise={"sigma": [float(f"{value:.3g}") for value in sigma]},
        tolerance={name: float(f"{value:.3g}") for name, value in found.tolerance.items()},
    )


def states_of(found: softening_modes.SofteningFit) -> int:
    """Count the real states: two for a complex mode, and as many again where the force acts."""
    return found.scheduled.centre.states * (2 if np.ndim(found.stage.force_inputs) else 1)
