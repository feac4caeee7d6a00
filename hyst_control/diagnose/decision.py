"""From scores to a verdict: nothing, coefficients, an effect, several that cannot be told apart, or nothing known."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from importlib.resources import files

import numpy as np
import yaml

from hyst_control.chain.stage import Array
from hyst_control.diagnose.hypothesis_search import Found, Scored, strain, strained
from hyst_control.diagnose.unexplained_residual import leftover


@dataclass(frozen=True)
class Thresholds:
    """See thresholds.yaml."""

    practical_floor: float
    discrepancy: float
    rounding: float
    margin: float
    sharpness: float
    sure: float
    possible: float
    unknown: float
    most: float
    further: float
    least_excess: float
    own_error: float
    form: float


@cache
def thresholds() -> Thresholds:
    """The committed thresholds."""
    document = yaml.safe_load((files("hyst_control.diagnose") / "thresholds.yaml").read_text(encoding="utf-8"))
    return Thresholds(**{field.name: float(document[field.name]) for field in fields(Thresholds)})


@dataclass(frozen=True)
class Decision:
    """What is concluded about one problem.

    verdict: no_gap, parameters, effect, ambiguous or unknown. chosen: the best explanation (None: the nominal model as it is).
    listed: explanations that the data cannot tell from it, best first, itself among them. probability: by explanation's names.
    remainder: share of the gap's energy that the best explanation leaves, 0 where that is under the floor.
    """

    verdict: str
    chosen: Scored
    listed: tuple[Scored, ...]
    probability: dict[tuple[str, ...], float]
    remainder: float

    def of(self, name: str) -> float:
        """Probability that an effect is at work."""
        return float(sum(p for names, p in self.probability.items() if name in names))


PARAMETERS = ("parameters",)


def key(scored: Scored) -> tuple[str, ...]:
    """What an explanation is called in `Decision.probability`."""
    return PARAMETERS if scored.inflated else scored.names


def decide(
    found: Found, threshold: float, floor: float, limits: Thresholds, stated: float = 1.0, lattice: Array | None = None
) -> Decision:
    """The verdict.

    threshold: 99 % quantile of the simulated null (nats); floor: practical size, rms in units of the noise; stated: energy (in
    units of the noise's) that the model itself says it leaves; lattice (A,): steps on which the measurement lies, 0 without.
    """
    problem = found.linearised.problem
    lattice = np.zeros(len(problem.model.axes)) if lattice is None else lattice
    size = len(found.linearised.measured)
    before = energy(found.none, size)
    # A model that states an error of its own leaves all kinds of it: an effect has to take off what goes beyond.
    least = max(floor**2, limits.own_error * (stated - 1.0))
    before_strain = strain(found.none.solution)

    def worth_naming(scored: Scored) -> bool:
        """It takes off more than the practical size, or relieves coefficients that had to leave their tolerance for it."""
        relief = before_strain - strain(scored.solution)
        return before - energy(scored, size) > least or stated < 1.5 and found.temper * relief > threshold + limits.margin

    claims = [
        scored
        for scored in (*found.singles, *found.combinations)
        if scored.score > 0
        and worth_naming(scored)
        and found.temper * (found.none.solution.misfit - scored.solution.misfit) > threshold + limits.margin
    ]
    if found.parameters.score > limits.margin and (stated < 1.5 or before - energy(found.parameters, size) > least):
        claims.append(found.parameters)
    claims = _without_idle_members(
        sorted(claims, key=lambda scored: -scored.score),
        threshold + limits.margin,
        found.temper,
        found.none.solution.misfit,
        limits.further,
    )
    hypotheses = claims or [found.none]
    weights = np.exp(limits.sharpness * (np.array([scored.score for scored in hypotheses]) - hypotheses[0].score))
    weights /= weights.sum()
    probability: dict[tuple[str, ...], float] = {}
    for scored, weight in zip(hypotheses, weights, strict=True):
        probability[key(scored)] = probability.get(key(scored), 0.0) + float(weight)
    chosen = hypotheses[0]
    after = float(np.mean(leftover(problem, chosen, lattice) ** 2))
    left_over = after - stated > max(floor**2, limits.least_excess * stated)
    remainder = float(np.clip((after - stated) / max(before - stated, 1e-12), 0.0, 1.0)) if left_over else 0.0
    if remainder > limits.unknown or len(chosen.names) > limits.most:
        return Decision("unknown", chosen, (chosen,), probability, remainder)
    if not claims:
        return Decision("no_gap", chosen, (), probability, remainder)
    if probability[key(chosen)] >= limits.sure:
        return Decision("parameters" if chosen.inflated else "effect", chosen, (chosen,), probability, remainder)
    listed, seen = [], set()
    for scored in hypotheses:
        if key(scored) not in seen and probability[key(scored)] >= limits.possible:
            seen.add(key(scored))
            listed.append(scored)
    return Decision(
        "ambiguous" if len(listed) > 1 else "parameters" if chosen.inflated else "effect",
        chosen,
        tuple(listed),
        probability,
        remainder,
    )


def energy(scored: Scored, size: int) -> float:
    """Mean square of what an explanation leaves, in units of the noise's variance."""
    return float(scored.solution.residual @ scored.solution.residual) / size


def _without_idle_members(claims: list[Scored], gain: float, temper: float, before: float, further: float) -> list[Scored]:
    """Combinations count only where they are better than each of their parts by what a claim needs.

    And by a share of all that they take off: beside a great effect what its stage and the physics differ by is many times the noise.
    But not where the coefficients had to leave their tolerance for a part, and need not for the combination.
    """
    kept = []
    for scored in claims:
        names = set(scored.names)
        parts = [other for other in claims if set(other.names) < names]
        if len(scored.names) > 1 and parts:
            best = min(parts, key=lambda other: other.solution.misfit)
            better = best.solution.misfit - scored.solution.misfit
            relieved = strained(best.solution) and not strained(scored.solution)
            if temper * better <= gain or (better <= further * (before - scored.solution.misfit) and not relieved):
                continue
        kept.append(scored)
    return kept
