"""Injected cases: known effects put into records of machines, so that the physics is real and the truth exact.

Every size is a multiple of what the identified model leaves on clean records that it was not identified from. `injections` has the effects,
`injected_machines` the records, `injected_plan` which is put into which.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from evaluation.blind_test.case import Case, Label, Made, plain_record
from evaluation.blind_test.injected_machines import SCORING, machine_of
from evaluation.blind_test.injections import COMPANIONS, OPEN_SET, SINGLES, Injection, apply_all, strength_of, structural_rms
from hyst_control.model_file import simulate

LAGS = ("delay", "sensor_lowpass", "amplifier_lowpass")
"""Effects that count as one name where the record has one frequency."""
QUASI_STATIC = ("gain", "resonance")
"""A further mode far above the one frequency of a record is a gain there."""
EQUAL = {"gain": ("hysteresis_width",), "dac_hold": ("sensor_noise",), "sensor_noise": ("flicker_noise",)}
"""Names that an engineer would accept as well."""
ONE_FREQUENCY = ("stack",)
"""Machines whose records have one frequency."""


def made(case: Case) -> Made:
    """Make a case: its effects, each as strong as is asked for, are put into the machine's clean record."""
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
    return Made(
        plain_record(command, measurement, step, machine.axes, case.name),
        model,
        label,
        tuple({**effect, "strength": strength} for effect, strength in zip(case.effects, strengths, strict=True)),
        tuple(
            plain_record(other.command, other.measurement, step, machine.axes, f"clean {number}")
            for number, other in enumerate(one for one in beside if one is not None)
        ),
        machine.warm_up,
    )


def accepted(name: str, one_frequency: bool) -> set[str]:
    """Names that are right for an injected effect."""
    names = {name, *EQUAL.get(name, ())}
    for alike in (LAGS, QUASI_STATIC) if one_frequency else ():
        names |= {right for other in alike for right in (other, *EQUAL.get(other, ()))} if name in alike else set()
    return names


def _injection(effect: Mapping[str, Any]) -> Injection:
    return next(one for one in (*SINGLES, *OPEN_SET) if (one.name, one.realization) == (effect["name"], effect["realization"]))
