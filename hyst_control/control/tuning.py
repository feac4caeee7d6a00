# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Automatic tuning of the PI feedback to stability margins, from a model's linear part as the loop samples it.

The loop is L(z) = P(z) z^-d F(z) (kp + ki T z / (z - 1)): P exact for the held command, delays included, d further ticks where the
loop carries them (a loop closed over topics on wall-clock timers carries about one), F the roll-off of the feedback (`pi`) where it
is asked for, 1 otherwise. Among all (kp, ki) that keep the margins for every case of plant gain and first resonance, the one with
the greatest ki is taken: it has the least integral of the error after a load step (Astrom and Hagglund, Advanced PID Control, 2006,
§4.6 and §6.3). Among roll-offs, each with its gains, the one whose step has the least integral of the absolute error is taken: the
greatest ki of all belongs to a low corner and a great kp, which overshoot.

The model's own error is a relative one: the plant's response may lie anywhere within `model_error` |P| of the model's, at every
frequency and in every case (multiplicative uncertainty, Doyle, Francis and Tannenbaum, Feedback Control Theory, 1992, §4). The
margins hold for the worst of these plants.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hyst_control.base.arrays import Array, Complex
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain
from hyst_control.control.feedback.loop import run_loop
from hyst_control.control.feedback.pi import PI, roll_off_share
from hyst_control.control.linearization import hysteresis_slopes, linearized, sampled_response, with_first_mode
from hyst_control.model_file import Model, Simulator
from hyst_control.reporting.tables import Table

LOWEST_SCALE = 1e-15
"""Of the gain at which the gain margin would be kept; a loop that cannot keep its margins at this little of it never does."""


@dataclass(frozen=True)
class Margins:
    """Stability of one loop.

    gain_margin dB, phase_margin degrees, peak_sensitivity (max |1 / (1 + L)|), crossover and bandwidth Hz (-3 dB of L / (1 + L), half
    the sampling rate when it stays above).
    """

    gain_margin: float
    phase_margin: float
    peak_sensitivity: float
    crossover: float
    bandwidth: float


@dataclass(frozen=True)
class Tuning:
    """Gains and what they give.

    kp (V per measurement unit) and ki (V per measurement unit and s), margins of the model as it is and the worst over the spread and
    the model's own error, settling_time s of a step into 2 %, overshoot in per cent; roll_off Hz, 0 without.
    """

    kp: float
    ki: float
    sample_time: float
    nominal: Margins
    worst: Margins
    settling_time: float
    overshoot: float
    roll_off: float = 0.0

    def controller(self, lower: float, upper: float, slew_limit: float = 0.0) -> PI:
        """Tuned controller with the command limits `lower` and `upper` in V and `slew_limit` in V/s (0 for none)."""
        return PI(self.kp, self.ki, self.sample_time, lower, upper, slew_limit, roll_off=self.roll_off)

    def sensitivity(self, model: Model, frequency: Sequence[float], loop_delay: int = 0) -> Array:
        """Greatest sensitivity |1 / (1 + L)| (F,) of all axes of the nominal model.

        Parameters
        ----------
        model
            Model of the plant.
        frequency
            Frequencies (F,), Hz.
        loop_delay
            Further delay of the loop, ticks.
        """
        z = np.exp(2j * np.pi * np.asarray(frequency, dtype=float) * self.sample_time)
        plants = spread_responses(model, self.sample_time, loop_delay, 0.0, 0.0, z)[: len(model.axes)]
        loops = plants * controller_response(self.kp, self.ki, self.roll_off, self.sample_time, z)
        return np.asarray(np.abs(1.0 / (1.0 + loops)).max(axis=0))

    def step(self, model: Model, length: int) -> Array:
        """Measurement (length, A) of `model` in the linear loop when the reference jumps from 0 to 1."""
        return _step(model, self.kp, self.ki, self.roll_off, self.sample_time, length)

    def table(self, model: Model) -> Table:
        """The result as rows, for the command line and the JSON."""
        table, unit = Table("tune"), model.units["measurement"]
        where = f"{model.name} at {1.0 / self.sample_time:g} Hz"
        table.add("PI feedback", where, "controller", "kp", f"V/{unit}", self.kp)
        table.add("PI feedback", where, "controller", "ki", f"V/({unit} s)", self.ki)
        if self.roll_off:
            table.add("PI feedback", where, "controller", "roll_off", "Hz", self.roll_off)
        for subject, case in (("nominal", self.nominal), ("worst case", self.worst)):
            for quantity, symbol in (
                ("gain_margin", "dB"),
                ("phase_margin", "deg"),
                ("peak_sensitivity", ""),
                ("crossover", "Hz"),
                ("bandwidth", "Hz"),
            ):
                table.add("PI feedback", where, subject, quantity, symbol, getattr(case, quantity))
        table.add("PI feedback", where, "nominal", "settling_time", "s", self.settling_time)
        table.add("PI feedback", where, "nominal", "overshoot", "%", self.overshoot)
        return table


AUTOMATIC = "auto"
ROLL_OFFS = tuple(np.geomspace(0.4, 0.004, 11))
"""Corners of the roll-off that are tried, relative to the sample rate."""


def tune(
    model: Model,
    *,
    sample_time: float | None = None,
    gain_margin: float = 6.0,
    phase_margin: float = 45.0,
    peak_sensitivity: float = 2.0,
    loop_delay: int = 0,
    gain_spread: float = 0.1,
    mode_spread: float = 0.2,
    model_error: float = 0.15,
    roll_off: float | str = 0.0,
) -> Tuning:
    """PI gains for a model, one pair for all axes.

    The hysteresis enters with its greatest slope, so that no part of a loop has less margin.

    Parameters
    ----------
    model
        Model of the plant.
    sample_time
        Sample time, s; the model's by default.
    gain_margin
        Least gain margin, dB.
    phase_margin
        Least phase margin, degrees.
    peak_sensitivity
        Greatest peak of the sensitivity |S|.
    loop_delay
        Further delay of the loop, ticks.
    gain_spread
        Relative spread of the plant's gain, over which the margins hold too.
    mode_spread
        Relative spread of the first resonance's frequency, over which the margins hold too.
    model_error
        Relative error of the model's response, at any frequency and in any direction, on top of the spreads.
    roll_off
        Corner of the feedback's roll-off, Hz; 0 for none, "auto" to choose it along with the gains, which then keep the margins
        only with it.

    Returns
    -------
    Tuning
        Gains, roll-off and the properties of the loop.

    Raises
    ------
    InputError
        A parameter is out of its range, or no controller keeps the margins.
    """
    sample_time = float(sample_time or model.sample_time)
    if not (
        gain_margin > 0
        and 0 < phase_margin < 90
        and peak_sensitivity > 1
        and loop_delay >= 0
        and all(0 <= spread < 1 for spread in (gain_spread, mode_spread, model_error))
    ):
        raise InputError(
            "margins: must be gain margin above 0 dB, phase margin between 0 and 90 degrees, peak sensitivity above 1, "
            "spreads and model error from 0 to below 1"
        )
    if roll_off != AUTOMATIC and not (isinstance(roll_off, (int, float)) and 0.0 <= roll_off < np.inf):
        raise InputError(f"roll_off: must be a corner in Hz, 0 for none, or {AUTOMATIC!r}, got {roll_off!r}")
    z = np.exp(1j * np.geomspace(1e-5, 1.0, 1500) * np.pi)
    plants = spread_responses(model, sample_time, loop_delay, gain_spread, mode_spread, z)
    static = np.abs(plants[:, 0]).max()
    if np.any(plants[:, 0].real <= 0.0):
        raise InputError("chain: the output falls when the command rises at rest: PI gains are positive; invert the axis")
    limits = 10.0 ** (gain_margin / 20.0), np.radians(phase_margin), peak_sensitivity, model_error
    corners = [float(roll_off)] if roll_off != AUTOMATIC else _ranked_corners(model, plants, static, sample_time, z, limits)
    for corner in corners:
        kp, ki = _greatest_integral(plants, static, sample_time, corner, z, limits)
        if ki > 0.0:
            break
    else:
        raise InputError("margins: no PI controller keeps them for this model: ask for less, or sample faster")
    controller = controller_response(kp, ki, corner, sample_time, z)
    axes = len(model.axes)
    nominal = [margins(plant * controller, z, sample_time) for plant in plants[:axes]]
    cases = [margins(plant * controller, z, sample_time, model_error) for plant in plants]
    settling, overshoot = step_response(model, kp, ki, sample_time, corner)
    return Tuning(kp, ki, sample_time, _worst(nominal), _worst(cases), settling, overshoot, corner)


def _ranked_corners(
    model: Model, plants: Complex, static: float, sample_time: float, z: Complex, limits: tuple[float, float, float, float]
) -> list[float]:
    """Corners of the roll-off in Hz, 0 for none, the best first; a third of the frequencies is enough to rank them."""
    ranked = []
    for corner in [0.0, *(share / sample_time for share in ROLL_OFFS)]:
        kp, ki = _greatest_integral(plants[:, ::3], static, sample_time, corner, z[::3], limits)
        if ki > 0.0:
            ranked.append((_absolute_error(model, kp, ki, corner, sample_time), corner))
    return [corner for _, corner in sorted(ranked)]


def _greatest_integral(
    plants: Complex, static: float, sample_time: float, roll_off: float, z: Complex, limits: tuple[float, float, float, float]
) -> tuple[float, float]:
    """The gains (kp, ki) with the greatest ki that keep the limits for all plants (M, F); zeros where there are none."""
    rolled = plants * controller_response(1.0, 0.0, roll_off, sample_time, z)
    best = (0.0, 0.0)
    # Integral action alone, and proportional-to-integral times from a tenth of a sample to ten thousand.
    for time in [0.0, *(sample_time * np.geomspace(0.1, 1e4, 26 if roll_off else 51))]:
        shape = (time + sample_time * z / (z - 1.0)) / (static * sample_time)
        loops, above = rolled * shape, best[1] * static * sample_time
        if roll_off and above and _phase_margin(_courses(loops), limits[3], above).min() < limits[1]:
            continue  # no greater integral gain than the best so far
        scale = _largest_scale(loops, *limits, above=above)
        gains = scale * time / (static * sample_time), scale / (static * sample_time)
        if gains[1] > best[1]:
            best = gains
    return float(best[0]), float(best[1])


def controller_response(kp: float, ki: float, roll_off: float, sample_time: float, z: Complex) -> Complex:
    """Response of the feedback from the error to the command.

    Parameters
    ----------
    kp
        Proportional gain, V per measurement unit.
    ki
        Integral gain, V per measurement unit and s.
    roll_off
        Corner of the roll-off, Hz; 0 for none.
    sample_time
        Sample time, s.
    z
        Points (F,) of the z plane.

    Returns
    -------
    Complex
        Response (F,), V per measurement unit.
    """
    response = kp + ki * sample_time * z / (z - 1.0) if ki else np.full(z.shape, kp, dtype=complex)
    share = roll_off_share(roll_off, sample_time)
    return response * (share / (1.0 - (1.0 - share) / z)) if share < 1.0 else response


def spread_responses(
    model: Model, sample_time: float, loop_delay: int, gain_spread: float, mode_spread: float, z: Complex
) -> Complex:
    """Responses of a model at the ends of the spreads of its gain and of its first resonance.

    Parameters
    ----------
    model
        Model of the plant.
    sample_time
        Sample time, s.
    loop_delay
        Further delay of the loop, ticks.
    gain_spread
        Relative spread of the gain.
    mode_spread
        Relative spread of the first resonance's frequency.
    z
        Points (F,) of the z plane.

    Returns
    -------
    Complex
        Responses (cases · A, F) of every axis, the nominal model first, measurement unit per V.
    """
    axes = len(model.axes)
    _, greatest = hysteresis_slopes(model)
    stages = linearized(model, greatest)
    responses = []
    for mode in (1.0, 1.0 - mode_spread, 1.0 + mode_spread):
        response = sampled_response(with_first_mode(stages, axes, mode), axes, sample_time, z)
        response = response[:, np.arange(axes), np.arange(axes)].T * z**-loop_delay
        responses += [gain * response for gain in (1.0, 1.0 - gain_spread, 1.0 + gain_spread)]
    return np.concatenate(responses)


def _largest_scale(
    loops: Complex, gain_margin: float, phase_margin: float, peak_sensitivity: float, error: float, above: float
) -> float:
    """The largest factor on loops (M, F) up to which all of them keep the margins; 0 when it is not larger than `above`."""
    ultimate = _crossing_180(loops).max() * (1.0 + error)
    highest = 1.0 / (max(ultimate, 1e-12) * gain_margin)

    courses = _courses(loops)

    def kept(scale: float) -> bool:
        if 1.0 > peak_sensitivity * _min_distance(scale * loops, error):
            return False
        return bool(_phase_margin(courses, error, scale).min() >= phase_margin)

    if highest <= above:
        return 0.0
    # A resonance may take the phase margin or the sensitivity long before the gain margin: begin where everything is kept.
    lowest = 1e-2
    while not kept(highest * lowest):
        lowest *= 0.1
        if lowest < LOWEST_SCALE:
            return 0.0
    last = 0.0
    for scale in highest * np.geomspace(lowest, 1.0, 25 + int(round(12 * np.log10(1e-2 / lowest)))):
        if not kept(scale):
            break
        last = float(scale)
    else:
        return last
    high = float(scale)
    if high <= above:
        return 0.0
    for _ in range(8):
        middle = 0.5 * (last + high)
        last, high = (middle, high) if kept(middle) else (last, middle)
    return last


def _crossing_180(loops: Complex) -> Array:
    """The greatest |L| (M,) where each of loops (M, F) crosses the negative real axis; 0 where it never does."""
    real, imaginary = loops.real, loops.imag
    change = imaginary[:, :-1] - imaginary[:, 1:]
    share = imaginary[:, :-1] / np.where(change == 0.0, 1.0, change)
    at = real[:, :-1] + share * (real[:, 1:] - real[:, :-1])
    crossed = (imaginary[:, :-1] * imaginary[:, 1:] <= 0.0) & (at < 0.0)
    # At half the sampling rate L is real, whatever its sign.
    return np.asarray(np.maximum(np.where(crossed, -at, 0.0).max(axis=1), -real[:, -1].clip(max=0.0)))


def _min_distance(loops: Complex, error: float) -> float:
    """The least |1 + L (1 + d)| over loops and all relative errors |d| up to `error`."""
    return float((np.abs(1.0 + loops) - error * np.abs(loops)).min())


class _Courses(NamedTuple):
    """Loops (M, F) between neighboring points: ln |L| (M, F) at all of them, arg L (M, F - 1) and what it turns by up to the next."""

    size: Array
    phase: Array
    turn: Array


def _courses(loops: Complex) -> _Courses:
    return _Courses(np.log(np.abs(loops)), np.angle(loops[:, :-1]), np.angle(loops[:, 1:] / loops[:, :-1]))


def _phase_margin(courses: _Courses, error: float = 0.0, scale: float = 1.0) -> Array:
    """Least distance (M,) in rad of the phase from -180 degrees where |L| of `scale` times the loops crosses 1; pi where it never does.

    A relative error turns the phase by its arc sine, and moves the crossing to where |L| is between 1 / (1 + error) and
    1 / (1 - error).
    """
    least = np.full(len(courses.size), np.pi)
    for factor in (1.0 - error, 1.0, 1.0 + error) if error else (1.0,):
        size = courses.size + np.log(factor * scale)
        loop, at = np.nonzero(size[:, :-1] * size[:, 1:] <= 0.0)
        before = size[loop, at]
        change = before - size[loop, at + 1]
        phase = courses.phase[loop, at] + courses.turn[loop, at] * before / np.where(change == 0.0, 1.0, change)
        np.minimum.at(least, loop, np.abs(np.mod(phase, 2.0 * np.pi) - np.pi))
    return np.asarray(least - np.arcsin(error))


def margins(loop: Complex, z: Complex, sample_time: float, error: float = 0.0) -> Margins:
    """Margins of a stable loop, the worst over a relative error of its response.

    Parameters
    ----------
    loop
        Response of the open loop (F,).
    z
        Points (F,) exp(j w T) of the response, in order of frequency.
    sample_time
        Sample time T, s.
    error
        Relative error of the response.

    Returns
    -------
    Margins
        Gain margin in dB, phase margin in degrees, peak sensitivity, and crossover and bandwidth in Hz.
    """
    frequency = np.angle(z) / (2.0 * np.pi * sample_time)
    crossing = float(_crossing_180(loop[None])[0]) * (1.0 + error)
    above = np.flatnonzero(np.abs(loop) >= 1.0)
    closed = np.abs(loop / (1.0 + loop))
    below = np.flatnonzero(closed < np.sqrt(0.5))
    return Margins(
        gain_margin=-20.0 * float(np.log10(crossing)) if crossing > 0.0 else np.inf,
        phase_margin=float(np.degrees(_phase_margin(_courses(loop[None]), error)[0])),
        peak_sensitivity=1.0 / _min_distance(loop, error),
        crossover=float(frequency[above[-1]]) if len(above) else 0.0,
        bandwidth=float(frequency[below[0]]) if len(below) else 0.5 / sample_time,
    )


def _worst(cases: list[Margins]) -> Margins:
    return Margins(
        min(case.gain_margin for case in cases),
        min(case.phase_margin for case in cases),
        max(case.peak_sensitivity for case in cases),
        min(case.crossover for case in cases),
        min(case.bandwidth for case in cases),
    )


def step_response(model: Model, kp: float, ki: float, sample_time: float, roll_off: float = 0.0) -> tuple[float, float]:
    """Settling time and overshoot of the linear loop with feedback alone, of the worst axis.

    Parameters
    ----------
    model
        Model of the plant.
    kp
        Proportional gain, V per measurement unit.
    ki
        Integral gain, V per measurement unit and s.
    sample_time
        Sample time, s.
    roll_off
        Corner of the roll-off, Hz; 0 for none.

    Returns
    -------
    tuple[float, float]
        Time until the step stays within 2 %, s (NaN where it does not), and the overshoot, percent.
    """
    length = 200
    while True:
        output = _step(model, kp, ki, roll_off, sample_time, length)
        outside = np.flatnonzero(np.any(np.abs(output - 1.0) > 0.02, axis=1))
        last = int(outside[-1]) if len(outside) else 0
        if last < 0.5 * length or length >= 200_000:
            break
        length *= 4
    settling = (last + 1) * sample_time if last < length - 1 else np.nan
    return float(settling), float(100.0 * max(output.max() - 1.0, 0.0))


def _absolute_error(model: Model, kp: float, ki: float, roll_off: float, sample_time: float) -> float:
    """Integral (s) of the absolute error of the linear loop's unit step, of the worst axis."""
    length = 200
    while True:
        error = np.abs(_step(model, kp, ki, roll_off, sample_time, length) - 1.0)
        if error[length // 2 :].max() < 1e-3 or length >= 200_000:
            return float(error.sum(axis=0).max() * sample_time)
        length *= 4


def _step(model: Model, kp: float, ki: float, roll_off: float, sample_time: float, length: int) -> Array:
    """Measurement (length, A) of the linear loop when the reference jumps to 1 at its first sample; feedback alone."""
    axes = len(model.axes)
    mean, _ = hysteresis_slopes(model)
    plant = Simulator(model.with_stages(Chain(linearized(model, mean)).stages), sample_time)
    controller = PI(kp, ki, sample_time, -1e300, 1e300, roll_off=roll_off).start(axes)
    return run_loop(np.ones((length, axes)), None, controller, plant)["measurement"]
