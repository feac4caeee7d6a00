# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Plan of the injected cases: which effect goes into which record, beside which clean records.

The plan is a round that repeats, so that any number of cases, and what an interrupted run has diagnosed, has every row of the table in
the same proportion. Each effect comes in turn before any comes again. A clean record as it is comes once for every set of clean records
beside it, since the same input has the same report.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import count, islice

import numpy as np

from evaluation.blind_test.case import Case
from evaluation.blind_test.effect_sizes import NOISE_LIKE
from evaluation.blind_test.injected_machines import SIMULATED, Machine
from evaluation.blind_test.injections import COMPANIONS, OPEN_SET, SINGLES, Injection
from evaluation.data_files import table_file

MODES = ("none", "other_command", "same_command")
"""Baseline records beside the new one."""
ALIKE = (("delay", "sensor_lowpass", "amplifier_lowpass"), ("gain", "resonance", "gain_drift"), ("creep", "gain_drift"))
"""Effects that are not put together into a pair: most records tell them apart alone, but not one beside the other."""

Step = tuple[str, str, str, float]

STEPS: dict[str, tuple[Step, ...]] = table_file("blind_test/injected_plan.yaml")
CLEAN = 2
"""Clean records in a round."""


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
    """Every clean record with every set of clean records beside it, in random order; of each of the mirror's levels one set."""
    cells = []
    mirrors = [machine for machine in machines if _group(machine) == "mirror"]
    for machine in mirrors:
        cells.append(_row(machine, 0, "none", MODES[mirrors.index(machine) % len(MODES)]))
    for machine in [machine for machine in machines if machine not in mirrors]:
        for record in range(len(machine.cases)):
            modes = ["none", *(["other_command"] if machine.others else []), *(["same_command"] if record in machine.same else [])]
            cells += [_row(machine, record, "none", mode) for mode in modes]
    return [cells[index] for index in random.permutation(len(cells))]


def _row(machine: Machine, record: int, kind: str, mode: str, multiple: float = 0.0, *injections: Injection) -> Case:
    return Case(
        "",
        machine.name,
        kind,
        machine.cases[record].name,
        0.0,
        0,
        tuple({"name": one.name, "realization": one.realization} for one in injections),
        source="injected",
        regime=mode,
        multiple=multiple,
        axes=machine.axes,
    )


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
