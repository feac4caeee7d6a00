"""Labels of the blind test's cases: the true gap of each, and its visibility."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from evaluation.blind_test.case import Case
from evaluation.blind_test.case_records import plant_of, run_case
from evaluation.blind_test.nominal_models import stated_noise
from evaluation.blind_test.plant_setups import SETUPS
from hyst_control.chain.stage import Array

LEAST_VISIBILITY = 10.0
"""Distance (standard deviations, coefficients marginalized) below which a gap is invisible: such a case counts as none."""


def with_label(case: Case, stated: float | None = None) -> Case:
    """Add the label to a case: kind and effects to score, true gap, begin of each effect, and visibility.

    A pair's label also lists the effects that are `shown`: visible beside the other.
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
    least = 0.2 * noise if setup.model is not None else 1.5 * stated  # a gap below the model's own error cannot be detected
    within = case.kind != "parameters"  # coefficients outside their tolerance are themselves the gap
    wrong = bool(case.effects) or not within
    if wrong:
        difference = _difference(case, replace(case, effects=()), within)
        gap = float(np.sqrt(np.mean(difference**2)))
        distance = visibility(case, difference, stated)
    label |= {"gap_rms": gap, "noise_rms": noise, "distance": distance}
    if wrong and (distance < LEAST_VISIBILITY or gap < least):
        label["kind"] = "none"
        label["hidden"] = list(case.names) or [case.kind]
        label["names"] = []
    elif case.kind == "pair":
        label["shown"] = []
        for effect in case.effects:
            part = _difference(case, replace(case, effects=tuple(other for other in case.effects if other is not effect)))
            size = visibility(replace(case, effects=(effect,)), part, stated)
            if size >= LEAST_VISIBILITY and float(np.sqrt(np.mean(part**2))) >= least:
                label["shown"].append(effect["name"])
    return replace(case, label=label)


def _difference(case: Case, other: Case, scattered: bool = True) -> Array:
    """Difference (N, A) of the noiseless measurements of two cases' plants; `scattered`: the other's coefficients scatter."""
    if case.excitation == "closed_loop":  # a loop hides a gap: both plants are driven by the same command
        command = run_case(case, noisy=False)["command"]
        truth, bare = plant_of(case, noisy=False), plant_of(other, noisy=False, scattered=scattered)
        measured, expected = (np.concatenate([plant.reset(command[0])[None], plant.step(command)[:-1]]) for plant in (truth, bare))
    else:
        measured = run_case(case, noisy=False)["measurement"]
        expected = run_case(other, noisy=False, scattered=scattered)["measurement"]
    return np.asarray(measured - expected, dtype=np.float64)


def visibility(case: Case, difference: Annotated[Array, "N A"], noise: float) -> float:
    """Distance of a difference from any change of gain and offset on each axis."""
    measured = run_case(case, effects=False, noisy=False)["measurement"]
    left = 0.0
    for axis in range(difference.shape[1]):
        known = np.stack([np.ones(len(measured)), measured[:, axis]], axis=1)
        if case.names and set(case.names) <= {"gain", "offset"}:
            known = known[:, :0]
        rest = difference[:, axis] - (known @ np.linalg.lstsq(known, difference[:, axis], rcond=None)[0] if known.shape[1] else 0.0)
        left += float(rest @ rest)
    return float(np.sqrt(left) / noise)
