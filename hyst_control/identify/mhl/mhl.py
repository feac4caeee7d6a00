# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identification of the modified Hammerstein-like model (MHL paper, Eq. 1-5): delay, Madelung hysteresis and rate correction, G(s).

    y = G(s) [ H_S[u(t - τ)] + Ψ ],   Ψ = (k1 u̇ + b1) / (k2 s + b2),   G(0) = 1,   b2 = 1

"joint" fits everything to all records at once; "paper" is the paper's own sequence (`paper_mhl`). `mhl_axis` holds the parameters of an
axis. G(s) is stable for every parameter vector, the curves rise and close, and the order of G(s) is the one that does best on rows held
out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.parallel import map_forked
from hyst_control.chain.chain import at_rest
from hyst_control.identify.assess.assembly import chain_model, fit_of, side_by_side
from hyst_control.identify.data.fit import Fit, check_records
from hyst_control.identify.data.fit_windows import response_sign, short_stretches, thinned, virgin_rows, whole_records, with_sign
from hyst_control.identify.families.estimator import Estimator, register
from hyst_control.identify.mhl import paper_mhl
from hyst_control.identify.mhl.coupling import Coupling, fit_coupling, simulated_rows, without_coupling
from hyst_control.identify.mhl.madelung import (
    curve_ends,
    fit_curves,
    mean_offset,
)
from hyst_control.identify.mhl.madelung_curves import Curves
from hyst_control.identify.mhl.mhl_axis import K2_UNIT, Axis, Found, MhlOptions
from hyst_control.identify.modal.late_modes import MOST_MODES, late_modes
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.identify.solve.pole_zero_pair import (
    PAIR_DAMPINGS,
    WORTHWHILE,
    pole_zero_pair,
    unexplained_frequency,
    with_numerator,
)
from hyst_control.identify.solve.simulation_error import SimulationError, Solution, minimize_simulation_error
from hyst_control.identify.solve.stable_dynamics import TAU_UNIT, Structure, pace
from hyst_control.model_file import Model
from hyst_control.records.record import Record

SELECTION_ROWS, FINAL_ROWS = 20_000, 100_000
STRETCH, SETTLE = 0.06, 0.015
"""Length (s) of the stretches that stand for a long record, and of their beginning that does not count."""
PAIR_PASSES, PAIR_TRIAL, LAST_PASSES = 12, 4, 3
"""Most passes of the fit of a further mode, of them those that compare its starts, and over all rows of all records in the end."""


@register
class ModifiedHammersteinLike(Estimator[MhlOptions]):
    """The modified Hammerstein-like model: one chain per axis and, between several axes, cross-coupling where the records show it."""

    name = "mhl"
    sentence = (
        "delay, Madelung hysteresis beside a rate correction, and dynamics G(s), together: the curves rise and close, G(s) is stable for "
        "every parameter vector, its factors are chosen on held-out rows"
    )
    Options = MhlOptions

    def fit(self, records: Sequence[Record], options: MhlOptions) -> Fit:
        check_records(records)
        if options.method == "paper":
            return _assembled(records, paper_mhl.fit_axes(records, options), "paper", None)
        axes: list[Found] = []
        for index in range(len(records[0].axes)):
            axes.append(fit_joint(axis_windows(records, index), options, axes[0] if axes else None))
        coupling = None
        if options.cross_coupling and len(axes) > 1:
            coupling, axes = with_coupling(records, axes, options.nuisance)
        cleaned = records
        if coupling is not None:
            cleaned = without_coupling(model_of(records, axes), coupling, records)
        if options.structure is None:
            model = model_of(cleaned, axes)
            axes = list(map_forked(lambda index: with_parted_pair(model, cleaned, axes[index], index, options.nuisance), len(axes)))
        final = map_forked(lambda index: refit(cleaned, index, axes[index], options.nuisance), len(axes))
        return _assembled(records, list(final), options.method, coupling)


def _assembled(records: Sequence[Record], axes: Sequence[Found], method: str, coupling: Coupling | None) -> Fit:
    fits = [found.axis_fit(records, index) for index, found in enumerate(axes)]
    behind, rows = ([coupling.stage], coupling.rows(records[0].axes)) if coupling is not None else ([], [])
    return fit_of(records, fits, "mhl", method, name=f"mhl_{method}", behind=behind, rows=rows)


def model_of(records: Sequence[Record], axes: Sequence[Found]) -> Model:
    """The model of the axes without coupling."""
    chains = [found.axis_fit(records, index).stages(found.vector) for index, found in enumerate(axes)]
    return chain_model(records, side_by_side(chains), "plain")


def axis_windows(records: Sequence[Record], index: int, sign: float = 1.0) -> list[Window]:
    """Records of one axis, counted from the end of its initial loading curve, which Madelung's rules do not describe.

    On the virgin curve a stack is up to a few percent lower and arrives at a different zero. Counting those rows would bend the
    curves; and while an axis waits for its turn, its zero would pass for a drift, or for coupling from the axis that moves.
    """
    windows = whole_records(records, index, weighted=False)
    return [with_sign(replace(window, skip=max(window.skip, virgin_rows(window.command))), sign) for window in windows]


def with_coupling(
    records: Sequence[Record], axes: list[Found], nuisance: str, rounds: int = 3
) -> tuple[Coupling | None, list[Found]]:
    """Coupling, None if the records show none, and the axes fitted without it.

    Both are fitted in turn, since each hides in the other where axes move alike.
    """
    coupling: Coupling | None = None
    for _ in range(rounds):
        plain = model_of(records, axes)
        coupling = fit_coupling(plain, records, coupling)
        if coupling is None:
            break
        cleaned = without_coupling(plain, coupling, records)
        axes = refined_axes(cleaned, axes, nuisance)
    return coupling, axes


def refined_axes(records: Sequence[Record], axes: Sequence[Found], nuisance: str) -> list[Found]:
    """Refine every axis by a few passes, on all cores."""

    def work(index: int) -> Found:
        return refined(axis_windows(records, index, axes[index].axis.sign), axes[index], nuisance, passes=3)

    return list(map_forked(work, len(axes)))


def fit_joint(windows: Sequence[Window], options: MhlOptions, like: Found | None) -> Found:
    """Fit one axis to all its records."""
    # like: fit of another axis of the same device, with whose dynamics the search begins; None for a search of the structure
    sign = response_sign(windows)
    turned = [with_sign(window, sign) for window in windows]
    ends = curve_ends(windows, options)
    few = short_stretches(turned, SELECTION_ROWS, STRETCH, SETTLE)
    # Where nothing creeps, the loops are bent by the dynamics: only the coarsest curves are to be had without them.
    creeping = any(thinned(window) is not window for window in windows)
    form = options.curves if creeping or options.curves.degree < 2 else Curves(2)
    static = fit_curves(slowest(few), form, ends, options.nuisance, passes=8)
    sample_time = min(window.sample_time for window in windows)
    blank = Axis(options.curves, Structure(pace=pace(sample_time)), ends, static.output_scale, sign, sample_time)
    curves = static.solution.parameters
    if like is not None and (options.structure is None or options.structure == like.axis.structure):
        axis = replace(blank, structure=like.axis.structure)
        first = curves if form == options.curves else options.curves.like(form, curves)
        start = np.concatenate([first, like.vector[options.curves.size :]])
        chosen = minimize_simulation_error(few, axis.parametrization(), start, nuisance=options.nuisance, passes=12)
        if options.structure is None:
            axis, chosen = with_late_modes(few, axis, chosen, options)
    else:
        axis, chosen = choose_structure(few, replace(blank, curves=form), curves, options)
    found = Found(axis, chosen.parameters, chosen.covariance, 0.0, chosen.held_out)
    return refined(turned, found, options.nuisance, passes=6)


def square_error(turned: Sequence[Window], found: Found, nuisance: str) -> float:
    """Mean square of an axis' simulation error over all rows, beside the nuisances that reduce it most."""
    return SimulationError(turned, found.axis.parametrization(), nuisance).visit(found.vector).fitted


def refined(turned: Sequence[Window], found: Found, nuisance: str, passes: int) -> Found:
    """Refine the parameters over stretches of all records."""
    many = short_stretches(turned, FINAL_ROWS, 3 * STRETCH, SETTLE)
    problem = found.axis.parametrization()
    solution = minimize_simulation_error(many, problem, found.vector, nuisance=nuisance, passes=passes, everything=True)
    return replace(found, vector=solution.parameters)


def refit(records: Sequence[Record], index: int, found: Found, nuisance: str) -> Found:
    """Last passes over every row of every record: the error on rows held out, then everything with its covariance and the offset."""
    turned, problem = axis_windows(records, index, found.axis.sign), found.axis.parametrization()
    chosen = minimize_simulation_error(turned, problem, found.vector, nuisance=nuisance, passes=LAST_PASSES)
    solution = minimize_simulation_error(turned, problem, chosen.parameters, nuisance=nuisance, passes=LAST_PASSES, everything=True)
    offset = mean_offset(solution, turned, nuisance)
    return replace(found, vector=solution.parameters, covariance=solution.covariance, offset=offset, held_out=chosen.held_out)


def slowest(windows: Sequence[Window]) -> list[Window]:
    """The windows of the records whose command moves slowest: from them the curves are seen without the dynamics."""
    speeds: dict[int, list[float]] = {}
    for window in windows:
        span = max(float(np.ptp(window.command)), 1e-300)
        speeds.setdefault(window.group, []).append(float(np.abs(np.diff(window.command)).mean()) / window.sample_time / span)
    wide = max(float(np.ptp(window.command)) for window in windows)
    spans = {group: max(float(np.ptp(w.command)) for w in windows if w.group == group) for group in speeds}
    usable = {group: float(np.mean(speeds[group])) for group in speeds if spans[group] > 0.3 * wide} or {0: 0.0}
    limit = 3.0 * min(usable.values())
    return [window for window in windows if usable.get(window.group, np.inf) <= limit]


def choose_structure(windows: Sequence[Window], blank: Axis, curves: Array, options: MhlOptions) -> tuple[Axis, Solution]:
    """Choose the factors of G(s) and fit everything: factors are added one by one as long as the held-out error falls."""
    given = options.structure
    if given is not None:
        first = replace(given, zeros=min(given.zeros, 1), pace=blank.structure.pace)
        axis, best = searched(windows, replace(blank, structure=first), curves, options)
        while axis.structure.zeros < given.zeros:
            axis, best = extended(windows, axis, best, [replace(axis.structure, zeros=axis.structure.zeros + 1)], options)[0]
        return axis, best
    one, two = (replace(blank.structure, modes=1, delay=True, lags=lags, zeros=lags) for lags in (0, 1))
    plain = searched(windows, replace(blank, structure=one), curves, options, thorough=False)
    rich = searched(windows, replace(blank, structure=two), curves, options)
    axis, best = better(plain, rich)
    if best is plain[1]:
        best = minimize_simulation_error(windows, axis.parametrization(), best.parameters, nuisance=options.nuisance, passes=25)
    axis, best = with_late_modes(windows, axis, best, options)
    while True:
        grown = extended(windows, axis, best, extensions(axis.structure), options)
        lowest = min([best.held_out, *(each.held_out for _, each in grown)])
        if not lowest < (1.0 - WORTHWHILE) * best.held_out:
            return axis, best
        # From the plainer to the richer: the first of those that do about as well as the best one.
        axis, best = next(each for each in grown if each[1].held_out <= (1.0 + WORTHWHILE) * lowest)


def searched(
    windows: Sequence[Window], axis: Axis, curves: Array, options: MhlOptions, *, thorough: bool = True
) -> tuple[Axis, Solution]:
    """Fit a structure from many starts, with the curves in the form of `axis`; then everything, in the form that is asked for.

    Curves that were fitted to creeping loops are held in the first part; coarse ones are fitted along.
    """
    held, n = axis.curves == options.curves, axis.curves.size
    problem, begin = axis.parametrization(), [np.concatenate([curves, start]) for start in starts(axis)]
    if held:
        problem, begin = problem.part(begin[0], slice(n, None)), [start[n:] for start in begin]
    trials = list(
        map_forked(lambda i: minimize_simulation_error(windows, problem, begin[i], nuisance=options.nuisance, passes=3), len(begin))
    )
    whole = replace(axis, curves=options.curves)
    followed = candidates(trials, -2 - axis.structure.size)[: 2 if thorough else 1]

    def pursued(index: int) -> Solution:
        solution = followed[index]
        further = minimize_simulation_error(windows, problem, solution.parameters, nuisance=options.nuisance, passes=15)
        vector = further.parameters if not held else np.concatenate([curves, further.parameters])
        full = vector[:n] if held else options.curves.like(axis.curves, vector[:n])
        start = np.concatenate([full, vector[n:]])
        passes = 25 if thorough else 6
        return minimize_simulation_error(windows, whole.parametrization(), start, nuisance=options.nuisance, passes=passes)

    return whole, min(map_forked(pursued, len(followed)), key=lambda solution: solution.fitted)


def candidates(trials: Sequence[Solution], share: int) -> list[Solution]:
    """Best trial whose rate part lags and best whose rate part leads, unless one is far better."""
    ordered = sorted(trials, key=lambda solution: solution.fitted)
    others = [solution for solution in ordered if solution.parameters[share] * ordered[0].parameters[share] < 0]
    return ordered[:1] + [solution for solution in others[:1] if solution.fitted < 10.0 * ordered[0].fitted]


def starts(axis: Axis) -> list[Array]:
    """Rate parts and dynamics from which the search for an `axis` begins.

    With k1 = κ k2 times the mean slope, H_D's small motions see (1 + (1 + κ) k2 s) / (1 + k2 s). A lag and a zero of G can undo
    that, and only large motions tell the two apart: so where G has them, every exchange is a start.
    """
    structure = axis.structure
    highest = 0.4 / axis.sample_time
    slow = structure.pace
    frequencies = [f / slow for f in (200.0, 800.0, 3000.0) if f / slow < highest] or [highest / 2]
    if not (structure.lags and structure.zeros):
        return [np.concatenate([[share, 0.0], structure.start(f)]) for f in frequencies for share in (-0.2, 0.2)]
    smaller = replace(structure, lags=structure.lags - 1, zeros=structure.zeros - 1)
    found = []
    for frequency in frequencies:
        dynamics = smaller.start(frequency)
        for k2 in (3e-4 * slow, 1e-3 * slow, 3e-3 * slow):
            for share in (-0.5, 0.5):
                parts = structure.split(structure.grow(smaller, dynamics, frequency))
                parts["lags"][-1] = -np.log(k2 * (1.0 + share))
                moved = with_numerator(parts, np.polymul(smaller.rational(dynamics)[0], [k2, 1.0]))
                found.append(np.concatenate([[share, np.log(k2 / (K2_UNIT * slow))], moved]))
    return found


def extended(
    windows: Sequence[Window], axis: Axis, best: Solution, structures: Sequence[Structure], options: MhlOptions
) -> list[tuple[Axis, Solution]]:
    """Fits of richer structures, each from the parameters of the poorer one, on all cores."""
    dynamics = axis.split(best.parameters)[2]
    before = best.parameters[: axis.curves.size + 2]
    begin: list[tuple[Structure, Array]] = []
    for structure in structures:
        begin.append((structure, structure.grow(axis.structure, dynamics, 1000.0 / structure.pace)))
        if structure == replace(axis.structure, zeros=axis.structure.zeros + 1):
            begin.append((structure, lead_and_delay(axis.structure, structure, dynamics)))

    def grown(index: int) -> Solution:
        structure, start = begin[index]
        problem = replace(axis, structure=structure).parametrization()
        return minimize_simulation_error(windows, problem, np.concatenate([before, start]), nuisance=options.nuisance, passes=12)

    solutions = list(map_forked(grown, len(begin)))
    found = []
    for structure in structures:
        own = [solution for (of, _), solution in zip(begin, solutions, strict=True) if of == structure]
        found.append((replace(axis, structure=structure), min(own, key=lambda solution: solution.fitted)))
    return found


def with_late_modes(windows: Sequence[Window], axis: Axis, best: Solution, options: MhlOptions) -> tuple[Axis, Solution]:
    """The best of a fit and of modes behind a delay alone, from those that vector fitting sees behind the curves of this fit."""
    curves = axis.split(best.parameters)[0]
    stage, parts = axis.curves.stage(curves, axis.ends, axis.output_scale), []
    for window in windows:
        if window.sample_time == axis.sample_time:
            earlier = np.zeros(0) if window.memory is None else window.memory
            hysteresis = at_rest([stage], np.append(earlier, window.command)[:, None])[len(earlier) :, 0]
            parts.append(replace(window, command=hysteresis))
    for structure, dynamics in late_modes(parts, axis.structure) if parts else []:
        late, start = replace(axis, structure=structure), np.concatenate([curves, np.zeros(2), dynamics])
        fit = minimize_simulation_error(windows, late.parametrization(), start, nuisance=options.nuisance, passes=12)
        axis, best = better((axis, best), (late, fit))
    return axis, best


def better(plain: tuple[Axis, Solution], rich: tuple[Axis, Solution]) -> tuple[Axis, Solution]:
    """The `rich` structure with its fit where it lowers the held-out error enough, else the `plain` one."""
    return rich if rich[1].held_out < (1.0 - WORTHWHILE) * plain[1].held_out else plain


def lead_and_delay(old: Structure, new: Structure, dynamics: Array) -> Array:
    """Start with one further, fast zero whose lead a longer delay cancels, as there is a minimum on either side of no zero."""
    parts = new.split(new.grow(old, dynamics, 1000.0 / old.pace))
    time = 0.5 / float(np.exp(parts["modes"][:, 0].max()))
    parts["delay"] = parts["delay"] + time / (TAU_UNIT * old.pace)
    return with_numerator(parts, np.polymul(old.rational(dynamics)[0], [time, 1.0]))


def with_parted_pair(model: Model, records: Sequence[Record], found: Found, index: int, nuisance: str) -> Found:
    """Add a mode and a nearby pair of zeros, a notch that misses its mode, to one axis where that lowers the held-out error enough.

    Both begin at the frequency where the command explains most of the residual of `model`, the zeros upon the mode. Neither alone
    lowers the error, so adding factor by factor never finds them. Cross-coupling must be removed before.
    """
    axis, dynamics = found.axis, found.axis.split(found.vector)[2]
    signals = []
    for data in records:
        error = simulated_rows(model, data)
        np.subtract(data.measurement, error, out=error)  # in place: a long record's is on a file
        begin = virgin_rows(data.command[:, index])
        signals.append((data.command[begin:, index], error[begin:, index]))
    frequency = unexplained_frequency(signals, axis.sample_time)
    if axis.structure.modes > MOST_MODES or frequency is None:
        return found
    turned = axis_windows(records, index, axis.sign)
    # Short stretches would miss the moment at which a sweep passes the frequency.
    many = short_stretches(turned, FINAL_ROWS, 3 * STRETCH, SETTLE)
    plain = minimize_simulation_error(many, axis.parametrization(), found.vector, nuisance=nuisance, passes=3)
    pairs = [pole_zero_pair(axis.structure, dynamics, frequency, damping) for damping in PAIR_DAMPINGS]
    problem, before = replace(axis, structure=pairs[0][0]).parametrization(), found.vector[: axis.curves.size + 2]
    starts_of = [np.concatenate([before, upon]) for _, upon in pairs]
    trials = [minimize_simulation_error(many, problem, start, nuisance=nuisance, passes=PAIR_TRIAL) for start in starts_of]
    first = min(trials, key=lambda trial: trial.fitted)
    best = minimize_simulation_error(many, problem, first.parameters, nuisance=nuisance, passes=PAIR_PASSES - PAIR_TRIAL)
    if not best.held_out < (1.0 - WORTHWHILE) * plain.held_out:
        return found
    # Stretches may miss the moments that would contradict: the whole records decide.
    rich = replace(found, axis=replace(axis, structure=pairs[0][0]), vector=best.parameters)
    return rich if square_error(turned, rich, nuisance) < square_error(turned, found, nuisance) else found


def extensions(structure: Structure) -> list[Structure]:
    """Structures with one factor more than `structure`, the plainer first."""
    options = []
    if structure.zeros + 1 < 2 * structure.modes + structure.lags:
        options.append(replace(structure, zeros=structure.zeros + 1))
    if structure.lags == 0:
        options.append(replace(structure, lags=1))
    elif structure.modes == 1:
        options.append(replace(structure, modes=2, zeros=structure.zeros + 1))
    return options
