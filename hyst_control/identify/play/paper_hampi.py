# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The HAMPI paper's own sequence (§3.2): step → G(s), quasi-static loops → w_i, loops at 100 Hz → m1, m2, k, b.

Kept to be compared with the joint fit: every later step inherits the error of the ones before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.identify.data.fit_windows import as_window, cut, whole_records
from hyst_control.identify.data.record_segmentation import select_stretches
from hyst_control.identify.play.hammerstein import HammersteinOptions, default_operators
from hyst_control.identify.solve.bounded_least_squares import cost, solve_bounded
from hyst_control.identify.solve.gram_sums import Operators, Window, gram_matrices
from hyst_control.identify.solve.stable_dynamics import Structure
from hyst_control.identify.solve.variable_projection import Problem, Solution, solve
from hyst_control.records.record import Record

DYNAMIC_FREQUENCY = 100.0
PAPER_STRUCTURE = Structure(modes=1, zeros=1, slow_pair=True)  # The factors of the paper's Eq. 7


def fit_axis(
    records: Sequence[Record], axis: int, options: HammersteinOptions, *, dynamic: bool
) -> tuple[Operators, Solution, float]:
    """One axis in the paper's three steps: its operators, the solution, and the mean square error of the last step."""
    step = _windows(records, axis, "step", "a step from rest that is then held")
    slow = _windows(records, axis, "quasi_static", "loops at 5 Hz or slower")
    everything = whole_records(records, axis)
    operators = default_operators(everything, options, one_sided=options.one_sided)
    drive = max(float(np.ptp(window.command)) for window in everything)
    mean_slope = max(float(np.ptp(window.measurement)) for window in everything) / drive

    # Step 1: G(s), with a plain gain for the hysteresis, which the small step hardly shows.
    gain = Problem(step, Operators(np.zeros(1)), "none", len(records), mean_slope)
    structure = options.structure or PAPER_STRUCTURE
    trials = [solve(gain, structure, structure.start(frequency), everything=True) for frequency in (300.0, 800.0, 2000.0)]
    parameters = min(trials, key=lambda trial: trial.fitted).parameters

    # Step 2: the static weights, G(s) as it is.
    static = solve(Problem(slow, operators, "offset", len(records), mean_slope), structure, parameters, passes=2, everything=True)
    static = replace(static, parameters=parameters, held_out=static.fitted)
    if not dynamic:
        return operators, static, static.fitted

    # Step 3: the dynamic weights, everything else as it is.
    fast = _windows(records, axis, "dynamic", "loops at 100 Hz", DYNAMIC_FREQUENCY)
    operators = replace(operators, dynamic=True)
    solution = _dynamic_weights(fast, operators, static, len(records))
    return operators, solution, solution.fitted


def _dynamic_weights(windows: Sequence[Window], operators: Operators, static: Solution, groups: int) -> Solution:
    """m1, m2, k, b from the loops at one frequency. No offset is free: one that is freed here and then dropped takes m1 and m2 to 0."""
    count = len(operators.thresholds)
    grams = gram_matrices(
        windows, operators, static.structure, static.parameters, np.append(static.theta, np.zeros(3)), "none", groups
    )
    gram = grams.fitted + grams.held_out
    size, total = static.structure.size, len(gram) - 1
    keep = np.r_[0 : operators.columns, operators.columns + size : total + 1]
    gram = gram[np.ix_(keep, keep)]
    # Columns m1, m2, k, b; b adds to every weight alike.
    free = np.zeros((len(gram) - 1, 4))
    free[count : count + 3, :3] = np.eye(3)
    free[:count, 3] = 1.0
    fixed = np.concatenate([static.theta, np.zeros(len(gram) - 1 - count)])
    normal, target = free.T @ gram[:-1, :-1] @ free, free.T @ (gram[:-1, -1] - gram[:-1, :-1] @ fixed)
    upper = np.full(len(target), np.inf)
    found = solve_bounded(normal, target, np.array([0.0, 0.0, -np.inf, -np.inf]), upper)
    vector = fixed + free @ found
    fitted = cost(gram, vector) / max(sum(grams.rows), 1)
    return replace(
        static,
        theta=vector[: operators.columns],
        nuisances=vector[operators.columns :],
        fitted=fitted,
        held_out=fitted,
        grams=grams,
    )


def _windows(records: Sequence[Record], axis: int, kind: str, words: str, frequency: float | None = None) -> list[Window]:
    chosen = select_stretches(records, axis, kind, frequency)
    if not chosen:
        raise InputError(
            f"{', '.join(data.name for data in records)}: the paper's sequence needs {words}: add such a record or "
            "use the joint method"
        )
    found = []
    for stretch in chosen:
        begin = max(stretch.begin - (20 if stretch.kind == "step" else 0), 0)
        found += cut(as_window(records[stretch.record], axis, stretch.record), [begin], stretch.end - begin, 0.0)
    return found
