# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Search of the structure of the family "linear": states are added as long as rows held out are explained better."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.fft import rfft

from hyst_control.base.arrays import Array, Complex
from hyst_control.base.errors import InputError
from hyst_control.base.parallel import forked, map_known
from hyst_control.identify.data.excited_band import REACH, excited_band
from hyst_control.identify.data.fit import OrderRow
from hyst_control.identify.data.fit_windows import response_sign
from hyst_control.identify.modal.linear_candidate import MIN_GAIN, VARIANTS, Candidate, Variant
from hyst_control.identify.modal.linear_options import LinearOptions
from hyst_control.identify.modal.partial_fractions import SLOWEST, Sections
from hyst_control.identify.modal.search_parts import SEARCH_ROWS, Parts, first_parts
from hyst_control.identify.modal.thinned_rows import thinned, thinning
from hyst_control.identify.modal.vector_fitting import Partial, spread_poles, vector_fit
from hyst_control.identify.solve.gram_sums import Grams, Window
from hyst_control.identify.solve.simulation_error import Parametrization, SimulationError, Solution, minimize_simulation_error

ORDERS = (0, 1, 2, 3, 4, 5, 6, 8, 10, 12, 16)
LEAST_ROWS = 8  # Rows for each state of a model
ROUNDS = 3  # Searches, each with parts of the records added that the last one's structure does not explain
WHOLE_ROWS = 2**22  # Rows of a record to which the chosen structure is fitted, from the middle of a longer one
STALE, FALLEN = 2, 2.25
"""Orders without a gain after which growing ends, and ratio to the least square error from which a variant grows no further."""
HIDDEN = 0.1  # Share of the least square error under which many poles show that growing has not ended
TWO_MODES, ALONE = 4, 6
"""Order up to which growing goes on: while one of two modes is missing, states without it may gain nothing. Order from which the best
variant grows alone, the others being fitted at the order chosen: every one of them takes as long."""
DELAYS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0, 128.0, 192.0, 256.0)
"""Delays (samples) with which a search begins."""
PASSES = 12  # Of a fit while structures are compared
MISSED = 1.5  # Ratio of square errors from which a structure is fitted again, from the poles of the best one of its order
EXACT = 1e-6  # Share of the range that no larger model needs to explain: records without noise leave rounding
DIES = 10.0  # Factors of e by which motions decay over a record that imitate no hum
SILENT = 1e-7  # Share of the power under which a record holds nothing between the lines of its command
LOBE = 8  # Bins that one sine fills


@dataclass(frozen=True)
class Trials:
    """Fits of structures to some rows, all with the same session effects."""

    windows: Sequence[Window]
    nuisance: str
    still: bool  # Initial states stay at rest
    late: float  # Delay with which fits begin, samples
    guess: bool  # Whether that delay is free
    gain: float  # Static gain with which fits begin
    fastest: float  # Rate of the fastest pole, 1/s
    exact: float  # Mean square error from which a fit counts as exact
    equations: float  # Independent equations that the records hold, where these are fewer than their rows

    @property
    def sample_time(self) -> float:
        """Sample time, s."""
        return self.windows[0].sample_time

    @property
    def longest(self) -> int:
        """Rows of the longest window."""
        return max(len(window.command) for window in self.windows)

    def fit(self, sections: Sections, start: Partial, tau: float) -> Solution:
        """Fit a structure from partial fractions and a delay (s)."""
        vector = sections.vector(start, self.sample_time, tau)
        return _fit(self.windows, sections, vector, self.nuisance, PASSES, unknown_state=not self.still)

    def poles(
        self, order: int, delays: Sequence[tuple[float, bool]], smaller: Sequence[Candidate]
    ) -> dict[tuple[float | bool, ...], Partial]:
        """By delay (samples) and direct path, vector fitting from evenly spread poles, and from those of the last order with idle ones."""
        jobs: list[tuple[np.ndarray, float, bool]] = []
        for delay, direct in delays:
            jobs.append((spread_poles(order, self.longest), delay, direct))
            if alike := [each for each in smaller if each.variant.direct == direct]:
                jobs.append((self.nested(min(alike, key=lambda each: each.solution.fitted), order).poles, delay, direct))
        found = map_known(vector_fit, [(self.windows, *job) for job in jobs])
        best: dict[tuple[float | bool, ...], Partial] = {}
        for (_, *kind), each in zip(jobs, found, strict=True):
            best[tuple(kind)] = min(best.get(tuple(kind), each), each, key=lambda one: one.error)
        return best

    def nested(self, smaller: Candidate, order: int) -> Partial:
        """Partial fractions of a smaller model with idle poles, evenly spread, up to an order."""
        known = smaller.sections.partial(smaller.solution.parameters, self.sample_time)
        idle = -np.geomspace(1.0, 0.1 * self.longest, order - smaller.sections.order + 2)[1:-1] / self.longest
        return replace(known, poles=np.concatenate([known.poles, idle]), residues=np.concatenate([known.residues, 0.0 * idle]))

    def delay_of(self, variant: Variant) -> float:
        """Delay (samples) with which the fit of a variant begins."""
        return self.late if variant.delay or not self.guess else 0.0

    def grown(self, order: int, variant: Variant, start: Partial, smaller: Candidate | None) -> Candidate:
        """Fit from partial fractions; where that leaves more than the last order did, from the latter: never worse."""
        began = time.perf_counter()
        delay = self.delay_of(variant)
        unit = (max(delay, 1.0) if variant.delay else delay) * self.sample_time
        sections = Sections(order, *variant, self.gain, unit, SLOWEST / (self.longest * self.sample_time), self.fastest)
        found = self.fit(sections, start, delay * self.sample_time)
        if smaller is not None and found.fitted > smaller.solution.fitted:
            late = smaller.sections.tau(smaller.solution.parameters)
            found = min(found, self.fit(sections, self.nested(smaller, order), late), key=lambda each: each.fitted)
        return Candidate(variant, sections, found, time.perf_counter() - began, self.exact, self.equations)

    def from_poles_of(self, nearest: Candidate, other: Candidate) -> Candidate:
        """A structure fitted from the poles of another one of its order, where that has a far smaller error."""
        if other.solution.fitted <= MISSED * nearest.solution.fitted + other.exact:
            return other
        known = nearest.solution.parameters
        found = self.fit(other.sections, nearest.sections.partial(known, self.sample_time), nearest.sections.tau(known))
        return min(other, replace(other, solution=found), key=lambda each: each.solution.fitted)

    def left(self, candidate: Candidate, part: Window) -> float:
        """Mean square error of a structure on another part, which may begin amid a motion."""
        alone = replace(part, group=0, skip=max(part.skip, self.windows[0].skip))
        error = SimulationError([alone], Parametrization(candidate.sections.running), self.nuisance, unknown_state=True)
        return error.visit(candidate.solution.parameters).fitted

    def explains(self, candidate: Candidate, parts: Sequence[Window], most: float) -> bool:
        """Check that the mean square error of a structure, fitted anew to more parts, is no larger than `most` on any."""
        if len(parts) == len(self.windows):
            return True
        start = candidate.solution.parameters
        found = replace(candidate, solution=_fit(parts, candidate.sections, start, self.nuisance, PASSES))
        return max(self.left(found, part) for part in parts) <= most

    def counts(self, candidate: Candidate, smaller: Sequence[Candidate]) -> bool:
        """True where the data tell a structure's poles, and it owes its gain to what the command drives."""
        return not (_beyond_reach(candidate) or (not self.still and self.rings_by_itself(candidate, smaller)))

    def rings_by_itself(self, candidate: Candidate, smaller: Sequence[Candidate]) -> bool:
        """Check that a structure owes its gain over the best smaller one to unknown initial states, not to what the command drives.

        The free motion of its poles beside the smaller model then shows more than half of the gain and leaves nearly as little. Modes that
        the command does not drive do so: they fit mains hum by ringing from the beginning of the record on.
        """
        if not smaller:
            return False
        best = min(smaller, key=lambda each: each.held_out)
        fitted, known = _usual_error(candidate.solution.grams), _usual_error(best.solution.grams)
        dies = bool(np.all(-_poles(candidate).real * self.longest * self.sample_time > DIES))
        if dies or known - fitted <= MIN_GAIN * known + candidate.exact:
            return False  # what it gains is in few rows, such as those behind a step
        parts = candidate.sections.parts(candidate.solution.parameters)
        undriven = [replace(part, B=np.zeros_like(part.B), D=np.zeros_like(part.D)) for part in parts]
        both = best.sections.running(best.solution.parameters, undriven)
        beside = SimulationError(self.windows, Parametrization(lambda _: both), self.nuisance, unknown_state=True).visit(
            np.zeros(0)
        )
        # What the command drives may be in few rows, those behind steps: nearly as little is a matter of all rows.
        nearly = beside.fitted < FALLEN * max(candidate.solution.fitted, candidate.exact)
        return nearly and known - _usual_error(beside.grams) > 0.5 * (known - fitted)


def search(windows: Sequence[Window], options: LinearOptions, *, still: bool = False) -> tuple[Candidate, list[OrderRow]]:
    """Grow the number of states as long as the held-out error falls, and fit the smallest good structure to all rows.

    still: the records begin at rest, according to their hysteresis. Initial states are then zero: estimated ones cancel the motion of a
    slow pole.
    """
    count = thinning(windows, SEARCH_ROWS)
    slower = [thinned(window, count) for window in windows]
    parts = first_parts(slower)
    for _ in range(ROUNDS):
        trials, chosen, table = _searched(windows, parts, options, still)
        most = FALLEN * max(trials.exact, *(trials.left(chosen, part) for part in trials.windows))
        parts = parts.with_worst(partial(trials.left, chosen), most)
        if trials.explains(chosen, parts.windows(), most):
            break
    table = [{**row, "delay_samples": [late * count for late in row["delay_samples"]]} for row in table]
    early = trials.windows[0].skip
    whole = [_middle(replace(window, skip=max(window.skip, early * count))) for window in windows]
    final = _final(whole, chosen, options, still)
    missed = chosen.held_out
    if count > 1:  # of all rows, whose noise is larger than that of their means
        start = chosen.solution.parameters
        missed = _fit(whole, chosen.sections, start, options.nuisance, PASSES, unknown_state=not trials.still).held_out
    return replace(chosen, solution=final, search_error=missed), table


def _searched(
    windows: Sequence[Window], parts: Parts, options: LinearOptions, still: bool
) -> tuple[Trials, Candidate, list[OrderRow]]:
    """The smallest good structure on parts of the records, and what was tried."""
    few = parts.windows()
    still = still and len(few) == len(windows)
    guess = options.delay == "estimate"
    with forked([few, *few]):
        late = _dead_time(few) if guess else float(options.delay) / few[0].sample_time
    # The first rows answer commands from before the record, which an initial state does not stand for.
    early = int(np.ceil(1.5 * late))
    few = [replace(window, skip=max(window.skip, early)) for window in few]
    trials = _trials(windows, few, options, still, late)
    total = sum(len(window.command) for window in few)
    if options.order and LEAST_ROWS * options.order >= total:
        most = total // LEAST_ROWS
        raise InputError(
            f"order: {options.order} states are more than {total} rows can tell: give {most} or fewer, or record longer"
        )
    limit = max(min(total, trials.equations) / LEAST_ROWS, 2)
    orders = [options.order] if options.order else [each for each in ORDERS[not options.direct :] if each < limit]
    variants = [each for each in VARIANTS if (guess or not each.delay) and (options.direct or not each.direct)]
    with forked([trials, few, *few]):
        chosen, unlimited, table = _grow(trials, orders, variants)
    if MISSED * unlimited + trials.exact < chosen.solution.fitted:
        # Poles without a limit explain more: the command's kinks or its first jump excite more than its spectrum shows.
        wide = replace(trials, fastest=np.pi / trials.sample_time)
        with forked([wide, few, *few]):
            other, _, more = _grow(wide, orders, variants)
        if MISSED * other.errors[1] < chosen.errors[1]:
            return wide, other, [*table, *more]
    return trials, chosen, table


def _trials(windows: Sequence[Window], few: Sequence[Window], options: LinearOptions, still: bool, late: float) -> Trials:
    """Trials on a few rows of the records, with what all of them share."""
    band = REACH * excited_band(few) or np.inf
    travel = max(float(np.ptp(window.measurement)) for window in windows) / max(float(np.ptp(w.command)) for w in windows)
    return Trials(
        few,
        options.nuisance,
        still,
        late,
        options.delay == "estimate",
        response_sign(few) * travel,
        2 * np.pi * min(band, 1.5 / few[0].sample_time),
        (EXACT * max(float(np.ptp(window.measurement)) for window in windows)) ** 2,
        _equations(windows),
    )


def _grow(trials: Trials, orders: Sequence[int], variants: Sequence[Variant]) -> tuple[Candidate, float, list[OrderRow]]:
    """Fit structures of more and more states until more of them explain no more: the best one, the least error of vector fits, a table."""
    table: list[OrderRow] = []
    tried: list[Candidate] = []
    smaller: dict[Variant, Candidate] = {}
    fitted: set[tuple[int, Variant]] = set()
    every, stale, reach, unlimited = variants, 0, 0.0, np.inf
    for order in orders:
        due = [each for each in variants if order >= 2 * each.smooth and (order or each.direct)]
        begins = list(dict.fromkeys((trials.delay_of(each), each.direct) for each in due))
        starts = trials.poles(order, begins, list(smaller.values()))
        unlimited = min([unlimited, *(each.error for each in starts.values())])
        fresh = map_known(
            trials.grown, [(order, each, starts[trials.delay_of(each), each.direct], smaller.get(each)) for each in due]
        )
        nearest = min(fresh, key=lambda each: each.solution.fitted)
        fresh = map_known(trials.from_poles_of, [(nearest, each) for each in fresh])
        smaller.update({each.variant: each for each in fresh})
        fitted |= {(order, each.variant) for each in fresh}
        table += [_row(each, trials.sample_time, trials.windows) for each in fresh]
        if order > max(orders[0], 1):
            fresh = [each for each in fresh if trials.counts(each, tried)]
        least = min(each.held_out for each in smaller.values())
        variants = _variants_to_grow(variants, smaller)
        if order >= ALONE:
            variants = [_best_of([smaller[each] for each in variants if each in smaller]).variant]
        gains = any(_least(fresh, of) * (1.0 + MIN_GAIN) < _least(tried, of) for of in range(2))
        known = min(tried, key=lambda each: each.held_out, default=None)
        stale = 0 if gains or (known and any(each.surely_beats(known) for each in fresh)) else stale + 1
        tried += fresh
        if stale >= STALE and order >= TWO_MODES:
            last = spread_poles(orders[-1], trials.longest)
            reach = reach or vector_fit(trials.windows, last, trials.late, False, relocations=4).error
            if max(reach, trials.exact) > HIDDEN * least:
                break
    best = _best_of(tried)
    order = best.sections.order
    others = [each for each in every if (order, each) not in fitted] if order > ALONE else []
    start = best.sections.partial(best.solution.parameters, trials.sample_time)
    fresh = map_known(trials.grown, [(order, each, start, None) for each in others])
    table += [_row(each, trials.sample_time, trials.windows) for each in fresh]
    return _best_of(tried + [each for each in fresh if trials.counts(each, tried)]), unlimited, table


def _variants_to_grow(variants: Sequence[Variant], smaller: Mapping[Variant, Candidate]) -> list[Variant]:
    """Variants that get more states: those not fitted yet, and those near the best of the given ones; at least one."""
    least = min((smaller[each].held_out for each in variants if each in smaller), default=np.inf)
    return [each for each in variants if each not in smaller or smaller[each].held_out <= FALLEN * least]


def _best_of(tried: Sequence[Candidate]) -> Candidate:
    """The smallest structure that is as good as any on rows held out and on rows fitted."""
    lowest = _least(tried, 0), _least(tried, 1)
    # A step's answer may lie in fitted rows alone, of which the held-out ones say nothing.
    behind = {each: max(own / due for own, due in zip(each.errors, lowest, strict=True)) for each in tried}
    best = min(behind, key=lambda each: behind[each])
    return min(
        (each for each in tried if behind[each] <= (1.0 + best.doubt) * behind[best] and not best.surely_beats(each)),
        key=lambda each: (each.sections.parameters, each.sections.order, VARIANTS.index(each.variant)),
    )


def _final(windows: Sequence[Window], chosen: Candidate, options: LinearOptions, still: bool) -> Solution:
    """Fit to all rows; records count as at rest and without drift unless Schwarz's criterion asks for more."""
    sections, start, steps = chosen.sections, chosen.solution.parameters, options.iterations
    free = _fit(windows, sections, start, options.nuisance, steps, everything=True, unknown_state=not still)
    rest = "offset" if options.nuisance == "linear" else options.nuisance
    plain = _fit(windows, sections, free.parameters, rest, steps, everything=True, unknown_state=False)
    rows = sum(len(window.command) for window in windows)
    columns = len(windows) * (sections.order * (not still) + (rest != options.nuisance))
    return plain if plain.fitted < free.fitted * (1.0 + columns * np.log(rows) / rows) + chosen.exact else free


def _fit(
    windows: Sequence[Window],
    sections: Sections,
    start: Array,
    nuisance: str,
    passes: int,
    *,
    everything: bool = False,
    unknown_state: bool = True,
) -> Solution:
    free = Parametrization(sections.running, limit=sections.limit)
    return minimize_simulation_error(
        windows,
        free,
        start,
        nuisance=nuisance,
        unknown_state=unknown_state,
        passes=max(passes, 1),
        tolerance=1e-5,
        everything=everything,
        alike=True,
    )


def _dead_time(windows: Sequence[Window], order: int = 3) -> float:
    """Delay (samples) at which few poles without a direct path fit best."""
    shortest = min(len(window.command) for window in windows)
    delays = [delay for delay in DELAYS if delay <= shortest / 8]
    start = spread_poles(order, max(len(window.command) for window in windows))
    found = map_known(vector_fit, [(windows, start, delay, False, 4) for delay in delays])
    return delays[int(np.argmin([each.error for each in found]))]


def _equations(windows: Sequence[Window]) -> float:
    """Independent equations of records made of a few sines, such as frequency responses; infinite for others."""
    from scipy.signal.windows import blackmanharris  # takes a second

    count = 0.0
    for window in map(_middle, windows):
        taper = blackmanharris(len(window.command))
        drive, answer = (np.abs(rfft(taper * (rows - rows.mean()))) ** 2 for rows in (window.command, window.measurement))
        lines = drive > SILENT * drive.max()
        if lines.mean() > 0.5 or answer[~lines].sum() > SILENT * answer.sum():
            return np.inf
        peaks = lines[1:-1] & (drive[1:-1] > drive[:-2]) & (drive[1:-1] >= drive[2:])
        begins, ends = (np.flatnonzero(np.diff(lines.astype(int), prepend=0, append=0) == sign) for sign in (1, -1))
        for begin, end in zip(begins, ends, strict=True):
            sines = max(int(np.count_nonzero(peaks[max(begin - 1, 0) : end])), 1)
            # A run of many bins with few peaks is no row of sines, but a sweep.
            count += 2.0 * (sines if end - begin <= 4 * LOBE * sines else end - begin)
    return count


def _beyond_reach(candidate: Candidate) -> bool:
    """True for a pole at the upper limit: the data cannot separate it from a delay or a direct path."""
    return bool(np.any(np.abs(_poles(candidate)) > 0.99 * candidate.sections.fastest))


def _poles(candidate: Candidate) -> Complex:
    """Poles of the fitted structure, 1/s."""
    return np.concatenate([np.zeros(0), *(np.roots(den) for _, den in candidate.sections.terms(candidate.solution.parameters))])


def _least(candidates: Sequence[Candidate], of: int) -> float:
    return min((each.errors[of] for each in candidates), default=np.inf)


def _usual_error(grams: Grams) -> float:
    """Mean square error of usual rows: a transient at the beginning is in few blocks, and does not count."""
    energies = grams.blocks[:, -1, -1]
    return float(np.median(energies)) * len(energies) / sum(grams.rows)


def _row(candidate: Candidate, sample_time: float, windows: Sequence[Window]) -> OrderRow:
    power = np.sqrt(np.mean(np.concatenate([window.measurement - np.mean(window.measurement) for window in windows]) ** 2))
    sections, solution = candidate.sections, candidate.solution
    return {
        "order": sections.order,
        "states": sections.order,
        "parameters": sections.parameters,
        "fitted": float(np.sqrt(solution.fitted) / power),
        "held_out": float(np.sqrt(solution.held_out) / power),
        "seconds": candidate.seconds,
        "delay_samples": [sections.tau(solution.parameters) / sample_time],
    }


def _middle(window: Window) -> Window:
    begin = max(len(window.command) - WHOLE_ROWS, 0) // 2
    rows = slice(begin, begin + WHOLE_ROWS)
    return window if begin == 0 else replace(window, command=window.command[rows], measurement=window.measurement[rows])
