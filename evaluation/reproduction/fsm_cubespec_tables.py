# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Tables and the figure of the measured mirror (`fsm_cubespec`)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from math import factorial
from pathlib import Path

import numpy as np

from evaluation.reproduction.fsm_cubespec_laws import LAWS as FORCE_LAWS
from evaluation.reproduction.fsm_cubespec_laws import left_over, motion_of
from evaluation.reproduction.fsm_cubespec_records import (
    AXES,
    BANDS,
    FIT,
    PERIOD,
    SAMPLE_TIME,
    SELECT,
    TEST,
    Level,
    response_error,
    simulation_error,
    steady_state,
)
from evaluation.reproduction.robust_bla import robust_bla
from hyst_control.chain.chain import Chain
from hyst_control.identify.modal.frequency_response import excited_lines, local_polynomial
from hyst_control.identify.modal.modal_candidate import Candidate
from hyst_control.identify.modal.modal_model import ModalModel
from hyst_control.model_file import Model
from hyst_control.reporting.tables import Table

PUBLISHED_OWN = {100: 8.4, 200: 8.0, 300: 5.6}
"""Published linear models on their own level, % of rms measurement (their own test set)."""
PUBLISHED_ALL = {100: 6.37, 200: 4.84, 300: 4.19}
"""Best published single model for all levels, a nonlinear state space in LFR form, % of rms measurement (their own
test set).
"""
HALF_WIDTH = 8
"""Of the local polynomial's window, in lines of 0.78 Hz."""


def report_linear(table: Table, levels: Sequence[Level], fits: Sequence[Sequence[Candidate]], models: Sequence[Model]) -> None:
    """Add the error of each level's model on its own level, and the numbers of states that were tried."""
    title = "Linear model per level, realization 6"
    for level, found, model in zip(levels, fits, models, strict=True):
        began = time.perf_counter()
        errors = simulation_error(model, level, TEST)
        rate = 2 * PERIOD * len(TEST) / (time.perf_counter() - began)
        fit, mv = found[0], int(level.name.split()[0])
        name = "state space"
        table.add(title, level.name, name, "relative_error", "% of rms", errors[0], published=PUBLISHED_OWN[mv], n=len(TEST))
        for axis, value in zip(AXES, errors[1:], strict=True):
            table.add(title, level.name, name, f"relative_error_{axis}", "% of rms", value, n=len(TEST))
        table.add(title, level.name, name, "relative_error_fit", "% of rms", 100.0 * fit.fitted, n=len(FIT))
        table.add(title, level.name, name, "states", "", fit.model.states)
        table.add(title, level.name, name, "parameters", "", fit.model.parameters)
        table.add(title, level.name, name, "fit_time", "s", sum(each.seconds for each in found))
        table.add(title, level.name, name, "simulation_rate", "samples/s", rate)
        for each in sorted(found, key=lambda fit: fit.model.states):
            subject = f"{each.model.states} states"
            table.add(title, level.name, subject, "relative_error_select", "% of rms", 100.0 * each.held_out, n=len(SELECT))


def report_nonparametric(table: Table, levels: Sequence[Level]) -> None:
    """Add the errors of responses without a model, fitted and tested alike.

    They show the accuracy that any linear model of a level could reach, and the noise.
    """
    title = "Nonparametric response per level, realization 6"
    for level in levels:
        records = [level.command[:, :, r].mean(axis=2) for r in FIT], [level.measurement[:, :, r].mean(axis=2) for r in FIT]
        for subject, width, degree in (("per line", 1, 0), ("local polynomial", HALF_WIDTH, 2)):
            if degree:
                found = local_polynomial(*records, SAMPLE_TIME, kind="periodic", half_width=width, degree=degree)
                response, lines = found.response, np.round(found.frequency * PERIOD * SAMPLE_TIME).astype(int)
            else:
                u, y = (np.fft.rfft(np.stack(part, axis=2), axis=0) for part in records)
                lines = excited_lines(np.sum(np.abs(u) ** 2, axis=(1, 2)))
                adjoint = np.conj(np.swapaxes(u[lines], 1, 2))
                response = y[lines] @ adjoint @ np.linalg.inv(u[lines] @ adjoint)
            errors = response_error(response, lines, level, TEST)
            table.add(title, level.name, subject, "relative_error", "% of rms", errors[0], n=len(TEST))
        power = float(np.sum(np.std(level.measurement, axis=(0, 2, 3)) ** 2))
        noise = float(np.sum(np.mean((level.measurement[..., 0] - level.measurement[..., 1]) ** 2, axis=(0, 2)) / 2.0))
        table.add(title, level.name, "noise of one period", "relative_error", "% of rms", 100.0 * np.sqrt(noise / power))
        bla = robust_bla(level.command, level.measurement, SAMPLE_TIME)
        assert bla.distortion_variance is not None, "a single realization tells no distortion"
        size = np.sum(np.abs(bla.response) ** 2)
        # Variances of the mean over two groups: a single group, hence a single realization, has twice as much.
        for subject, variance in (("noise in the response", bla.noise_variance), ("nonlinear distortion", bla.distortion_variance)):
            table.add(title, level.name, subject, "relative_size", "% of rms", 100.0 * np.sqrt(2.0 * np.sum(variance) / size), n=6)


def report_across(table: Table, levels: Sequence[Level], models: Sequence[Model]) -> None:
    """Add the errors of each level's model on the other levels."""
    title = "Linear model of one level on another, realization 6 (published: 15 to 33 %)"
    for level in levels:
        for other, model in zip(levels, models, strict=True):
            if other is not level:
                table.add(
                    title,
                    level.name,
                    f"model of {other.name}",
                    "relative_error",
                    "% of rms",
                    simulation_error(model, level, TEST)[0],
                    n=len(TEST),
                )


ALL = "One model for all levels, realization 6"


def report_one(
    table: Table, levels: Sequence[Level], subject: str, model: Model, states: int, parameters: int, seconds: float
) -> float:
    """Add the errors of one model of all levels on the sixth realization and the fifth, its size and its speed."""
    squares = []
    for level in levels:
        mv = int(level.name.split()[0])
        began = time.perf_counter()
        error = simulation_error(model, level, TEST)[0]
        elapsed = time.perf_counter() - began
        table.add(ALL, level.name, subject, "relative_error", "% of rms", error, published=PUBLISHED_ALL[mv], n=len(TEST))
        selected = simulation_error(model, level, SELECT)[0]
        table.add(ALL, level.name, subject, "relative_error_select", "% of rms", selected, n=len(SELECT))
        squares.append(selected**2)
    table.add(ALL, "all", subject, "states", "", states)
    table.add(ALL, "all", subject, "parameters", "", parameters)
    table.add(ALL, "all", subject, "fit_time", "s", seconds)
    table.add(ALL, "all", subject, "simulation_rate", "samples/s", 2 * PERIOD * len(TEST) / elapsed)
    return float(np.sqrt(np.mean(squares)))


def report_laws(table: Table, levels: Sequence[Level], models: Sequence[ModalModel]) -> None:
    """Add candidate forces beside each level's linear model (`fsm_cubespec_laws`): fifth realization, to choose on, and sixth."""
    title = "Force laws by regression on the error of each level's linear model"
    for level, model in zip(levels, models, strict=True):
        command, measurement = level.command.mean(axis=3), level.measurement.mean(axis=3)
        motion, output = motion_of(model, command, SAMPLE_TIME)
        power = np.sum(np.mean(measurement**2, axis=0), axis=0)
        for name, law in FORCE_LAWS.items():
            left = left_over(measurement - output, np.concatenate([motion.command, *law(motion)], axis=1), FIT)
            errors = 100.0 * np.sqrt(left / power)
            table.add(title, level.name, name, "relative_error_select", "% of rms", errors[SELECT[0]], n=len(SELECT))
            table.add(title, level.name, name, "relative_error", "% of rms", errors[TEST[0]], n=len(TEST))


EFFECTS = {
    "softening: frequencies": {"frequency_change": 0.0},
    "softening: damping": {"decay_change": 0.0},
    "softening: gains": {"inputs_change": 0.0},
    "softening from instant to instant": {"force_inputs": 0.0, "force_feedthrough": 0.0},
    "hysteresis of the actuators": {"stop_inputs": 0.0, "stop_feedthrough": 0.0},
    "even force, products of elongations": {"product_inputs": 0.0, "product_feedthrough": 0.0},
}
"""The parts of the chosen model, and the parameters that switch each off."""


def report_shares(table: Table, levels: Sequence[Level], model: Model) -> None:
    """Add each effect's share of the gap between the linear simulator and the mirror.

    The linear simulator is the chosen model with every effect off. Shapley values of the mean square error on the sixth realization: an
    effect's share is the mean of its reduction over all orders in which the effects can be switched on. Nothing is fitted again. The
    noise is that of the measured period, the rest is not explained; all add up to the gap.
    """
    title = SHARES
    stage = model.chain.stages[0]
    names = list(EFFECTS)
    totals = dict.fromkeys((*names, "noise", "not explained"), 0.0)
    for level in levels:
        left = {}
        for present in range(1 << len(names)):
            off = [EFFECTS[name] for bit, name in enumerate(names) if not present >> bit & 1]
            changed = replace(stage, **{key: value for effect in off for key, value in effect.items()})
            left[present] = simulation_error(replace(model, chain=Chain((changed,))), level, TEST)[0] ** 2
        values = level.measurement[:, :, TEST]
        noise = 1e4 * float(np.mean((values[..., 0] - values[..., 1]) ** 2) / 2.0 / np.mean(values**2))
        shares = {}
        for bit, name in enumerate(names):
            shares[name] = 0.0
            for present in left:
                if not present >> bit & 1:
                    before = bin(present).count("1")
                    weight = factorial(before) * factorial(len(names) - before - 1) / factorial(len(names))
                    shares[name] += weight * (left[present] - left[present | 1 << bit])
        shares |= {"noise": noise, "not explained": left[len(left) - 1] - noise}
        table.add(title, level.name, "linear simulator", "relative_error", "% of rms", np.sqrt(left[0]), n=len(TEST))
        for name, value in shares.items():
            table.add(title, level.name, name, "share", "% of mean square", 100.0 * value / left[0], n=len(TEST))
            totals[name] += value
    for name, value in totals.items():
        table.add(title, "all", name, "share", "% of mean square", 100.0 * value / sum(totals.values()), n=len(TEST))


SHARES = "Shares of the gap between the linear simulator and the mirror, realization 6"


def report_residual(table: Table, levels: Sequence[Level], model: Model) -> None:
    """Add the chosen model's residual by frequency band: each band's share of it, and the band's own relative error."""
    title = "What the chosen model leaves, by frequency, realization 6"
    for level in levels:
        measured = level.measurement[:, :, TEST].mean(axis=3)
        error = measured - steady_state(model, level.command[:, :, TEST].mean(axis=3))
        lines = np.arange(PERIOD // 2 + 1) / (PERIOD * SAMPLE_TIME)
        power = [np.sum(np.abs(np.fft.rfft(signal, axis=0)) ** 2, axis=(1, 2)) for signal in (error, measured)]
        for lower, upper in zip(BANDS[:-1], BANDS[1:], strict=True):
            inside = (lines > 0) & (lines >= lower) & (lines < upper)
            left, whole = (float(part[inside].sum()) for part in power)
            band = f"{lower}-{upper} Hz"
            table.add(title, level.name, band, "share", "% of mean square", 100.0 * left / float(power[0][1:].sum()), n=len(TEST))
            table.add(title, level.name, band, "relative_error", "% of rms", 100.0 * np.sqrt(left / whole), n=len(TEST))


def draw(folder: Path, levels: Sequence[Level], models: Sequence[Model]) -> None:
    """Draw the measured, error and noise spectra of every level's linear model."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    figure, panels = plt.subplots(len(levels), 1, figsize=(9, 9), sharex=True)
    for panel, level, model in zip(panels, levels, models, strict=True):
        measured = level.measurement[:, :, TEST]
        simulated = steady_state(model, level.command[:, :, TEST].mean(axis=3))
        curves = {
            "measured": measured.mean(axis=3),
            "error": measured.mean(axis=3) - simulated,
            "noise": (measured[..., 0] - measured[..., 1]) / np.sqrt(2.0),
        }
        for label, signal in curves.items():
            spectrum = np.sqrt(np.sum(np.abs(np.fft.rfft(signal, axis=0)) ** 2, axis=(1, 2))) / PERIOD
            smooth = np.sqrt(np.convolve(spectrum**2, np.ones(9) / 9, mode="same"))
            panel.semilogy(np.arange(len(smooth))[1:3840] / (PERIOD * SAMPLE_TIME), smooth[1:3840], label=label, linewidth=0.9)
        panel.set_ylabel(f"{level.name}: um per line")
        panel.grid(alpha=0.3)
    panels[0].legend()
    panels[-1].set_xlabel("frequency (Hz)")
    figure.tight_layout()
    figure.savefig(folder / "fsm_cubespec_linear.png", dpi=120)
    plt.close(figure)
