# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A measured piezo stack: PI PICMA P-885.91 on a flexure stage (Aye & Ang, "A Discrete Backlash Operator …", ICSTSD 2018).

Nested quasi-static loops at 1 Hz, 200 Hz sampling. Models are fitted on one full cycle of the first file and predict the
nested loops of the second, rows 7950-14150, from its command alone, everything before included as memory. NRMSE is over the
range of those rows with the mean removed: the sensor's zero differs between the files.

A command holds until the next one and the sample is taken before that acts (`hold: zoh`), the convention under which a static
model does better on either file. What is left is a lag of two to four samples, which a rate-independent model cannot have: it
is shown as a model of its own, its delay fitted on the same cycle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, cast

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from evaluation.reproduction.generalized_play import fit_generalized_play
from evaluation.reproduction.measured_data import data_folder
from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.identify import identify
from hyst_control.identify.assess.fit_report import record_rows, residual
from hyst_control.identify.data.dataset import Dataset
from hyst_control.identify.data.initial_memory import with_beginning
from hyst_control.identify.data.reversal_points import turning_points
from hyst_control.model_file import Model, simulate
from hyst_control.reporting.tables import Table

SAMPLE_TIME = 5e-3
SCORED = {"rows 7950-14150": slice(7950, 14150), "rows 7950-11950": slice(7950, 11950)}
"""Rows of the second file: loops whose amplitude shrinks and grows again, with and without the full loops that follow."""
OPERATORS = 12
GENERALIZED = {False: "one curve", True: "a curve each way"}
CUT = 4700
"""Rows cut off the second file's beginning, its first third."""


@dataclass(frozen=True)
class Change:
    """Change of a record as another amplifier or sensor would have it: command sign · u + shift (V), measurement factor · y + zero (um)."""

    sign: float
    shift: float
    factor: float
    zero: float

    def of(self, record: Dataset, cut: int = 0) -> Dataset:
        """Change a record and cut off its first rows; how it begins is for the identification to find."""
        command = self.sign * record.command[cut:] + self.shift
        return replace(
            record, command=command, measurement=self.factor * record.measurement[cut:] + self.zero, start="auto", beginning=None
        )


CHANGES = {
    "bipolar drive": Change(1.0, -1.8, 1.0, 0.0),
    "bipolar drive, other zero": Change(1.0, -1.8, 1.0, 5.0),
    "negative drive": Change(-1.0, 0.0, 1.0, -3.0),
    "inverted bipolar drive and sensor": Change(-1.0, 1.5, -1.0, 2.0),
    "offset drive": Change(1.0, 2.5, 1.0, 0.0),
}
"""Other signs, offsets and beginnings of the same measurements; their first third is cut off besides."""


@dataclass(frozen=True)
class Prediction:
    """A model by name, its error on the cycle it was fitted on (% of range), and the second file as it predicts it (N,)."""

    name: str
    fitted: float
    predicted: Array


def load() -> tuple[Dataset, Dataset]:
    """Load the two files: full loops and nested loops."""
    folder = data_folder("pea_p885")
    records = []
    for name, columns in (("Model_Vi_Do.dat", 7), ("Test_Vi_Do_Di.dat", 11)):
        try:
            values = np.loadtxt(folder / name)
        except (OSError, ValueError) as error:
            raise InputError(f"{folder / name}: cannot be read ({error}): fetch the file again") from None
        if values.ndim != 2 or values.shape[1] != columns or len(values) < 8000:
            raise InputError(f"{folder / name}: shape {values.shape}, {columns} columns are due: fetch the file again")
        command, measurement = values[:, [0]].copy(), values[:, [4]].copy()
        records.append(Dataset(name, command, measurement, SAMPLE_TIME, ("x",), "um", "zoh", "unknown"))
    return records[0], records[1]


def cycles(record: Dataset) -> list[Dataset]:
    """Split the first file into full cycles, each from one lowest command to the next."""
    command = record.command[:, 0]
    turns = turning_points(command)
    lowest = [int(turn) for turn in turns if command[turn] < 0.02 * command.max()]
    return [replace(record.rows(begin, end + 1), name=f"cycle {i + 1}") for i, (begin, end) in enumerate(zip(lowest, lowest[1:]))]


def score(measured: Annotated[Array, "N"], predicted: Annotated[Array, "N"]) -> float:
    """Compute the NRMSE in % of the measured range, means removed."""
    return 100.0 * float(np.std(measured - predicted)) / float(np.ptp(measured))


def predict(model: Model, record: Dataset) -> Annotated[Array, "N"]:
    """Predict a record from its command."""
    return simulate(model, record.command)[:, 0]


def fitted_error(model: Model, cycle: Dataset) -> float:
    """Compute the error of a model on the cycle it was fitted on."""
    return float(record_rows(model, [cycle])[0][0]["nrmse_centered"])


def nested_branches(
    command: Annotated[Array, "N"], up: Callable[[float], float], down: Callable[[float], float], rule: str
) -> Annotated[Array, "N"]:
    """Apply Madelung's rules with one of three branch rules.

    From a turning point A back to B: "scaled" moves the major curve to A and scales it in y to meet B; "affine" stretches it in
    both directions; "moved" only moves it, and jumps where it rejoins an outer branch.
    """
    stack = [(1.0, 1.0), (0.0, 0.0)]
    u, y, direction = 0.0, 0.0, 1.0
    output = np.empty(len(command))
    for k, value in enumerate(command):
        heading = 1.0 if value > u else -1.0
        if value <= 0.0 or value >= 1.0:
            stack = [(1.0, 1.0), (0.0, 0.0)] if value <= 0.0 else [(0.0, 0.0), (1.0, 1.0)]
            u, y = stack[-1]
            direction = heading
        elif value != u:
            if heading != direction and stack[-1][0] != u:
                stack.append((u, y))
            direction = heading
            while len(stack) > 2 and (value - stack[-2][0]) * direction >= 0.0:
                del stack[-2:]
            (a, y_a), (b, y_b) = stack[-1], stack[-2]
            distance, whole = abs(value - a), abs(b - a)

            def curve(d: float, rising: bool = direction > 0) -> float:
                return up(d) if rising else 1.0 - down(1.0 - d)

            if rule == "moved":
                y = y_a + direction * curve(distance)
            elif rule == "affine":
                y = y_a + (y_b - y_a) * curve(distance / whole)
            else:
                y = y_a + (y_b - y_a) * curve(distance) / curve(whole)
            u = value
        output[k] = y
    return output


def other_branches(model: Model, record: Dataset, rule: str) -> Annotated[Array, "N"]:
    """Predict a record from a Madelung model's curves with another branch rule, under the record's own timing."""
    stage = model.chain.stages[0]
    assert isinstance(stage, Madelung), f"{stage.name} has no branches"
    rising, falling = stage.curves(1)[0]
    full = float(rising(np.ones(1))[0])
    normalised = np.clip((record.command[:, 0] - stage.input_offset) / stage.input_scale, 0.0, 1.0)
    turned = nested_branches(
        normalised, lambda x: float(rising(np.array([x]))[0]) / full, lambda x: float(falling(np.array([x]))[0]) / full, rule
    )
    output_scale = cast(float, stage.output_scale)  # of a single axis
    return np.asarray(output_scale * full * np.concatenate([turned[:1], turned[:-1]]), dtype=np.float64)


def with_delay(cycle: Dataset, record: Dataset) -> tuple[Prediction, float]:
    """Fit a Madelung model behind a delay on a cycle and predict a record; the command is linear between its samples."""

    def fitted(delay: float) -> tuple[Model, float]:
        late = replace(cycle, command=shifted(cycle.command, delay))
        model = identify([late], "madelung").model
        return model, fitted_error(model, late)

    delay = float(minimize_scalar(lambda tau: fitted(tau)[1], bounds=(0.0, 10 * SAMPLE_TIME), method="bounded").x)
    model, error = fitted(delay)
    rows = np.arange(len(record.command))
    command = np.interp(rows - delay / SAMPLE_TIME, rows, record.command[:, 0])
    return Prediction("Madelung, quintic, behind a delay", error, predict(model, replace(record, command=command[:, None]))), delay


def shifted(command: Annotated[Array, "N 1"], delay: float) -> Annotated[Array, "N 1"]:
    """Delay a closed cycle, linear between its samples."""
    n = len(command) - 1
    late: Array = np.interp(np.arange(n + 1) - delay / SAMPLE_TIME, np.arange(n + 1), command[:, 0], period=n)[:, None]
    return late


def odd_map(command: Annotated[Array, "N"], highest: float, coefficients: Annotated[Array, "C"]) -> Array:
    """Apply the input map of Hammerstein-like models: c (1 + x + c3 x³ + c5 x⁵ + …).

    x is the distance from mid-drive c, relative to c.
    """
    center = 0.5 * highest
    x = (command - center) / center
    mapped: Array = center * (1.0 + x + sum(value * x ** (2 * i + 3) for i, value in enumerate(coefficients)))
    return mapped


def mapped_operators(cycle: Dataset, record: Dataset, count: int) -> Prediction:
    """Fit play operators behind an odd polynomial of the command, both on the cycle."""
    highest = float(cycle.command.max())

    def fitted(coefficients: Array) -> tuple[Model, float]:
        mapped = replace(cycle, command=odd_map(cycle.command, highest, coefficients))
        model = identify([mapped], "pi", operators=OPERATORS, nuisance="offset").model
        return model, fitted_error(model, mapped)

    options = {"xatol": 1e-3, "fatol": 1e-4, "maxfev": 60 * count}
    found = minimize(lambda numbers: fitted(numbers)[1], np.zeros(count), method="Nelder-Mead", options=options).x
    model, error = fitted(found)
    predicted = predict(model, replace(record, command=odd_map(record.command, highest, found)))
    return Prediction(f"play operators behind an odd polynomial of degree {2 * count + 1}", error, predicted)


def predictions(cycle: Dataset, record: Dataset) -> list[Prediction]:
    """Fit every static model on one cycle and predict the second file."""
    found: list[Prediction] = []
    quintic = identify([cycle], "madelung").model
    found.append(Prediction("Madelung, quintic", fitted_error(quintic, cycle), predict(quintic, record)))
    cubic = identify([cycle], "madelung", knots=np.linspace(0.0, 1.0, 6)).model
    found.append(Prediction("Madelung, piecewise cubic", fitted_error(cubic, cycle), predict(cubic, record)))
    for rule in ("affine", "moved"):
        # The major loop is the same, so the curves are too.
        found.append(Prediction(f"Madelung, {rule} branches", fitted_error(quintic, cycle), other_branches(quintic, record, rule)))
    for one_sided in (False, True):
        model = identify([cycle], "pi", operators=OPERATORS, one_sided=one_sided, nuisance="offset").model
        name = f"{OPERATORS} play operators, {'one' if one_sided else 'two'}-sided"
        found.append(Prediction(name, fitted_error(model, cycle), predict(model, record)))
    found += [mapped_operators(cycle, record, count) for count in (1, 2)]
    found += [generalized_operators(cycle, record, each_way) for each_way in (False, True)]
    return found


def generalized_operators(cycle: Dataset, record: Dataset, each_way: bool) -> Prediction:
    """Fit generalized play operators, whose edges bend, on a cycle and predict a record."""
    measured, thresholds = cycle.measurement[:, 0], np.linspace(0.0, 0.5, OPERATORS, endpoint=False)
    model = fit_generalized_play(cycle.command[:, 0], measured, thresholds, each_way=each_way)
    name = f"{OPERATORS} generalized play operators, {GENERALIZED[each_way]}"
    return Prediction(name, 100.0 * model.fitted / float(np.ptp(measured)), model.predict(record.command[:, 0]))


def run(json_path: str | Path | None = None, figures_dir: str | Path | None = None) -> Table:
    """Compare every static model on held-out loops and return the table."""
    full, nested = load()
    available = cycles(full)
    table = Table("reproduce pea-p885")
    first = available[0]
    found = predictions(first, nested)
    delayed, delay = with_delay(first, nested)
    report(table, [*found, delayed], nested)
    table.add("P-885.91, lag", first.name, delayed.name, "delay", "s", delay)
    report_cycles(table, available, nested)
    report_fitted_there(table, nested)
    report_changes(table, first, nested)
    if figures_dir is not None:
        draw(Path(figures_dir), [*found, delayed], nested)
    if json_path is not None:
        table.write(json_path)
    return table


def report(table: Table, found: Sequence[Prediction], nested: Dataset) -> None:
    """Add the held-out and fitted errors of every model."""
    title = "P-885.91, fitted on one cycle, nested loops held out"
    for model in found:
        for case, rows in SCORED.items():
            table.add(title, case, model.name, "nrmse", "%", score(nested.measurement[rows, 0], model.predicted[rows]))
        table.add(title, "the cycle itself", model.name, "nrmse", "%", model.fitted)


def report_cycles(table: Table, available: Sequence[Dataset], nested: Dataset) -> None:
    """Add the scatter of the error when other cycles are fitted."""
    found: dict[str, list[Array]] = {}
    for cycle in available[::4]:
        found.setdefault("Madelung, quintic", []).append(predict(identify([cycle], "madelung").model, nested))
        for each_way in GENERALIZED:
            play = generalized_operators(cycle, nested, each_way)
            found.setdefault(play.name, []).append(play.predicted)
    for name, predicted in found.items():
        for case, rows in SCORED.items():
            errors = [score(nested.measurement[rows, 0], each[rows]) for each in predicted]
            for quantity, value in (
                ("nrmse_mean", float(np.mean(errors))),
                ("nrmse_least", min(errors)),
                ("nrmse_greatest", max(errors)),
            ):
                table.add("P-885.91, every fourth cycle in turn", case, name, quantity, "%", value, n=len(errors))


def report_fitted_there(table: Table, nested: Dataset) -> None:
    """Add play operators fitted on the scored rows themselves: the least error that their predictions can reach."""
    for case, rows in SCORED.items():
        part = nested.rows(rows.start, rows.stop + 1)
        model = identify([part], "pi", operators=OPERATORS, nuisance="offset").model
        predicted = predict(model, nested)
        table.add(
            "P-885.91, fitted on the rows scored",
            case,
            f"{OPERATORS} play operators, two-sided",
            "nrmse",
            "%",
            score(nested.measurement[rows, 0], predicted[rows]),
        )


def report_changes(table: Table, cycle: Dataset, nested: Dataset) -> None:
    """Add the held-out error when signs, offsets and beginnings of the records are others."""
    for name, change in CHANGES.items():
        model = identify([change.of(cycle)], "madelung").model
        record = with_beginning(change.of(nested, CUT))
        error = residual(model, record)[:, 0]
        for case, rows in SCORED.items():
            behind = len(nested.command) - rows.stop
            part = error[len(error) - behind - (rows.stop - rows.start) : len(error) - behind]
            value = 100.0 * float(np.std(part)) / float(np.ptp(nested.measurement[rows, 0]))
            table.add(f"P-885.91, {name}, first third cut off", case, "Madelung, quintic", "nrmse", "%", value)


def draw(folder: Path, found: Sequence[Prediction], nested: Dataset) -> None:
    """Draw nested loops, measured and predicted, and the errors of every model over time."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    folder.mkdir(parents=True, exist_ok=True)
    rows = SCORED["rows 7950-11950"]
    measured = nested.measurement[rows, 0] - nested.measurement[rows, 0].mean()
    figure, (loops, errors) = plt.subplots(1, 2, figsize=(12, 5))
    loops.plot(nested.command[rows, 0], measured, color="black", linewidth=0.8, label="measured")
    best = found[0].predicted[rows] - found[0].predicted[rows].mean()
    loops.plot(nested.command[rows, 0], best, linewidth=0.8, label=found[0].name)
    loops.set_xlabel("command (V)")
    loops.set_ylabel("displacement (um)")
    loops.legend()
    time = SAMPLE_TIME * np.arange(rows.start, rows.stop)
    for model in found:
        predicted = model.predicted[rows] - model.predicted[rows].mean()
        errors.plot(time, measured - predicted, linewidth=0.7, label=model.name)
    errors.set_xlabel("time (s)")
    errors.set_ylabel("measured - predicted (um)")
    errors.legend(fontsize=7)
    for panel in (loops, errors):
        panel.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(folder / "pea_p885.png", dpi=120)
    plt.close(figure)
