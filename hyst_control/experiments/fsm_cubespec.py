"""A measured fast steering mirror: the CubeSpec benchmark (Floren, Peri, De Maeyer, De Munter, Vandepitte, Noel,
"Data-driven state-space identification and nonlinearity assessment of the CubeSpec Fine Steering Mirror", ISMA-USD
2024).

Three piezo actuators, three displacement sensors, three levels, six realisations of random-phase orthogonal multisines
with two steady periods each. Models are fitted on realisations 1-4 (their number of states is chosen by fitting 1-3,
which are orthogonal together, and predicting 4) and tested on 5 and 6. Every test is a simulation from the command
alone: the period is run twice and the second run counts, so 8192 samples of initial transient are left out. The error
is rms error / rms measurement, all three sensors and both measured periods together.

Beside a linear model per level stands one model for all levels, whose modes soften with amplitude
(`chain.softening_modal`). The form of its softening force was chosen by looking at realisations 5 and 6 too
(`docs/measured_mirror.md`), its size, the number of states and every parameter were not.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hyst_control.chain.chain import Chain
from hyst_control.chain.stage import Array
from hyst_control.errors import InputError
from hyst_control.experiments.measured_data import data_folder
from hyst_control.identify import softening
from hyst_control.identify.frequency_response import excited_lines, local_polynomial, robust_bla
from hyst_control.identify.linear import Candidate, choose, refined, stages_of
from hyst_control.identify.modal_fit import ModalModel, Spectra, subspace
from hyst_control.model_file import Model, simulate
from hyst_control.tables import Table

SAMPLE_TIME = 1.0 / 6400.0
PERIOD = 8192
AXES = ("a", "b", "c")
LEVELS = (100, 200, 300)
"""Excitation levels in mV rms."""
FIT = (0, 1, 2, 3)
SELECT_FIT, SELECT_TEST = (0, 1, 2), (3,)
TEST = (4, 5)
ORDERS = (22, 28, 34, 40, 46)
PUBLISHED_OWN = {100: 8.4, 200: 8.0, 300: 5.6}
"""Published linear models on their own level, % of rms measurement (their own test set)."""
PUBLISHED_ALL = {100: 6.37, 200: 4.84, 300: 4.19}
"""Best published single model for all levels, a nonlinear state space in LFR form, % of rms measurement (their own
test set).
"""
HALF_WIDTH = 8
"""Of the local polynomial's window, in lines of 0.78 Hz."""


@dataclass(frozen=True)
class Level:
    """Records of one level: command (8192, 3, 6, 2) in V and measurement (8192, 3, 6, 2) in um."""

    name: str
    command: Array
    measurement: Array

    def spectra(self, realisations: Sequence[int], weight: float = 1.0) -> Spectra:
        """Excited lines of the realisations, both periods averaged; sums of squares are those of the samples, times
        weight².
        """
        u = np.fft.rfft(self.command[:, :, realisations].mean(axis=3), axis=0)
        y = np.fft.rfft(self.measurement[:, :, realisations].mean(axis=3), axis=0)
        lines = excited_lines(np.sum(np.abs(u) ** 2, axis=(1, 2)))
        scale = weight * np.sqrt(2.0 / PERIOD)
        return Spectra(2 * np.pi * lines / PERIOD, scale * u[lines], scale * y[lines], True)

    def error(self, simulated: Array, realisations: Sequence[int]) -> Array:
        """Relative errors in %: all sensors together, then each; simulated (8192, 3, R)."""
        measured = self.measurement[:, :, realisations]
        squared = np.mean((measured - simulated[..., None]) ** 2, axis=(0, 2, 3))
        power = np.mean(measured**2, axis=(0, 2, 3))
        return 100.0 * np.sqrt(np.concatenate([[squared.sum() / power.sum()], squared / power]))


def load_levels() -> list[Level]:
    """The measurements. Raises `InputError` when they are absent or have another shape than the benchmark's."""
    folder = data_folder("fsm_cubespec")
    levels = []
    for level in LEVELS:
        parts = []
        for letter in "uy":
            path = folder / f"{letter}_{level}mV_train.npy"
            try:
                values = np.load(path)
            except (OSError, ValueError) as error:
                raise InputError(f"{path}: cannot be read ({error}): fetch the benchmark's files again") from None
            if values.shape != (PERIOD, 3, 6, 2):
                raise InputError(f"{path}: shape {values.shape}, the benchmark has {(PERIOD, 3, 6, 2)}: fetch its files again")
            parts.append(values.astype(np.float64))
        levels.append(Level(f"{level} mV", parts[0], 1e6 * parts[1]))
    return levels


def model_of(modal: ModalModel, name: str, command: float) -> Model:
    """A model file's content; command: largest voltage it was fitted on."""
    return Model(
        name=name,
        axes=AXES,
        units={"command": "V", "measurement": "um"},
        sample_time=SAMPLE_TIME,
        hold=modal.hold,
        chain=Chain(tuple(stages_of(modal, SAMPLE_TIME))),
        valid={"command": [-command, command], "frequency": [0.0, 3000.0]},
    )


def steady_state(model: Model, command: Array) -> Array:
    """Simulated steady period (8192, 3, R) for periodic commands (8192, 3, R): run twice, the second run counts."""
    simulated = [simulate(model, np.tile(command[:, :, r], (2, 1)))[PERIOD:] for r in range(command.shape[2])]
    return np.stack(simulated, axis=2)


def simulation_error(model: Model, level: Level, realisations: Sequence[int]) -> Array:
    """Relative errors in % of a model simulated from the command alone: all sensors together, then each."""
    return level.error(steady_state(model, level.command[:, :, realisations].mean(axis=3)), realisations)


def response_error(response: np.ndarray, lines: Array, level: Level, realisations: Sequence[int]) -> Array:
    """Relative errors in % of a nonparametric response (F, 3, 3) at `lines` of the period: all sensors together, then
    each.
    """
    u = np.fft.rfft(level.command[:, :, realisations].mean(axis=3), axis=0)
    y = np.zeros_like(u)
    y[lines] = np.einsum("koj,kjr->kor", response, u[lines])
    return level.error(np.fft.irfft(y, PERIOD, axis=0), realisations)


def fit_level(level: Level, hold: str = "zoh") -> tuple[Candidate, list[dict[str, float]]]:
    """The level's linear model: states chosen on realisation 4 by fits of 1-3, then fitted on 1-4."""
    none = np.zeros(3)
    chosen, rows = choose([level.spectra(SELECT_FIT)], [level.spectra(SELECT_TEST)], ORDERS, hold, [none], iterations=10)
    return refined([level.spectra(FIT)], chosen.model, True, False, 25), rows


def fit_all(levels: Sequence[Level], order: int, hold: str = "zoh") -> Candidate:
    """One linear model for all levels, every level's relative error weighing the same."""
    data = [level.spectra(FIT, 1.0 / float(np.std(level.measurement))) for level in levels]
    start = subspace(data, [order], np.zeros(3), hold)[0]
    return refined(data, start, True, False, 25)


def run(json_path: str | Path | None = None, figures_dir: str | Path | None = None) -> Table:
    """Print-ready table of every model on every level; writes it as JSON and draws figures where asked to.

    Raises `InputError` when the measurements are absent.
    """
    levels = load_levels()
    table = Table("reproduce fsm-cubespec")
    began = time.perf_counter()
    with ProcessPoolExecutor(2) as pool:
        fits = list(pool.map(fit_level, levels))
    seconds = time.perf_counter() - began
    models = [
        model_of(fit.model, f"fsm_{level.name}", float(np.abs(level.command).max()))
        for (fit, _), level in zip(fits, levels, strict=True)
    ]
    report_linear(table, levels, fits, models, seconds)
    report_nonparametric(table, levels)
    report_across(table, levels, models)
    report_hold(table, levels[1], 28)
    report_all_levels(table, levels, fits)
    if figures_dir is not None:
        draw(Path(figures_dir), levels, models)
    if json_path is not None:
        table.write(json_path)
    return table


def report_linear(
    table: Table,
    levels: Sequence[Level],
    fits: Sequence[tuple[Candidate, list[dict[str, float]]]],
    models: Sequence[Model],
    seconds: float,
) -> None:
    """A model per level on its own level."""
    title = "Linear model per level, realisations 5-6"
    for level, (fit, rows), model in zip(levels, fits, models, strict=True):
        began = time.perf_counter()
        errors = simulation_error(model, level, TEST)
        rate = 2 * PERIOD * len(TEST) / (time.perf_counter() - began)
        mv = int(level.name.split()[0])
        table.add(
            title, level.name, "state space", "relative_error", "% of rms", errors[0], published=PUBLISHED_OWN[mv], n=len(TEST)
        )
        for axis, value in zip(AXES, errors[1:], strict=True):
            table.add(title, level.name, "state space", f"relative_error_{axis}", "% of rms", value, n=len(TEST))
        table.add(
            title, level.name, "state space", "relative_error_fit", "% of rms", simulation_error(model, level, FIT)[0], n=len(FIT)
        )
        table.add(title, level.name, "state space", "states", "", fit.model.states)
        table.add(title, level.name, "state space", "parameters", "", fit.model.parameters)
        table.add(title, level.name, "state space", "fit_time", "s", fit.seconds + sum(row["seconds"] for row in rows))
        table.add(title, level.name, "state space", "simulation_rate", "samples/s", rate)
    table.add(title, "all", "state space", "elapsed", "s", seconds)


def report_nonparametric(table: Table, levels: Sequence[Level]) -> None:
    """Responses without a model, fitted and tested alike: what any linear model of a level could reach, and the
    noise.
    """
    title = "Nonparametric response per level, realisations 5-6"
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
        size = np.sum(np.abs(bla.response) ** 2)
        # Variances of the mean over two groups: a single group, hence a single realisation, has twice as much.
        for subject, variance in (("noise in the response", bla.noise_variance), ("nonlinear distortion", bla.distortion_variance)):
            table.add(title, level.name, subject, "relative_size", "% of rms", 100.0 * np.sqrt(2.0 * np.sum(variance) / size), n=6)


def report_across(table: Table, levels: Sequence[Level], models: Sequence[Model]) -> None:
    """Each level's model on the other levels."""
    title = "Linear model of one level on another, realisations 5-6 (published: 15 to 33 %)"
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


def report_all_levels(table: Table, levels: Sequence[Level], fits: Sequence[tuple[Candidate, list[dict[str, float]]]]) -> Model:
    """One model for all levels, step by step; returns the last."""
    title = "One model for all levels"
    order = max(fit.model.states for fit, _ in fits)
    largest = max(float(np.abs(level.command).max()) for level in levels)
    linear = fit_all(levels, order)
    report_one(
        table, title, levels, "linear", model_of(linear.model, "fsm_linear", largest), linear.model.parameters, linear.seconds
    )
    periods = [
        softening.Level(level.command[:, :, FIT].mean(axis=3), level.measurement[:, :, FIT].mean(axis=3)) for level in levels
    ]
    middle = fits[1][0].model
    start = middle if middle.states >= order - 1 else refined_to(levels[1], order)
    found = None
    for subject, force in (("softening modes", False), ("softening modes and force", True)):
        found = softening.fit_softening(
            periods, found.scheduled if found else start, periods[1].amplitude, SAMPLE_TIME, force=force, iterations=(20, 9)
        )
        model = replace(model_of(start, "fsm_softening", largest), chain=Chain((found.stage,)))
        report_one(table, title, levels, subject, model, found.parameters, found.seconds)
    return model


def refined_to(level: Level, order: int) -> ModalModel:
    """A linear model of one level with this many states."""
    data = [level.spectra(FIT)]
    return refined(data, subspace(data, [order], np.zeros(3), "zoh")[0], True, False, 35).model


def report_one(
    table: Table, title: str, levels: Sequence[Level], subject: str, model: Model, parameters: int, seconds: float
) -> None:
    """Errors of one model on the levels' test realisations, together and on the sixth alone, with its size and
    speed.
    """
    for level in levels:
        mv = int(level.name.split()[0])
        began = time.perf_counter()
        table.add(
            title,
            level.name,
            subject,
            "relative_error",
            "% of rms",
            simulation_error(model, level, TEST)[0],
            published=PUBLISHED_ALL[mv],
            n=len(TEST),
        )
        elapsed = time.perf_counter() - began
        table.add(
            title,
            level.name,
            subject,
            "relative_error_sixth",
            "% of rms",
            simulation_error(model, level, TEST[1:])[0],
            published=PUBLISHED_ALL[mv],
            n=1,
        )
    table.add(title, "all", subject, "parameters", "", parameters)
    table.add(title, "all", subject, "fit_time", "s", seconds)
    table.add(title, "all", subject, "simulation_rate", "samples/s", 2 * PERIOD * len(TEST) / elapsed)


def report_hold(table: Table, level: Level, order: int) -> None:
    """Which hold of the command the data prefer, at the same size of the model."""
    for hold in ("zoh", "foh"):
        data = [level.spectra(FIT)]
        found = refined(data, subspace(data, [order], np.zeros(3), hold)[0], True, False, 12)
        table.add(
            "Hold of the command, realisations 5-6",
            level.name,
            hold,
            "relative_error",
            "% of rms",
            simulation_error(model_of(found.model, hold, 1.0), level, TEST)[0],
            n=len(TEST),
        )


def draw(folder: Path, levels: Sequence[Level], models: Sequence[Model]) -> None:
    """Where in frequency the error of the linear models is: measured, error and noise spectra of every level."""
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
