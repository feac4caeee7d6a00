# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Models for scripts and notebooks: identified from records, scored, drawn, inverted, and handed to other programs."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from hyst_control import model_file
from hyst_control.api.record import Record, from_arrays, keywords, record_of, records_of
from hyst_control.api.shown import SEED, Shown, drawn, needed, promoted, rows_for, step_of, table_frame
from hyst_control.base import progress
from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.quantity import TEXT, Quantity
from hyst_control.chain.coordinates import chain_coordinates
from hyst_control.control.feedback.loop import feedforward_rows
from hyst_control.control.feedforward.compensator import Compensator, build_compensator, drive_limits
from hyst_control.control.feedforward.whole_inverse import lifted_inverse
from hyst_control.control.linearization import hysteresis_slopes, linearized
from hyst_control.control.model_figures import beside, bode_of, poles_and_zeros
from hyst_control.control.state_space import state_space
from hyst_control.identify.assess.choice_figure import choice_panels
from hyst_control.identify.assess.explained_share import NOTHING
from hyst_control.identify.assess.fit_report import residual
from hyst_control.identify.data.fit import Report
from hyst_control.identify.validation import compared_stretches, validate_record
from hyst_control.identify.workflow import fit_text, identify_records
from hyst_control.reporting.signal_figures import over_time
from hyst_control.reporting.tables import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from scipy.signal import StateSpace

KINDS = ("hampi", "mhl_inverse", "mhl")
"""Compensators that a model is inverted by, the first that fits it: both papers' of hysteresis and dynamics, and that of slow motion."""

START = Quantity("start", None, "", "state at the first row", choices=("settled", "unknown", "auto"), kind=TEXT)


@dataclass(frozen=True)
class Score(Shown):
    """Errors of a model on a record.

    Parameters
    ----------
    table
        NRMSE, NME and RMSE of every axis, on the whole record and by frequency and amplitude.
    r2
        Coefficient of determination of the worst axis: 1 for a perfect model, 0 for one that is no better than a constant.
    model, record
        What was scored, and on what.

    Examples
    --------
    >>> score = model.score(record)
    >>> score.nrmse < 0.1, score.r2 > 0.999
    (True, True)
    """

    table: Table
    r2: float
    model: model_file.Model = field(repr=False)
    record: Record = field(repr=False)

    @property
    def nrmse(self) -> float:
        """Rms error in % of the measured range, of the worst axis."""
        return max(row.value for row in self.table.rows if row.table == "validation" and row.quantity == "nrmse")

    def __float__(self) -> float:
        return self.r2

    def summary(self) -> str:
        """The table as text."""
        return f"{self.table.text()}\nR2 {self.r2:.6f}"

    def to_frame(self) -> Any:
        """The table as a pandas DataFrame."""
        return table_frame(self.table)

    def plot(self, path: str | Path | None = None) -> list[Axes]:
        """Draw measured and simulated signals and the residual, as `Model.plot` does, and write them to a file where `path` is given."""
        return drawn(beside(self.model, self.record), f"{self.model.name} on {self.record.source}", path)


@dataclass(frozen=True)
class Model(model_file.Model, Shown):
    """A model of a stage: the chain from command to measurement, and what is known about it.

    Parameters
    ----------
    name, axes, units, sample_time, chain, hold, valid, noise, tolerance, uncertainty, discrepancy
        As in the model file.
    report
        Errors and parameters of the fit; None of a model that was loaded.

    Examples
    --------
    >>> model.units["measurement"]
    'um'
    >>> simulated = model.simulate(command, rate=1000)
    >>> len(simulated) == len(command)
    True
    >>> system = model.linear(rate=1000)                # scipy.signal; control.ss(system.A, system.B, system.C, system.D, system.dt)
    >>> len(model.bode(record))                         # magnitude, phase and coherence
    3
    >>> len(model.plot(record))                         # signals, residual, loops and correlations
    4
    >>> len(model.plot_poles())                         # in the plane of s, an axis each
    1
    """

    report: Report | None = field(default=None, compare=False)

    def summary(self) -> str:
        """The chain, its range, and the fit where there was one."""
        stages = " -> ".join(stage.name for stage in self.chain.stages)
        lines = [
            f"{self.name}: {', '.join(self.axes)}, V to {self.units['measurement']}, {1.0 / self.sample_time:g} Hz",
            f"  {stages}",
        ]
        if "command" in self.valid:
            lines.append(f"  valid for commands {_range(self.valid['command'])} V")
        return "\n".join(lines if self.report is None else [*lines, fit_text(self.report)])

    def to_frame(self) -> Any:
        """The parameters as a pandas DataFrame: those of the fit with their standard errors, or all numbers of the chain."""
        if self.report is not None:
            return needed("pandas").DataFrame(self.report["parameters"])
        numbers = chain_coordinates(self.chain.stages, self.axes)
        rows = [{"name": name, "value": each.value, "unit": each.unit} for name, each in numbers.items()]
        return needed("pandas").DataFrame(rows)

    def simulate(self, command: ArrayLike, rate: float | None = None, *, seed: int | None = None) -> Record:
        """Simulate the stage, at rest at the first command.

        The command (N,) or (N, A) in V, at a rate in Hz, the model's by default. A seed adds the model's noise, drawn with it.
        """
        rows, sample_time = rows_for("command", command, self.axes), step_of(rate, self.sample_time)
        measurement = np.array(model_file.simulate(self, rows, sample_time))
        if seed is not None:
            sigma = np.asarray(self.noise.get("sigma", 0.0), dtype=float)
            measurement += sigma * np.random.default_rng(SEED.checked(seed)).standard_normal(measurement.shape)
        return from_arrays(
            rows, measurement, 1.0 / sample_time, unit=self.units["measurement"], axes=self.axes, hold=self.hold, source=self.name
        )

    def score(self, record: Record) -> Score:
        """Score the model on a record that it was not fitted to: errors; as a number the coefficient of determination."""
        record = record_of("record", record)
        table = validate_record({self.name: self}, record, "score")
        shares = []
        for data in compared_stretches(record, self):
            error = residual(self, data)
            with np.errstate(divide="ignore", invalid="ignore"):  # minus infinity of what does not move
                shares.append(1.0 - np.mean(error**2, axis=0) / np.var(data.measurement[-len(error) :], axis=0))
        return Score(table, float(np.min(shares)), self, record)

    def plot(self, record: Record, path: str | Path | None = None) -> list[Axes]:
        """Draw measured and simulated signals of a record, what is left, the loops, and how what is left correlates.

        Give a path to write the figure as well: .png, .svg, .pdf or .html. Returns the axes of matplotlib.
        """
        return drawn(beside(self, record_of("record", record)), f"{self.name} on {record.source}", path)

    def bode(self, record: Record | None = None, path: str | Path | None = None) -> list[Axes]:
        """Draw the frequency response, the hysteresis replaced by its mean slope, over that of a record where one is given.

        Give a path to write the figure as well, as in `plot`.
        """
        return drawn(bode_of(self, record and record_of("record", record)), self.name, path)

    def plot_poles(self, path: str | Path | None = None) -> list[Axes]:
        """Draw poles and zeros, the hysteresis replaced by its mean slope, and write them to a file where `path` is given."""
        return drawn(poles_and_zeros(self), self.name, path)

    def plot_choice(self, path: str | Path | None = None) -> list[Axes]:
        """Draw what the identification chose among, the error on held-out rows over the number of parameters."""
        if self.report is None:
            raise InputError(f"{self.name}: was loaded, and its file does not say among what it was chosen: identify it")
        return drawn(choice_panels(self.report), self.name, path)

    def linear(self, rate: float | None = None) -> StateSpace:
        """The linear part as a discrete system of scipy, from the held command to the measurement, delays included.

        The hysteresis is replaced by its mean slope.

        Parameters
        ----------
        rate
            Sample rate, Hz; the model's by default.

        Returns
        -------
        scipy.signal.StateSpace
            For python-control: ``control.ss(system.A, system.B, system.C, system.D, system.dt)``.
        """
        from scipy.signal import StateSpace

        sample_time = step_of(rate, self.sample_time)
        mean, _ = hysteresis_slopes(self)
        return StateSpace(*state_space(linearized(self, mean), len(self.axes), sample_time), dt=sample_time)

    def inverse(self, rate: float | None = None, *, limits: tuple[ArrayLike, ArrayLike] | None = None) -> Inverse:
        """The feedforward of the model: a function from a reference to the command.

        Parameters
        ----------
        rate
            Sample rate, Hz; the model's by default.
        limits
            Lower and upper limit of the command, V; the model's valid range by default.

        Returns
        -------
        Inverse
            Of hysteresis and dynamics.
        """
        sample_time = step_of(rate, self.sample_time)
        sides = [np.size(side) in (1, len(self.axes)) for side in limits] if np.iterable(limits) else []
        if limits is not None and sides != [True, True]:
            raise InputError(
                f"limits: must be lower and upper, each a number or one for each of {', '.join(self.axes)}, got {limits!r}"
            )
        drive_limits(self, limits)
        refused = ""
        for kind in KINDS:
            try:
                compensator = build_compensator(self, kind, sample_time=sample_time, limits=limits)
            except InputError as error:
                refused = f"{kind}: {error}"
                continue
            found = Inverse(self, sample_time, limits, compensator, refused)
            if found.left_out:
                logging.getLogger("hyst_control").warning("inverse of %s: %s", self.name, found.left_out)
            return found
        return Inverse(self, sample_time, limits)

    def save(self, path: str | Path) -> None:
        """Write the model file (YAML) to `path`, which the commands and nodes read."""
        model_file.save_model(self, path)


@dataclass(frozen=True)
class Inverse(Shown):
    """Feedforward of a model: called with a reference, it gives the command.

    Parameters
    ----------
    model
        The model that is inverted.
    sample_time
        Sample time, s.
    limits
        Lower and upper limit of the command, V; None: the model's.
    compensator
        The streaming compensator that the node of the feedforward runs; None: the model has none, and is inverted over the whole
        reference by iterations.
    refused
        The better inverse that the model has not, and why; empty if there is none.

    Examples
    --------
    >>> feedforward = model.inverse()
    >>> reference = 2 - np.cos(2 * np.pi * 50 * np.arange(5000) / 50e3)     # begins at rest
    >>> error = model.simulate(feedforward(reference)).signal("measurement").values[:, 0] - reference
    >>> bool(np.abs(error).max() < 0.03)
    True
    >>> print(feedforward)
    inverse of pea_hampi at 50000 Hz
      commands 0 to 50 V
      looks 2 samples ahead
    >>> len(feedforward.plot(reference))                # motion and command
    2
    """

    model: Model
    sample_time: float
    limits: tuple[ArrayLike, ArrayLike] | None = None
    compensator: Compensator | None = None
    refused: str = ""

    @property
    def left_out(self) -> str:
        """Sentence on the parts of the model that are not inverted, and why; empty if all are."""
        parts = self.compensator.left_out if self.compensator else ()
        return f"leaves out {', '.join(parts)} ({self.refused})" if parts else ""

    def summary(self) -> str:
        """Model, rate, limits and method of the inverse, and what it leaves out."""
        lines = [f"inverse of {self.model.name} at {1.0 / self.sample_time:g} Hz"]
        if self.limits is not None:
            lines.append(f"  commands {_range(np.transpose(np.asarray(self.limits)))} V")
        elif "command" in self.model.valid:
            lines.append(f"  commands {_range(self.model.valid['command'])} V")
        how = f"looks {self.compensator.preview} samples ahead" if self.compensator else "iterates over the whole reference"
        return "\n".join([*lines, f"  {how}", *([f"  {self.left_out}"] if self.left_out else [])])

    def plot(self, reference: ArrayLike, path: str | Path | None = None) -> list[Axes]:
        """Draw a reference, the motion that the model predicts for its command, and the command.

        The reference (N,) or (N, A) in the measurement unit begins at rest. Give a path to write the figure as well, as in
        `Model.plot`.
        """
        wanted = rows_for("reference", reference, self.model.axes)
        predicted = self.model.simulate(self(wanted), 1.0 / self.sample_time)
        motion = predicted.signal("measurement")
        signals = {"reference": replace(motion, values=wanted), "predicted": motion, "command": predicted.signal("command")}
        return drawn(over_time(replace(predicted, signals=signals)), f"inverse of {self.model.name}", path)

    def __call__(self, reference: ArrayLike) -> Array:
        """Command (N, A), V, of a reference (N,) or (N, A) in the measurement unit that begins at rest."""
        rows = rows_for("reference", reference, self.model.axes)
        if self.compensator is None:
            command = lifted_inverse(self.model, rows, sample_time=self.sample_time, limits=self.limits).command
        else:
            command = feedforward_rows(rows, self.compensator)
        self._warn_of_limits(rows, command)
        return command

    def _warn_of_limits(self, reference: Array, command: Array) -> None:
        """Warn of commands (N, A) at their limits while the reference (N, A) is away from where it rests at the beginning."""
        lower, upper = drive_limits(self.model, self.limits)
        held = np.any(((command <= lower) | (command >= upper)) & (reference != reference[0]), axis=1)
        if held.any():
            logging.getLogger("hyst_control").warning(
                "inverse of %s: the command stands at its limits in %d of %d samples: change offset or amplitude of the reference, or "
                "give limits",
                self.model.name,
                np.count_nonzero(held),
                len(held),
            )


def identify(
    records: Record | Sequence[Record],
    family: str | None = None,
    *,
    method: str = "joint",
    start: str = "auto",
    allow_gaps: bool = False,
    force: bool = False,
    verbose: bool = True,
    **options: Any,
) -> Model:
    """Identify a model from one record or several of one stage.

    Parameters
    ----------
    records
        Command and measurement.
    family
        Model family, such as "hampi" or "linear"; None: the best of several on held-out data.
    method
        "joint": from all at once; "paper", where the family has it: in its paper's sequence.
    start
        "settled" at the first command, "unknown", or "auto", found from the record.
    allow_gaps
        Use the stretches between lost samples.
    force
        Fit records, too, that are no measurement of their command.
    verbose
        Print what was tried.
    **options
        Options of the family, as `hyst identify --help` lists them.

    Returns
    -------
    Model
        The model, with the report of the fit.

    Raises
    ------
    InputError
        The records do not determine a model, or an option does not exist.

    Examples
    --------
    >>> found = hc.identify(record, family="pi", operators=4, verbose=False)
    >>> found.report["family"], found.score(record).nrmse < 4
    ('pi', True)
    """
    START.checked(start)
    if "model" in options:
        raise InputError(f"model: the argument is called family: give family={options['model']!r}")
    given = records_of("records", records)
    with progress.shown(verbose), keywords():
        fit = identify_records(given, family, method=method, start=start, allow_gaps=allow_gaps, force=force, **options)
    if fit.report["verdict"] == NOTHING and not force:
        raise InputError(fit.report["notes"][0])
    if verbose:
        print(fit_text(fit.report))
    return promoted(Model, fit.model, report=fit.report)


def load_model(path: str | Path) -> Model:
    """Read a model file, or a shipped model by its name.

    Parameters
    ----------
    path
        YAML file, or a name such as "pea_hampi".

    Returns
    -------
    Model
        The model.

    Raises
    ------
    InputError
        The file cannot be read or makes no sense.

    Examples
    --------
    >>> import hyst_control as hc
    >>> print(hc.load_model("pea_hampi"))
    pea_hampi: x, V to um, 50000 Hz
      modified_prandtl_ishlinskii -> transfer_function
      valid for commands 0 to 50 V
    """
    from hyst_control.base.config_files import config_path

    named = str(path)
    shipped = not Path(path).exists() and named.isidentifier()
    return promoted(Model, model_file.load_model(config_path(f"models/{named}.yaml") if shipped else path))


def model_of(given: Any) -> model_file.Model:
    """The model that is given; refuses anything else, such as a file's name."""
    if not isinstance(given, model_file.Model):
        raise InputError(f"model: {type(given).__name__} is no Model: make one by hc.load_model or hc.identify")
    return given


def _range(valid: Any) -> str:
    return ", ".join(f"{low:g} to {high:g}" for low, high in np.reshape(np.asarray(valid, dtype=float), (-1, 2)))
