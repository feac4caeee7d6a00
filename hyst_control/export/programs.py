# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Programs to be exported: of a model its simulator, a feedforward, its twin or its stated error; of nodes' parameters the controller."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.installed import installed_version
from hyst_control.base.yaml_files import read_yaml
from hyst_control.chain import Filter
from hyst_control.chain.c_code.c_code import CCode, reals
from hyst_control.control.feedback.filters import Filters
from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedforward.compensator import FROM_MODEL, Compensator, build_compensator
from hyst_control.control.feedforward.static_gain import Proportional
from hyst_control.control.learning.learning_loop import learned_rows
from hyst_control.export.c_source import Program, Slot
from hyst_control.export.controller import Controller, FaultResponse, Feedforward
from hyst_control.export.stated_error import StatedError
from hyst_control.model_file import FORMAT, Model, Simulator, load_model, model_to_document

HELD = {
    "zoh": ("held for the tick", "at the tick that follows"),
    "foh": ("a straight line from the tick before", "at the same tick"),
}
"""The command between the ticks, and when the measurement is, by the hold."""

MADE_BY = "Made by hyst export"  # Stands at the head of every file of a folder, by which it is known when it is written again


@dataclass(frozen=True)
class Exported:
    """A program, and the same in Python."""

    program: Program  # To be written as C
    python: Filter | Compensator  # Running filter, whose outputs are the golden vectors
    spans: Array = field(compare=False)  # Lower and upper value (inputs, 2) between which the golden vectors' inputs lie
    notes: tuple[str, ...] = ()  # What the command says of it, as the header does


class Twin(Filter):
    """The model beside a running system: command and measurement in, what the measurement has beyond the prediction out."""

    def __init__(self, model: Model, sample_time: float) -> None:
        self.axes = len(model.axes)
        self._filter = model.filter(sample_time)
        self.hold = self._filter.hold
        self._at_once = model.hold == "foh"  # the prediction is of the command's own instant
        self._ahead = np.zeros(self.axes)

    def settle(self, value: Array) -> Array:
        """Come to rest at commands (A,) and measurements (A,) in one `value` (2 A,); the residual (A,)."""
        value = np.array(value, dtype=float)
        self._ahead = self._filter.settle(value[: self.axes])
        return np.asarray(value[self.axes :] - self._ahead)

    def process(self, block: Array) -> Array:
        """Residuals (N, A) of a `block` of commands and measurements (N, 2 A)."""
        following = self._filter.process(np.ascontiguousarray(block[:, : self.axes]))
        predicted = following if self._at_once else np.concatenate([self._ahead[None], following[:-1]])
        self._ahead = following[-1].copy()
        return np.asarray(block[:, self.axes :] - predicted)

    def c_code(self) -> CCode:
        body = "for (int i = 0; i < AXES; i++) {\n    out[i] = in[AXES + i] - s->ahead[i];\n}\n"
        follow = "PART0_step(&s->part0, in, s->ahead);\n"
        return CCode(
            "twin",
            follow + body if self._at_once else body + follow,
            "PART0_settle(&s->part0, in, s->ahead);\n" + body,
            state={"ahead": reals(self._ahead, "measurement that the model foresees")},
            parts=(self._filter.c_code(),),
        )


@dataclass(frozen=True)
class FeedforwardOptions:
    """Choices of `control.feedforward.build_compensator`, named as the parameters of the feedforward nodes."""

    kind: str
    inverse: str = "zpetc"
    discretisation: str = "zoh"
    iterations: int | None = None
    smoothing: int = 0
    inverse_model: str = ""  # Path of a model file
    rate_filter: tuple[float, ...] | None = FROM_MODEL
    limits: tuple[float, float] | None = None  # Lower and upper, V
    preview: bool = True

    def compensator(self, model: Model, sample_time: float) -> Compensator:
        """Compensator of a `model` at a `sample_time` in s."""
        inverse_model = load_model(self.inverse_model) if self.inverse_model else None
        return build_compensator(model, sample_time=sample_time, **{**vars(self), "inverse_model": inverse_model})


def is_model(path: str | Path) -> bool:
    """Tell a model file from a file of nodes' parameters."""
    document = read_yaml(
        path, "give a model file or a file of nodes' parameters (YAML), or --to csv, mat, mcap or parquet for a bag"
    )
    return isinstance(document, Mapping) and document.get("format") == FORMAT


def simulator(
    model: Model, sample_time: float | None = None, real: str = "double", name: str = "", hold: str | None = None
) -> Exported:
    """A model as the plant: a command in, the measurement at the following tick out, or at the same one where the hold is `foh`."""
    # hold: The model's own by default; "zoh" for a plant whose command is held, in a loop and in an FMU
    time, hold = sample_time or model.sample_time, hold or model.hold
    running = model.filter(time, hold)
    unit, (inward, outward) = model.units["measurement"], HELD[hold]
    inputs = tuple(Slot(f"command_{axis}", f"V, {inward}") for axis in model.axes)
    outputs = tuple(Slot(f"measurement_{axis}", f"{unit}, {outward}") for axis in model.axes)
    note = _hold(model, hold)
    facts = _facts(model, "simulator", [note])
    program = Program(name or model.name, running.c_code(), len(model.axes), inputs, outputs, time, facts, real)
    return Exported(program, running, _command_span(model), (note,))


def twin(model: Model, sample_time: float | None = None, real: str = "double", name: str = "") -> Exported:
    """A model beside the running system: command and measurement in, residual out."""
    time = sample_time or model.sample_time
    running = Twin(model, time)
    unit = model.units["measurement"]
    inputs = [Slot(f"command_{axis}", "V, of this tick") for axis in model.axes]
    when = "before the command acts" if model.hold == "zoh" else "at the same instant"
    inputs += [Slot(f"measurement_{axis}", f"{unit}, {when}") for axis in model.axes]
    outputs = tuple(Slot(f"residual_{axis}", f"{unit}, measured minus predicted") for axis in model.axes)
    rms = model.discrepancy.get("rms")
    stated = ", ".join(f"{value:.6g}" for value in np.atleast_1d(np.asarray(rms, dtype=float)))
    note = _hold(model, model.hold)
    extra = [] if rms is None else [f"Discrepancy on the records it was identified from: {stated} {unit} rms."]
    command = _command_span(model)
    plant = Simulator(model, time)
    plant.reset(command[:, 0])
    simulated = plant.step(np.linspace(command[:, 0], command[:, 1], 400))
    spans = np.concatenate([command, np.stack([simulated.min(axis=0), simulated.max(axis=0)], axis=1)])
    facts = _facts(model, "twin", [note, *extra])
    named = name or f"{model.name}_twin"
    program = Program(named, running.c_code(), len(model.axes), tuple(inputs), outputs, time, facts, real)
    return Exported(program, running, spans, (note,))


def stated_error(model: Model, sample_time: float | None = None, real: str = "double", name: str = "") -> Exported:
    """The error that a model states of itself: a command in, mean and standard deviation of the model's error out."""
    time = sample_time or model.sample_time
    running = StatedError(model, time)
    unit = model.units["measurement"]
    late = f", {running.late} ticks before" if running.late else ""
    inputs = tuple(Slot(f"command_{axis}", "V, of this tick") for axis in model.axes)
    outputs = [Slot(f"mean_{axis}", f"{unit}, of measured minus predicted{late}") for axis in model.axes]
    outputs += [Slot(f"deviation_{axis}", f"{unit}, its standard deviation{late}") for axis in model.axes]
    facts = _facts(
        model,
        "the error that it states of itself",
        [
            f"It is late by {running.late} ticks: the rate of the command is known no earlier." if late else "It is not late.",
            "Zero, drift and curvature of a record are not part of it: the mean counts from where the program has settled.",
        ],
    )
    named = name or f"{model.name}_error"
    program = Program(named, running.c_code(), len(model.axes), inputs, tuple(outputs), time, facts, real)
    return Exported(program, running, _command_span(model))


def feedforward(
    model: Model,
    options: FeedforwardOptions,
    sample_time: float | None = None,
    real: str = "double",
    name: str = "",
    reference_ahead: bool = False,
) -> Exported:
    """A compensator: a reference in, the command out."""
    time = sample_time or model.sample_time
    running = options.compensator(model, time)
    check_preview(running.preview, reference_ahead)
    unit, axes = model.units["measurement"], model.axes
    early = f", {running.preview} ticks ahead of the command" if running.preview else ""
    late = [f"The command is {running.residual_delay_ticks} ticks late."] if running.residual_delay_ticks else []
    left_out = [f"The inverse leaves out {', '.join(running.left_out)} of the model."] if running.left_out else []
    chosen = ", ".join(f"{item.name} {getattr(options, item.name)!r}" for item in fields(options))
    program = Program(
        name or f"{model.name}_{options.kind}",
        running.c_code(),
        len(axes),
        tuple(Slot(f"reference_{axis}", unit + early) for axis in axes),
        tuple(Slot(f"command_{axis}", "V") for axis in axes),
        time,
        _facts(model, "feedforward", [f"Options: {chosen}.", *late, *left_out]),
        real,
    )
    return Exported(program, running, _reference_span(model, running), tuple(left_out))


def check_preview(preview: int, reference_ahead: bool) -> None:
    """Refuse a preview that is not there in real time."""
    if preview and not reference_ahead:
        raise InputError(
            f"preview: the feedforward looks {preview} ticks ahead, where a reference in real time is not known: give --causal "
            f"(preview: false) for the form that is late by as many ticks, or --reference-ahead where it is known {preview} ticks ahead"
        )


def controller(path: str | Path, real: str = "double", name: str = "", reference_ahead: bool = False) -> Exported:
    """The controller that a file of nodes' parameters describes: its `pi_feedback` and its feedforward node."""
    document = read_yaml(path, "give a model file or a file of nodes' parameters (YAML)")
    try:
        return _controller(document, Path(path), real, name, reference_ahead)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _controller(document: Any, path: Path, real: str, name: str, reference_ahead: bool) -> Exported:
    nodes = _nodes(document)
    if "pi_feedback" not in nodes:
        raise InputError("pi_feedback: is missing: give a model file, or nodes' parameters with pi_feedback")
    given = nodes["pi_feedback"]
    axes, unit = tuple(map(str, given.get("axes", ["x"]))), str(given.get("unit", "um"))
    rate = _number(given, "rate_hz", 1000.0)
    if given.get("feedback", True) is not True:
        raise InputError("pi_feedback.feedback: is not true: export the feedforward from the model file (--kind)")
    if not rate > 0:
        raise InputError(f"pi_feedback.rate_hz: must be > 0, got {rate!r}")
    time = 1.0 / rate
    defaults = {"kp": 0.0, "ki": 0.0, "lower": 0.0, "upper": 100.0, "slew_limit": 0.0, "tracking_time": 0.0, "roll_off": 0.0}
    law = PI(sample_time=time, filters=_filters(given), **{key: _number(given, key, value) for key, value in defaults.items()})
    known: dict[str, Any] = {item.name: given[item.name] for item in fields(FaultResponse) if item.name in given}
    for key in known:
        if key == "safe_command":
            known[key] = _numbers(known, key)
        elif key not in ("recovery", "axis_fault"):
            known[key] = _number(known, key, 0.0)
    feeding = [key for key in nodes if key.endswith("_feedforward")]
    if len(feeding) > 1:
        raise InputError(f"{' and '.join(feeding)}: two feedforwards: keep the one that is used")
    fed = _fed(nodes[feeding[0]], feeding[0], axes, time, path) if feeding else _Fed()
    running = Controller(law, len(axes), FaultResponse(**known), fed.filter, fed.learned)
    check_preview(running.ahead, reference_ahead)
    inputs, outputs = running.slots(axes, unit)
    used = {key: value for key, value in sorted(nodes.items()) if key in ("pi_feedback", *feeding)}
    learned = None if fed.learned is None else fed.learned.tolist()
    facts = (
        f"Controller of {path.name}: PI feedback with limits, its answers to faults, {fed.text}.",
        _made_by(),
        f"Content: {_digest(repr((used, learned, fed.model and model_to_document(fed.model))))}.",
        *([f"It inverts the model {fed.model.name}, {_sha(fed.model)}."] if fed.model else []),
    )
    reach = np.tile([[-5.0, 5.0]], (len(axes), 1))
    if fed.model is not None and isinstance(fed.filter, Compensator):
        reach = _reference_span(fed.model, fed.filter)
    spans = np.concatenate([reach, reach, [[0.0, 1.2]]])
    program = Program(name or path.stem, running.c_code(), len(axes), inputs, outputs, time, facts, real)
    return Exported(program, running, spans)


@dataclass(frozen=True)
class _Fed:
    """Feedforward of a node: its filter, learned rows, model, and what the header says of it."""

    filter: Feedforward | None = None
    learned: Array | None = None
    model: Model | None = None
    text: str = "no feedforward"


def _fed(given: Mapping[str, Any], node: str, axes: Sequence[str], time: float, path: Path) -> _Fed:
    learned = None
    learning = given.get("learning", "none")
    if learning == "played":
        learned = learned_rows(_beside(path, str(given.get("learned_file", ""))), len(axes))
    elif learning != "none":
        raise InputError(f"{node}.learning: {learning} goes on learning, which is not exported: let it learn, then take played")
    also = "" if learned is None else f" with {len(learned)} learned rows"
    kind = str(given.get("kind", node.removesuffix("_feedforward")))
    if kind == "proportional":
        gain, offset = (np.broadcast_to(np.asarray(given.get(key, 0.0), dtype=float), len(axes)) for key in ("gain", "offset"))
        return _Fed(Proportional(gain, offset), learned, None, f"feedforward proportional{also}")
    if not given.get("model"):
        raise InputError(f"{node}.model: is missing: give the model file to invert, or kind: proportional")
    model = load_model(_beside(path, str(given["model"])))
    if model.axes != tuple(axes):
        raise InputError(f"{node}.model: has axes {', '.join(model.axes)}, the loop {', '.join(axes)}")
    rating, filtered = given.get("limits", [0.0, 0.0]), given.get("rate_filter", FROM_MODEL)
    iterations = int(given.get("iterations", -1))
    options = FeedforwardOptions(
        kind,
        str(given.get("inverse", "zpetc")),
        str(given.get("discretisation", "zoh")),
        iterations if iterations >= 0 else None,
        int(given.get("smoothing", 0)),
        _beside(path, str(given["inverse_model"])) if given.get("inverse_model") else "",
        tuple(map(float, filtered)) if any(filtered) else None,
        (float(rating[0]), float(rating[-1])) if rating[0] != rating[-1] else None,
        bool(given.get("preview", True)),
    )
    found = options.compensator(model, time)
    late = f", {found.residual_delay_ticks} ticks late" if found.residual_delay_ticks else ""
    return _Fed(found, learned, model, f"feedforward {kind}{late}{also}")


def _beside(path: Path, name: str) -> str:
    """A file that another one names: from the present folder, as for the nodes, or else beside that one."""
    places = (Path(name), path.parent / name)
    for place in places:
        if place.exists():
            return str(place)
    raise InputError(f"{name}: is neither in the present folder nor in {path.parent}: put it there, or give its path")


def _nodes(document: Any) -> dict[str, dict[str, Any]]:
    """Parameters by node, those of `/**` in each."""
    if not isinstance(document, Mapping) or not document:
        raise InputError("is neither a model file nor nodes' parameters")
    found: dict[str, dict[str, Any]] = {}
    for name, content in document.items():
        own = content.get("ros__parameters") if isinstance(content, Mapping) else None
        if not isinstance(own, Mapping):
            raise InputError(f"{name}: has no ros__parameters: is neither a model file nor nodes' parameters")
        found[str(name).rsplit("/", 1)[-1]] = dict(own)
    common = found.pop("**", {})
    return {name: {**common, **own} for name, own in found.items()}


def _filters(given: Mapping[str, Any]) -> Filters:
    """Filters of the feedback, by the names of the node's parameters."""
    values: dict[str, Any] = {}
    for item in fields(Filters):
        if item.name not in given:
            continue
        if isinstance(item.default, tuple):
            values[item.name] = _numbers(given, item.name)
        else:
            values[item.name] = _number(given, item.name, 0.0)
    return Filters(**values)


def _numbers(given: Mapping[str, Any], name: str) -> tuple[float, ...]:
    rows = given[name]
    rows = rows if isinstance(rows, Sequence) and not isinstance(rows, str) else [rows]
    return tuple(_number({name: row}, name, 0.0) for row in rows)


def _number(given: Mapping[str, Any], name: str, default: float) -> float:
    value = given.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"pi_feedback.{name}: must be a number, got {value!r}")
    return float(value)


def _command_span(model: Model) -> Array:
    valid = np.array(model.valid.get("command", [0.0, 100.0]), dtype=float).reshape(-1, 2)
    return np.array(np.broadcast_to(valid, (len(model.axes), 2)))


def _reference_span(model: Model, running: Compensator) -> Array:
    """Range of references that the compensator answers within its limits, by what the model does there."""
    plant = Simulator(model, running.sample_time)
    plant.reset(np.zeros(len(model.axes)))
    limits = running.limits if "command" not in model.valid else _command_span(model).T
    measured = plant.step(np.linspace(limits[0], limits[1], 2000))
    low, high = measured.min(axis=0), measured.max(axis=0)
    return np.stack([low + 0.05 * (high - low), high - 0.05 * (high - low)], axis=1)


def _facts(model: Model, what: str, more: Sequence[str]) -> tuple[str, ...]:
    return f"{model.name}: {what}.", _made_by(), f"Content of the model: {_sha(model)}.", *more


def _hold(model: Model, hold: str) -> str:
    own = "" if hold == model.hold else f" (the model's own hold is {model.hold})"
    return f"Hold {hold}{own}: the command is {HELD[hold][0]}, the measurement {HELD[hold][1]}."


def _made_by() -> str:
    return f"{MADE_BY}, hyst_control {installed_version('0')}: the same input gives the same bytes."


def _sha(model: Model) -> str:
    return _digest(repr(model_to_document(model)))


def _digest(text: str) -> str:
    return f"SHA-256 {hashlib.sha256(text.encode()).hexdigest()}"
