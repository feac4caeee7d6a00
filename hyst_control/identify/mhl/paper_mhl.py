# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The MHL paper's own sequence (§2.4, §4.2).

Step → τ, slow loops of variable amplitude → f0, g0, sweep to 100 Hz → k1, k2, sweep to 4 kHz → G(s). Kept to be compared with the
joint fit: every later step inherits the error of the ones before.

The inverse (Eq. 6, 7) is identified too, not derived: curves of its own (Table 1, right), then Ψ' from u - H_S^-1[y] on the sweep to
100 Hz as it was recorded. Delay and hold are left in, so Ψ' leads and makes up for them: Ψ of the model, which was fitted with the
delay removed, lags, and its inverse would have the other sign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import minimize_scalar

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Parallel, Sampling, Stage
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.linear.linear_stages import RateCorrection
from hyst_control.chain.linear.symmetric_filter import smooth_weights
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.identify.assess.assembly import side_by_side
from hyst_control.identify.assess.fit_report import command_bandwidth
from hyst_control.identify.data.fit import check_records
from hyst_control.identify.data.fit_windows import (
    as_window,
    cut,
    response_sign,
    short_stretches,
    virgin_rows,
    whole_records,
    with_sign,
)
from hyst_control.identify.data.record_segmentation import moving_stretches
from hyst_control.identify.mhl.madelung import curve_ends, fit_curves, fit_inverse
from hyst_control.identify.mhl.madelung_curves import Ends
from hyst_control.identify.mhl.mhl_axis import K2_UNIT, Axis, Found, MhlOptions
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.identify.solve.pole_zero_pair import PAIR_DAMPINGS, WORTHWHILE, pole_zero_pair, unexplained_frequency
from hyst_control.identify.solve.simulation_error import (
    Parametrization,
    Solution,
    driving_signal,
    minimize_simulation_error,
)
from hyst_control.identify.solve.stable_dynamics import TAU_UNIT, Structure
from hyst_control.model_file import Model
from hyst_control.records.record import Record

REST_TIME = 0.02  # A command that holds still for this long (s) rests
SLOW, MEDIUM = 5.0, 150.0  # Bandwidths (Hz) of the slow loops and of the sweep for the rate correction, at most
PAPER_STRUCTURE = Structure(modes=1, lags=1, zeros=2)  # The order of Eq. 12
STEP_TIME = 0.05  # Length of a step's response that is used, s
REST_KEPT = 0.3
"""Length of the rest after a motion that is kept, s: it may be all the time in which the other axis moves, and tell nothing."""
ROWS = 60_000
FASTEST, SLOWEST = 0.25, 50.0
"""Samples, between which k2' is looked for: below a quarter of one Tustin's rule makes an alternating filter of Ψ'."""


def _with_pair(windows: Sequence[Window], axis: Axis, whole: Array, plain: Solution, nuisance: str) -> tuple[Solution, Axis]:
    """G(s) with a further mode and zeros next to it, where that lowers the held-out error.

    Eq. 12 has no room for a mode that its notch misses, and its order is the one of its fitting accuracy (§4.2).
    """
    signals = []
    for window in windows:
        signal, first = driving_signal(window)
        simulated = _run(axis.stages(whole), signal, Sampling(window.sample_time, 1, window.hold))[first:]
        signals.append((window.command[window.skip :], (window.measurement - simulated)[window.skip :]))
    frequency = unexplained_frequency(signals, axis.sample_time)
    if frequency is None:
        return plain, axis
    best, richest = plain, axis
    for damping in PAIR_DAMPINGS:
        structure, start = pole_zero_pair(replace(axis.structure, delay=False), plain.parameters, frequency, damping)
        richer = replace(axis, structure=replace(structure, delay=True))
        dynamics = _dynamics_of(richer, np.concatenate([whole[: axis.curves.size + 2], start, whole[-1:]]))
        found = minimize_simulation_error(windows, dynamics, start, nuisance=nuisance, passes=30, tolerance=1e-6, everything=True)
        if found.held_out < (1.0 - WORTHWHILE) * best.held_out:
            best, richest = found, richer
    return best, richest


def _dynamics_of(axis: Axis, whole: Array) -> Parametrization:
    """G(s) alone, without the delay, which is the last of the parameters."""
    return axis.parametrization().part(whole, slice(axis.curves.size + 2, -1))


def inverse_model(
    records: Sequence[Record], options: MhlOptions | None = None, k2: float | None = None, smoothing: int = 0
) -> Model:
    """Identify the compensator of Eq. 6 and 7 from the paper's records, taken at the rate of the loop, whose hold it makes up for.

    Its chain runs from the measurement to V, for the kinds `mhl` and `mhl_static`.
    """
    # smoothing: order of the N without phase behind which Ψ' is to stand (`mhl_inverse.composite`), and is identified; 0 for none
    check_records(records)
    options = options or MhlOptions()
    first = records[0]
    signs, zeros, curves, rates = [], [], [], []
    for index in range(len(first.axes)):
        sign = response_sign(whole_records(records, index))
        pieces = sorted_pieces(records, index, sign)
        static = fit_curves(pieces["slow"], options.curves, from_zero(records, index, options), options.nuisance)
        hysteresis = fit_inverse(static.stage, options.curves)
        rates.append(fit_inverse_correction(records, index, sign, hysteresis, static.offset, k2, smoothing))
        signs.append(sign)
        zeros.append(static.offset)
        curves.append([hysteresis])
    rate = RateCorrection(*map(list, zip(*rates, strict=True)))
    turned = [Gain(signs)] if min(signs) < 0 else []
    stages = [*turned, Offset([-zero for zero in zeros]), Parallel((tuple(side_by_side(curves)), (rate,)))]
    return Model(
        name="mhl_inverse",
        axes=first.axes,
        units={"command": first.unit, "measurement": "V"},
        sample_time=first.sample_time,
        hold="foh",
        chain=Chain(tuple(stages)),
    )


def fit_inverse_correction(
    records: Sequence[Record],
    index: int,
    sign: float,
    hysteresis: Madelung,
    zero: float,
    k2: float | None = None,
    smoothing: int = 0,
) -> tuple[float, float, float]:
    """Fit k1', k2' and b1' of one axis to u - H_S^-1[y - zero] on the sweeps to 100 Hz as recorded; for every k2' the others are linear.

    Ψ' is discretized by Tustin's rule, as in the compensator.
    """
    weights, ahead = (smooth_weights(smoothing), smoothing + 1) if smoothing else (np.ones(1), 0)
    targets: list[tuple[Array, Array, list[slice], Sampling]] = []
    for data in records:
        command = data.command[:, index]
        rows = [
            slice(begin, moving)
            for begin, moving, end in motions(command, data.sample_time)
            if moving - begin > 2
            and SLOW < command_bandwidth(data.command[begin:end, index : index + 1], data.sample_time) <= MEDIUM
        ]
        sampling = Sampling(data.sample_time, 1, "foh")
        y = sign * data.measurement[:, index : index + 1] - zero
        targets.append((command - _run([hysteresis], y, sampling), y, rows, sampling))

    def left(log_k2: float) -> tuple[float, Array]:
        """Mean square of what is left and (k1, b1)."""
        from scipy.signal import lfilter  # takes a second

        wanted, columns = [], []
        for target, y, rows, sampling in targets:
            half, k2 = 0.5 * sampling.sample_time, float(np.exp(log_k2))
            held = np.append(y[:, 0], np.repeat(y[-1, 0], ahead)) - y[0, 0]
            led = lfilter(weights, 1.0, lfilter([1.0, -1.0], [k2 + half, half - k2], held))[ahead:]
            for part in rows:
                wanted.append(target[part])
                columns.append(np.column_stack([led[part], np.ones(len(target[part]))]))
        matrix, goal = np.concatenate(columns), np.concatenate(wanted)
        solution = np.linalg.lstsq(matrix, goal, rcond=None)[0]
        return float(np.mean((goal - matrix @ solution) ** 2)), solution

    bounds = np.log(np.array([FASTEST, SLOWEST]) * records[0].sample_time)
    best = np.log(k2) if k2 else minimize_scalar(lambda value: left(value)[0], bounds=bounds, method="bounded").x
    k1, b1 = left(best)[1]
    return float(k1), float(np.exp(best)), float(b1)


def _run(stages: Sequence[Stage], signal: Array, sampling: Sampling) -> Array:
    running = Chain(tuple(stages)).filter(sampling)
    running.settle(signal[0])
    return np.asarray(running.process(np.ascontiguousarray(signal)))[:, 0]


def from_zero(records: Sequence[Record], index: int, options: MhlOptions) -> Ends:
    """Commands at the ends of the curves, which begin at 0 V in the paper's sequence."""
    ends = curve_ends(whole_records(records, index), options)
    if ends.lower != 0.0:
        raise InputError(
            f"{records[0].name}: command: the paper's sequence begins at 0 V, the records of axis {records[0].axes[index]} at "
            f"{ends.lower:g} V: use the joint method"
        )
    return ends


def fit_axes(records: Sequence[Record], options: MhlOptions) -> list[Found]:
    """Identify every axis in the paper's steps. Raises `InputError` naming an experiment that is missing."""
    return [_fit_axis(records, index, options) for index in range(len(records[0].axes))]


def _fit_axis(records: Sequence[Record], index: int, options: MhlOptions) -> Found:
    everything = whole_records(records, index)
    sign = response_sign(everything)
    pieces = sorted_pieces(records, index, sign)
    ends = from_zero(records, index, options)
    structure = options.structure or PAPER_STRUCTURE

    # Step 1: the delay.
    tau, tau_error = step_delay(pieces["step"])

    # Step 2: the curves, from loops so slow that nothing else matters.
    static = fit_curves(pieces["slow"], options.curves, ends, options.nuisance)
    curves = static.solution.parameters

    # Steps 3 and 4: the rate correction without G, then G, everything before as it is.
    axis = Axis(options.curves, replace(structure, delay=True), ends, static.output_scale, sign, everything[0].sample_time)
    late = np.array([tau / TAU_UNIT])
    medium = short_stretches(pieces["medium"], ROWS, 0.3, 0.02)
    rates = [np.array([share, np.log(k2 / K2_UNIT)]) for share in (-0.2, 0.2) for k2 in (3e-4, 1e-3, 3e-3)]
    bare = replace(axis, structure=Structure(delay=True)).parametrization()
    known = np.concatenate([curves, rates[0], late])
    rate = _best(medium, bare.part(known, slice(curves.size, curves.size + 2)), rates, options.nuisance)
    fast = short_stretches(pieces["fast"], ROWS, 0.3, 0.02)
    starts = [structure.start(frequency) for frequency in (300.0, 1000.0, 3000.0) if frequency < 0.4 / axis.sample_time]
    known = np.concatenate([curves, rate.parameters, starts[0], late])
    dynamics = _best(fast, _dynamics_of(axis, known), starts, options.nuisance)
    if options.structure is None:
        known = np.concatenate([curves, rate.parameters, dynamics.parameters, late])
        dynamics, axis = _with_pair(fast, axis, known, dynamics, options.nuisance)
    covariance = block_diag(static.solution.covariance, rate.covariance, dynamics.covariance, (tau_error / TAU_UNIT) ** 2)
    steps = {"delay": {"tau": tau, "steps": len(pieces["step"])}}
    vector = np.concatenate([curves, rate.parameters, dynamics.parameters, late])
    return Found(axis, vector, covariance, static.offset, dynamics.held_out, steps)


def sorted_pieces(records: Sequence[Record], index: int, sign: float) -> dict[str, list[Window]]:
    """Sort the motions between rests by kind. Raises `InputError` naming an experiment that is missing."""
    found: dict[str, list[Window]] = {"step": [], "slow": [], "medium": [], "fast": []}
    group = 0
    for data in records:
        whole = with_sign(as_window(data, index, 0), sign)
        loading = virgin_rows(whole.command)
        for begin, moving, end in motions(whole.command, data.sample_time):
            jump = moving - begin <= 2
            lead = int(0.01 / data.sample_time) if jump else 1
            first = max(begin - lead, 0)
            bandwidth = command_bandwidth(data.command[begin:end, index : index + 1], data.sample_time)
            end = min(end, begin + int(STEP_TIME / data.sample_time) if jump else moving + int(REST_KEPT / data.sample_time))
            # A step stands by itself; the curves are those of the major loop, not of the initial loading curve.
            [window] = cut(replace(whole, skip=0 if jump else loading), [first], end - first, 0.0)
            kind = "step" if jump else "slow" if bandwidth <= SLOW else "medium" if bandwidth <= MEDIUM else "fast"
            found[kind].append(replace(window, begin=0.0, share=1.0, group=group))
            group += 1
    names = ", ".join(data.name for data in records)
    for kind, words in (
        ("step", "a step between two rests"),
        ("slow", f"slow loops (up to {SLOW:g} Hz) of variable amplitude"),
        ("medium", "a sweep to 100 Hz"),
        ("fast", f"a sweep to beyond {MEDIUM:g} Hz"),
    ):
        if not found[kind]:
            raise InputError(
                f"{names}: the paper's sequence needs {words} of axis {records[0].axes[index]}: add such a record or use the "
                "joint method"
            )
    return found


def motions(command: Annotated[Array, "N"], sample_time: float) -> list[tuple[int, int, int]]:
    """Rows (first, last moving row + 1, end) of the motions of a command, each with the rest that follows it."""
    runs = moving_stretches(command, 1e-9 * float(np.ptp(command)), int(REST_TIME / sample_time))
    following = [begin + 1 for begin, _ in runs[1:]] + [len(command)]
    return [(begin + 1, end + 1, next_one) for (begin, end), next_one in zip(runs, following, strict=True)]


def step_delay(windows: Sequence[Window]) -> tuple[float, float]:
    """Delay (s) and its standard error, from a delayed second-order response fitted to the beginning of each step."""
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
    found = _best(plain, Parametrization(stages, limit=limit), starts, "linear")
    return structure.tau(found.parameters[1:]), TAU_UNIT * float(np.sqrt(max(found.covariance[-1, -1], 0.0)))


def _best(windows: Sequence[Window], problem: Parametrization, starts: Sequence[Array], nuisance: str) -> Solution:
    """The best of several starts, brought to its minimum."""
    trials = [minimize_simulation_error(windows, problem, start, nuisance=nuisance, passes=5, everything=True) for start in starts]
    best = min(trials, key=lambda solution: solution.fitted)
    return minimize_simulation_error(
        windows, problem, best.parameters, nuisance=nuisance, passes=30, tolerance=1e-6, everything=True
    )
