# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Injected cases: known effects put into records of machines, so that the physics is real and the truth exact.

Every size is a multiple of what the identified model leaves on baseline records that it was not identified from.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count, islice
from typing import Any

import numpy as np

from evaluation.blind_test.case import Case, Label, Made
from evaluation.blind_test.effect_sizes import NOISE_LIKE
from evaluation.blind_test.injected_machines import SCORING, SIMULATED, Machine, machine_of
from evaluation.blind_test.injections import COMPANIONS, OPEN_SET, SINGLES, Injection, apply_all, strength_of, structural_rms
from evaluation.data_files import table_file
from hyst_control.model_file import simulate
from hyst_control.records.record import sampled_record

LAGS = ("delay", "sensor_lowpass", "amplifier_lowpass")
"""Effects that count as one name where the record has one frequency."""
QUASI_STATIC = ("gain", "resonance")
"""A further mode far above the one frequency of a record is a gain there."""
EQUAL = {"gain": ("hysteresis_width",), "dac_hold": ("sensor_noise",), "sensor_noise": ("flicker_noise",)}
"""Names that an engineer would accept as well."""
ONE_FREQUENCY = ("stack",)
"""Machines whose records have one frequency."""


def made(case: Case) -> Made:
    """Make a case: its effects, each as strong as is asked for, are put into the machine's baseline record."""
    machine = machine_of(case.plant, case.seed >= SCORING)
    model, step = machine.model(), machine.sample_time
    record = next(index for index, clean in enumerate(machine.cases) if clean.name == case.excitation)
    clean, seeds = machine.cases[record], (case.seed, int(case.name.rpartition("_")[2]), 1)
    first = round(machine.warm_up / step)
    own = structural_rms(clean.measurement - simulate(model, clean.command), first)
    injections = [_injection(effect) for effect in case.effects]
    strengths = [strength_of(one, clean, step, case.multiple * own, seeds, first) for one in injections]
    command, measurement = apply_all(injections, strengths, clean, step, seeds)
    truth = injections[0].truth(strengths[0], clean.measurement, step) if injections else {}
    label = Label(
        case.kind,
        case.names,
        structural_rms(measurement - simulate(model, command), first),
        own,
        accepted=tuple(tuple(sorted(accepted(name, case.plant in ONE_FREQUENCY))) for name in case.names),
        ignored=tuple(name for name in COMPANIONS if not set(COMPANIONS) & set(case.names)),
        truth={name: tuple(np.broadcast_to(value, len(machine.axes)).tolist()) for name, value in truth.items()},
    )
    beside = {"none": (), "other_command": machine.others, "same_command": (machine.same.get(record),)}[case.regime]
    effects = tuple({**effect, "strength": strength} for effect, strength in zip(case.effects, strengths, strict=True))
    others = [(other.command, other.measurement) for other in beside if other is not None]
    named = {case.name: (command, measurement), **{f"clean {number}": other for number, other in enumerate(others)}}
    new, *baseline = (sampled_record(name, *rows, step, machine.axes, "um") for name, rows in named.items())
    return Made(new, model, label, effects, tuple(baseline), machine.warm_up)


def accepted(name: str, one_frequency: bool) -> set[str]:
    """Names that are right for an injected effect."""
    names = {name, *EQUAL.get(name, ())}
    for alike in (LAGS, QUASI_STATIC) if one_frequency else ():
        names |= {right for other in alike for right in (other, *EQUAL.get(other, ()))} if name in alike else set()
    return names


def _injection(effect: Mapping[str, Any]) -> Injection:
    return next(one for one in (*SINGLES, *OPEN_SET) if (one.name, one.realization) == (effect["name"], effect["realization"]))


MODES = ("none", "other_command", "same_command")
"""Baseline records beside the new one."""
ALIKE = (("delay", "sensor_lowpass", "amplifier_lowpass"), ("gain", "resonance", "gain_drift"), ("creep", "gain_drift"))
"""Effects that are not put together into a pair: most records tell them apart alone, but not one beside the other."""

Step = tuple[str, str, str, float]

STEPS: dict[str, tuple[Step, ...]] = table_file("blind_test/injected_plan.yaml")
CLEAN = 2
"""Baseline records in a round."""


def planned(machines: Sequence[Machine], seed: int, number: int) -> Iterator[Case]:
    """Plan cases."""
    rows = islice(_rounds(machines, seed), number)
    return (replace(case, name=f"case_{index:04d}", seed=seed) for index, case in enumerate(rows))


def _rounds(machines: Sequence[Machine], seed: int) -> Iterator[Case]:
    random = np.random.default_rng([seed, 11])
    groups = {group: [one for one in machines if _group(one) == group] for group in ("stack", "mirror", "simulated")}
    clean = _clean_cells(machines, random)
    waiting: dict[str, list[str]] = {}
    for turn in count():
        stack, simulations, unknown, mirror = (STEPS[name] for name in ("stack", "simulations", "open", "mirror"))
        steps = [*stack, *stack, unknown[turn % len(unknown)], *simulations, *simulations]
        steps += [mirror[turn // 2 % len(mirror)]] if turn % 2 == 0 else []
        cells = [
            _cell(group[(turn + number) % len(group)], step, waiting, random)
            for number, step in enumerate(steps)
            if (group := groups[step[0]])
        ]
        yield from cells
        yield from [clean.pop() for _ in range(min(CLEAN, len(clean)))]


def _group(machine: Machine) -> str:
    return "simulated" if machine.name in SIMULATED else machine.name.split(",")[0]


def _clean_cells(machines: Sequence[Machine], random: np.random.Generator) -> list[Case]:
    """Every baseline record with every set of baseline records beside it, in random order; of each of the mirror's levels one set."""
    cells = []
    mirrors = [machine for machine in machines if _group(machine) == "mirror"]
    cells += [_row(machine, 0, "none", MODES[index % len(MODES)]) for index, machine in enumerate(mirrors)]
    for machine in [machine for machine in machines if machine not in mirrors]:
        for record in range(len(machine.cases)):
            modes = ["none", *(["other_command"] if machine.others else []), *(["same_command"] if record in machine.same else [])]
            cells += [_row(machine, record, "none", mode) for mode in modes]
    return [cells[index] for index in random.permutation(len(cells))]


def _row(machine: Machine, record: int, kind: str, mode: str, multiple: float = 0.0, *injections: Injection) -> Case:
    effects = tuple({"name": one.name, "realization": one.realization} for one in injections)
    how: dict[str, Any] = {"source": "injected", "regime": mode, "multiple": multiple, "axes": machine.axes}
    return Case("", machine.name, kind, machine.cases[record].name, 0.0, 0, effects, **how)


def _cell(machine: Machine, step: Step, waiting: dict[str, list[str]], random: np.random.Generator) -> Case:
    group, kind, mode, multiple = step
    record = int(random.choice(sorted(machine.same) if mode == "same_command" else len(machine.cases)))
    if kind == "open_set":
        return _row(machine, record, kind, mode, multiple, _next(OPEN_SET, "realization", f"open {group}", waiting, random))
    if kind == "pair":
        while True:
            names = random.choice(sorted({one.name for one in SINGLES} - set(COMPANIONS) - set(NOISE_LIKE)), 2, replace=False)
            if not any(set(names) <= set(alike) for alike in ALIKE):
                break
        return _row(machine, record, kind, mode, multiple, *(_realized(str(name), random) for name in names))
    singles = tuple(one for one in SINGLES if one.name not in COMPANIONS)
    name = _next(singles, "name", f"single {group} {mode} {multiple}", waiting, random).name
    return _row(machine, record, kind, mode, multiple, _realized(name, random))


def _realized(name: str, random: np.random.Generator) -> Injection:
    realizations = [one for one in SINGLES if one.name == name]
    return realizations[int(random.integers(len(realizations)))]


def _next(
    injections: Sequence[Injection], attribute: str, key: str, waiting: dict[str, list[str]], random: np.random.Generator
) -> Injection:
    """One of the injections, each value of the attribute in turn before any comes again."""
    left = waiting.setdefault(key, [])
    if not left:
        left += [str(value) for value in random.permutation(sorted({getattr(one, attribute) for one in injections}))]
    value = left.pop()
    return next(one for one in injections if getattr(one, attribute) == value)
