# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Gaps between a model and the machine, for scripts and notebooks."""

from __future__ import annotations

import tempfile
import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hyst_control import model_file
from hyst_control.api.model import Model, model_of
from hyst_control.api.record import Record, keywords, records_of
from hyst_control.api.shown import SEED, Shown, drawn, needed, promoted
from hyst_control.base import progress
from hyst_control.base.errors import InputError
from hyst_control.base.quantity import NUMBER, Quantity
from hyst_control.chain.external_simulator import Simulate
from hyst_control.diagnose.workflow import GapResult, diagnose_records, diagnose_simulator

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WARM_UP = Quantity("warm_up", None, "s", "time that does not count", lower=0.0, kind=NUMBER)


@dataclass(frozen=True)
class Gap(GapResult, Shown):
    """The gap between model and machine, and the effects that explain it.

    Parameters
    ----------
    document
        The gap report, as `hyst diagnose --json` writes it.
    words
        The same in words.
    diagnosis
        What the page is drawn from; None where the record is no measurement of its command.
    better
        The model with the effects added; None where none was named, or where it comes no closer without re-fitted parameters.

    Examples
    --------
    >>> gap = hc.diagnose(record, model)
    >>> gap.verdict
    'no_gap'
    """

    @property
    def verdict(self) -> str:
        """no_gap, effect, ambiguous, parameters or unknown."""
        return str(self.document["verdict"])

    @property
    def model(self) -> Model | None:
        """The model with the effects added, its parameters as given; None where none was named or this comes no closer to the records."""
        return None if self.better is None else promoted(Model, self.better)

    def summary(self) -> str:
        """The report in words."""
        return self.words

    def to_frame(self) -> Any:
        """Parameters of the effects, and below those of the model that are off, as a pandas DataFrame; a row a parameter."""
        effects = [
            {"effect": effect["name"], "axis": ", ".join(effect["axis"]), "probability": effect["probability"], "parameter": name}
            | {"value": row["value"], "lower": row["ci90"][0], "upper": row["ci90"][1], "unit": row["unit"]}
            for effect in self.document["effects"]
            for name, row in effect["parameters"].items()
        ]
        own = [
            {"parameter": row["name"], "value": row["value"], "lower": row["ci90"][0], "upper": row["ci90"][1], "unit": row["unit"]}
            | {"nominal": row["nominal"]}
            for row in self.document["parameters"]
        ]
        columns = ["effect", "axis", "probability", "parameter", "value", "lower", "upper", "unit", "nominal"]
        return needed("pandas").DataFrame([*effects, *own], columns=columns)

    def plot(self, path: str | Path | None = None) -> list[Axes]:
        """Draw measured against simulated signals and the gap, with and without the effects; written to `path` where one is given."""
        return drawn(self.panels(), self.words.partition("\n")[0], path)

    def save(self, path: str | Path) -> None:
        """Write the page of the gap (HTML) to the file at `path`."""
        self.write_page(path)

    def show(self) -> Path:
        """Open the page of the gap in the browser; the file it is in."""
        path = Path(tempfile.mkdtemp(prefix="hyst-gap-")) / "gap.html"
        self.write_page(path)
        webbrowser.open(path.as_uri())
        return path


def diagnose(
    records: Record | Sequence[Record],
    model: model_file.Model | Simulate | None = None,
    baseline: Record | Sequence[Record] = (),
    *,
    parameters: Mapping[str, Sequence[Any]] | None = None,
    without: Sequence[str] = (),
    warm_up: float = 0.0,
    seed: int = 0,
    verbose: bool = True,
) -> Gap:
    """Find the effects that explain why a machine differs from its model.

    Parameters
    ----------
    records
        Records of today.
    model
        The model, or a function ``simulate(command, sample_time, **parameters)`` that returns the measurement; None: the baseline record
        of the same command in `baseline` is the prediction.
    baseline
        Baseline records of the same stage: what the model leaves on them is its discrepancy.
    parameters
        Of such a function, by name: value, standard deviation, and the unit if it has one.
    without
        Effects that are left out.
    warm_up
        Time at the beginning of each record that does not count, s.
    seed
        Seed of the simulated records and of the resampling.
    verbose
        Show the progress on a terminal.

    Returns
    -------
    Gap
        Verdict, effects with their sizes, and the model with them added.

    Raises
    ------
    InputError
        Model and records differ in axes or units, an effect does not exist, or the function fails.

    Examples
    --------
    >>> hc.diagnose(record, model, warm_up=0.1).verdict
    'no_gap'
    >>> def simulate(command, sample_time, gain):  # a sample is taken before its command acts
    ...     return gain * np.append(command[0], command[:-1])
    >>> steps = np.repeat([0.0, 30.0, 10.0, 50.0, 20.0, 0.0], 50)
    >>> noise = 0.01 * np.random.default_rng(0).standard_normal(300)
    >>> machine = hc.from_arrays(steps, simulate(steps, 1e-3, 0.09) + noise, rate=1000)
    >>> hc.diagnose(machine, simulate, parameters={"gain": (0.1, 0.002, "um/V")}, verbose=False).verdict
    'parameters'
    """
    given, before = records_of("records", records), records_of("baseline", baseline)
    settings: dict[str, Any] = {
        "without": without,
        "warm_up": WARM_UP.checked(warm_up),
        "seed": SEED.checked(seed),
        "progress": verbose,
    }
    with progress.shown(verbose), keywords():
        if model is None or not callable(model):
            if parameters is not None:
                raise InputError("parameters: are those of a function: a model has its own")
            found = diagnose_records(given, None if model is None else model_of(model), before, **settings)
        else:
            found = diagnose_simulator(given, model, parameters or {}, before, **settings)
    return promoted(Gap, found)
