# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Cases of the blind test, drawn by a seed and balanced: kinds, plants, excitations, noise, and effects of drawn size.

Seeds 0 to 999 are for tuning, scoring seeds begin at 100000; an effect has several realizations (place, phase, law, …), of which tuning
seeds draw only some.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from evaluation.blind_test.case import EXCITATIONS, NOISES, Case
from evaluation.blind_test.case_records import commands
from evaluation.blind_test.effect_sizes import NOISE_LIKE, OPEN_SET, SEVERITIES, draw_effect, draw_realization
from evaluation.blind_test.plant_setups import PLANTS, SETUPS

KIND_FRACTIONS = {"single": 0.45, "none": 0.25, "pair": 0.12, "open_set": 0.1, "parameters": 0.08}
"""Fraction of the cases that are of a kind."""

COEFFICIENT_DEVIATION = (4.0, 8.0)
"""`parameters`: the coefficients are off by this many times their tolerance."""

SWITCH_FRACTION = (0.3, 0.7)
"""Fraction of the record's length after which an effect that is switched on begins."""


def draw(
    seed: int,
    count: int,
    plants: Sequence[str] = PLANTS,
    kinds: Mapping[str, float] | Sequence[str] | None = None,
    excitations: Sequence[str] = EXCITATIONS,
    switched: float = 0.0,
    duration: float = 1.5,
) -> list[Case]:
    """Draw a balanced set of cases: every effect on every plant in turn, half of it on the rich record."""
    random = np.random.default_rng(seed)
    realizations = np.random.default_rng([seed, 5])  # separate, so that sizes and scatter do not depend on how many there are
    chosen = kinds or KIND_FRACTIONS
    shares = (
        dict(chosen) if isinstance(chosen, Mapping) else {kind: KIND_FRACTIONS[kind] for kind in KIND_FRACTIONS if kind in chosen}
    )
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
        off = float(random.uniform(*COEFFICIENT_DEVIATION)) if kind == "parameters" else 1.0
        case = Case("", plant, kind, excitation, noise, int(random.integers(1 << 31)), off=off, duration=duration)
        realized = [draw_realization(name, plant, seed, realizations) for name in names]
        effects = tuple({**draw_effect(name, plant, noise, random), **own} for name, (own, _) in zip(names, realized, strict=True))
        cases.append(replace(case, effects=effects, untuned=any(untuned for _, untuned in realized)))
    random.shuffle(cases)
    times = np.random.default_rng([seed, 3])  # separate, so that the cases are the same with and without switching
    return [replace(case, name=f"case_{index:04d}", effects=_begun(case, switched, times)) for index, case in enumerate(cases)]


def _begun(case: Case, switched: float, random: np.random.Generator) -> tuple[Mapping[str, Any], ...]:
    """Effects of a case, switched on within the record in a fraction `switched` of the cases."""
    if not case.effects or random.random() >= switched:
        return case.effects
    sample_time = SETUPS[case.plant].sample_time
    length = len(commands(case))
    return tuple({**effect, "from": round(random.uniform(*SWITCH_FRACTION) * length) * sample_time} for effect in case.effects)


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
