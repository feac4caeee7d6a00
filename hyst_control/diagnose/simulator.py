# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A Python function in place of a model file: the nominal model that has it as its only stage."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.optimize import least_squares

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.yaml_files import read_yaml
from hyst_control.chain import Chain
from hyst_control.chain.external_simulator import ALIKE, ExternalSimulator, Simulate, external_simulator, title_of, together
from hyst_control.diagnose.noise.white import noise_of
from hyst_control.diagnose.record_checks.summary import lattice_of
from hyst_control.model_file import Model
from hyst_control.model_file import simulate as simulated
from hyst_control.records.record import Record

MOVING = 0.5  # Share of the ticks at which a command moves that may be smooth between them
RESCALED = 0.9731  # Command for which a function's own value grid is the same, and one from its command's levels is not
SAME_GRID = 0.001  # Share by which two steps of one grid may differ
MIN_ROWS = 64  # Rows from which the noise of a residual can be estimated
NOISE_ALONE = 1.1  # Rms of what a model leaves, as a multiple of its noise, up to which that is noise alone
MARGIN = 10.0  # Nats by which another one has to leave more
FIT_TRIALS = 5  # Steps of the fit of the parameters for that comparison
SAME_SETS = 1e-9  # Share of the range by which a set may differ from the same one by itself
UNIT_FACTORS = {17.4533: ("mrad", "deg"), 57.2958: ("deg", "rad"), 206.265: ("arcsec", "mrad"), 1000.0: ("um or mrad", "mm or rad")}
"""Factors between numbers in the first unit and in the second."""
CORRELATED = 0.9  # Correlation of measurement and simulation from which their ratio is a unit's
NEARLY = 0.1  # How far a ratio may be from that of two units, as a share


def simulator_model(simulate: Simulate, parameters: Mapping[str, Sequence[Any]], records: Sequence[Record]) -> Model:
    """The model of a function: axes, units and clock are those of the records, the uncertainty that of the parameters."""
    if not records:
        raise InputError("records: there is none: give at least one with command and measurement")
    record = records[0]
    record.check_axes()
    part = record.aligned(allow_gaps=True)[0]
    command, sample_time = part.command, part.sample_time
    stage, deviations = external_simulator(simulate, parameters)
    _check_repeatable(stage, command, sample_time)
    _check_sets(stage, deviations, command, sample_time)
    _check_rounding(stage, part)
    stage = stage.stepped(command, sample_time).begun(command, sample_time)
    known = {"parameters": [f"{stage.name}.{name}" for name in stage.names], "factor": np.diag(deviations).tolist()}
    model = Model(
        name=title_of(simulate),
        axes=part.axes,
        units={"command": record.command_unit, "measurement": record.unit},
        sample_time=sample_time,
        chain=Chain((stage,)),
        hold="zoh",
        uncertainty=known if any(deviations) else {},
    )
    smooth = replace(model, chain=Chain((stage.held(command, sample_time),)), hold="foh")
    is_smooth = record.hold == "foh" if record.states_hold else _fits_alone(smooth, model, deviations, part)
    found = smooth if is_smooth else model
    _check_unit(found, record)
    return found


def _fits_alone(one: Model, other: Model, deviations: Sequence[float], part: Record) -> bool:
    """True where a model leaves noise alone on a moving command, and another more, each with the parameters that leave least."""
    if len(part.command) < MIN_ROWS or np.mean(np.any(np.diff(part.command, axis=0) != 0.0, axis=1)) < MOVING:
        return False
    try:
        left = _left_by_fit(one, deviations, part)
        noise = np.array([noise_of([rows]) for rows in left.T])
        if np.any(np.sqrt(np.mean(left**2, axis=0)) > NOISE_ALONE * noise):
            return False
        more = _left_by_fit(other, deviations, part)
    except InputError:
        return False
    ratios = np.mean(more**2, axis=0) / np.maximum(np.mean(left**2, axis=0), 1e-300)
    return 0.5 * len(left) * float(np.sum(np.log(np.maximum(ratios, 1e-300)))) > MARGIN


def _left(model: Model, part: Record) -> Array:
    """Measurement without the simulation and without a zero (N, A)."""
    rows = part.measurement - simulated(model, part.command)
    left: Array = rows - rows.mean(axis=0)
    return left


def _left_by_fit(model: Model, deviations: Sequence[float], part: Record) -> Annotated[Array, "N A"]:
    """The same with the parameters that leave least, within their deviations."""
    [stage] = model.chain.stages
    assert isinstance(stage, ExternalSimulator)
    spreads = np.array(deviations)
    free = spreads > 0.0

    def left(moved: Array) -> Array:
        values = np.array(stage.values)
        values[free] += spreads[free] * moved
        return _left(replace(model, chain=Chain((replace(stage, values=tuple(values.tolist())),))), part)

    begin = np.zeros(int(free.sum()))
    nominal = left(begin)
    if not free.any():
        return nominal
    noise = np.array([max(noise_of([rows]), 1e-9 * float(np.ptp(rows)), 1e-300) for rows in nominal.T])
    found = least_squares(
        lambda moved: np.concatenate([(left(moved) / noise).reshape(-1), moved]), begin, diff_step=1e-3, max_nfev=FIT_TRIALS
    )
    return left(found.x)


def function_of(model: Model | None) -> ExternalSimulator | None:
    """The function that is the model; None for a model file."""
    stages = () if model is None else model.chain.stages
    return next((stage for stage in stages if isinstance(stage, ExternalSimulator)), None)


def of_function(model: Model | None, record: Record) -> Record:
    """A record that does not state its hold, with the hold that was found for a function."""
    if model is None or function_of(model) is None or record.states_hold:
        return record
    return replace(record, hold=model.hold)


def simulator_notes(model: Model | None, records: Sequence[Record]) -> list[str]:
    """List notes on a function: finer steps that it refuses, and a hold that was found."""
    stage = function_of(model)
    if model is None or stage is None:
        return []
    found = [finer_note(stage.differs)]
    if model.hold == "foh" and not records[0].states_hold:
        found.append("a command that is smooth between samples leaves noise alone, a held one more: taken as smooth (hold foh)")
    return [f"simulator {title_of(stage.simulate)}: {each}" for each in found if each]


def finer_note(differs: float) -> str:
    """Note on a function that has other samples at finer steps; "" of one that has the same."""
    if differs <= ALIKE:
        return ""
    found = f"its samples differ by {100.0 * differs:.2g} % of the range" if np.isfinite(differs) else "it fails"
    return (
        f"called with a quarter of the sample time {found} (limit {100.0 * ALIKE:g} %): low-pass filters and delays next to it are only "
        "approximate, and may come with a false resonance; give it a step of its own that does not depend on sample_time"
    )


def _check_unit(model: Model, record: Record) -> None:
    """Refuse a function of which the measurement is a multiple by a factor between units."""
    parts = record.aligned(allow_gaps=True)
    try:
        pairs = [(simulated(model, part.command), part.measurement) for part in parts]
    except InputError:
        return  # the diagnosis says what fails
    expected, measured = (np.concatenate([rows - rows.mean(axis=0) for rows in each]) for each in zip(*pairs, strict=True))
    product = float(np.sum(expected * measured))
    norms = float(np.linalg.norm(expected) * np.linalg.norm(measured))
    if not product > CORRELATED * norms > 0.0:
        return
    gain = product / float(np.sum(expected**2))
    for factor, (one, other) in UNIT_FACTORS.items():
        for ratio, text in ((factor, f"{one} beside {other}"), (1.0 / factor, f"{other} beside {one}")):
            if abs(gain / ratio - 1.0) < NEARLY:
                raise InputError(
                    f"simulator {model.name}: the measurement is {gain:.4g} times the simulation, as {text} would be: return the unit "
                    "of the record"
                )


def _check_repeatable(stage: ExternalSimulator, command: Array, sample_time: float) -> None:
    """Refuse a function whose second call gives something else: derivatives by differences would be noise."""
    if not np.array_equal(stage.run(command, sample_time), replace(stage, recent={}).run(command, sample_time)):
        raise InputError(
            f"simulator {title_of(stage.simulate)}: a second call gives other values: begin each call from the same state, and seed "
            "its random numbers"
        )


def _check_sets(stage: ExternalSimulator, deviations: Sequence[float], command: Array, sample_time: float) -> None:
    """Refuse a vectorized function that gives other values for two sets of parameters in one call than set by set."""
    if not getattr(stage.simulate, "vectorized", False) or not any(deviations):
        return
    moved = np.array(stage.values) + 0.1 * np.array(deviations)
    sets = stage, replace(stage, values=tuple(moved.tolist()))
    with together([[one] for one in sets]):
        at_once = [one.run(command, sample_time) for one in sets]
    try:
        alone = [one.run(command, sample_time) for one in sets]
    except InputError:
        return  # A trial of the fit turns back there
    change, apart = (float(np.max(np.abs(two[0] - two[1]))) for two in (alone, (at_once[1], alone[1])))
    if apart > max(0.5 * change, SAME_SETS * float(np.ptp(alone[0]))):  # In the wrong order they are as far apart as the sets are
        raise InputError(
            f"simulator {title_of(stage.simulate)}: vectorized: two sets of parameters in one call give other values than one by one: "
            "return the sets in their order, or leave out the attribute vectorized"
        )


def _check_rounding(stage: ExternalSimulator, part: Record) -> None:
    """Refuse a function that rounds where the machine does not: it does not follow small changes of a parameter."""
    rows, scaled = (stage.run(factor * part.command, part.sample_time) for factor in (1.0, RESCALED))
    for axis in range(rows.shape[1]):
        grids = [lattice_of(values[:, axis]) for values in (rows, scaled, part.measurement)]
        # A gain on a coarse command has a grid as well, but one of the command's size.
        if grids[0] > 0.0 and abs(grids[1] / grids[0] - 1.0) < SAME_GRID and grids[2] < (1.0 - SAME_GRID) * grids[0]:
            raise InputError(
                f"simulator {title_of(stage.simulate)}: returns multiples of {grids[0]:.4g} {part.unit}, between which the record has "
                "values: return it before it is rounded"
            )


def named_simulator(name: str) -> Simulate:
    """The function that `module:function` names, of a module here or installed."""
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise InputError(f"--simulator {name}: give it as module:function")
    if str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        found: Any = importlib.import_module(module)
        for part in attribute.split("."):
            found = getattr(found, part)
    except (Exception, SystemExit) as error:  # of any kind: it is foreign code
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(
            f"--simulator {name}: cannot be imported ({reason}): start from the folder that the module is in"
        ) from None
    if not callable(found):
        raise InputError(f"--simulator {name}: is no function: give it as module:function")
    simulate: Simulate = found
    return simulate


def read_parameters(path: str | Path) -> Mapping[str, Sequence[Any]]:
    """Parameters of a YAML file, a line each: `stiffness: [1.2, 0.1, N/um]`."""
    document = read_yaml(path, "give a YAML file with lines such as stiffness: [1.2, 0.1, N/um]")
    if not isinstance(document, Mapping):
        raise InputError(f"{path}: must be a mapping with lines such as stiffness: [1.2, 0.1, N/um]")
    return document
