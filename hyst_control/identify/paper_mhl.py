"""The MHL paper's own sequence (§2.4, §4.2).

Step → τ, slow loops of variable amplitude → f0, g0, sweep to 100 Hz → k1, k2, sweep to 4 kHz → G(s); and curves of their own for the
inverse (Table 1, right). Kept to be compared with the joint fit: every later step inherits the error of the ones before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from hyst_control.chain import Stage
from hyst_control.chain.memoryless import Gain
from hyst_control.chain.stage import Array
from hyst_control.errors import InputError
from hyst_control.identify.dataset import Dataset
from hyst_control.identify.fit_report import command_bandwidth
from hyst_control.identify.fit_windows import whole_records
from hyst_control.identify.gram_sums import Window
from hyst_control.identify.madelung import fit_axis, fit_inverse, full_scale, response_sign
from hyst_control.identify.mhl_axis import K2_UNIT, Axis, AxisFit, MhlOptions
from hyst_control.identify.reversal_points import turning_points
from hyst_control.identify.simulation_error import (
    Parametrization,
    Solution,
    minimize_simulation_error,
    short_stretches,
    surviving_turns,
)
from hyst_control.identify.stable_dynamics import TAU_UNIT, Structure

REST_TIME = 0.02
"""A command that holds still for this long (s) rests."""
SLOW, MEDIUM = 5.0, 150.0
"""Bandwidths (Hz) of the slow loops and of the sweep for the rate correction, at most."""
PAPER_STRUCTURE = Structure(modes=1, lags=1, zeros=2)
"""The order of Eq. 12."""
STEP_TIME = 0.05
"""How long (s) a step's response is looked at."""
ROWS = 60_000


@dataclass(frozen=True)
class Pieces:
    """Windows of one axis by their role in the sequence."""

    step: list[Window]
    slow: list[Window]
    medium: list[Window]
    fast: list[Window]


def fit_axes(datasets: Sequence[Dataset], options: MhlOptions) -> list[AxisFit]:
    """Identify every axis in the paper's steps. Raises `InputError` naming the experiment that the records lack."""
    return [_fit_axis(datasets, index, options) for index in range(len(datasets[0].axes))]


def _fit_axis(datasets: Sequence[Dataset], index: int, options: MhlOptions) -> AxisFit:
    everything = whole_records(datasets, index)
    sign = response_sign(everything)
    pieces = sorted_pieces(datasets, index, sign)
    scale = full_scale(everything, options.input_scale)
    structure = options.structure or PAPER_STRUCTURE

    # Step 1: the delay.
    tau, tau_error = step_delay(pieces.step)

    # Step 2: the curves, from loops so slow that nothing else matters.
    static = fit_axis(pieces.slow, options.curves, scale, options.nuisance)
    curves = static.solution.parameters
    inverse = fit_inverse(static.stage, options.curves)

    # Steps 3 and 4: the rate correction without G, then G, everything before as it is.
    whole = replace(structure, delay=True)
    axis = Axis(options.curves, whole, scale, static.output_scale, sign, everything[0].sample_time)
    bare = replace(axis, structure=Structure(delay=True))
    late = np.array([tau / TAU_UNIT])
    medium = short_stretches(pieces.medium, ROWS, 0.3, 0.02)
    rate = _best(
        medium,
        lambda vector: bare.stages(np.concatenate([curves, vector, late])),
        [np.array([share, np.log(k2 / K2_UNIT)]) for share in (-0.2, 0.2) for k2 in (3e-4, 1e-3, 3e-3)],
        lambda vector: bare.limit(np.concatenate([curves, vector, late]))[curves.size : curves.size + 2],
        options.nuisance,
    )
    fast = short_stretches(pieces.fast, ROWS, 0.3, 0.02)
    dynamics = _best(
        fast,
        lambda vector: axis.stages(np.concatenate([curves, rate.parameters, vector, late])),
        [structure.start(frequency) for frequency in (300.0, 1000.0, 3000.0) if frequency < 0.4 / axis.sample_time],
        lambda vector: structure.limit(vector, axis.sample_time),
        options.nuisance,
    )
    covariance = block_diag(static.solution.covariance, rate.covariance, dynamics.covariance, (tau_error / TAU_UNIT) ** 2)
    steps = {
        "delay": {"tau": tau, "steps": len(pieces.step)},
        "inverse": {
            "ascending": list(inverse.ascending),
            "descending": list(inverse.descending),
            "input_scale": inverse.input_scale,
            "output_scale": inverse.output_scale,
        },
        "fitted_rms": {
            name: float(np.sqrt(solution.fitted))
            for name, solution in (("slow", static.solution), ("medium", rate), ("fast", dynamics))
        },
    }
    vector = np.concatenate([curves, rate.parameters, dynamics.parameters, late])
    return AxisFit(axis, vector, covariance, static.offset, dynamics.held_out, steps)


def sorted_pieces(datasets: Sequence[Dataset], index: int, sign: float) -> Pieces:
    """The motions between rests by kind. Raises `InputError` naming the experiment that is missing."""
    found = Pieces([], [], [], [])
    group = 0
    for data in datasets:
        command, measurement = data.command[:, index], sign * data.measurement[:, index]
        for begin, moving, end in motions(command, data.sample_time):
            jump = moving - begin <= 2
            lead = int(0.01 / data.sample_time) if jump else 1
            first = max(begin - lead, 0)
            if jump:
                end = min(end, begin + int(STEP_TIME / data.sample_time))
            turns = command[turning_points(command[: first + 1])] if first else np.zeros(0)
            earlier = np.concatenate([[0.0], turns, command[first : first + 1]])
            memory = earlier[surviving_turns(earlier)][:-1] if first else None
            window = Window(
                np.ascontiguousarray(command[first:end]),
                np.ascontiguousarray(measurement[first:end]),
                data.sample_time,
                data.hold,
                0,
                group,
                memory=memory,
            )
            group += 1
            part = replace(data, command=command[begin:end, None], measurement=measurement[begin:end, None])
            bandwidth = command_bandwidth(part)
            kind = found.step if jump else found.slow if bandwidth <= SLOW else found.medium if bandwidth <= MEDIUM else found.fast
            kind.append(window)
    names = ", ".join(data.name for data in datasets)
    for kind, words in (
        (found.step, "a step between two rests"),
        (found.slow, f"slow loops (up to {SLOW:g} Hz) of variable amplitude"),
        (found.medium, "a sweep to 100 Hz"),
        (found.fast, f"a sweep to beyond {MEDIUM:g} Hz"),
    ):
        if not kind:
            raise InputError(
                f"{names}: the paper's sequence needs {words} of axis {datasets[0].axes[index]}: add such a record or use the "
                "joint method"
            )
    return found


def motions(command: Array, sample_time: float) -> list[tuple[int, int, int]]:
    """(first, last moving row + 1, end) of the motions of a command (N,): each with the rest that follows it."""
    span = float(np.ptp(command))
    moving = np.flatnonzero(np.abs(np.diff(command)) > 1e-9 * span) + 1
    if span == 0 or not len(moving):
        return []
    breaks = np.flatnonzero(np.diff(moving) > REST_TIME / sample_time)
    begins = moving[np.concatenate([[0], breaks + 1])]
    ends = moving[np.concatenate([breaks, [len(moving) - 1]])] + 1
    following = np.append(begins[1:], len(command))
    return [(int(b), int(m), int(e)) for b, m, e in zip(begins, ends, following, strict=True)]


def step_delay(windows: Sequence[Window]) -> tuple[float, float]:
    """The delay (s) and its standard error: a second-order response behind a delay, fitted to the beginning of each step."""
    structure = Structure(modes=1, delay=True)
    sample_time = windows[0].sample_time
    travel = max(float(np.ptp(window.measurement)) / float(np.ptp(window.command)) for window in windows)

    def stages(vector: Array) -> list[Stage]:
        return [Gain(travel * vector[0]), *structure.stages(vector[1:])]

    def limit(vector: Array) -> Array:
        return np.concatenate([vector[:1], structure.limit(vector[1:], sample_time)])

    starts = [
        np.concatenate([[1.0], structure.start(frequency)])
        for frequency in (300.0, 1000.0, 3000.0)
        if frequency < 0.4 / sample_time
    ]
    # Every step has its own zero, and creep its own drift.
    plain = [replace(window, memory=None, group=number) for number, window in enumerate(windows)]
    found = _best(plain, stages, starts, limit, "linear")
    return structure.tau(found.parameters[1:]), TAU_UNIT * float(np.sqrt(max(found.covariance[-1, -1], 0.0)))


def _best(
    windows: Sequence[Window],
    stages: Callable[[Array], Sequence[Stage]],
    starts: Sequence[Array],
    limit: Callable[[Array], Array],
    nuisance: str,
) -> Solution:
    """The best of several starts, brought to its minimum."""
    groups = {group: number for number, group in enumerate(sorted({window.group for window in windows}))}
    own = [replace(window, group=groups[window.group]) for window in windows]
    size = len(starts[0])
    problem = Parametrization(stages, np.zeros((0, size)), np.zeros(0), limit)
    trials = [minimize_simulation_error(own, problem, start, nuisance=nuisance, passes=5, everything=True) for start in starts]
    best = min(trials, key=lambda solution: solution.fitted)
    return minimize_simulation_error(own, problem, best.parameters, nuisance=nuisance, passes=30, tolerance=1e-6, everything=True)
