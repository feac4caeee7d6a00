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
from math import factorial
from pathlib import Path

import numpy as np

from hyst_control import progress
from hyst_control.chain.chain import Chain
from hyst_control.chain.stage import Array
from hyst_control.errors import InputError
from hyst_control.identify import softening_modes
from hyst_control.identify.frequency_response import excited_lines, local_polynomial, robust_bla
from hyst_control.identify.modal_candidate import Candidate, error_of, refined
from hyst_control.identify.modal_fit import ModalModel, Spectra, subspace
from hyst_control.identify.modal_stages import stages_of
from hyst_control.model_file import Model, save_model, simulate
from hyst_control.parallel import executor
from hyst_control.reporting.tables import Table
from hyst_control.reproduction.fsm_cubespec_laws import LAWS as FORCE_LAWS
from hyst_control.reproduction.fsm_cubespec_laws import left_over, motion_of
from hyst_control.reproduction.measured_data import data_folder

SAMPLE_TIME = 1.0 / 6400.0
PERIOD = 8192
AXES = ("a", "b", "c")
LEVELS = (100, 200, 300)
"""Excitation levels in mV rms."""
FIT, SELECT, TEST = (0, 1, 2, 3), (4,), (5,)
ORDERS = (46, 58, 64)
BANDS = (0, 500, 700, 1100, 1500, 2000, 3200)
"""Edges in Hz of the bands in which what is left is told."""
PUBLISHED_OWN = {100: 8.4, 200: 8.0, 300: 5.6}
"""Published linear models on their own level, % of rms measurement (their own test set)."""
PUBLISHED_ALL = {100: 6.37, 200: 4.84, 300: 4.19}
"""Best published single model for all levels, a nonlinear state space in LFR form, % of rms measurement (their own
test set).
"""
HALF_WIDTH = 8
"""Of the local polynomial's window, in lines of 0.78 Hz."""


@dataclass(frozen=True)
class Law:
    """Exponents of the softening force's terms, and thresholds (V) of the stop operators of the command."""

    exponents: tuple[float, ...]
    stops: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """Text for tables."""
        force = "and force " + " + ".join(f"q|q|^{exponent:g}" for exponent in self.exponents)
        return force + "".join(f", stop operators of {1e3 * threshold:g} mV" for threshold in self.stops)


LAWS = (Law((0.5,)), Law((0.5, 1.0)), Law((0.5, 1.0), (0.03,)))
"""Laws of the softening force and of the actuators' hysteresis among which the fifth realization chooses."""


@dataclass(frozen=True)
class Level:
    """Records of one level: command (8192, 3, 6, 2) in V and measurement (8192, 3, 6, 2) in um."""

    name: str
    command: Array
    measurement: Array

    def spectra(self, realisations: Sequence[int], weight: float = 1.0) -> Spectra:
        """Compute the spectra at the excited lines, both periods averaged.

        Sums of squares equal those of the samples, times weight².

        Parameters
        ----------
        realisations : sequence of int
            Indices of realizations, 0 to 5.
        weight : float
            Factor of command and measurement.

        Returns
        -------
        Spectra
            Command and measurement at the excited lines.
        """
        u = np.fft.rfft(self.command[:, :, realisations].mean(axis=3), axis=0)
        y = np.fft.rfft(self.measurement[:, :, realisations].mean(axis=3), axis=0)
        lines = excited_lines(np.sum(np.abs(u) ** 2, axis=(1, 2)))
        scale = weight * np.sqrt(2.0 / PERIOD)
        return Spectra(2 * np.pi * lines / PERIOD, scale * u[lines], scale * y[lines], True)

    def error(self, simulated: Array, realisations: Sequence[int]) -> Array:
        """Compute relative errors of a simulation.

        Parameters
        ----------
        simulated : ndarray, shape (8192, 3, R)
            Simulated measurement, um.
        realisations : sequence of int
            Indices of realizations, 0 to 5.

        Returns
        -------
        ndarray, shape (4,)
            Relative errors, %: all sensors together, then each.
        """
        measured = self.measurement[:, :, realisations]
        squared = np.mean((measured - simulated[..., None]) ** 2, axis=(0, 2, 3))
        power = np.mean(measured**2, axis=(0, 2, 3))
        errors: Array = 100.0 * np.sqrt(np.concatenate([[squared.sum() / power.sum()], squared / power]))
        return errors


def load_levels() -> list[Level]:
    """Load the measurements of all levels.

    Raises
    ------
    InputError
        Where they are absent or have another shape than the benchmark's.
    """
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
    """Convert a modal model to the content of a model file.

    Parameters
    ----------
    modal : ModalModel
        Identified modal model.
    name : str
        Name of the model.
    command : float
        Largest voltage of the fitted records, V.

    Returns
    -------
    Model
        Model in V and um.
    """
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
    """Simulate the steady period for periodic commands: the period runs twice, and the second run counts.

    Parameters
    ----------
    model : Model
        Model to simulate.
    command : ndarray, shape (8192, 3, R)
        Periodic commands, V.

    Returns
    -------
    ndarray, shape (8192, 3, R)
        Simulated measurement, um.
    """
    simulated = [simulate(model, np.tile(command[:, :, r], (2, 1)))[PERIOD:] for r in range(command.shape[2])]
    return np.stack(simulated, axis=2)


def simulation_error(model: Model, level: Level, realisations: Sequence[int]) -> Array:
    """Compute the relative errors of a model simulated from the command alone.

    Parameters
    ----------
    model : Model
        Model to simulate.
    level : Level
        Records of one level.
    realisations : sequence of int
        Indices of realizations, 0 to 5.

    Returns
    -------
    ndarray, shape (4,)
        Relative errors, %: all sensors together, then each.
    """
    return level.error(steady_state(model, level.command[:, :, realisations].mean(axis=3)), realisations)


def response_error(response: np.ndarray, lines: Array, level: Level, realisations: Sequence[int]) -> Array:
    """Compute the relative errors of a nonparametric frequency response.

    Parameters
    ----------
    response : ndarray, shape (F, 3, 3)
        Response, um/V.
    lines : ndarray, shape (F,)
        Its lines of the period, as integers.
    level : Level
        Records of one level.
    realisations : sequence of int
        Indices of realizations, 0 to 5.

    Returns
    -------
    ndarray, shape (4,)
        Relative errors, %: all sensors together, then each.
    """
    u = np.fft.rfft(level.command[:, :, realisations].mean(axis=3), axis=0)
    y = np.zeros_like(u)
    y[lines] = np.einsum("koj,kjr->kor", response, u[lines])
    return level.error(np.fft.irfft(y, PERIOD, axis=0), realisations)


def fit_level(level: Level, order: int) -> Candidate:
    """Fit a level's linear model on realizations 1-4 and evaluate it on the fifth.

    Parameters
    ----------
    level : Level
        Records of one level.
    order : int
        Number of real states.

    Returns
    -------
    Candidate
        Fit with its relative error on the fifth realization.
    """
    data = [level.spectra(FIT)]
    fit = refined(data, subspace(data, [order], np.zeros(3), "zoh")[0], True, False, 25)
    return replace(fit, held_out=error_of(fit.model, [level.spectra(SELECT)]))


def smallest_first(found: Sequence[Candidate]) -> list[Candidate]:
    """Put the chosen candidate first: the smallest one within 1 % of the best on the fifth realization.

    Parameters
    ----------
    found : sequence of Candidate
        Candidates with their error on the fifth realization.

    Returns
    -------
    list of Candidate
        The same candidates, reordered.
    """
    good = 1.01 * min(fit.held_out for fit in found)
    return sorted(found, key=lambda fit: (fit.held_out > good, fit.model.states))


def fit_all(levels: Sequence[Level], order: int, hold: str = "zoh") -> Candidate:
    """Fit one linear model for all levels, with the same weight for every level's relative error.

    Parameters
    ----------
    levels : sequence of Level
        Records of all levels.
    order : int
        Number of real states.
    hold : str
        Behavior of the command between samples: "zoh" or "foh".

    Returns
    -------
    Candidate
        Fit on realizations 1-4.
    """
    data = [level.spectra(FIT, 1.0 / float(np.std(level.measurement))) for level in levels]
    start = subspace(data, [order], np.zeros(3), hold)[0]
    return refined(data, start, True, False, 25)


def run(json_path: str | Path | None = None, figures_dir: str | Path | None = None) -> Table:
    """Compare every model on every level and return the table.

    Parameters
    ----------
    json_path : str or Path or None
        JSON file to write the table to; None: none.
    figures_dir : str or Path or None
        Folder for the spectra, the model file and the table of shares; None: none.

    Returns
    -------
    Table
        All rows of the experiment.

    Raises
    ------
    InputError
        Where the measurements are absent.
    """
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
        forced = list(pool.map(soften, [levels] * len(LAWS), [mean.scheduled] * len(LAWS), LAWS))
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
        (folder / "fsm_cubespec_shares.md").write_text(shares_page(table), encoding="utf-8")
    if json_path is not None:
        table.write(json_path)
    return table


def soften(levels: Sequence[Level], start: ModalModel | softening_modes.Scheduled, law: Law | None) -> softening_modes.SofteningFit:
    """Fit one model for all levels on realizations 1-4, with or without a softening force and hysteresis of the actuators.

    Parameters
    ----------
    levels : sequence of Level
        Records of all levels.
    start : ModalModel or softening_modes.Scheduled
        Model from which the fit starts.
    law : Law or None
        Law of the softening force and the hysteresis; None: neither.

    Returns
    -------
    softening_modes.SofteningFit
        Fit with its scheduled model.
    """
    periods = [
        softening_modes.Level(level.command[:, :, FIT].mean(axis=3), level.measurement[:, :, FIT].mean(axis=3)) for level in levels
    ]
    steps = (20, 8)
    if law is None:
        return softening_modes.fit_softening(periods, start, periods[1].amplitude, SAMPLE_TIME, force=False, iterations=steps)
    return softening_modes.fit_softening(
        periods, start, periods[1].amplitude, SAMPLE_TIME, exponent=law.exponents, stops=law.stops, iterations=steps
    )


def softening_model(found: softening_modes.SofteningFit, levels: Sequence[Level]) -> Model:
    """Convert a fit to the content of a model file, with the median noise of one period over all realizations.

    The median, because the periods of realizations 2 and 3 at 100 mV differ six times as much as those of the others.

    Parameters
    ----------
    found : softening_modes.SofteningFit
        Fit of the model of all levels.
    levels : sequence of Level
        Records of all levels.

    Returns
    -------
    Model
        Model with noise and tolerances.
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
    """Count the real states: two for a complex mode, and as many again where the force acts.

    Parameters
    ----------
    found : softening_modes.SofteningFit
        Fit of the model of all levels.

    Returns
    -------
    int
    """
    return found.scheduled.centre.states * (2 if np.ndim(found.stage.force_inputs) else 1)


def report_linear(table: Table, levels: Sequence[Level], fits: Sequence[Sequence[Candidate]], models: Sequence[Model]) -> None:
    """Add the error of each level's model on its own level, and the numbers of states that were tried.

    Parameters
    ----------
    table : Table
        Table to which rows are added.
    levels : sequence of Level
        Records of all levels.
    fits : sequence of sequence of Candidate
        Candidates of each level, the chosen one first.
    models : sequence of Model
        Linear models, one per level.
    """
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

    Parameters
    ----------
    table : Table
        Table to which rows are added.
    levels : sequence of Level
        Records of all levels.
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
    """Add the errors of each level's model on the other levels.

    Parameters
    ----------
    table : Table
        Table to which rows are added.
    levels : sequence of Level
        Records of all levels.
    models : sequence of Model
        Linear models, one per level.
    """
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
    """Add the errors of one model of all levels on the sixth realization and the fifth, its size and its speed.

    Parameters
    ----------
    table : Table
        Table to which rows are added.
    levels : sequence of Level
        Records of all levels.
    subject : str
        Name of the model in the table.
    model : Model
        Model to simulate.
    states : int
        Number of real states.
    parameters : int
        Number of parameters.
    seconds : float
        Duration of the fit, s.

    Returns
    -------
    float
        Root mean square over the levels of the errors on the fifth realization, %.
    """
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
    """Add candidate forces beside each level's linear model (`fsm_cubespec_laws`): fifth realization, to choose on, and sixth.

    Parameters
    ----------
    table : Table
        Table to which rows are added.
    levels : sequence of Level
        Records of all levels.
    models : sequence of ModalModel
        Linear modal models, one per level.
    """
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
}
"""The parts of the chosen model, and the parameters that switch each off."""


def report_shares(table: Table, levels: Sequence[Level], model: Model) -> None:
    """Add each effect's share of the gap between the linear simulator and the mirror.

    The linear simulator is the chosen model with every effect off. Shapley values of the mean square error on the sixth realization: an
    effect's share is the mean of its reduction over all orders in which the effects can be switched on. Nothing is fitted again. The
    noise is that of the measured period, the rest is not explained; all add up to the gap.

    Parameters
    ----------
    table : Table
        Table to which rows are added.
    levels : sequence of Level
        Records of all levels.
    model : Model
        Chosen model of all levels.
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


def shares_page(table: Table) -> str:
    """Format the shares as a Markdown table, effect by effect, with the gap in % of rms in the last row.

    Parameters
    ----------
    table : Table
        Table with the rows of `report_shares`.

    Returns
    -------
    str
        Markdown text.
    """
    rows = [row for row in table.rows if row.table == SHARES]
    cases = list(dict.fromkeys(row.case for row in rows))
    names = dict.fromkeys(row.subject for row in rows if row.quantity == "share")
    value = {(row.subject, row.case): row.value for row in rows}
    lines = [f"| share of the gap's mean square, % | {' | '.join(cases)} |", "|---|" + "---|" * len(cases)]
    lines += [f"| {name} | {' | '.join(f'{value[name, case]:.1f}' for case in cases)} |" for name in names]
    gaps = [f"{value['linear simulator', case]:.1f}" if ("linear simulator", case) in value else "" for case in cases]
    return "\n".join([*lines, f"| the gap itself, % of rms | {' | '.join(gaps)} |", ""])


def report_residual(table: Table, levels: Sequence[Level], model: Model) -> None:
    """Add the chosen model's residual by frequency band: each band's share of it, and the band's own relative error.

    Parameters
    ----------
    table : Table
        Table to which rows are added.
    levels : sequence of Level
        Records of all levels.
    model : Model
        Chosen model of all levels.
    """
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
    """Draw the measured, error and noise spectra of every level's linear model.

    Parameters
    ----------
    folder : Path
        Folder for the figure; created if missing.
    levels : sequence of Level
        Records of all levels.
    models : sequence of Model
        Linear models, one per level.
    """
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
