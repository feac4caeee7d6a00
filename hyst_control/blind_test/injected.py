"""Injected cases: known effects put into measured records, so that the physics is real and the truth exact.

Effects of the sensor act on the measurement; effects of the drive that can be inverted act backwards on the command: the recorded command
u is what the effect made of another one, c, and c takes its place. Every size is a multiple of what the identified model leaves on clean
records that it was not identified from. The records:

- stack (`pea_p885`): eight cycles each, the first two of which fill the memory. Models are identified from full cycles of the first file
  and from two stretches of the second, cases come from other stretches; tuning seeds (below `SCORING`) see stretches of the second file's
  first half, scoring seeds of its second half, where an inverse operator shaped the command. The repeated full cycles have clean records
  of the same command.
- mirror (`fsm_cubespec`): three levels; models from realizations 1-4, tuning seeds see the fifth, scoring seeds the sixth. The period of
  a record is repeated, that of its clean record is the other measured one.

The effects are written here with numpy and scipy alone: nothing is shared with the catalogue that is tested.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.signal import bilinear, lfilter, lfilter_zi

from hyst_control.blind_test.published_labels import rounded
from hyst_control.errors import InputError
from hyst_control.files import write_json
from hyst_control.parallel import map_spawned
from hyst_control.records.record import Record, Signal
from hyst_control.records.session_zero import without_zero
from hyst_control.reporting.tables import Table

Array = NDArray[np.float64]

SCORING = 1000
"""First seed that is drawn from the records set apart for scoring."""
PLANTS = ("stack", "mirror")
MODES = ("none", "other_command", "same_command")
"""Clean records beside the new one."""
SIZES = (1.0, 3.0, 10.0)
"""Sizes of the effects, as multiples of the model's own error."""
ROWS, FILLING, PERIOD = 1600, 400, 200
"""Rows of the stack's records, of their begin, in which the memory fills, and of a cycle."""
COMPANIONS = ("offset", "offset_drift")
LAGS = ("delay", "sensor_lowpass", "amplifier_lowpass")
"""Effects that count as one name where the record has one frequency."""
SCALES = np.geomspace(1e-6, 1e3, 37)
"""Strengths among which that of a given size is sought."""
TITLE = "Injected into measured records"


@dataclass(frozen=True)
class Clean:
    """Clean record: command and measurement (N, A), and whether it is periodic, so that its first half does not count."""

    name: str
    command: Array
    measurement: Array


@dataclass(frozen=True)
class Machine:
    """Measured machine: its records for models and cases.

    Parameters
    ----------
    name
        Name of the machine.
    axes
        Names of the axes.
    sample_time
        Sample time, s.
    warm_up
        Begin of each record that does not count, s.
    cases
        Clean records for cases.
    same
        By the index of a case's record, a clean one of the same command; absent where there is none.
    others
        Clean records of other commands.
    model
        Identifies the model, with its own error in it.
    """

    name: str
    axes: tuple[str, ...]
    sample_time: float
    warm_up: float
    cases: tuple[Clean, ...]
    same: Mapping[int, Clean]
    others: tuple[Clean, ...]
    model: Callable[[], Any]


@dataclass(frozen=True)
class Injection:
    """Effect that is put in: strength s > 0 to another command or measurement.

    Parameters
    ----------
    name
        In the gap report's vocabulary; "unknown" of the open set.
    apply
        (command (N, A), measurement (N, A), sample time, strength, random) to the two as recorded with the effect.
    realization
        Name among the realizations of the effect.
    """

    name: str
    apply: Callable[[Array, Array, float, float, np.random.Generator], tuple[Array, Array]]
    realization: str = ""


def _measured(change: Callable[[Array, float, float, np.random.Generator], Array]) -> Callable[..., tuple[Array, Array]]:
    return lambda u, y, step, s, random: (u, change(y, step, s, random))


def _commanded(change: Callable[[Array, float, float, np.random.Generator], Array]) -> Callable[..., tuple[Array, Array]]:
    return lambda u, y, step, s, random: (change(u, step, s, random), y)


def _along(rows: Array) -> Array:
    return np.linspace(0.0, 1.0, len(rows))[:, None]


def _span(y: Array) -> Array:
    return np.asarray(np.ptp(y, axis=0), dtype=np.float64)


def _later(rows: Array, step: float, tau: float) -> Array:
    time_axis = step * np.arange(len(rows))
    return np.asarray(CubicSpline(time_axis, rows)(np.clip(time_axis - tau, 0.0, time_axis[-1])), dtype=np.float64)


def _lowpass(y: Array, step: float, tau: float, order: int) -> Array:
    b, a = bilinear([1.0], [tau, 1.0], 1.0 / step)
    for _ in range(order):
        y = lfilter(b, a, y, axis=0, zi=lfilter_zi(b, a)[:, None] * y[:1])[0]
    return np.asarray(y, dtype=np.float64)


def _creep(y: Array, step: float, share: float, times: Array) -> Array:
    slow = np.zeros_like(y)
    for tau in times:
        slow += _lowpass(y - y[0], step, tau, 1) / len(times)
    return np.asarray(y + share * slow, dtype=np.float64)


def _play(y: Array, half: Array) -> Array:
    found, state = np.empty_like(y), y[0].copy()
    for k, row in enumerate(y):
        state = np.clip(state, row - half, row + half)
        found[k] = state
    return found


def _bent(y: Array, second: float, third: float) -> Array:
    low, span = y.min(axis=0), _span(y)
    x = 2.0 * (y - low) / span - 1.0
    return np.asarray(y + 0.5 * span * (second * (1.5 * x**2 - 0.5) + third * (2.5 * x**3 - 1.5 * x)), dtype=np.float64)


def _line(y: Array, step: float, frequency: float, amplitude: Array, random: np.random.Generator) -> Array:
    angle = 2.0 * np.pi * frequency * step * np.arange(len(y))[:, None]
    return np.asarray(y + amplitude * np.sin(angle + random.uniform(0.0, 2.0 * np.pi, y.shape[1])), dtype=np.float64)


def _mode(y: Array, step: float, gain: float, frequency: float) -> Array:
    w = 2.0 * np.pi * frequency
    b, a = bilinear([w**2], [1.0, 0.04 * w, w**2], 1.0 / step)
    return np.asarray(y + gain * lfilter(b, a, y - y[0], axis=0), dtype=np.float64)


def _flicker(y: Array, random: np.random.Generator) -> Array:
    spectrum = np.fft.rfft(random.standard_normal(y.shape), axis=0)
    spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))[:, None]
    spectrum[0] = 0.0
    rows = np.fft.irfft(spectrum, len(y), axis=0)
    return np.asarray(rows / rows.std(axis=0), dtype=np.float64)


def _held(y: Array, share: float, random: np.random.Generator) -> Array:
    rows = np.arange(len(y))
    repeated = random.random(len(y)) < min(share, 0.9)
    repeated[0] = False
    rows[repeated] = 0
    return y[np.maximum.accumulate(rows)]


def _ahead(u: Array, step: float, tau: float) -> Array:
    return _later(u[::-1], step, tau)[::-1]


SINGLES = (
    Injection("gain", _measured(lambda y, step, s, r: y * (1.0 + s)), "sensor"),
    Injection("gain", _commanded(lambda u, step, s, r: u / (1.0 + s)), "amplifier"),
    Injection("gain_drift", _measured(lambda y, step, s, r: y * (1.0 + s * _along(y))), "linear"),
    Injection("offset", _measured(lambda y, step, s, r: y + s * _span(y))),
    Injection("offset_drift", _measured(lambda y, step, s, r: y + s * _span(y) * _along(y)), "linear"),
    Injection("offset_drift", _measured(lambda y, step, s, r: y - s * _span(y) * np.expm1(-5.0 * _along(y))), "settling"),
    Injection("creep", _measured(lambda y, step, s, r: _creep(y, step, s, len(y) * step * np.array([0.01, 0.1, 1.0]))), "ladder"),
    Injection("delay", _measured(lambda y, step, s, r: _later(y, step, s * len(y) * step)), "sensor"),
    Injection("delay", _commanded(lambda u, step, s, r: _ahead(u, step, s * len(u) * step)), "command"),
    Injection("sensor_lowpass", _measured(lambda y, step, s, r: _lowpass(y, step, s * len(y) * step, 1)), "first"),
    Injection("sensor_lowpass", _measured(lambda y, step, s, r: _lowpass(y, step, s * len(y) * step, 2)), "second"),
    Injection("sensor_nonlinearity", _measured(lambda y, step, s, r: _bent(y, s, 0.0)), "even"),
    Injection("sensor_nonlinearity", _measured(lambda y, step, s, r: _bent(y, 0.3 * s, s)), "odd"),
    Injection("resonance", _measured(lambda y, step, s, r: _mode(y, step, s, 0.2 / step)), "sensor side"),
    Injection("backlash", _measured(lambda y, step, s, r: _play(y, s * _span(y)))),
    Injection("quantization", _measured(lambda y, step, s, r: s * _span(y) * np.round(y / (s * _span(y))))),
    Injection("held_samples", _measured(lambda y, step, s, r: _held(y, s, r))),
    Injection("mains_hum", _measured(lambda y, step, s, r: _line(y, step, 50.0, s * _span(y), r))),
    Injection("vibration", _measured(lambda y, step, s, r: _line(y, step, 0.31 / step, s * _span(y), r))),
    Injection("sensor_noise", _measured(lambda y, step, s, r: y + s * _span(y) * r.standard_normal(y.shape))),
    Injection("flicker_noise", _measured(lambda y, step, s, r: y + s * _span(y) * _flicker(y, r))),
    Injection("dac_hold", _commanded(lambda u, step, s, r: u + s * np.ptp(u, axis=0) * r.uniform(-0.5, 0.5, u.shape)), "rounding"),
)
OPEN_SET = (
    Injection("unknown", _measured(lambda y, step, s, r: y + s * _span(y) * 30.0 * (r.random(y.shape) < 0.001)), "spikes"),
    Injection(
        "unknown", _measured(lambda y, step, s, r: _later(y, step, 0.0) + _warped(y, step, s * len(y) * step)), "clock mismatch"
    ),
    Injection("unknown", _measured(lambda y, step, s, r: _dead_band(y, s * _span(y))), "dead band"),
    Injection(
        "unknown", _measured(lambda y, step, s, r: y * (1.0 + s * (np.sin(40.0 * _along(y)) > 0))), "gain that comes and goes"
    ),
)
EQUAL = {"gain": ("hysteresis_width",), "dac_hold": ("sensor_noise",), "sensor_noise": ("flicker_noise",)}
"""Names that an engineer would accept as well."""


def _warped(y: Array, step: float, whole: float) -> Array:
    """Change by a clock that is `whole` seconds late at the end."""
    axis = step * np.arange(len(y))
    return np.asarray(CubicSpline(axis, y)(axis - whole * axis / axis[-1]) - y, dtype=np.float64)


def _dead_band(y: Array, half: Array) -> Array:
    center = y.mean(axis=0)
    away = y - center
    return np.asarray(center + np.sign(away) * np.maximum(np.abs(away) - half, 0.0), dtype=np.float64)


def stack_machine(scoring: bool) -> Machine:
    """Construct the stack.

    Parameters
    ----------
    scoring
        Cases from the records set apart for scoring.

    Returns
    -------
    Machine
        The machine.
    """
    from hyst_control.identify.workflow import identified
    from hyst_control.reproduction import pea_p885 as stack

    full, nested = stack.load()

    def stretches(record: Any, first: int, last: int) -> list[Clean]:
        begins = range(first, last - ROWS + 1, ROWS)
        return [
            Clean(f"{record.name}, row {row}", record.command[row : row + ROWS], record.measurement[row : row + ROWS])
            for row in begins
        ]

    begin = int(np.argmin(full.command[:PERIOD, 0]))  # the same phase in every record: 1 Hz, 200 rows a cycle
    loops, plain, shaped = stretches(full, begin, len(full.command)), stretches(nested, 0, 7300), stretches(nested, 7400, 14155)
    training = (loops[0], plain[0], shaped[0])
    cases = (loops[1], *shaped[1:-1]) if scoring else (loops[2], *plain[1:-1])
    same = {0: loops[3]}

    def model() -> Any:
        datasets = [
            replace(full, name=one.name, command=one.command, measurement=one.measurement, start="unknown") for one in training
        ]
        return identified(datasets).model

    return Machine("stack", ("x",), stack.SAMPLE_TIME, FILLING * stack.SAMPLE_TIME, cases, same, (plain[-1], shaped[-1]), model)


def mirror_machine(scoring: bool, level: int) -> Machine:
    """Construct the mirror at one of its levels.

    Parameters
    ----------
    scoring
        Cases from the records set apart for scoring.
    level
        Index of the level.

    Returns
    -------
    Machine
        The machine.
    """
    from hyst_control.blind_test.measured import DELAYS, fit, own_error
    from hyst_control.reproduction import fsm_cubespec as mirror

    data = mirror.load_levels()[level]
    case, other = (mirror.TEST[0], mirror.SELECT[0]) if scoring else (mirror.SELECT[0], mirror.TEST[0])

    def twice(realization: int, period: int) -> Clean:
        command, measurement = (
            np.concatenate([rows[:, :, realization, 1 - period], rows[:, :, realization, period]])
            for rows in (data.command, data.measurement)
        )
        return Clean(f"{data.name}, realization {realization + 1}", command, measurement)

    def model() -> Any:
        bare = mirror.model_of(fit(data, DELAYS[-1]).model, data.name, float(np.abs(data.command).max()))
        return replace(bare, discrepancy=own_error(bare, data, other))

    warm_up = mirror.PERIOD * mirror.SAMPLE_TIME
    return Machine(
        f"mirror, {mirror.LEVELS[level]} mV",
        mirror.AXES,
        mirror.SAMPLE_TIME,
        warm_up,
        (twice(case, 1),),
        {0: twice(case, 0)},
        (twice(other, 0),),
        model,
    )


def strength_of(
    injections: Sequence[Injection], clean: Clean, step: float, rms: float, seed: Sequence[int]
) -> tuple[float, Array, Array]:
    """Find the strength at which effects change the record by a given rms; effects of the drive, the command's equivalent.

    Parameters
    ----------
    injections
        Effects, all of the same relative strength.
    clean
        Clean record.
    step
        Sample time, s.
    rms
        Size of the change, measurement unit.
    seed
        Seed of what is random in them.

    Returns
    -------
    strength
        The common strength.
    command, measurement
        The record with the effects, (N, A).
    """
    slope = float(np.sqrt(np.mean(np.var(clean.measurement, axis=0)) / max(np.mean(np.var(clean.command, axis=0)), 1e-300)))

    def record(strength: float) -> tuple[Array, Array]:
        command, measurement = clean.command, clean.measurement
        for injection in injections:
            command, measurement = injection.apply(command, measurement, step, strength, np.random.default_rng(list(seed)))
        return np.asarray(command, dtype=np.float64), np.asarray(measurement, dtype=np.float64)

    def size(strength: float) -> float:
        command, measurement = record(strength)
        moved = measurement - clean.measurement
        return float(np.sqrt(np.mean(moved**2) + slope**2 * np.mean((command - clean.command) ** 2)))

    beyond = next((scale for scale in SCALES if size(scale) > rms), None)
    if beyond is None:
        strength = float(SCALES[-1])
    elif size(beyond / 2.0) > rms:
        strength = float(beyond)
    else:
        strength = float(np.exp(brentq(lambda x: size(float(np.exp(x))) - rms, np.log(beyond / 2.0), np.log(beyond), xtol=1e-3)))
    return (strength, *record(strength))


def make(out: str, seed: int, count: int, plants: Sequence[str] | None = None, note: Callable[[str], None] = print) -> Path:
    """Draw injected cases, record them, and write their labels to a separate file.

    Parameters
    ----------
    out
        Folder of the run.
    seed
        Seed of the cases; from `SCORING` on the records set apart for scoring are used.
    count
        Number of cases.
    plants
        Restriction to some of `PLANTS`; None: all.
    note
        Called with every line of progress.

    Returns
    -------
    Path
        File of the labels.

    Raises
    ------
    InputError
        A plant does not exist, the measurements are absent, or the folder is that of another run.
    """
    from hyst_control.model_file import save_model, simulate
    from hyst_control.records.importing import write_bag

    for name in plants or ():
        if name not in PLANTS:
            raise InputError(f"--plants: must be among {', '.join(PLANTS)} with --measured, got {name}")
    folder, labels = Path(out), Path(out) / "labels.json"
    given: dict[str, Any] = {"seed": seed, "count": count, "plants": list(plants or PLANTS)}
    if labels.exists():
        known = json.loads(labels.read_text(encoding="utf-8"))
        if {name: known.get(name) for name in given} != given:
            raise InputError(f"{labels}: holds cases of another seed, count or plants: choose another folder")
        note(f"labels: SHA-256 {_digest(labels)}")
        return labels
    if folder.exists() and any(folder.iterdir()) and not (folder / "cases").is_dir():
        raise InputError(f"{folder}: holds files that are not of a blind test: choose another folder")
    scoring = seed >= SCORING
    machines: list[Machine] = []
    if "stack" in given["plants"]:
        machines.append(stack_machine(scoring))
    if "mirror" in given["plants"]:
        machines += [mirror_machine(scoring, level) for level in range(3)]
    models = []
    for machine in machines:
        models.append(machine.model())
        note(f"{machine.name}: model {models[-1].name}")
    documents = []
    for index in range(count):
        random = np.random.default_rng([seed, index])
        which = index % len(machines)
        machine, model = machines[which], models[which]
        kind = str(random.choice(["single", "pair", "none", "open_set"], p=[0.65, 0.1, 0.15, 0.1]))
        mode = MODES[index // len(machines) % len(MODES)]
        at = int(random.integers(len(machine.cases)))
        if mode == "same_command":
            at = int(random.choice(sorted(machine.same)))
        clean = machine.cases[at]
        rest = without_zero(clean.measurement - simulate(model, clean.command))[0][
            len(clean.command) // 2 if machine.warm_up else 0 :
        ]
        own = float(np.sqrt(np.mean(rest**2)))
        multiple = float(random.choice(SIZES))
        chosen = _drawn(kind, random)
        strength, command, measurement = 0.0, clean.command, clean.measurement
        if chosen:
            strength, command, measurement = strength_of(chosen, clean, machine.sample_time, multiple * own, (seed, index, 1))
        name = f"case_{index:04d}"
        place = folder / "cases" / name
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        write_bag(place / "bag", _record(machine, command, measurement, name))
        beside = {"none": (), "other_command": machine.others, "same_command": (machine.same.get(at),)}[mode]
        for number, other in enumerate(one for one in beside if one is not None):
            write_bag(place / f"clean_{number}", _record(machine, other.command, other.measurement, f"clean {number}"))
        save_model(model, place / "model.yaml")
        write_json(place / "case.json", {"warm_up": machine.warm_up})
        documents.append(
            {
                "name": name,
                "plant": machine.name,
                "record": clean.name,
                "mode": mode,
                "kind": kind,
                "names": [one.name for one in chosen],
                "realizations": [one.realization for one in chosen],
                "multiple": multiple if chosen else 0.0,
                "strength": strength,
                "own_error_rms": own,
                "gap_rms": float(np.sqrt(np.mean((measurement - clean.measurement) ** 2))),
                "one_frequency": machine.name == "stack",
            }
        )
    write_json(labels, {**given, "cases": rounded(documents)})
    note(f"labels: SHA-256 {_digest(labels)}")
    return labels


def run(
    out: str,
    seed: int,
    count: int,
    plants: Sequence[str] | None = None,
    page: str | None = None,
    note: Callable[[str], None] = print,
) -> Table:
    """Draw, diagnose and score injected cases; what an interrupted run has done is kept.

    Parameters
    ----------
    out
        Folder of the run.
    seed
        Seed of the cases.
    count
        Number of cases.
    plants
        Restriction to some of `PLANTS`; None: all.
    page
        Page to write.
    note
        Called with every line of progress.

    Returns
    -------
    Table
        The figures.

    Raises
    ------
    InputError
        As `make`.
    """
    labels = make(out, seed, count, plants, note)
    reports = Path(out) / "reports"
    reports.mkdir(exist_ok=True)
    documents = json.loads(labels.read_text(encoding="utf-8"))["cases"]
    waiting = [one["name"] for one in documents if not (reports / f"{one['name']}.json").exists()]
    for done, name in enumerate(map_spawned(_diagnose_one, [(str(out), name) for name in waiting]), 1):
        note(f"{done} of {len(waiting)} diagnosed ({name})")
    rows = [(one, json.loads((reports / f"{one['name']}.json").read_text(encoding="utf-8"))) for one in documents]
    table = score(rows)
    if page is not None:
        write_page(Path(page), rows, table, seed, count, _digest(labels))
    return table


def score(rows: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]]) -> Table:
    """Score reports against their labels.

    Parameters
    ----------
    rows
        Label and report by case.

    Returns
    -------
    Table
        Fractions with their numbers, by clean records and size.
    """
    from hyst_control.blind_test.scores import wilson

    table = Table("blind-test --injected")

    def add(case: str, subject: str, quantity: str, hits: Sequence[bool]) -> None:
        right = sum(hits)
        table.add(TITLE, case, subject, quantity, "", right / len(hits), n=len(hits), ci95=wilson(right, len(hits)))

    for mode in MODES:
        ours = [(label, report) for label, report in rows if label["mode"] == mode]
        for size in SIZES:
            singles = [pair for pair in ours if pair[0]["kind"] == "single" and pair[0]["multiple"] == size]
            if singles:
                add(mode, f"{size:g} x own error", "top_1", [named_right(*pair) for pair in singles])
        for kind, quantity, judge in (
            ("pair", "at_least_one", named_right),
            ("open_set", "unknown", lambda label, report: report["verdict"] == "unknown"),
            ("none", "false_alarm", lambda label, report: not quiet(report)),
        ):
            some = [pair for pair in ours if pair[0]["kind"] == kind]
            if some:
                add(mode, kind, quantity, [judge(*pair) for pair in some])
    if rows:
        seconds = [report["seconds"] for _, report in rows]
        table.add(TITLE, "all", "diagnosis", "seconds_median", "s", float(np.median(seconds)), n=len(seconds))
    return table


def named_right(label: Mapping[str, Any], report: Mapping[str, Any]) -> bool:
    """Report whether the first name is that of an injected effect, and the verdict names effects.

    Parameters
    ----------
    label
        Label of the case.
    report
        Report on it.

    Returns
    -------
    bool
        True if so.
    """
    named = [effect["name"] for effect in report["effects"]]
    accepted = {name for one in label["names"] for name in (one, *EQUAL.get(one, ()))}
    if label["one_frequency"] and accepted & set(LAGS):
        accepted |= set(LAGS)
    companion = bool(accepted & set(COMPANIONS))
    first = next((name for name in named if companion or name not in COMPANIONS), None)
    return report["verdict"] in ("effect", "ambiguous") and first in accepted


def quiet(report: Mapping[str, Any]) -> bool:
    """Report whether a diagnosis of a clean record names nothing but coefficients and companions.

    Parameters
    ----------
    report
        Report on it.

    Returns
    -------
    bool
        True if so.
    """
    if report["verdict"] in ("no_gap", "parameters"):
        return True
    return report["verdict"] == "effect" and all(effect["name"] in COMPANIONS for effect in report["effects"])


def write_page(
    path: Path, rows: Sequence[tuple[Mapping[str, Any], Mapping[str, Any]]], table: Table, seed: int, count: int, digest: str
) -> None:
    """Write the page of a run.

    Parameters
    ----------
    path
        File to write.
    rows
        Label and report by case.
    table
        The figures.
    seed, count
        Seed and number of the cases.
    digest
        SHA-256 of the labels.
    """
    from hyst_control.files import write_text

    lines = [
        "# The diagnosis on measurements, an effect injected",
        "",
        f"Generated by `hyst blind-test --injected --seed {seed} --count {count} --page`; labels: SHA-256 `{digest}`.",
        "",
        *(line.strip() for line in (__doc__ or "").strip().splitlines()),
        "",
        "| clean records | cases | figure | value | number |",
        "|---|---|---|---|---|",
        *(f"| {row.case} | {row.subject} | {row.quantity} | {row.value:.2f} | {row.n} |" for row in table.rows),
        "",
        "| case | plant | clean records | injected | size | verdict | named |",
        "|---|---|---|---|---|---|---|",
    ]
    for label, report in rows:
        injected = ", ".join(
            f"{name} ({how})" if how else name for name, how in zip(label["names"], label["realizations"], strict=True)
        )
        named = ", ".join(effect["name"] for effect in report["effects"])
        lines.append(
            f"| {label['name']} | {label['plant']} | {label['mode']} | {injected or 'nothing'} | {label['multiple']:g} | "
            f"{report['verdict']} | {named} |"
        )
    write_text(path, "\n".join(lines) + "\n")


def _drawn(kind: str, random: np.random.Generator) -> list[Injection]:
    if kind == "none":
        return []
    if kind == "open_set":
        return [OPEN_SET[int(random.integers(len(OPEN_SET)))]]
    names = sorted({one.name for one in SINGLES})
    chosen = random.choice(names, 2 if kind == "pair" else 1, replace=False)
    found = []
    for name in chosen:
        realizations = [one for one in SINGLES if one.name == name]
        found.append(realizations[int(random.integers(len(realizations)))])
    return found


def _record(machine: Machine, command: Array, measurement: Array, name: str) -> Record:
    axis = machine.sample_time * np.arange(len(command), dtype=np.float64)
    signals = {"command": Signal(axis, command, machine.axes, "V"), "measurement": Signal(axis, measurement, machine.axes, "um")}
    return Record(signals, name)


def _diagnose_one(job: tuple[str, str]) -> str:
    from hyst_control.diagnose.workflow import diagnosed
    from hyst_control.model_file import load_model
    from hyst_control.records.bag_reader import read_bag

    out, name = job
    place = Path(out) / "cases" / name
    begin = time.monotonic()
    warm_up = float(json.loads((place / "case.json").read_text(encoding="utf-8"))["warm_up"])
    clean = [read_bag(path) for path in sorted(place.glob("clean_*"))]
    document, *_ = diagnosed([read_bag(place / "bag")], load_model(place / "model.yaml"), warm_up=warm_up, baseline=clean)
    document["seconds"] = time.monotonic() - begin
    write_json(Path(out) / "reports" / f"{name}.json", document)
    return name


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
