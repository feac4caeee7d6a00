"""Cases of the blind test: records of truth plants with effects in them, and what is in each, kept apart.

A case is a truth plant whose coefficients scatter, one of four excitations, one of two noise levels, and effects of drawn size:
one, two, none, coefficients off by more than their tolerance, or an effect that is in nobody's catalogue; they are there from the
start or, where asked for, from a time within the record on. Seeds 0 to 999 are for tuning, scoring seeds begin at 100000.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np
import yaml

from hyst_control.config_files import config_path
from hyst_control.control.loop import run_loop
from hyst_control.control.pi import PI
from hyst_control.identify import identify
from hyst_control.identify.dataset import Dataset
from hyst_control.model_file import Model, load_model, simulate
from hyst_control.records.excitation import build
from hyst_control.records.record import Record, Signal
from hyst_plant_sim.physics import Plant, load_plant
from hyst_plant_sim.physics.plant_files import shipped

PLANTS = ("pea_published", "fsm_published", "third")
"""The blind test's; others that can be asked for are in `SETUPS`."""

EXCITATIONS = ("rich", "multisine", "sine", "closed_loop")
KINDS = ("single", "pair", "parameters", "none", "open_set")
NOISES = (5e-4, 3e-3)
"""Share of the stroke, rms."""

SCATTER = 0.01
"""Relative standard deviation of every coefficient of a plant about the nominal one."""

OFF = (4.0, 8.0)
"""`parameters`: the coefficients are off by this many times their tolerance."""

SHARES = {"single": 0.45, "none": 0.25, "pair": 0.12, "open_set": 0.1, "parameters": 0.08}
"""Of the kinds."""

BEGIN = (0.3, 0.7)
"""Share of the record's length after which an effect that is switched on begins."""

LEAST = 10.0
"""Distance (standard deviations, coefficients marginalised) below which nobody could see a gap: such a case counts as none."""


@dataclass(frozen=True)
class Setup:
    """How a plant is driven: model file (None: identified), sample time s, command range V, stroke (measurement unit)."""

    model: str | None
    sample_time: float
    command: tuple[float, float]
    stroke: float
    scattered: tuple[str, ...]
    gains: tuple[float, float]
    """Proportional V per unit, and integral V per unit and s."""


SETUPS = {
    "pea_published": Setup(
        "models/pea_hampi.yaml", 5e-5, (0.0, 50.0), 5.2, ("weights", "m1", "m2", "k", "b", "num", "den"), (1.0, 3000.0)
    ),
    "fsm_published": Setup(
        "models/fsm_mhl.yaml",
        1e-4,
        (0.0, 100.0),
        2.0,
        ("ascending", "descending", "delay", "k1", "k2", "num", "den"),
        (5.0, 9000.0),
    ),
    "third": Setup(
        None,
        5e-5,
        (0.0, 100.0),
        9.0,
        ("slope", "alpha", "beta", "gamma", "ladder_shares", "mode_frequency", "mode_damping"),
        (1.0, 2000.0),
    ),
    "pea": Setup(
        None,
        5e-5,
        (0.0, 100.0),
        10.8,
        (
            "elastic_slope",
            "slip_slope",
            "slip_decay",
            "saturation",
            "drag_rise",
            "drag_fall",
            "mode_frequency",
            "mode_damping",
            "slow_share",
        ),
        (1.0, 2000.0),
    ),
    "fsm": Setup(
        None,
        1e-4,
        (0.0, 100.0),
        2.0,
        ("delay", "elastic_slope", "slip_slope", "slip_decay", "relaxation_share", "mode_frequency", "mode_damping"),
        (5.0, 9000.0),
    ),
}

IDENTIFICATION: dict[str, tuple[str, dict[str, Any]]] = {
    # by plant without a published model: the family, and what identifies it beside the diagnostic record, over the command range
    "third": ("hampi", {"signal": "hampi_identification"}),
    "pea": ("hampi", {"signal": "hampi_identification"}),
    "fsm": ("mhl", {"signal": "mhl_identification", "sweep_time": 1.0}),
}

TOLERANCE = ("weights", "m1", "m2", "k", "b", "w0", "num", "den", "ascending", "descending", "tau", "k1", "k2", "b2")

Range = tuple[float, float]

SEVERITIES: dict[str, dict[str, Range | str]] = {
    # lengths and rates relative to the plant: "stroke" and "volt" scale with its stroke and command range, "tick" with its sample time
    "creep": {"gamma": (0.006, 0.04)},
    "gain": {"gain": (0.06, 0.18)},
    "gain_drift": {"change": (0.008, 0.05), "tau": (0.2, 1.0)},
    "offset": {"offset stroke": (0.003, 0.02)},
    "offset_drift": {"change stroke": (0.004, 0.03), "tau": (0.2, 1.0)},
    "hysteresis_width": {"width": (0.1, 0.4)},
    "hysteresis_shape": {"amount": (0.006, 0.03)},
    "hysteresis_rate": {"factor": (1.6, 3.0)},
    "delay": {"tau tick": (0.5, 6.0)},
    "amplifier_lowpass": {"cutoff": (500.0, 3000.0)},
    "sensor_lowpass": {"cutoff": (500.0, 3000.0)},
    "slew_limit": {"rate volt": (200.0, 1000.0)},
    "saturation": {"upper volt": (0.75, 0.92)},
    "dac_hold": {"samples": (3.0, 8.0)},
    "resonance": {"frequency": (300.0, 1500.0), "damping": (0.01, 0.06), "gain": (0.01, 0.05)},
    "added_mass": {"mass_ratio": (0.1, 0.4)},
    "backlash": {"half_width stroke": (0.002, 0.012)},
    "cross_coupling": {"coupling": (0.01, 0.06)},
    "sensor_nonlinearity": {"second stroke": (0.004, 0.015), "third stroke": (0.004, 0.015)},
    "sensor_noise": {"rms noise": (1.0, 4.0)},
    "flicker_noise": {"rms noise": (3.0, 12.0)},
    "mains_hum": {"amplitude noise": (1.5, 8.0)},
    "vibration": {"amplitude noise": (1.5, 8.0), "frequency": (70.0, 700.0)},
    "quantization": {"step noise": (4.0, 15.0)},
    "held_samples": {"fraction": (0.02, 0.2)},
}
"""Every effect of the catalogue with the range its parameters are drawn from, evenly in their logarithm."""

OPEN_SET: dict[str, dict[str, Range | str]] = {
    "crossover_dead_band": {"half_width volt": (0.01, 0.05)},
    "duffing_stiffness": {"share": (0.05, 0.25)},
    "wandering_mode": {"change": (0.05, 0.2)},
    "gain_scheduled_hysteresis": {"amount": (0.3, 1.2)},
    "clock_rate_mismatch": {"share": (2e-4, 2e-3)},
    "outliers": {"fraction": (0.002, 0.01), "size stroke": (0.02, 0.2)},
    "guide_friction": {"share": (0.01, 0.06)},
}
"""Effects that are in nobody's catalogue."""

EITHER_SIGN = ("width", "gain", "change", "amount", "offset", "second", "third", "coupling")
NOISE_LIKE = ("sensor_noise", "flicker_noise", "quantization", "held_samples", "mains_hum", "vibration", "outliers")


@dataclass(frozen=True)
class Case:
    """One case: what is done, and (label) what is in it. effects: mappings that `load_plant` takes."""

    name: str
    plant: str
    kind: str
    excitation: str
    noise: float
    seed: int
    effects: tuple[Mapping[str, Any], ...] = ()
    off: float = 1.0
    label: Mapping[str, Any] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that are in it."""
        return tuple(effect["name"] for effect in self.effects)


def draw(
    seed: int,
    count: int,
    plants: Sequence[str] = PLANTS,
    kinds: Mapping[str, float] | Sequence[str] | None = None,
    excitations: Sequence[str] = EXCITATIONS,
    switched: float = 0.0,
) -> list[Case]:
    """A balanced set of cases: every effect on every plant in turn, half of it on the rich record.

    kinds: which, with their usual shares among each other, or with these shares. switched: share of the cases with effects in
    which every effect begins within the record, each at a time of its own.
    """
    random = np.random.default_rng(seed)
    chosen = kinds or SHARES
    shares = dict(chosen) if isinstance(chosen, Mapping) else {kind: SHARES[kind] for kind in SHARES if kind in chosen}
    if not isinstance(chosen, Mapping):
        shares = {kind: share / sum(shares.values()) for kind, share in shares.items()}
    order = [kind for kind, share in shares.items() for _ in range(int(round(share * count)))]
    order = (order + [max(shares, key=lambda kind: shares[kind])] * count)[:count]
    cycles: dict[str, list[tuple[str, ...]]] = {}
    cases = []
    for index, kind in enumerate(order):
        plant = plants[index % len(plants)]
        excitation = "rich" if "rich" in excitations and index % 2 == 0 else str(excitations[(index // 2) % len(excitations)])
        names = _names(kind, plant, cycles, random)
        noise = NOISES[(index // 4) % 2]
        off = float(random.uniform(*OFF)) if kind == "parameters" else 1.0
        case = Case("", plant, kind, excitation, noise, int(random.integers(1 << 31)), off=off)
        cases.append(replace(case, effects=tuple(_severity(name, plant, noise, random) for name in names)))
    random.shuffle(cases)  # type: ignore[arg-type]
    times = np.random.default_rng([seed, 3])  # apart, so that the cases are the same with and without
    return [replace(case, name=f"case_{index:04d}", effects=_begun(case, switched, times)) for index, case in enumerate(cases)]


def _begun(case: Case, switched: float, random: np.random.Generator) -> tuple[Mapping[str, Any], ...]:
    """Its effects, switched on within the record in a share `switched` of the cases."""
    if not case.effects or random.random() >= switched:
        return case.effects
    sample_time = SETUPS[case.plant].sample_time
    length = len(commands(case))
    return tuple({**effect, "from": round(random.uniform(*BEGIN) * length) * sample_time} for effect in case.effects)


def _names(kind: str, plant: str, cycles: dict[str, list[tuple[str, ...]]], random: np.random.Generator) -> tuple[str, ...]:
    """The effects of the next case of a kind on a plant, each in turn before any comes again."""
    if kind in ("none", "parameters"):
        return ()
    catalogue = [
        name for name in (OPEN_SET if kind == "open_set" else SEVERITIES) if name != "cross_coupling" or plant.startswith("fsm")
    ]
    waiting = cycles.setdefault(f"{kind} {plant}", [])
    if not waiting:
        if kind == "pair":
            waveforms = [name for name in catalogue if name not in NOISE_LIKE]
            waiting += [tuple(random.choice(waveforms, 2, replace=False)) for _ in range(len(waveforms))]
        else:
            waiting += [(name,) for name in random.permutation(catalogue)]
    return tuple(str(name) for name in waiting.pop())


def _severity(name: str, plant: str, noise: float, random: np.random.Generator) -> dict[str, Any]:
    setup = SETUPS[plant]
    scale = {
        "stroke": setup.stroke,
        "volt": setup.command[1] - setup.command[0],
        "tick": setup.sample_time,
        "noise": noise * setup.stroke,
    }
    effect: dict[str, Any] = {"name": name}
    for key, limits in {**SEVERITIES, **OPEN_SET}[name].items():
        parameter, _, unit = key.partition(" ")
        value = float(np.exp(random.uniform(*np.log(limits)))) * scale.get(unit, 1.0)
        effect[parameter] = float(np.rint(value)) if parameter == "samples" else value
        if parameter in EITHER_SIGN and random.random() < 0.5:
            effect[parameter] *= -1.0
    if name == "mains_hum":
        effect["frequency"] = float(random.choice([50.0, 60.0]))
    if plant.startswith("fsm") and random.random() < 0.7:
        effect["axis"] = str(random.choice(["x", "y"]))
    return effect


def commands(case: Case) -> np.ndarray:
    """The open loop's commands (N, A) in V; the reference (N, A) in the measurement unit for the closed loop."""
    setup = SETUPS[case.plant]
    axes = 2 if case.plant.startswith("fsm") else 1
    low, high = setup.command
    span, centre, random = high - low, 0.5 * (high + low), np.random.default_rng([case.seed, 1])
    if case.excitation == "rich":
        spec: dict[str, Any] = {"signal": "diagnostic", "lowest": low, "highest": high, "seed": int(random.integers(3))}
    elif case.excitation == "multisine":
        spec = {
            "signal": "multisine",
            "period": 0.25,
            "lower_frequency": 4.0,
            "upper_frequency": 600.0,
            "rms": 0.13 * span,
            "offset": centre,
            "periods": 6,
            "detection": 4,
            "avoid_mains": True,
            "seed": int(random.integers(3)),
        }
    elif case.excitation == "sine":
        spec = {
            "signal": "sine",
            "frequency": float(random.choice([5.0, 12.0, 35.0, 90.0])),
            "amplitude": 0.42 * span,
            "offset": centre,
            "duration": 1.5,
        }
    else:
        spec = {
            "signal": "multi_frequency",
            "frequencies": [3.0, 17.0, 41.0],
            "offset": 0.5 * setup.stroke,
            "duration": 1.5,
            "amplitudes": [0.2 * setup.stroke, 0.08 * setup.stroke, 0.08 * setup.stroke],
        }
    rows = build(spec, setup.sample_time, axes)
    if case.excitation != "closed_loop":
        return np.clip(rows, low, high)
    # A record starts at rest: the loop closes at a reference of 0 and goes from there.
    ramp = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, int(0.1 / setup.sample_time)))
    return np.concatenate([np.zeros((20, axes)), ramp[:, None] * rows[0], rows])


def run(case: Case, effects: bool = True, noisy: bool = True, scattered: bool = True) -> dict[str, np.ndarray]:
    """Signals of a case by topic, (N, A) each, with or without its effects, the noise, and the scatter of its plant."""
    truth = plant_of(case, effects, noisy, scattered)
    rows, setup = commands(case), SETUPS[case.plant]
    if case.excitation != "closed_loop":
        first = truth.reset(rows[0])
        return {"command": rows, "measurement": np.concatenate([first[None], truth.step(rows)[:-1]])}
    controller = PI(setup.gains[0], setup.gains[1], setup.sample_time, setup.command[0], setup.command[1]).start(rows.shape[1])
    signals = run_loop(rows, None, controller, truth)
    return {name: signals[name] for name in ("reference", "feedforward", "feedback", "command", "measurement")}


def plant_of(case: Case, effects: bool = True, noisy: bool = True, scattered: bool = True) -> Plant:
    """The truth plant of a case, rated for the range in which it is driven."""
    setup = SETUPS[case.plant]
    changes = scatter(case.plant, case.seed, SCATTER * case.off if scattered else 0.0)
    document = {
        "plant": case.plant,
        "rating": list(setup.command),
        "stroke": [0.0, setup.stroke],
        "effects": [dict(effect) for effect in case.effects] if effects else [],
    }
    noise = case.noise * setup.stroke if noisy else 0.0
    return load_plant(document, seed=case.seed, sample_time=setup.sample_time, **{**changes, "noise": noise})


def scatter(plant: str, seed: int, size: float) -> dict[str, Any]:
    """Coefficients of a plant, each off by a normal share of `size`; both axes of a mirror about the first axis' values."""
    parameters = _parameters(plant)
    random = np.random.default_rng([seed, 2])
    setup = SETUPS[plant]

    def off(value: Any) -> Any:
        return [off(item) for item in value] if isinstance(value, list) else value * (1.0 + size * random.standard_normal())

    if plant != "fsm_published":
        return {name: off(parameters[name]) for name in setup.scattered}
    changes = {name: [off(parameters[name][0]) for _ in range(2)] for name in setup.scattered}
    for name in ("span", "scale", "b2"):
        changes[name] = [parameters[name][0]] * 2
    for axis in range(2):  # the major branches meet at their end
        ends = [sum(changes[name][axis]) for name in ("ascending", "descending")]
        for name, end in zip(("ascending", "descending"), ends, strict=True):
            changes[name][axis] = [value * 0.5 * sum(ends) / end for value in changes[name][axis]]
    return changes


@cache
def _parameters(plant: str) -> dict[str, Any]:
    path = shipped(plant)
    assert path is not None
    return yaml.safe_load(path.read_text(encoding="utf-8"))["parameters"]


@cache
def nominal(plant: str, noise: float) -> Model:
    """The model that a case is diagnosed against: the published one, or one identified from a clean record of the nominal plant.

    Its tolerance is the scatter of the plants; its noise, that of the sensor and of what the identification left.
    """
    setup = SETUPS[plant]
    sigma = noise * setup.stroke
    if setup.model is not None:
        model = load_model(config_path(setup.model))
    else:
        model, left = _identified(plant)
        sigma = float(np.hypot(sigma, left))
    return replace(
        model,
        sample_time=setup.sample_time,
        noise={"sigma": sigma},
        tolerance={name: SCATTER for name in TOLERANCE},
        valid={**model.valid, "command": list(setup.command)},
    )


@cache
def _identified(plant: str) -> tuple[Model, float]:
    """A model of the nominal plant, and what (rms) its family leaves of this physics on a record that did not identify it."""
    setup, (family, spec) = SETUPS[plant], IDENTIFICATION[plant]
    low, high = setup.command
    truth = load_plant({"plant": plant, "rating": [low, high]}, seed=1, sample_time=setup.sample_time, noise=1e-4 * setup.stroke)

    def clean(spec: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        rows = build(spec, setup.sample_time, len(truth.axes))
        return rows, np.concatenate([truth.reset(rows[0])[None], truth.step(rows)[:-1]])

    diagnostic = {"signal": "diagnostic", "lowest": low, "highest": high}
    records = [clean({**spec, "peak": high}), clean({**diagnostic, "seed": 5000})]
    model = identify(
        [
            Dataset(f"clean {index}", *record, setup.sample_time, truth.axes, truth.units["measurement"])
            for index, record in enumerate(records)
        ],
        family,
    ).model
    rows, measured = clean({**diagnostic, "seed": 6000})
    return model, float(np.sqrt(np.mean((measured - simulate(model, rows, setup.sample_time)) ** 2)))


def record_of(case: Case, signals: Mapping[str, np.ndarray]) -> Record:
    """A case's signals as a record; nothing in it tells what is in the case."""
    setup = SETUPS[case.plant]
    time = np.arange(len(signals["command"])) * setup.sample_time
    axes = ("x", "y") if case.plant.startswith("fsm") else ("x",)
    unit = "mrad" if case.plant.startswith("fsm") else "um"
    units = {"command": "V", "feedforward": "V", "feedback": "V"}
    return Record({name: Signal(time, values, axes, units.get(name, unit)) for name, values in signals.items()}, case.name)


def stated_noise(plant: str, noise: float) -> float:
    """What the nominal model of a plant says of the noise, rms."""
    return float(np.max(nominal(plant, noise).noise["sigma"]))


def labelled(case: Case, stated: float | None = None) -> Case:
    """The case with its label: what to score, the true gap, from when each effect is there, and whether anybody could see it.

    Of a pair also which of the two are `shown`: could be seen beside the other.
    stated: what `stated_noise` says, where it is known already (a plant without a published model is identified first).
    """
    setup = SETUPS[case.plant]
    noise = case.noise * setup.stroke
    stated = stated_noise(case.plant, case.noise) if stated is None else stated
    label: dict[str, Any] = {
        "kind": case.kind,
        "names": list(case.names),
        "effects": [dict(effect) for effect in case.effects],
        "plant": case.plant,
        "excitation": case.excitation,
        "noise": case.noise,
    }
    gap, distance = 0.0, 0.0
    least = 0.2 * noise if setup.model is not None else 1.5 * stated  # under a model's own error nothing can be told
    within = case.kind != "parameters"  # those off by more than their tolerance are themselves the gap
    wrong = bool(case.effects) or not within
    if wrong:
        difference = _difference(case, replace(case, effects=()), within)
        gap = float(np.sqrt(np.mean(difference**2)))
        distance = visible(case, difference, stated)
    label |= {"gap_rms": gap, "noise_rms": noise, "distance": distance}
    if wrong and (distance < LEAST or gap < least):
        label["kind"] = "none"
        label["hidden"] = list(case.names) or [case.kind]
        label["names"] = []
    elif case.kind == "pair":
        label["shown"] = []
        for effect in case.effects:
            part = _difference(case, replace(case, effects=tuple(other for other in case.effects if other is not effect)))
            size = visible(replace(case, effects=(effect,)), part, stated)
            if size >= LEAST and float(np.sqrt(np.mean(part**2))) >= least:
                label["shown"].append(effect["name"])
    return replace(case, label=label)


def _difference(case: Case, other: Case, scattered: bool = True) -> np.ndarray:
    """What a case's plant measures more than that of another, (N, A) without noise; scattered: the other's coefficients."""
    if case.excitation == "closed_loop":  # the loop hides a gap: what counts is the plant on one and the same command
        command = run(case, noisy=False)["command"]
        truth, bare = plant_of(case, noisy=False), plant_of(other, noisy=False, scattered=scattered)
        return np.concatenate([truth.reset(command[0])[None], truth.step(command)[:-1]]) - np.concatenate(
            [bare.reset(command[0])[None], bare.step(command)[:-1]]
        )
    return run(case, noisy=False)["measurement"] - run(other, noisy=False, scattered=scattered)["measurement"]


def visible(case: Case, difference: np.ndarray, noise: float) -> float:
    """Size of a difference in standard deviations (of the stated noise) once a change of gain and of offset on each axis is taken off."""
    measured = run(case, effects=False, noisy=False)["measurement"]
    left = 0.0
    for axis in range(difference.shape[1]):
        known = np.stack([np.ones(len(measured)), measured[:, axis]], axis=1)
        if case.names and set(case.names) <= {"gain", "offset"}:
            known = known[:, :0]
        rest = difference[:, axis] - (known @ np.linalg.lstsq(known, difference[:, axis], rcond=None)[0] if known.shape[1] else 0.0)
        left += float(rest @ rest)
    return float(np.sqrt(left) / noise)


def as_document(case: Case) -> dict[str, Any]:
    """The label of a case as JSON types."""
    return {**asdict(case), "effects": [dict(effect) for effect in case.effects], "label": dict(case.label)}
