# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Search for the effects that explain a gap: every candidate against the nominal model, then combinations by a beam search.

The weight of a candidate is its evidence (Laplace) relative to "no effect":

    score = τ (Φ_0 - Φ_c) - ½ log det(1 + τ (I_c - 1)) - log(number of effects) - log(realizations of the effect)

τ ≤ 1 reduces the weight of the misfit when even the best explanation leaves more than noise: that residual is correlated along
the record, so its samples are not independent.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np
from scipy.linalg import cho_factor

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.parallel import beside, map_known
from hyst_control.diagnose.configuration import CONFIGURATION, Configuration, SearchSettings, Thresholds
from hyst_control.diagnose.decide.policy import strained as are_strained
from hyst_control.diagnose.problem.per_record_stages import CarriedError
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.search.candidate import Candidate, Member
from hyst_control.diagnose.search.combinations import Tangent, closest_combinations, tangents_at, tangents_of_starts
from hyst_control.diagnose.search.fit import Linearized, Solution, fit, refined
from hyst_control.diagnose.search.starts import Begun, begin, gone_on, misfit_at, within
from hyst_control.records.correlation import correlation_length

RENEWED = 20  # Most times that the columns of the coefficients alone are renewed
FAR_BESIDE, GROWTH = 2.0, 10.0
"""Distance of a coefficient, in tolerances times a factor, from which a larger factor is looked at, and how much larger it is."""


@dataclass(frozen=True)
class FittedHypothesis:
    """Hypothesis with its fit and its score."""

    candidate: Candidate | None  # Effects; None for "no effect" and for coefficients alone
    solution: Solution  # The fit
    score: float  # Evidence over "no effect", nats
    inflated: bool = False  # Whether it is coefficients alone, beyond their tolerance
    tolerances: float = 1.0  # Size of the fit's unit of the coefficients, in tolerances
    noise: float = 0.0  # Misfit that is noise of the baseline records, carried over and changed by the effects (nats)

    @property
    def names(self) -> tuple[str, ...]:
        """Effects, none for the nominal model."""
        return () if self.candidate is None else self.candidate.names


@dataclass(frozen=True)
class Found:
    """Hypotheses that a search fitted on one problem."""

    linearized: Linearized  # Problem with the columns of its coefficients
    none: FittedHypothesis  # No effect
    parameters: FittedHypothesis  # Coefficients alone
    # singles, combinations: Single effects and combinations, best first
    singles: tuple[FittedHypothesis, ...]
    combinations: tuple[FittedHypothesis, ...]
    temper: float  # Weight of a sample

    @property
    def hypotheses(self) -> tuple[FittedHypothesis, ...]:
        """All of them, in the order of the evidence on them."""
        return (self.none, *self.singles, *self.combinations, self.parameters)


def inflated(linearized: Linearized, factor: float) -> Linearized:
    """The same columns with every tolerance multiplied; session effects stay as they are."""
    wide = copy(linearized)
    factors = np.where(linearized.scatter.companions > 0, 1.0, factor)
    wide.scatter = replace(
        linearized.scatter,
        coefficients=tuple(
            replace(c, tolerance=c.tolerance * float(f)) for c, f in zip(linearized.scatter.coefficients, factors, strict=True)
        ),
    )
    wide.columns, wide.gram = linearized.columns * factors, linearized.gram * np.outer(factors, factors)
    wide.factor = cho_factor(wide.gram + np.eye(wide.count)) if wide.count else None
    return wide


def search(
    linearized: Linearized,
    members: Sequence[Member],
    threshold: float,
    floor: float,
    leaves: float = 1.0,
    progress: Callable[[str], None] = lambda _: None,
    configuration: Configuration = CONFIGURATION,
) -> Found:
    """Fit and weigh all candidates."""
    settings, thresholds = configuration.search, configuration.policy
    none = FittedHypothesis(None, settled(linearized), 0.0)
    # The coefficients alone are needed when all is weighed.
    with beside(lambda: beyond_tolerance(linearized, none.solution, settings)) as alone:
        beam, depth = settings.beam, settings.depth
        whitened = linearized.problem.own_spectrum is not None
        if leaves >= thresholds.own_error_energy or whitened:
            depth = min(depth, settings.depth_with_own_error)
            beam = max(beam, settings.beam_with_own_error)
        strained = partial(_strained, thresholds=thresholds)
        # Every effect is as likely as any other before the record is seen, however many realizations it has.
        realizations = Counter(member.name for member in members)
        alternatives = np.log(max(len(realizations), 1))
        members = _screened(linearized, members, settings.realizations)
        without = none.solution.misfit
        begun = begin(linearized, [(Candidate((member,)), member.starts()) for member in members], settings, without)
        for one in begun:
            progress(one.candidate.names[0])
        size = len(linearized.measured)
        leading, waiting, finished = _leading(begun, size), begun, list[tuple[Candidate, Solution]]()

        def explained(best: Solution, excess: float) -> bool:
            return any(_beyond_noise(one) < excess and not strained(one) for one in (best, *(solution for _, solution in finished)))

        singles: list[Tangent] = []
        for size_reached in range(1, depth):
            if not leading:
                break
            best = leading[0].ends[0]
            excess = max(leaves - 1.0 + leaves * settings.spent * size_reached**2, settings.spent_floor * floor**2)
            # The stated spectrum of the discrepancy is an upper bound: an effect may hide below it, so there the search goes on. Elsewhere
            # exact fits are made first: beside linear coefficients a large effect leaves an error that looks like a second effect.
            if not whitened:
                finished += _contenders(linearized, _rest(waiting, finished), finished, without, threshold, configuration)
                if size_reached == 1 and not explained(
                    best, excess
                ):  # one that does not lead by its linear fit may still be all that there is
                    finished += _completed(linearized, _rest(leading[:beam], finished), without, threshold, configuration)
                if explained(best, excess):
                    break  # nothing but noise is left, and no coefficients were strained for it
            if whitened and without - best.misfit < threshold:
                break  # there is no gap to explain
            singles = singles or tangents_of_starts(linearized, members, settings.laid_beside)
            grown = _grown(linearized, leading[:beam], singles, settings, progress)
            if not grown:
                break
            end = grown[0].ends[0]
            gain = min(best.misfit, without) - end.misfit
            taken_off = 2.0 * gain / (size * linearized.problem.weight)
            relieved = strained(best) and not strained(end)
            if gain * effective_sample_weight(linearized.problem, end.residual) < threshold or (
                taken_off < floor**2 and not relieved
            ):
                break
            leading = _leading(grown, size)
            waiting = waiting + grown
        finished += _contenders(linearized, _rest(waiting, finished), finished, without, threshold, configuration)
        fits = [item for item in finished if len(item[0].members) == 1]
        combinations = [item for item in finished if len(item[0].members) > 1]
        for candidate, solution in _pruned(linearized, combinations):
            (combinations if len(candidate.members) > 1 else fits).append((candidate, solution))
        everything = [solution for _, solution in fits + combinations] + [none.solution]
        fits += [(one.candidate, one.ends[0]) for one in _rest(waiting, fits) if len(one.candidate.members) == 1]
        together = _with_fewer_limits(linearized, fits + combinations, without, thresholds.added_share)
        fits, combinations = together[: len(fits)], together[len(fits) :]
        temper = effective_sample_weight(linearized.problem, min(everything, key=lambda solution: solution.misfit).residual)
        none = replace(none, noise=carried_noise(linearized, None, none.solution))
        nothing = weighed(linearized.problem, none)

        def scored(candidate: Candidate, solution: Solution) -> FittedHypothesis:
            count = len(candidate.members)
            # Every parameter beyond the first may also follow the model discrepancy, which is no white noise.
            further = settings.own_error_parameter * (len(solution.x) - count) if leaves >= thresholds.own_error_energy else 0.0
            found = FittedHypothesis(candidate, solution, 0.0, noise=carried_noise(linearized, candidate, solution))
            gain = temper * (nothing - weighed(linearized.problem, found))
            # Beside baseline records ranges are as wide as physics allows, and say nothing of how probable an effect is: the information
            # criterion of Schwarz (1978) is the most that parameters cost.
            most = 0.5 * np.log(size) * len(solution.x) if whitened else np.inf
            among = count * alternatives + sum(np.log(realizations[name]) for name in candidate.names)
            return replace(found, score=float(gain - _occam(solution, temper, most) - among - further))

        def ranked(found: Sequence[tuple[Candidate, Solution]]) -> tuple[FittedHypothesis, ...]:
            return tuple(sorted((scored(*item) for item in found), key=lambda item: -item.score))

        def freedom(factor: float) -> float:
            """½ log of the room that the coefficients have, with their tolerances multiplied, to what the data leave of it."""
            gram = inflated(linearized, factor).gram
            return 0.5 * float(np.linalg.slogdet(np.eye(len(gram)) + temper * gram)[1]) if len(gram) else 0.0

        wider = alone.result()
        cost = float(freedom(1.0) - alternatives - np.log(len(wider)))  # a size is as likely as any other that was looked at
        parameters = max(
            (
                FittedHypothesis(
                    None,
                    fitted,
                    temper * float(nothing - weighed(linearized.problem, replace(none, solution=fitted))) + cost - freedom(factor),
                    True,
                    factor,
                    none.noise,
                )
                for factor, fitted in wider
            ),
            key=lambda one: one.score,
        )
        return Found(linearized, none, parameters, ranked(fits), ranked(combinations), temper)


def beyond_tolerance(linearized: Linearized, none: Solution, settings: SearchSettings) -> list[tuple[float, Solution]]:
    """Fits of coefficients alone, each with the factor of their tolerances: larger ones as long as a coefficient is far off beside it.

    What an identification tells to a millionth may be off by a per cent once the machine has been moved.
    """
    found: list[tuple[float, Solution]] = []
    factor, z = settings.inflation, none.z
    own = linearized.scatter.companions == 0.0
    while True:
        fitted = settled(inflated(linearized, factor), z / (factor / found[-1][0] if found else factor))
        found.append((factor, fitted))
        if np.abs(fitted.z[own]).max(initial=0.0) <= FAR_BESIDE or factor >= settings.most_inflation:
            return found
        factor, z = GROWTH * factor, fitted.z


def _screened(linearized: Linearized, members: Sequence[Member], most: int) -> list[Member]:
    """The members, of those of an effect without anything to fit only the `most` that come closest to the record."""
    ready = [member for member in members if not member.size]
    if len(ready) <= most:
        return list(members)
    order = np.argsort(map_known(_left_by, [(linearized, member) for member in ready]))
    kept = {id(ready[i]) for i in order[:most]}
    return [member for member in members if member.size or id(member) in kept]


def _left_by(linearized: Linearized, member: Member) -> float:
    """The misfit of an effect without anything to fit."""
    return misfit_at(linearized, Candidate((member,)).unknowns(), np.zeros(0))


def _leading(found: Sequence[Begun], rows: int) -> list[Begun]:
    """The best realization of every explanation, best first."""

    def spent(one: Begun) -> float:
        # Schwarz's criterion (1978): a line that swells, of fifty parameters, would take up what a second effect explains by one.
        return 0.5 * float(np.log(rows)) * sum(member.size for member in one.candidate.members if member.is_line)

    best: dict[tuple[object, ...], Begun] = {}
    for one in sorted(found, key=lambda one: one.misfit + spent(one)):
        best.setdefault(tuple(member.variant for member in one.candidate.members), one)
    return list(best.values())


def _rest(begun: Sequence[Begun], finished: Sequence[tuple[Candidate, Solution]]) -> list[Begun]:
    """Candidates that were begun, without those that are finished."""
    done = {id(candidate) for candidate, _ in finished}
    return [one for one in begun if id(one.candidate) not in done]


def _contenders(
    linearized: Linearized,
    begun: Sequence[Begun],
    finished: Sequence[tuple[Candidate, Solution]],
    without: float,
    threshold: float,
    configuration: Configuration,
) -> list[tuple[Candidate, Solution]]:
    """Fits of the chain as it is, of the best candidate and of those that might come near it: some at a time, the best first."""
    settings, found, pending = configuration.search, list[tuple[Candidate, Solution]](), list[tuple[Begun, Solution]]()
    best = min([without, *(solution.misfit for _, solution in finished)])
    begun = sorted(begun, key=lambda one: one.misfit)
    while begun:
        reach = within(min(best, begun[0].misfit), without, settings)
        # What gains less than half of what a claim needs can be left as it is.
        least = min(reach, without - settings.promise * threshold)
        near = [one for one in begun[: settings.first] if one.misfit <= least] or (
            [] if found or finished or pending else begun[:1]
        )
        if not near:
            break
        pending += zip(near, _gone_on(linearized, near, within(best, without, settings), without, configuration), strict=True)
        begun = begun[len(near) :]
        # A fit that has lost its way is not the one to go on with before others are tried.
        if min(solution.misfit for _, solution in pending) < without or not begun:
            found += _all_settled(linearized, pending, best if found else reach, without, configuration)
            best, pending = min([best, *(solution.misfit for _, solution in found)]), []
    return found + _all_settled(linearized, pending, best, without, configuration)


def _completed(
    linearized: Linearized, begun: Sequence[Begun], without: float, threshold: float, configuration: Configuration
) -> list[tuple[Candidate, Solution]]:
    """Fits of the chain as it is of all candidates that gain enough, each gone on with."""
    enough = [one for one in begun if one.misfit <= without - configuration.search.promise * threshold]
    ends = _gone_on(linearized, enough, without, without, configuration)
    return _all_settled(linearized, list(zip(enough, ends, strict=True)), np.inf, without, configuration)


def _beyond_noise(solution: Solution) -> float:
    """Energy that a fit leaves beyond the noise's, as a share of it."""
    return float(solution.residual @ solution.residual) / len(solution.residual) - 1.0


def _strained(solution: Solution, thresholds: Thresholds) -> bool:
    return are_strained(strain(solution), len(solution.z), thresholds)


def weighed(problem: Problem, scored: FittedHypothesis) -> float:
    """The misfit with the model discrepancy's bins, and the coefficients that it moves, by as much as they are independent.

    What the noise of baseline records adds to it is taken off: else an effect that smooths it would gain by that.
    """
    solution, residual = scored.solution, scored.solution.residual
    rest = solution.misfit - 0.5 * problem.weight * float(residual @ residual)
    return problem.nats(residual) - scored.noise + rest - (1.0 - problem.independent) * strain(solution)


def carried_noise(linearized: Linearized, candidate: Candidate | None, solution: Solution) -> float:
    """Misfit (nats) of a hypothesis that is noise of the baseline records, carried over with the model's error."""
    stages = linearized.problem.model.chain.stages  # coefficients move next to none of it
    noisier = tuple(stage.noisier() if isinstance(stage, CarriedError) and stage.noise else stage for stage in stages)
    if all(one is other for one, other in zip(noisier, stages, strict=True)):
        return 0.0
    either = (noisier, stages) if candidate is None else (candidate.unknowns().stages(one, solution.x) for one in (noisier, stages))
    more, less = (linearized.problem.simulate(one) for one in either)
    return linearized.problem.nats(more - less)


def strain(solution: Solution) -> float:
    """Misfit that is the coefficients' distance from the nominal ones."""
    return 0.5 * float(solution.z @ solution.z)


def _grown(
    linearized: Linearized,
    parents: Sequence[Begun],
    singles: Sequence[Tangent],
    settings: SearchSettings,
    progress: Callable[[str], None],
) -> list[Begun]:
    """Combinations with one effect more than the parents, begun: of pairs all, for the two at work need not lead alone."""
    some = tangents_at(linearized, [(one.candidate, one.ends[0].x) for one in parents])
    if len(parents[0].candidate.members) == 1:
        some += singles
    combined = closest_combinations(linearized, some, singles, settings.combinations, parents[0].candidate.names)
    begun = begin(linearized, [(candidate, [start]) for candidate, start in combined], settings, parents[0].misfit)
    for one in begun:
        progress("+".join(one.candidate.names))
    return begun


def _pruned(linearized: Linearized, found: Sequence[tuple[Candidate, Solution]]) -> list[tuple[Candidate, Solution]]:
    """The best combination without each of its effects: what was grown step by step may have come to do without one of the first."""
    if not found:
        return []
    candidate, solution = min(found, key=lambda item: item[1].misfit)
    places = candidate.slices()
    candidates = [candidate.without(dropped) for dropped in range(len(places))]
    starts = [np.delete(solution.x, np.r_[place]) for place in places]
    solutions = map_known(_refitted, [(linearized, one, start, solution.z) for one, start in zip(candidates, starts, strict=True)])
    return [(one, found) for one, found in zip(candidates, solutions, strict=True) if found is not None]


def _with_fewer_limits(
    linearized: Linearized, found: Sequence[tuple[Candidate, Solution]], without: float, share: float
) -> list[tuple[Candidate, Solution]]:
    """Fits, where the best one has lost the limits that remove no more than a share of what the effect with several limits removes."""
    found = list(found)
    if not found:
        return found
    best = min(range(len(found)), key=lambda index: found[index][1].misfit)
    candidate, solution = found[best]
    most = solution.misfit + share * (without - solution.misfit)
    for index, member in enumerate(candidate.members):
        for limit in [parameter for parameter in member.parameters if np.isinf(parameter.absent)]:
            member = candidate.members[index]
            p = member.parameters.index(limit)
            if sum(np.isinf(parameter.absent) for parameter in member.parameters) > 1:
                plainer = candidate.replacing(index, member.without(p))
                fewer = _refitted(linearized, plainer, np.delete(solution.x, candidate.slices()[index].start + p), solution.z)
                if fewer is not None and fewer.misfit <= most:
                    candidate, solution = plainer, fewer
    found[best] = candidate, solution
    return found


def _refitted(linearized: Linearized, candidate: Candidate, start: Array, z: Array) -> Solution | None:
    """The fit of a candidate from a start; None where it cannot be simulated."""
    unknowns = candidate.unknowns()
    try:
        return refined(linearized, unknowns, fit(linearized, unknowns, start, z))
    except InputError:
        return None


def _occam(solution: Solution, temper: float, most: float) -> float:
    """½ log of how much narrower the data make the parameters than the prior has them, `most` nats at most."""
    if not len(solution.information):
        return 0.0
    eye = np.eye(len(solution.information))
    sign, value = np.linalg.slogdet(eye + temper * (solution.information - eye))
    return min(0.5 * max(float(value), 0.0), most) if sign > 0 else 0.0


def effective_sample_weight(problem: Problem, residual: Annotated[Array, "M"]) -> float:
    """Weight of a residual's samples: 1 for white noise of the stated size, less for what is larger and correlated.

    Where the spectrum of the model discrepancy is known, its size and correlation together count, which are its density at low
    frequencies: a record of less noise than the clean ones leaves slow residuals, which are small.

    Beside baseline records what is left is no model's error but the machine's own variation from run to run. It is slow, so that
    its samples count as few as are independent. The problem's own weight, which the fits have already, is not applied again.
    """
    size = float(np.mean(residual**2))
    length = correlation_length(residual.reshape(-1, len(problem.model.axes))) if problem.beside_error else 1.0
    density = size * length if problem.own_spectrum is not None else max(size, 1.0) * length
    return min(1.0 / max(density, 1.0) / problem.weight, 1.0)


def settled(linearized: Linearized, z: Array | None = None) -> Solution:
    """The fit of the coefficients alone, with columns renewed wherever a step reduces Φ by less than they predict."""
    return refined(linearized, None, fit(linearized, z=z, renewed=True), RENEWED, renewed=True)


def _gone_on(
    linearized: Linearized, begun: Sequence[Begun], rival: float, without: float, configuration: Configuration
) -> list[Solution]:
    """Fits of the chain as it is, gone on with by the columns of the nominal coefficients."""
    return map_known(_ended, [(linearized, one, rival, without, configuration) for one in begun])


def _ended(linearized: Linearized, begun: Begun, rival: float, without: float, configuration: Configuration) -> Solution:
    solution = gone_on(linearized, begun, rival)
    if len(solution.x) == 1 and (solution.misfit > without or _strained(solution, configuration.policy)):
        solution = _from_grid_minimum(linearized, begun.candidate, solution, configuration.search.scanned)
    return solution


def _all_settled(
    linearized: Linearized, fits: Sequence[tuple[Begun, Solution]], limit: float, without: float, configuration: Configuration
) -> list[tuple[Candidate, Solution]]:
    """Such fits settled where they are not behind the limit: the best one, then the others that may come near it."""

    def settled(fits: Sequence[tuple[Begun, Solution]], limit: float, rival: float) -> list[Solution]:
        # A fit by columns of the nominal coefficients may stop far from its minimum: what it was begun with says where that is.
        near = [min(begun.misfit, solution.misfit) <= limit for begun, solution in fits]
        jobs = [
            (linearized, begun.candidate, solution, rival, configuration.policy)
            for (begun, solution), is_near in zip(fits, near, strict=True)
            if is_near
        ]
        ends = iter(map_known(_settled, jobs))
        return [next(ends) if is_near else solution for (_, solution), is_near in zip(fits, near, strict=True)]

    if not fits:
        return []
    fits = sorted(fits, key=lambda fit: fit[1].misfit)
    (best,) = settled(fits[:1], limit, np.inf)
    near = within(best.misfit, without, configuration.search)
    solutions = [best, *settled(fits[1:], min(limit, near) if np.isfinite(limit) else limit, near)]
    return [(begun.candidate, solution) for (begun, _), solution in zip(fits, solutions, strict=True)]


def _settled(linearized: Linearized, candidate: Candidate, solution: Solution, rival: float, thresholds: Thresholds) -> Solution:
    """A fit gone on with; where it strains the coefficients, also begun again from where the effects do best without them."""
    unknowns = candidate.unknowns()
    best = refined(linearized, unknowns, solution, rival=rival)
    if not _strained(best, thresholds):
        return best
    try:
        alone = fit(_held(linearized), unknowns, best.x)
        again = refined(linearized, unknowns, fit(linearized, unknowns, alone.x, rival=rival), rival=rival)
    except InputError:
        return best
    return min(best, again, key=lambda one: one.misfit)


def _held(linearized: Linearized) -> Linearized:
    """The same problem with coefficients that a fit leaves where they are."""
    held = copy(linearized)
    held.columns, held.gram = np.zeros_like(linearized.columns), np.zeros_like(linearized.gram)
    return held


def _from_grid_minimum(linearized: Linearized, candidate: Candidate, solution: Solution, count: int) -> Solution:
    """A fit of one parameter, begun again where the effect alone does best, if that comes closer."""
    try:
        again = fit(linearized, candidate.unknowns(), _best_alone(linearized, candidate, count))
    except InputError:
        return solution
    return min(solution, again, key=lambda one: one.misfit)


def _best_alone(linearized: Linearized, candidate: Candidate, count: int) -> Array:
    """The value (1,) of a candidate's one parameter that comes closest to the record with the nominal coefficients."""
    from scipy.optimize import minimize_scalar  # seldom needed, and takes long to import

    unknowns, nominal = candidate.unknowns(), np.zeros(linearized.count)

    def misfit(value: float) -> float:
        try:
            residual = linearized.measured - linearized.simulate(nominal, unknowns, np.array([value]))
        except InputError:
            return np.inf
        size = float(residual @ residual)
        return size if np.isfinite(size) else np.inf

    values = np.linspace(unknowns.lower[0], unknowns.upper[0], count)
    best = int(np.argmin([misfit(value) for value in values]))
    bounds = values[max(best - 1, 0)], values[min(best + 1, count - 1)]
    return np.array([minimize_scalar(misfit, bounds=bounds, method="bounded", options={"maxiter": count}).x])
