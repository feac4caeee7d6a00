# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Joint identification of Prandtl-Ishlinskii models, static or in front of dynamics: all records together.

For given thresholds and G(s) the output is linear in the weights and the dynamic weights (HAMPI paper Eq. 2-6), so the search
is over G's few parameters alone (`variable_projection`). G's structure is chosen on held-out stretches of the records.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.parallel import map_forked
from hyst_control.identify.data.excited_band import REACH, excited_band
from hyst_control.identify.data.fit_windows import largest_drift, stretches, whole_records
from hyst_control.identify.families.options import INTEGER, NUMBERS, TRUTH, Options, methods_option, option
from hyst_control.identify.families.shared_options import nuisance_option, structure_option
from hyst_control.identify.modal.late_modes import MOST_MODES, late_modes
from hyst_control.identify.modal.vector_fitting import spread_poles, vector_fit
from hyst_control.identify.solve.gram_sums import Operators, Window, simulated_rows, weighted_operators
from hyst_control.identify.solve.pole_zero_pair import pole_zero_pair
from hyst_control.identify.solve.stable_dynamics import Structure, pace
from hyst_control.identify.solve.variable_projection import Problem, Solution, solve
from hyst_control.records.record import Record
from hyst_control.records.stream.row_store import largest_change, largest_size

SELECTION_ROWS = 60_000
OPERATORS, MORE_OPERATORS = 10, 20
"""Numbers of play operators: by which G's structure is chosen, and that are used where rows held out show so fine a hysteresis."""
MIN_FOR_LOADING = 6  # Number of operators below which the first loading gets none
PRECISION = 1e-3  # Share of the bracket to which the widening with the rate is found
MOST_PAIRS = 4  # Largest number of modes of G, where the further ones come with zeros of their own
SEEN_ROWS = 16_000  # Rows in which vector fitting looks for modes
SPACING, FOLLOWED = 1.6, 2
"""Ratio of the frequencies at which a single mode is looked for, and how many of them are starts."""
MIN_TIME_CONSTANTS = 6.0  # Duration of the longest record, in time constants of the slowest pole
MIN_IMPROVEMENT = 0.03  # A factor of G is kept when it lowers the held-out mean square error by more than this fraction
EXACT = 1e-300  # Mean square error below which two fits are alike
PAIR_IMPROVEMENT = 0.12  # The same for a mode with a pair of zeros, which has four parameters, and for more operators
HALVED = 0.5
"""Factor of the held-out mean square error below which weights that each change with the command are taken, and G is chosen anew."""
Finer = tuple[float, list[Operators]]
"""Largest held-out mean square error, relative to that of coarser operators, with which one is taken of these, the plainest first."""


@dataclass(frozen=True)
class OperatorOptions(Options):
    """Options of a fit of play operators."""

    operators: int | None = option(
        None,
        INTEGER,
        "number of play operators; by default 10, of `pi`, `hapi` and `hampi` 20 if rows held out show it",
        lower=3,
    )
    thresholds: tuple[float, ...] | None = option(
        None, NUMBERS, "increasing thresholds of the play operators, in place of the default ones", unit="V", lower=0.0
    )
    nuisance: str = nuisance_option("linear", methods=("joint",))

    def check(self) -> None:
        if self.thresholds is not None and (not self.thresholds or np.any(np.diff(self.thresholds) <= 0)):
            raise InputError(f"thresholds: must be strictly increasing, got {list(self.thresholds)}")


@dataclass(frozen=True)
class PlayOptions(OperatorOptions):
    """Options of a fit of one-sided or two-sided play operators."""

    one_sided: bool = option(False, TRUTH, "one-sided play operators")


@dataclass(frozen=True)
class HammersteinOptions(PlayOptions):
    """Options of a fit of play operators in front of dynamics."""

    method: str = methods_option("joint", "paper")
    structure: Structure | None = structure_option()


@dataclass(frozen=True)
class DynamicWeightOptions(HammersteinOptions):
    """Options of a fit of play operators of dynamic weights in front of dynamics."""

    levels: bool = option(
        True,
        TRUTH,
        "let every weight change with the command by an amount of its own, where rows held out show it; false: by one k, as in the paper",
        methods=("joint",),
    )


def axis_problem(
    records: Sequence[Record], axis: int, options: OperatorOptions, *, one_sided: bool = False, dynamic: bool = False
) -> Problem:
    """Set up the fit of one axis to all its records."""
    windows = whole_records(records, axis)
    operators = default_operators(windows, options, one_sided=one_sided, dynamic=dynamic)
    travel = max(np.ptp(window.measurement) for window in windows)
    drive = max(np.ptp(window.command) for window in windows)
    drift = [largest_drift(data, axis) for data in records]
    return Problem(windows, operators, options.nuisance, len(records), travel / drive, drift)


def finer_operators(problem: Problem, options: OperatorOptions, *, levels: bool = False) -> list[Finer]:
    """More play operators for a problem, where the options do not list or count them; then, with `levels`, those of further weights."""
    kept, more = problem.operators, []
    if not (options.operators or options.thresholds):
        counted = replace(options, operators=MORE_OPERATORS)
        more = [default_operators(problem.windows, counted, one_sided=kept.one_sided, dynamic=kept.dynamic)]
    found = [(1.0 - PAIR_IMPROVEMENT, more)]
    if levels:
        low = min(float(window.command.min()) for window in problem.windows)
        high = max(float(window.command.max()) for window in problem.windows)
        reach = 0.5 * (high - low)
        found.append((HALVED, [replace(each, center=low + reach, reach=reach) for each in (kept, *more)]))
    return found


def fit_static(problem: Problem, finer: Sequence[Finer] = ()) -> tuple[Operators, Solution, float]:
    """The operators of one axis, their weights without dynamics, and the mean square error on rows held out."""
    problem, chosen = _with_finer_operators(problem, solve(problem, Structure(), np.zeros(0)), finer)
    return problem.operators, solve(problem, Structure(), np.zeros(0), everything=True), chosen.held_out


def fit_dynamic(
    problem: Problem, structure: Structure | None, finer: Sequence[Finer] = ()
) -> tuple[Operators, Solution, float, list[Solution]]:
    """The operators of one axis, their weights and G(s) behind them, the mean square error on rows held out, and all structures."""
    selection = replace(problem, windows=stretches(problem.windows, SELECTION_ROWS))
    tried: list[Solution] = []
    chosen = choose_structure(selection, structure, tried.append)
    chosen = solve(selection, chosen.structure, chosen.parameters, chosen.theta, passes=20)
    coarse = chosen
    selection, chosen = _with_finer_operators(selection, chosen, finer)
    if structure is None and chosen.held_out < HALVED * coarse.held_out:  # what G took over of the hysteresis is the operators' now
        anew = choose_structure(selection, None, tried.append)
        anew = solve(selection, anew.structure, anew.parameters, anew.theta, passes=20)
        chosen = min((chosen, anew), key=lambda each: _relative_error(each, coarse))
    problem = replace(problem, operators=selection.operators)
    final = solve(problem, chosen.structure, chosen.parameters, chosen.theta, passes=3, everything=True)
    if structure is None and chosen.structure.slow_pair and not _is_determined(problem, final):
        # All rows together know the slow pair no more: it would only share the static gain with the session's drift.
        plainer = replace(chosen.structure, slow_pair=False)
        chosen = solve(selection, plainer, chosen.structure.without_slow_pair(chosen.parameters), chosen.theta, passes=20)
        final = solve(problem, plainer, chosen.parameters, chosen.theta, passes=3, everything=True)
    return problem.operators, final, chosen.held_out, tried


def _with_finer_operators(problem: Problem, found: Solution, finer: Sequence[Finer]) -> tuple[Problem, Solution]:
    """The problem of other operators with its solution, where rows held out show them; the plainest of those that fit about as well."""
    for most, candidates in finer:
        problems = [replace(problem, operators=each) for each in candidates]
        trials = [solve(each, found.structure, found.parameters, passes=1) for each in problems]  # behind the same G
        chosen = _plainest(trials, found, most)
        if chosen is not None:
            problem = next(each for each, trial in zip(problems, trials, strict=True) if trial is chosen)
            found = solve(problem, found.structure, found.parameters, chosen.theta, passes=12)
    return problem, found


def default_operators(
    windows: Sequence[Window], options: OperatorOptions, *, one_sided: bool = False, dynamic: bool = False
) -> Operators:
    """Choose the thresholds, where the options do not list them.

    They begin at 0 and are closer together where most reversals engage them, up to half the drive; two more are for the first
    loading, unless there are fewer than `MIN_FOR_LOADING`.
    """
    highest = max(largest_size(window.command) for window in windows)
    span = max(float(np.ptp(window.command)) for window in windows)
    if options.thresholds is not None:
        thresholds = np.array(options.thresholds, dtype=float)
    else:
        reach = span if one_sided else span / 2
        loading = np.array([0.5, 0.85]) * highest if highest > 1.4 * reach else reach * np.array([0.9, 0.97])
        count = OPERATORS if options.operators is None else options.operators
        inner = count - len(loading) if count >= MIN_FOR_LOADING else count
        thresholds = np.concatenate([0.98 * reach * (np.arange(inner) / (inner - 0.5)) ** 1.4, loading[: count - inner]])
        thresholds = np.unique(np.round(thresholds, 9))
    return Operators(thresholds, one_sided, dynamic, center=0.5 * highest)


def choose_structure(problem: Problem, given: Structure | None, report: Callable[[Solution], object] = lambda _: None) -> Solution:
    """Grow G factor by factor as long as the held-out error falls, by none whose poles lie beyond what the records excite."""
    sample_time = min(window.sample_time for window in problem.windows)
    # A slower pole is not separable from the session's drift.
    slowest = MIN_TIME_CONSTANTS * min(each.share / (len(each.command) * each.sample_time) for each in problem.windows)
    plain = Structure(pace=pace(sample_time), highest=REACH * excited_band(problem.windows), slowest=slowest)
    best = solve(problem, plain, np.zeros(0))
    if given is not None:
        given = replace(given, pace=plain.pace, slowest=slowest)
        starts = [given.start(first_modes(problem, best)[0][0])]
        if given.delay and given.modes:
            fitting = [
                each for each in _late_starts(problem, best) if each[0].modes <= given.modes and each[0].zeros <= given.zeros
            ]
            starts += [given.grow(*each, np.exp(each[1][0]) / (2 * np.pi)) for each in fitting[-1:]]
        errors = [solve(problem, given, start, passes=2).fitted for start in starts] if len(starts) > 1 else [0.0]
        return solve(problem, given, starts[int(np.argmin(errors))])
    report(best)
    if not plain.highest:
        return best
    new = first_modes(problem, best)
    frequency = new[0][0]
    late_tried = False
    while True:
        trials = _grown(problem, best, frequency, new)
        for trial in trials:
            report(trial)
        chosen = _plainest(trials, best, 1.0 - MIN_IMPROVEMENT)
        if chosen is None:
            pairs = _with_pair(problem, best)
            for trial in pairs:
                report(trial)
            chosen = min([best, *pairs], key=lambda each: _relative_error(each, best))
            if not _relative_error(chosen, best) < 1.0 - PAIR_IMPROVEMENT:
                late, late_tried = [] if late_tried else _late_modes(problem, best), True
                for trial in late:
                    report(trial)
                chosen = _plainest([each for each in late if _replaces(each, best)], best, np.inf)
                if chosen is None:
                    return best
        poorer, best = best, chosen
        if best.structure.modes > poorer.structure.modes:
            frequency = float(np.exp(best.structure.split(best.parameters)["modes"][0, 0])) / (2 * np.pi)
            new = seen_modes(problem, best, MOST_MODES) if best.structure.modes < MOST_MODES else []


def _relative_error(trial: Solution, best: Solution) -> float:
    """Mean square error on held-out rows, relative to that of the best model so far.

    The response to steps may lie in fitted rows alone. Therefore a reduction on fitted rows counts in part, unless the error on held-out
    rows increases.
    """
    # An exact fit leaves rounding errors, which may be 0.
    held_out, fitted = (
        max(one, EXACT) / max(other, EXACT) for one, other in ((trial.held_out, best.held_out), (trial.fitted, best.fitted))
    )
    return held_out if held_out > 1.0 else min(held_out, 1.0 - MIN_IMPROVEMENT / PAIR_IMPROVEMENT * (1.0 - fitted))


def _plainest(trials: Sequence[Solution], best: Solution, most: float) -> Solution | None:
    """Find the first trial that fits about as well as the best one; None if none has a relative error below `most`."""
    lowest = min((_relative_error(each, best) for each in trials), default=np.inf)
    return (
        next((each for each in trials if _relative_error(each, best) <= lowest * (1.0 + MIN_IMPROVEMENT)), None)
        if lowest < most
        else None
    )


def _grown(problem: Problem, best: Solution, frequency: float, new: Sequence[tuple[float, float]]) -> list[Solution]:
    """Solve for every structure with one factor more. new: frequency (Hz) and damping of what may be its further mode."""
    structures = best.structure.extensions()
    starts: list[tuple[Structure, Array]] = []
    for structure in structures:
        start = structure.grow(best.structure, best.parameters, frequency)
        if structure.modes == best.structure.modes or best.structure.modes:
            starts.append((structure, start))
        if structure.modes > best.structure.modes:
            starts += [(structure, structure.with_last_mode(start, *mode)) for mode in new]
    found = _solved(problem, best, starts)
    nearest = [min((each for each in found if each.structure == of), key=lambda each: each.fitted) for of in structures]
    return [each for each in nearest if _is_determined(problem, each)]


def _with_pair(problem: Problem, best: Solution) -> list[Solution]:
    """Solve for a further mode with a pair of zeros, from every mode that the residual shows."""
    if not 0 < best.structure.modes < MOST_PAIRS:
        return []
    seen = seen_modes(problem, best, MOST_MODES, unexplained=True)
    found = _solved(problem, best, [pole_zero_pair(best.structure, best.parameters, *mode) for mode in seen])
    return [each for each in found if _is_determined(problem, each)]


def _replaces(late: Solution, best: Solution) -> bool:
    """True for modes behind a delay that fit better than what growth ended with, or as well with fewer parameters."""
    simpler = late.structure.size < best.structure.size
    return _relative_error(late, best) < (1.0 + MIN_IMPROVEMENT if simpler else 1.0 - PAIR_IMPROVEMENT)


def _late_modes(problem: Problem, best: Solution) -> list[Solution]:
    """Solve for one and for two modes behind a delay, all found at once: none of a mode and a long delay is found without the other."""
    return [each for each in _solved(problem, best, _late_starts(problem, best)) if _is_determined(problem, each)]


def _late_starts(problem: Problem, at: Solution) -> list[tuple[Structure, Array]]:
    """Starts of modes behind a delay, where the command moves fastest."""
    if not at.structure.size:  # the weights of a resonant record without dynamics mean nothing
        at = replace(at, theta=np.eye(len(at.theta))[0])
    return late_modes(fastest_parts(problem, at)[1], at.structure)


def _solved(problem: Problem, best: Solution, starts: Sequence[tuple[Structure, Array]]) -> list[Solution]:
    """Solve from every start, on all cores."""
    theta = best.theta if np.any(best.theta) else None
    return list(map_forked(lambda index: solve(problem, *starts[index], theta, passes=8), len(starts)))


def _is_determined(problem: Problem, solution: Solution) -> bool:
    """True where no pole or damping lies at its bound, where the records do not determine it."""
    return not solution.structure.at_limit(solution.parameters, min(window.sample_time for window in problem.windows))


def first_modes(problem: Problem, static: Solution) -> list[tuple[float, float]]:
    """Frequency (Hz) and damping of the single modes that leave least: of a grid over the band, and of those that vector fitting sees."""
    sample_time = min(window.sample_time for window in problem.windows)
    longest = max(len(window.command) * window.sample_time for window in problem.windows)
    highest = min(0.4 / sample_time, 0.8 * (static.structure.highest or np.inf))  # 0: nothing is excited
    lowest = min(2.0 / longest, 0.5 * highest)
    grid = np.geomspace(lowest, highest, 2 + int(np.log(highest / lowest) / np.log(SPACING)))
    tried = [(float(frequency), 0.5) for frequency in grid] + seen_modes(problem, static, MOST_MODES)
    structure = Structure(modes=1)

    def left(index: int) -> float:
        return solve(problem, structure, structure.with_last_mode(structure.start(1.0), *tried[index]), passes=1).fitted

    order = np.argsort(list(map_forked(left, len(tried))))
    return [tried[index] for index in order[:FOLLOWED]]


def seen_modes(problem: Problem, at: Solution, count: int, *, unexplained: bool = False) -> list[tuple[float, float]]:
    """Frequency (Hz) and damping of modes that vector fitting finds behind the weighted operators, where the command moves fastest.

    unexplained: look at the residual of the solution instead of the measurement.
    """
    sample_time, parts = fastest_parts(problem, at, unexplained=unexplained)
    longest = max(len(part.command) for part in parts)
    found = vector_fit(parts, spread_poles(2 * count, longest), at.structure.tau(at.parameters) / sample_time, direct=False)
    return [(abs(pole) / (2 * np.pi * sample_time), -pole.real / abs(pole)) for pole in found.poles if pole.imag]


def fastest_parts(problem: Problem, at: Solution, *, unexplained: bool = False) -> tuple[float, list[Window]]:
    """Sample time, and the rows of the weighted operators and the measurement, or its residual, where the command moves fastest."""
    sample_time = min(window.sample_time for window in problem.windows)
    windows = [window for window in problem.windows if window.sample_time == sample_time]
    rows = max(SEEN_ROWS // len(windows), 1)
    parts = []
    for window in windows:
        command = weighted_operators(window, problem.operators, at.theta)
        steps = np.diff(command, prepend=command[:1]) ** 2
        total = np.concatenate([[0.0], np.cumsum(steps)])
        begin = int(np.argmax(total[rows:] - total[:-rows])) if rows < len(command) else 0
        cut = slice(begin, begin + rows)
        target = window.measurement
        if unexplained:
            target = target - simulated_rows(window, problem.operators, at.structure, at.parameters, at.theta)
        parts.append(replace(window, command=command[cut], measurement=target[cut], skip=max(window.skip - begin, 0)))
    return sample_time, parts


def fit_rate_dependent(problem: Problem) -> tuple[Operators, Solution, float]:
    """The weights of one axis whose thresholds are r_i + β |du/dt|, without dynamics; β by a bounded search on the error."""
    fastest = max(largest_change(window.command) / window.sample_time for window in problem.windows)
    largest = 2.0 * float(problem.operators.thresholds[-1]) / fastest

    def widened(beta: float) -> Problem:
        return replace(problem, operators=replace(problem.operators, rate_gain=beta))

    def error(beta: float) -> float:
        return solve(widened(beta), Structure(), np.zeros(0)).fitted

    grid = largest * np.concatenate([[0.0], np.geomspace(1e-3, 1.0, 13)])
    at = int(np.argmin(list(map_forked(lambda i: error(grid[i]), len(grid)))))
    low, high = grid[max(at - 1, 0)], grid[min(at + 1, len(grid) - 1)]
    found = minimize_scalar(error, bounds=(low, high), method="bounded", options={"xatol": PRECISION * (high - low)})
    return fit_static(widened(float(found.x)))
