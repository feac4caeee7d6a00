# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The model file: one YAML that describes a simulator, its range, noise and tolerances; and the simulator that runs it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import hyst_control.effects  # noqa: F401  (makes the effects' stages known)
from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.files import write_text
from hyst_control.base.yaml_files import EXPONENT, read_yaml
from hyst_control.chain import STAGES, Chain, Filter, Sampling, Stage
from hyst_control.chain.coordinates import chain_coordinates
from hyst_control.chain.parameter import Form, declared
from hyst_control.chain.stage import HOLDS
from hyst_control.records.stream.row_store import blocks, empty_rows
from hyst_control.records.tables.units import refusal_of_unit

FORMAT = "hyst_control/model"
VERSION = 1
USUAL_UNITS = {"command": "V", "measurement": "um or mrad"}
FORM = "its parameters do not have the form of numbers and lists it needs"
KEYS = (
    "format",
    "version",
    "name",
    "axes",
    "units",
    "sample_time",
    "hold",
    "valid",
    "chain",
    "noise",
    "tolerance",
    "uncertainty",
    "discrepancy",
)
DISCREPANCY_VERSION = 1


@dataclass(frozen=True)
class Model:
    """A simulator: the chain from command to measurement, and what is known about it."""

    name: str  # For people
    axes: tuple[str, ...]  # Names of the axes
    # {"command": "V", "measurement": "um"}, say: lengths are in um, angles in mrad or deg; other units are kept as they are
    units: Mapping[str, str]
    sample_time: float  # s, of the data it was fitted on
    chain: Chain  # From command to measurement, in signal order
    hold: str = "zoh"  # The command between samples, "zoh" or "foh"
    # {"command": [V, V], "frequency": [Hz, Hz]}: the range it was fitted over
    valid: Mapping[str, Any] = field(default_factory=dict)
    noise: Mapping[str, Any] = field(default_factory=dict)  # {"sigma": rms in the measurement unit}, a number or one per axis
    # Relative standard deviation by parameter name or "stage.parameter"
    tolerance: Mapping[str, float] = field(default_factory=dict)
    # {"parameters": names as in `chain.coordinates`, "factor": a row (K,) for each}: value = nominal + factor @ z, z ~ N(0,
    # I), in the units of the parameters; it takes the place of `tolerance`, where there is one
    uncertainty: Mapping[str, Any] = field(default_factory=dict)
    # What the model leaves on the records it was identified from: {"version": 1, "rms": by axis, on the worst record,
    # measurement unit, each record's own zero and drift taken off, "correlation": time of that error per independent sample,
    # s, "zero": zero, drift and curvature up to which a session is usual, by axis, absent for one record, "zero_mean": their
    # means, "learned": by axis, the error as a function of the command (`identify.learned_discrepancy`), absent where the
    # command does not predict it, "spectrum": by axis, the power of the error and of the output in bands of frequency
    # (`identify.stated_spectrum`), "step": step of the sensor's values, by axis, absent where it shows none}
    discrepancy: Mapping[str, Any] = field(default_factory=dict)

    def filter(self, sample_time: float | None = None, hold: str | None = None) -> Filter:
        """A running filter of the chain, at the model's own sample_time and hold unless given."""
        return self.chain.filter(Sampling(sample_time or self.sample_time, len(self.axes), hold or self.hold))

    def with_stages(self, stages: Sequence[Stage]) -> Model:
        """The same model with a chain of other stages; of its uncertainty the numbers that are still in the chain."""
        known = chain_coordinates(stages, self.axes) if self.uncertainty else {}
        kept = [i for i, name in enumerate(self.uncertainty.get("parameters", ())) if name in known]
        uncertainty = {key: [values[i] for i in kept] for key, values in self.uncertainty.items()} if kept else {}
        return replace(self, chain=Chain(tuple(stages)), uncertainty=uncertainty)


class Simulator:
    """Streams a model as a plant whose command a DAC holds: a command in, the measurement at the following tick out."""

    def __init__(self, model: Model, sample_time: float | None = None) -> None:
        self.model = model
        self.sample_time = sample_time or model.sample_time
        self.axes = model.axes
        self.units = dict(model.units)
        self._filter = model.filter(self.sample_time, "zoh")

    def reset(self, command: Array) -> Array:
        """Settle at the command (A,) in V and return measurement[0] (A,)."""
        return self._filter.settle(np.asarray(command, dtype=float))

    def step(self, commands: Array) -> Array:
        """Advance by commands (N, A) in V, each held for one sample; measurements (N, A) at the ticks that follow them."""
        return self._filter.process(np.ascontiguousarray(commands, dtype=float))


def simulate(
    model: Model, commands: Array, sample_time: float | None = None, hold: str | None = None, memory: Array | None = None
) -> Array:
    """Simulate a record that starts settled at its first command, or at the first of those that precede it.

    Parameters
    ----------
    model
        Of the plant.
    commands
        (N, A) in V.
    sample_time, hold
        Of the record; by default the model's.
    memory
        Commands (M, A) in V that precede the record.

    Returns
    -------
    ndarray
        Measurements (N, A). Under `zoh` measurement[k] is the sample at t_k before command[k] acts, under `foh` the one at the
        same instant.

    Raises
    ------
    InputError
        Where the chain does not run at this clock.
    """
    commands = np.ascontiguousarray(commands, dtype=float)
    hold = hold or model.hold
    running = model.filter(sample_time, hold)
    if memory is None:
        before = running.settle(commands[0])[None]
    else:
        memory = np.ascontiguousarray(memory, dtype=float)
        running.settle(memory[0])
        for part in blocks(len(memory)):
            before = running.process(memory[part])[-1:]
    measurements = empty_rows(*commands.shape)
    for part in blocks(len(commands)):
        output = running.process(commands[part])
        measurements[part] = output if hold == "foh" else np.concatenate([before, output[:-1]])
        before = output[-1:]
    return measurements


def load_model(path: str | Path) -> Model:
    """Read and check a model file.

    Parameters
    ----------
    path
        Of a YAML file.

    Returns
    -------
    Model
        Ready to be run.

    Raises
    ------
    InputError
        Naming file, field and remedy, where it cannot be read or makes no sense.
    """
    document = read_yaml(path, "give the path of a model file (YAML)")
    try:
        return model_from_document(document)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def save_model(model: Model, path: str | Path) -> None:
    """Write a model file: to a temporary file beside it, then renamed, so that a reader never meets half of one.

    Parameters
    ----------
    model
        To be written.
    path
        Of a YAML file.
    """
    write_text(path, yaml.dump(model_to_document(model), Dumper=_Dumper, sort_keys=False, width=120))


def model_from_document(document: Any) -> Model:
    """Make a model from the parsed YAML.

    Parameters
    ----------
    document
        The file's mapping.

    Returns
    -------
    Model
        Checked.

    Raises
    ------
    InputError
        Naming the field.
    """
    if not isinstance(document, Mapping):
        raise InputError("is not a model file: must be a mapping with format, version, …")
    if document.get("format") != FORMAT:
        if "plant" in document:
            raise InputError(
                "is a reference simulation, for the node plant and hyst learn --plant, no model: give one of hyst identify"
            )
        raise InputError(f"format: {document.get('format')!r}, a model file says {FORMAT!r}: give what hyst identify wrote")
    if document.get("version") != VERSION or isinstance(document["version"], bool):
        raise InputError(f"version: {document.get('version')!r} is not known here, version {VERSION} is")
    for key in document:
        if key not in KEYS:
            raise InputError(f"{key}: no such key: {_nearest(str(key), KEYS)}")
    for key in ("axes", "units", "sample_time", "chain"):
        if key not in document:
            raise InputError(f"{key}: is missing")
    axes = document["axes"]
    if not isinstance(axes, list) or not axes or not all(isinstance(axis, str) and axis for axis in axes):
        raise InputError(f"axes: {axes!r}, a list of names such as [x] or [x, y] is due")
    if len(set(axes)) != len(axes):
        raise InputError(f"axes: {axes!r} names an axis twice")
    hold = document.get("hold", "zoh")
    if hold not in HOLDS:
        raise InputError(f"hold: {hold!r}, one of {', '.join(HOLDS)} is due")
    sample_time = document["sample_time"]
    if not _numeric(sample_time) or np.ndim(sample_time) or not sample_time > 0:
        raise InputError(f"sample_time: {sample_time!r}, a positive time in s is due")
    name = document.get("name", "model")
    if not isinstance(name, str):
        raise InputError(f"name: {name!r}, a text is due: put it in quotes")
    chain = Chain(stages_from_document(document["chain"], "chain"))
    for index, stage in enumerate(chain.stages):
        try:
            stage.filter(Sampling(float(sample_time), len(axes), hold))
        except InputError as error:
            raise InputError(f"chain[{index}] ({stage.name}): {error}") from None
        except (TypeError, ValueError, IndexError, OverflowError, np.linalg.LinAlgError) as error:
            raise InputError(f"chain[{index}] ({stage.name}): {FORM} ({error})") from None
        except MemoryError:
            raise InputError(f"chain[{index}] ({stage.name}): too large for this machine at {sample_time:g} s") from None
    try:
        chain.filter(Sampling(float(sample_time), len(axes), hold))  # modifiers change their neighbors
    except InputError as error:
        raise InputError(f"chain: {error}") from None

    def section(key: str, checked: Callable[..., dict[str, Any]], *known: Any) -> dict[str, Any]:
        return {} if document.get(key) is None else checked(document[key], *known)

    return Model(
        name=name,
        axes=tuple(axes),
        units=_units(document["units"]),
        sample_time=float(sample_time),
        chain=chain,
        hold=hold,
        valid=section("valid", _ranges),
        noise=section("noise", _noise, len(axes)),
        tolerance=section("tolerance", _tolerance),
        uncertainty=section("uncertainty", _uncertainty, chain.stages, axes),
        discrepancy=section("discrepancy", _discrepancy, len(axes)),
    )


def model_to_document(model: Model) -> dict[str, Any]:
    """The model as plain lists, numbers and strings, in the order of the model file.

    Parameters
    ----------
    model
        To be written.

    Returns
    -------
    dict
        Keys in the order of the file.
    """
    document: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "name": model.name,
        "axes": list(model.axes),
        "units": dict(model.units),
        "sample_time": float(model.sample_time),
        "hold": model.hold,
    }
    if model.valid:
        document["valid"] = _plain(model.valid)
    document["chain"] = [stage_to_document(stage) for stage in model.chain.stages]
    for key in ("noise", "tolerance", "uncertainty", "discrepancy"):
        if known := getattr(model, key):
            document[key] = _plain(known)
    return document


def stages_from_document(rows: Any, where: str) -> tuple[Stage, ...]:
    """Make stages from a list of mappings, one a stage; messages name the list, the row and the parameter."""
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{where}: must be a list of stages")
    return tuple(_stage_from_document(row, f"{where}[{index}]") for index, row in enumerate(rows))


def stage_to_document(stage: Stage) -> dict[str, Any]:
    """A stage as the mapping of the model file: its name, and the parameters that are not at their default."""
    found = {"stage": stage.name, **_plain(stage.parameters())}
    for key, declaration in stage.declarations().items():
        if declaration.form is Form.CHAINS:
            found[key] = [[stage_to_document(item) for item in chain] for chain in getattr(stage, key)]
    return found


def _stage_from_document(row: Any, where: str) -> Stage:
    if not isinstance(row, Mapping) or not isinstance(row.get("stage"), str):
        raise InputError(f"{where}: must be a mapping with the key stage")
    name = row["stage"]
    if name not in STAGES:
        raise InputError(f"{where}.stage: {name!r} is not a stage: {_nearest(name, sorted(STAGES))}")
    known = {item.name: item for item in fields(STAGES[name])}
    given = {key: value for key, value in row.items() if key != "stage"}
    for key in given:
        if key not in known:
            raise InputError(f"{where} ({name}).{key}: no such parameter: {_nearest(str(key), list(known))}")
    for key, item in known.items():
        if key not in given and item.default is MISSING:
            raise InputError(f"{where} ({name}).{key}: is missing")
    for key, declaration in declared(STAGES[name]).items():
        if declaration.form is Form.CHAINS:
            chains = given[key]
            if not isinstance(chains, list) or not chains:
                raise InputError(f"{where}.{key}: must be a list of chains")
            given[key] = tuple(stages_from_document(chain, f"{where}.{key}[{i}]") for i, chain in enumerate(chains))
    try:
        return STAGES[name](**given)
    except InputError as error:
        raise InputError(f"{where} ({name}): {error}") from None
    except (TypeError, ValueError, IndexError, OverflowError, np.linalg.LinAlgError) as error:
        raise InputError(f"{where} ({name}): {FORM} ({error})") from None


def _nearest(word: str, known: Sequence[str], otherwise: str = "") -> str:
    from difflib import get_close_matches

    close = get_close_matches(word, known, 1)
    return f"did you mean {close[0]!r}?" if close else otherwise or f"must be one of {', '.join(known)}"


def _units(units: Any) -> dict[str, str]:
    for signal, usual in USUAL_UNITS.items():
        given = units.get(signal) if isinstance(units, Mapping) else units
        if not isinstance(units, Mapping) or not isinstance(given, str):
            raise InputError(f"units.{signal}: {given!r}, {usual} is due")
        if reason := refusal_of_unit(given, usual):
            raise InputError(f"units.{signal}: {reason}")
    for key in units:
        if key not in ("command", "measurement"):
            raise InputError(f"units.{key}: no such key, must be command or measurement")
    return {"command": units["command"], "measurement": units["measurement"]}


def _ranges(valid: Any) -> dict[str, Any]:
    if not isinstance(valid, Mapping):
        raise InputError("valid: must be a mapping with command and frequency")
    for key, value in valid.items():
        if key not in ("command", "frequency"):
            raise InputError(f"valid.{key}: no such key, must be command or frequency")
        numbers = np.array(value, dtype=float) if _numeric(value) else np.zeros(0)
        if numbers.shape[-1:] != (2,) or np.any(numbers[..., 0] >= numbers[..., 1]):
            raise InputError(f"valid.{key}: {value!r}, [lower, upper] is due")
    return dict(valid)


def _noise(noise: Any, axes: int) -> dict[str, Any]:
    if not isinstance(noise, Mapping) or set(noise) != {"sigma"}:
        raise InputError("noise: a mapping with sigma alone is due")
    sigma = noise["sigma"]
    if not _numeric(sigma) or np.size(sigma) not in (1, axes) or np.any(np.array(sigma, dtype=float) < 0):
        raise InputError(f"noise.sigma: {sigma!r}, one rms value or one per axis, not negative, is due")
    return dict(noise)


def _tolerance(tolerance: Any) -> dict[str, float]:
    if not isinstance(tolerance, Mapping):
        raise InputError("tolerance: must be a mapping from parameter to relative standard deviation")
    for key, value in tolerance.items():
        if not _numeric(value) or np.any(np.array(value, dtype=float) < 0):
            raise InputError(f"tolerance.{key}: {value!r}, a relative standard deviation, not negative, is due")
    return {str(key): value for key, value in tolerance.items()}


def _uncertainty(uncertainty: Any, stages: Sequence[Stage], axes: Sequence[str]) -> dict[str, Any]:
    if not isinstance(uncertainty, Mapping) or set(uncertainty) != {"parameters", "factor"}:
        raise InputError("uncertainty: must be a mapping with parameters and factor: identify the model again, or leave it out")
    names, factor = uncertainty["parameters"], uncertainty["factor"]
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        raise InputError(f"uncertainty.parameters: must be a list of different names, got {names!r}")
    known = list(chain_coordinates(stages, axes))
    for name in names:
        if name not in known:
            raise InputError(f"uncertainty.parameters: {name!r} is no number of the chain: {_nearest(name, known, 'take it out')}")
    if not isinstance(factor, list) or not _numeric(factor) or np.ndim(factor) != 2 or len(factor) != len(names):
        raise InputError(f"uncertainty.factor: must be a list of {len(names)} rows of numbers, one for each of the parameters")
    return {"parameters": list(names), "factor": factor}


def _discrepancy(discrepancy: Any, axes: int) -> dict[str, Any]:
    if not isinstance(discrepancy, Mapping) or discrepancy.get("version") != DISCREPANCY_VERSION:
        raise InputError(
            f"discrepancy: must be a mapping with version {DISCREPANCY_VERSION}: identify the model again, or leave it out"
        )
    for key, shape in (("rms", (axes,)), ("zero", (axes, 3)), ("step", (axes,))):
        value: Any = discrepancy.get(key)
        if value is None and key != "rms":
            continue
        if not _numeric(value) or np.shape(value) != shape or np.any(np.array(value, dtype=float) < 0):
            raise InputError(f"discrepancy.{key}: must be numbers >= 0 of shape {shape}, got {value!r}")
    mean = discrepancy.get("zero_mean")
    if mean is not None and (not _numeric(mean) or np.shape(mean) != (axes, 3)):
        raise InputError(f"discrepancy.zero_mean: must be numbers of shape {(axes, 3)}, got {mean!r}")
    correlation = discrepancy.get("correlation", 1.0)
    if not _numeric(correlation) or np.ndim(correlation) or not correlation > 0:
        raise InputError(f"discrepancy.correlation: must be a time > 0 s, got {correlation!r}")
    for key in ("learned", "spectrum"):
        each: Any = discrepancy.get(key)
        if each is not None and (not isinstance(each, list) or len(each) != axes):
            raise InputError(
                f"discrepancy.{key}: must be a list with one entry for each of the {axes} axes: identify the model again"
            )
    return dict(discrepancy)


def _numeric(value: Any) -> bool:
    try:
        return not isinstance(value, (bool, str)) and bool(np.all(np.isfinite(np.array(value, dtype=float))))
    except (TypeError, ValueError, OverflowError):
        return False


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    return value.item() if isinstance(value, np.generic) else value


class _Dumper(yaml.SafeDumper):
    """Lists of numbers on one line, everything else in block style; a text that reads as a number, such as 1e3, in quotes."""


def _represent_list(dumper: yaml.SafeDumper, value: list[Any]) -> Any:
    flat = all(not isinstance(item, (list, dict)) for item in value)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", value, flow_style=flat)


_Dumper.add_representer(list, _represent_list)
_Dumper.add_implicit_resolver(*EXPONENT)
