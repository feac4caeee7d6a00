"""Reference and excitation signals, from a description to rows: used by the reference generator and offline.

A description is a mapping with `signal`, the kind, and that kind's parameters (seconds, hertz, and the signal's own unit: V for
an excitation, um or mrad for a reference). `build` turns it into rows (N, A). Every kind takes besides:

    lower, upper   bounds of the values; a signal that leaves them is refused
    slew_limit     bound of the rate (unit/s): a jump that is held is spread along a straight line over as many samples as it takes;
                   a signal that exceeds the bound anywhere else is refused
    axis           index of the axis that moves, the others rest at `idle` (default: all axes move alike)
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyst_control.errors import InputError

Array = NDArray[np.float64]

COPIES = 8
"""Times that a signal stands in memory while it is built."""

LONGEST = 500_000_000
"""Samples; a longer signal would not fit in memory."""


@cache
def most_samples() -> float:
    """Samples of all axes that this machine's memory holds, with the copies that are made of them."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError, AttributeError):
        return LONGEST
    return min(LONGEST, memory / COPIES / 8)


def build(spec: Mapping[str, Any], sample_time: float, axes: int = 1) -> Array:
    """Rows of a signal, built from its description.

    Parameters
    ----------
    spec
        Mapping with `signal`, the kind, and that kind's parameters, as the module describes it.
    sample_time
        Sample time, s.
    axes
        Number of axes A.

    Returns
    -------
    Array
        Rows (N, A), in the signal's own unit.

    Raises
    ------
    InputError
        The kind or a parameter is not known, missing or not valid, or the signal leaves its bounds; the text names the parameter.
    """
    if not isinstance(spec, Mapping) or not all(isinstance(key, str) for key in spec):
        raise InputError("is no description of a signal: give a mapping with signal: KIND and its parameters")
    given = dict(spec)
    kind = given.pop("signal", None)
    if not isinstance(kind, str) or kind not in KINDS:
        raise InputError(f"signal: {kind!r} is not known, one of {', '.join(sorted(KINDS))} is due")
    lower, upper, slew_limit = (
        _number(given.pop(key, default), key) for key, default in (("lower", -np.inf), ("upper", np.inf), ("slew_limit", np.inf))
    )
    axis, idle = given.pop("axis", None), _number(given.pop("idle", 0.0), "idle")
    function = KINDS[kind]
    known = inspect.signature(function).parameters
    for key in given:
        if key not in known or key in ("sample_time", "axes"):
            allowed = [name for name in known if name not in ("sample_time", "axes")]
            raise InputError(
                f"{kind}: {key}: no such parameter, must be one of {', '.join([*allowed, 'lower', 'upper', 'slew_limit', 'axis'])}"
            )
    for key, parameter in known.items():
        if parameter.default is inspect.Parameter.empty and key not in given and key not in ("sample_time", "axes"):
            raise InputError(f"{kind}: {key}: is missing")
    if "duration" in given and _number(given["duration"], "duration") / sample_time > most_samples():
        raise InputError(f"{kind}: duration: {given['duration']} s at {sample_time:g} s a sample is too long for memory")
    extra = {"axes": axes} if "axes" in known else {}
    try:
        rows = np.asarray(function(sample_time=sample_time, **extra, **given), dtype=float)
    except InputError as error:
        raise InputError(f"{kind}: {error}") from None
    except (TypeError, ValueError, OverflowError, ZeroDivisionError, IndexError, MemoryError) as error:
        raise InputError(f"{kind}: its parameters are not the numbers and lists it needs ({error})") from None
    if rows.ndim == 1:
        if rows.size * axes > most_samples():
            raise InputError(f"{kind}: {len(rows)} samples of {axes} axes do not fit in memory: shorten it")
        rows = np.repeat(rows[:, None], axes, axis=1)
        if axis is not None:
            if isinstance(axis, bool) or not isinstance(axis, int) or axis not in range(axes):
                raise InputError(f"{kind}: axis: {axis!r}, 0 to {axes - 1} is due")
            rows[:, [other for other in range(axes) if other != axis]] = idle
    if not rows.size or not np.isfinite(rows).all():
        raise InputError(f"{kind}: the signal is empty or not finite: check duration, frequency and amplitude")
    rows = _jumps_spread(rows, slew_limit * sample_time)
    _check_bounds(kind, rows, sample_time, lower, upper, slew_limit)
    return np.ascontiguousarray(rows)


def _jumps_spread(rows: Array, most: float) -> Array:
    """Jumps of more than `most` from one sample to the next made straight lines, where what they lead to is held that long."""
    if not np.isfinite(most) or most <= 0:
        return rows
    spread = rows.copy()
    for before, after in zip(rows.T, spread.T, strict=True):
        changes = np.diff(before)
        for index in np.flatnonzero(np.abs(changes) > most * (1 + 1e-9)):
            count = int(np.ceil(abs(changes[index]) / most - 1e-9))
            following = slice(index + 1, index + 1 + count)
            if np.all(before[following] == before[index + 1]):
                line = before[index] + changes[index] * np.arange(1, count + 1) / count
                after[following] = line[: len(after[following])]
    return spread


def _check_bounds(kind: str, rows: Array, sample_time: float, lower: float, upper: float, slew_limit: float) -> None:
    if rows.min() < lower - 1e-9 or rows.max() > upper + 1e-9:
        excess = max(lower - rows.min(), rows.max() - upper)
        raise InputError(
            f"{kind}: runs from {rows.min():.6g} to {rows.max():.6g}, {excess:.4g} beyond {lower:g} to {upper:g}: lower the "
            "amplitude or move the offset"
        )
    if len(rows) > 1 and np.isfinite(slew_limit):
        fastest = float(np.max(np.abs(np.diff(rows, axis=0)))) / sample_time
        if fastest > slew_limit * (1 + 1e-9):
            raise InputError(
                f"{kind}: its rate reaches {fastest:.4g}/s, over the limit of {slew_limit:.4g}/s: lower amplitude or frequency"
            )


def rest(sample_time: float, duration: float, offset: float = 0.0) -> Array:
    """Constant signal at `offset`.

    Parameters
    ----------
    sample_time
        Sample time, s.
    duration
        Length, s.
    offset
        Value, signal unit.

    Returns
    -------
    Array
        Rows (N,), signal unit.
    """
    return np.full(_count(duration, sample_time), _number(offset, "offset"))


def sine(
    sample_time: float, frequency: float, amplitude: float, offset: float = 0.0, duration: float = 1.0, phase: float = 0.0
) -> Array:
    """Sine: offset + amplitude sin(2π frequency t + phase).

    Parameters
    ----------
    sample_time
        Sample time, s.
    frequency
        Frequency, Hz.
    amplitude
        Amplitude, signal unit.
    offset
        Mean, signal unit.
    duration
        Length, s.
    phase
        Phase at the first sample, rad; -π/2 starts at the lowest point.

    Returns
    -------
    Array
        Rows (N,), signal unit.
    """
    return offset + amplitude * np.sin(2 * np.pi * frequency * _time(duration, sample_time) + phase)


def cosine_ramp(sample_time: float, start: float, stop: float, duration: float) -> Array:
    """Ramp along half a cosine, without a jump in value or rate.

    Parameters
    ----------
    sample_time
        Sample time, s.
    start
        First value, signal unit.
    stop
        Value that the sample after the last one would have, signal unit.
    duration
        Length, s.

    Returns
    -------
    Array
        Rows (N,), signal unit.
    """
    count = _count(duration, sample_time)
    return start + (stop - start) * 0.5 * (1 - np.cos(np.pi * np.arange(count) / count))


def decaying_sine(
    sample_time: float,
    frequency: float,
    amplitude: float,
    offset: float = 0.0,
    duration: float = 1.0,
    final: float = 0.0,
    phase: float = 0.0,
) -> Array:
    """Sine whose amplitude changes linearly from `amplitude` to `final`; it grows where `final` is larger.

    Parameters
    ----------
    sample_time
        Sample time, s.
    frequency
        Frequency, Hz.
    amplitude
        Amplitude at the beginning, signal unit.
    offset
        Mean, signal unit.
    duration
        Length, s.
    final
        Amplitude at the end, signal unit.
    phase
        Phase at the first sample, rad.

    Returns
    -------
    Array
        Rows (N,), signal unit.
    """
    time = _time(duration, sample_time)
    return offset + (amplitude + (final - amplitude) * time / duration) * np.sin(2 * np.pi * frequency * time + phase)


def multi_frequency(
    sample_time: float,
    frequencies: Sequence[float],
    amplitudes: Sequence[float],
    offset: float = 0.0,
    duration: float = 1.0,
    phases: Sequence[float] | None = None,
) -> Array:
    """Sum of sines: offset + Σ a_i sin(2π f_i t + φ_i) (MHL paper §4.3, §4.4).

    Parameters
    ----------
    sample_time
        Sample time, s.
    frequencies
        Frequencies (F,), Hz.
    amplitudes
        Amplitudes (F,), signal unit.
    offset
        Mean, signal unit.
    duration
        Length, s.
    phases
        Phases (F,), rad; all 0 by default.

    Returns
    -------
    Array
        Rows (N,), signal unit.

    Raises
    ------
    InputError
        The three lists are empty or differ in length.
    """
    f, a = np.asarray(frequencies, dtype=float), np.asarray(amplitudes, dtype=float)
    p = np.zeros_like(f) if phases is None else np.asarray(phases, dtype=float)
    if not f.shape == a.shape == p.shape or f.ndim != 1 or not f.size:
        raise InputError(f"frequencies: must be as many as amplitudes and phases, got {f.size}, {a.size} and {p.size}")
    time = _time(duration, sample_time)
    waves = sum(ai * np.sin(2 * np.pi * fi * time + pi) for fi, ai, pi in zip(f, a, p, strict=True))
    return np.asarray(offset + waves)


def multisine_lines(
    period: float,
    lower_frequency: float,
    upper_frequency: float,
    odd: bool = True,
    detection: int = 0,
    avoid_mains: bool = False,
    seed: int = 0,
) -> NDArray[np.int64]:
    """Harmonics of 1 / period that a multisine excites.

    Parameters
    ----------
    period
        Period, s.
    lower_frequency
        Lowest frequency, Hz.
    upper_frequency
        Highest frequency, Hz.
    odd
        True to take odd harmonics only.
    detection
        One line of every group of this many is left out at random, where a nonlinearity then shows; 0 or 1 for none.
    avoid_mains
        True to leave out lines within one line of a multiple of 50 or 60 Hz.
    seed
        Seed of the lines that are left out.

    Returns
    -------
    NDArray[np.int64]
        Harmonic numbers (F,), ascending.
    """
    lines = np.arange(max(int(np.ceil(lower_frequency * period - 1e-9)), 1), int(np.floor(upper_frequency * period + 1e-9)) + 1)
    if odd:
        lines = lines[lines % 2 == 1]
    if avoid_mains:
        f = lines / period
        near = np.minimum(np.abs(f - 50 * np.rint(f / 50)), np.abs(f - 60 * np.rint(f / 60)))
        lines = lines[near >= 1.0 / period - 1e-9]
    if detection > 1:
        rng = np.random.default_rng(seed)
        left_out = [
            group[rng.integers(len(group))]
            for group in np.split(lines, np.arange(detection, len(lines), detection))
            if len(group) == detection
        ]
        lines = np.setdiff1d(lines, left_out)
    return lines


def multisine(
    sample_time: float,
    period: float,
    lower_frequency: float,
    upper_frequency: float,
    rms: float,
    axes: int,
    offset: float = 0.0,
    periods: int = 1,
    odd: bool = True,
    detection: int = 0,
    avoid_mains: bool = False,
    seed: int = 0,
) -> Array:
    """Random-phase multisine with equal amplitudes on its lines (`multisine_lines`) and separate phases for every axis.

    Every period is the same to the last bit.

    Parameters
    ----------
    sample_time
        Sample time, s.
    period
        Period, s; a whole number of samples.
    lower_frequency
        Lowest frequency, Hz.
    upper_frequency
        Highest frequency, Hz.
    rms
        Root mean square about the offset, signal unit.
    axes
        Number of axes A.
    offset
        Mean, signal unit.
    periods
        Number of periods.
    odd
        True to excite odd harmonics only.
    detection
        Size of the groups of lines of which one is left out; 0 or 1 for none.
    avoid_mains
        True to leave out lines near multiples of 50 and 60 Hz.
    seed
        Seed of the phases and of the lines that are left out.

    Returns
    -------
    Array
        Rows (N, A), signal unit.

    Raises
    ------
    InputError
        The period is no whole number of samples, or no line lies between the frequencies.
    """
    _check_size(max(_number(period, "period"), period * _number(periods, "periods")) * axes / sample_time)
    count = int(round(period / sample_time))
    if count < 4 or abs(count * sample_time - period) > 1e-6 * period:
        raise InputError(f"period: {period:g} s is no whole number of samples of {sample_time:g} s: choose one that is")
    lines = multisine_lines(period, lower_frequency, upper_frequency, odd, detection, avoid_mains, seed)
    lines = lines[lines < count / 2]
    if not len(lines):
        raise InputError(f"upper_frequency: no line of 1/{period:g} s lies between {lower_frequency:g} and {upper_frequency:g} Hz")
    rng = np.random.default_rng([seed, 1])
    columns = []
    for _ in range(axes):
        spectrum = np.zeros(count // 2 + 1, dtype=complex)
        spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
        wave = np.fft.irfft(spectrum, count)
        columns.append(offset + rms * wave / np.sqrt(np.mean(wave**2)))
    return np.tile(np.stack(columns, axis=1), (int(periods), 1))


def sweep(
    sample_time: float,
    start_frequency: float,
    stop_frequency: float,
    amplitude: float,
    offset: float = 0.0,
    duration: float = 1.0,
    logarithmic: bool = True,
) -> Array:
    """Frequency sweep offset - amplitude cos φ(t), which begins at its lowest point.

    Parameters
    ----------
    sample_time
        Sample time, s.
    start_frequency
        Frequency at the beginning, Hz.
    stop_frequency
        Frequency at the end, Hz.
    amplitude
        Amplitude, signal unit.
    offset
        Mean, signal unit.
    duration
        Length, s.
    logarithmic
        True for equal time per octave, False for a frequency that changes linearly.

    Returns
    -------
    Array
        Rows (N,), signal unit.

    Raises
    ------
    InputError
        A logarithmic sweep has a frequency that is not positive.
    """
    time = _time(duration, sample_time)
    if logarithmic:
        if start_frequency <= 0 or stop_frequency <= 0:
            raise InputError("start_frequency: a logarithmic sweep needs positive frequencies: set logarithmic: false or raise it")
        octaves = np.log(stop_frequency / start_frequency)
        phase = (
            2
            * np.pi
            * (
                start_frequency * time
                if octaves == 0
                else start_frequency * duration / octaves * np.expm1(time / duration * octaves)
            )
        )
    else:
        phase = 2 * np.pi * (start_frequency * time + (stop_frequency - start_frequency) * time**2 / (2 * duration))
    return offset - amplitude * np.cos(phase)


def triangle(sample_time: float, frequency: float, amplitude: float, offset: float = 0.0, duration: float = 1.0) -> Array:
    """Triangle between offset ± amplitude, which begins at its lowest point.

    Parameters
    ----------
    sample_time
        Sample time, s.
    frequency
        Frequency, Hz.
    amplitude
        Amplitude, signal unit.
    offset
        Mean, signal unit.
    duration
        Length, s.

    Returns
    -------
    Array
        Rows (N,), signal unit.
    """
    phase = (frequency * _time(duration, sample_time)) % 1.0
    return offset + amplitude * (1.0 - 4.0 * np.abs(phase - 0.5))


def staircase(sample_time: float, levels: Sequence[float] | Array, hold: float, ramp: float = 0.0) -> Array:
    """Levels that are held one after the other.

    Parameters
    ----------
    sample_time
        Sample time, s.
    levels
        Levels (L,), signal unit.
    hold
        Time at each level, s.
    ramp
        Time of the half cosine from one level to the next, s; 0 for a jump.

    Returns
    -------
    Array
        Rows (N,), signal unit.

    Raises
    ------
    InputError
        There is no level, one is not a number, or the signal does not fit in memory.
    """
    values = [_number(level, "levels") for level in levels]
    _check_size(len(values) * (_number(hold, "hold") + _number(ramp, "ramp")) / sample_time)
    if not values:
        raise InputError("levels: must be a list of at least one level, got an empty one")
    parts = []
    for before, level in zip([values[0], *values], values, strict=False):
        if ramp and level != before:
            parts.append(cosine_ramp(sample_time, before, level, ramp))
        parts.append(rest(sample_time, hold, level))
    return np.concatenate(parts)


def step(sample_time: float, height: float, offset: float = 0.0, before: float = 0.01, after: float = 0.2) -> Array:
    """Step from `offset` to offset + height.

    Parameters
    ----------
    sample_time
        Sample time, s.
    height
        Height, signal unit.
    offset
        Value before the step, signal unit.
    before
        Time before the step, s.
    after
        Time after the step, s.

    Returns
    -------
    Array
        Rows (N,), signal unit.
    """
    return np.concatenate([rest(sample_time, before, offset), rest(sample_time, after, offset + height)])


def steps(sample_time: float, lowest: float, highest: float, hold: float, count: int, seed: int = 0) -> Array:
    """Random levels between `lowest` and `highest`, each held; begins and ends at `lowest`.

    Parameters
    ----------
    sample_time
        Sample time, s.
    lowest
        Lowest level, signal unit.
    highest
        Highest level, signal unit.
    hold
        Time at each level, s.
    count
        Number of random levels, drawn from a uniform distribution.
    seed
        Seed of the levels.

    Returns
    -------
    Array
        Rows (N,), signal unit.
    """
    _check_size(_number(count, "count") * max(_number(hold, "hold") / sample_time, 1.0))
    levels = np.random.default_rng(seed).uniform(lowest, highest, int(count))
    return staircase(sample_time, [lowest, *levels, lowest], hold)


def spiral(sample_time: float, axes: int, radius: float, frequency: float, duration: float, offset: float = 0.0) -> Array:
    """Spiral of axes 0 and 1: offset + r(t) (cos, sin), with r growing linearly from 0 to `radius`.

    Parameters
    ----------
    sample_time
        Sample time, s.
    axes
        Number of axes A, at least 2; further axes rest at the offset.
    radius
        Radius at the end, signal unit.
    frequency
        Turns per second, Hz.
    duration
        Length, s.
    offset
        Center, signal unit.

    Returns
    -------
    Array
        Rows (N, A), signal unit.
    """
    _two_axes(axes)
    _check_size(_number(duration, "duration") * axes / sample_time)
    time = _time(duration, sample_time)
    rows = np.full((len(time), axes), float(offset))
    grown = radius * time / duration
    rows[:, 0] += grown * np.cos(2 * np.pi * frequency * time)
    rows[:, 1] += grown * np.sin(2 * np.pi * frequency * time)
    return rows


def raster(sample_time: float, axes: int, width: float, height: float, lines: int, line_time: float, offset: float = 0.0) -> Array:
    """Raster scan: axis 0 sweeps ± width/2 as a triangle while axis 1 climbs linearly from -height/2 to height/2.

    Parameters
    ----------
    sample_time
        Sample time, s.
    axes
        Number of axes A, at least 2; further axes rest at the offset.
    width
        Width, signal unit.
    height
        Height, signal unit.
    lines
        Number of passes of axis 0.
    line_time
        Time of one pass, s.
    offset
        Center, signal unit.

    Returns
    -------
    Array
        Rows (N, A), signal unit.
    """
    _two_axes(axes)
    duration = lines * line_time
    _check_size(_number(duration, "lines") * axes / sample_time)
    rows = np.full((_count(duration, sample_time), axes), float(offset))
    rows[:, 0] += triangle(sample_time, 0.5 / line_time, width / 2, 0.0, duration)
    rows[:, 1] += height * (np.arange(len(rows)) / max(len(rows) - 1, 1) - 0.5)
    return rows


def sequence(sample_time: float, axes: int, parts: Sequence[Mapping[str, Any]], join: float = 0.0) -> Array:
    """Signals one after the other.

    Parameters
    ----------
    sample_time
        Sample time, s.
    axes
        Number of axes A.
    parts
        Descriptions of the signals, as for `build`.
    join
        Time of the half cosine that joins two signals without a jump, s; 0 for none.

    Returns
    -------
    Array
        Rows (N, A), signal unit.

    Raises
    ------
    InputError
        There is no list of descriptions, or one is not valid; the text gives its index.
    """
    if not parts or isinstance(parts, (str, Mapping)):
        raise InputError(f"parts: must be a list of signal descriptions, got {parts!r}")
    rows: list[Array] = []
    for index, part in enumerate(parts):
        try:
            following = build(part, sample_time, axes)
        except InputError as error:
            raise InputError(f"parts[{index}]: {error}") from None
        _check_size(sum(each.size for each in rows) + following.size + _number(join, "join") * axes / sample_time)
        if rows and join:
            rows.append(np.stack([cosine_ramp(sample_time, rows[-1][-1, a], following[0, a], join) for a in range(axes)], axis=1))
        rows.append(following)
    return np.concatenate(rows)


def loops(sample_time: float, frequency: float, peak: float, cycles: float) -> Array:
    """One-sided loops from 0 to `peak` and back: peak (1 - cos 2π f t) / 2.

    Parameters
    ----------
    sample_time
        Sample time, s.
    frequency
        Frequency, Hz.
    peak
        Greatest value, signal unit.
    cycles
        Number of loops; the length is rounded to whole samples.

    Returns
    -------
    Array
        Rows (N,), signal unit.
    """
    count = _count(cycles / frequency, sample_time)
    return np.asarray(0.5 * peak * (1 - np.cos(2 * np.pi * frequency * np.arange(count) * sample_time)))


def hampi_identification(
    sample_time: float,
    peak: float = 50.0,
    step_height: float = 10.0,
    frequencies: Sequence[float] = (10.0, 20.0, 50.0, 100.0, 200.0, 300.0, 500.0),
    quasi_static: float = 1.0,
    pause: float = 0.02,
    fast_share: float = 0.7,
    time: float = 0.06,
) -> Array:
    """Experiments that identify HAMPI (paper §3.2), one after the other from rest at 0 V, with rests between.

    A step; quasi-static loops to the peak and to 0.6 of it; loops at every frequency to the peak, and at every second one to 0.45
    of it as well, so that rate and amplitude can be told apart.

    Parameters
    ----------
    sample_time
        Sample time, s.
    peak
        Greatest command, V.
    step_height
        Height of the step, V.
    frequencies
        Frequencies (F,) of the faster loops, Hz.
    quasi_static
        Frequency of the quasi-static loops, Hz.
    pause
        Rest after each group of loops, s.
    fast_share
        Part of the peak that loops above 300 Hz reach, to spare the amplifier.
    time
        Time at every frequency, s; three loops at least.

    Returns
    -------
    Array
        Rows (N,), V.
    """
    longest = [1.0 / _number(quasi_static, "quasi_static"), *(max(3.0 / float(f), time) for f in frequencies)]
    _check_size(2 * (sum(map(abs, longest)) + len(longest) * abs(_number(pause, "pause"))) / sample_time)
    pieces = [rest(sample_time, pause), rest(sample_time, 0.15, step_height), rest(sample_time, 0.1)]
    for share in (1.0, 0.6):
        pieces += [loops(sample_time, quasi_static, share * peak, 1), rest(sample_time, pause)]
    for index, frequency in enumerate(sorted(float(f) for f in frequencies)):
        share = fast_share if frequency > 300 else 1.0
        cycles = max(3, int(round(time * frequency)))
        pieces += [loops(sample_time, frequency, share * peak, cycles), rest(sample_time, pause)]
        if index % 2:
            pieces += [loops(sample_time, frequency, 0.45 * peak, cycles), rest(sample_time, pause)]
    return np.concatenate(pieces)


def mhl_identification(
    sample_time: float,
    peak: float = 100.0,
    step_height: float = 10.0,
    axes: int = 1,
    slow: float = 1.0,
    highest: float = 4000.0,
    sweep_time: float = 2.0,
) -> Array:
    """Experiments that identify MHL (paper §4.2), each axis in turn with the others at rest at 0 V.

    A step; slow loops of falling amplitude; a full-amplitude sweep to 100 Hz; a small sweep to `highest` about mid-drive.

    Parameters
    ----------
    sample_time
        Sample time, s.
    peak
        Greatest command, V.
    step_height
        Height of the step, V.
    axes
        Number of axes A.
    slow
        Frequency of the slow loops, Hz.
    highest
        Highest frequency of the small sweep, Hz; 0.4 of the sample rate at most.
    sweep_time
        Length of each sweep, s.

    Returns
    -------
    Array
        Rows (N, A), V.
    """
    _check_size((5.0 / _number(slow, "slow") + 3 * _number(sweep_time, "sweep_time")) * axes**2 / sample_time)
    small = 0.1 * peak
    centre = 0.5 * peak
    highest = min(highest, 0.4 / sample_time)
    own = np.concatenate(
        [
            rest(sample_time, 0.02),
            rest(sample_time, 0.1, step_height),
            rest(sample_time, 0.1),
            *(loops(sample_time, slow, share * peak, 1) for share in (1.0, 0.8, 0.6, 0.4, 0.2)),
            rest(sample_time, 0.05),
            sweep(sample_time, 1.0, 100.0, centre, centre, sweep_time, False),
            cosine_ramp(
                sample_time, _last(sweep(sample_time, 1.0, 100.0, centre, centre, sweep_time, False)), centre - small, 0.05
            ),
            rest(sample_time, 0.05, centre - small),
            sweep(sample_time, 20.0, highest, small, centre, sweep_time, True),
        ]
    )
    own = np.concatenate([own, cosine_ramp(sample_time, own[-1], 0.0, 0.1), rest(sample_time, 0.05)])
    rows = np.zeros((len(own) * axes, axes))
    for axis in range(axes):
        rows[axis * len(own) : (axis + 1) * len(own), axis] = own
    return rows


def diagnostic(
    sample_time: float, lowest: float, highest: float, axes: int, duration: float = 1.5, band: float = 1000.0, seed: int = 0
) -> Array:
    """Experiments that show every effect of the catalogue, within `lowest` to `highest`.

    Rest; a step that is held (creep, drift); a small and a large multisine of two equal periods each, odd with detection lines and
    none near the mains (linear, even, odd, noise); a triangle (static curve, velocity sign); fast steps (slew, delay); rest. The
    axes move with separate phases; in the triangle and the steps they move in turn, so that cross-coupling shows.

    Parameters
    ----------
    sample_time
        Sample time, s.
    lowest
        Lowest command, V.
    highest
        Highest command, V.
    axes
        Number of axes A.
    duration
        Approximate length, s.
    band
        Highest frequency of the small multisine, Hz; 0.35 of the sample rate at most.
    seed
        Seed of the multisines.

    Returns
    -------
    Array
        Rows (N, A), V.
    """
    _check_size(2 * _number(duration, "duration") * axes / sample_time)
    span, centre = highest - lowest, 0.5 * (lowest + highest)
    unit = duration / 15.0
    period = max(round(2 * unit / sample_time), 40) * sample_time
    band = min(band, 0.35 / sample_time)

    def everywhere(column: Array) -> Array:
        return np.repeat(column[:, None], axes, axis=1)

    def in_turn(column: Array, idle: float) -> list[Array]:
        piece = np.full((axes, len(column), axes), float(idle))
        for axis in range(axes):
            piece[axis, :, axis] = column
        return list(piece)

    small = multisine(sample_time, period, 1.0 / period, band, 0.03 * span, axes, centre, 2, True, 4, True, seed)
    large = multisine(sample_time, period, 1.0 / period, 0.3 * band, 0.13 * span, axes, centre, 2, True, 4, True, seed + 1)
    large = np.clip(large, lowest, highest)
    share = 1.0 / axes
    levels = centre + span * np.array([0.3, -0.3, 0.15, -0.15, 0.4, -0.4])
    pieces = [
        everywhere(rest(sample_time, unit, lowest)),
        everywhere(rest(sample_time, 2.5 * unit, lowest + 0.6 * span)),
        _joined(sample_time, np.full(axes, lowest + 0.6 * span), small[0], 0.25 * unit),
        small,
        _joined(sample_time, small[-1], large[0], 0.25 * unit),
        large,
        _joined(sample_time, large[-1], np.full(axes, lowest), 0.25 * unit),
    ]
    pieces += in_turn(triangle(sample_time, 1.0 / (1.25 * unit * share), 0.5 * span, centre, 2.5 * unit * share), lowest)
    pieces += in_turn(staircase(sample_time, levels, 0.2 * unit * share), centre)
    pieces += [everywhere(rest(sample_time, unit, lowest))]
    return np.concatenate(pieces)


KINDS: dict[str, Callable[..., Array]] = {
    function.__name__: function
    for function in (
        rest,
        sine,
        cosine_ramp,
        decaying_sine,
        multi_frequency,
        multisine,
        sweep,
        triangle,
        staircase,
        step,
        steps,
        spiral,
        raster,
        sequence,
        loops,
        hampi_identification,
        mhl_identification,
        diagnostic,
    )
}
"""Every kind of signal by name."""


def _joined(sample_time: float, start: Array, stop: Array, duration: float) -> Array:
    return np.stack([cosine_ramp(sample_time, a, b, duration) for a, b in zip(start, stop, strict=True)], axis=1)


def _last(signal: Array) -> float:
    return float(signal[-1])


def _two_axes(axes: int) -> None:
    if axes < 2:
        raise InputError(f"axes: {axes}, two axes are needed")


def _number(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or np.isnan(value):
        raise InputError(f"{name}: must be a number, got {value!r}")
    return float(value)


def _check_size(samples: float) -> None:
    """Refuse what does not fit in memory before any of it is made; samples: of all axes."""
    if not samples <= most_samples():
        raise InputError(f"{samples:.3g} samples do not fit in memory: shorten it, or lower the rate")


def _count(duration: float, sample_time: float) -> int:
    count = int(round(_number(duration, "duration") / sample_time))
    if count > most_samples():
        raise InputError(f"duration: {duration:g} s at {sample_time:g} s a sample is too long for memory")
    if count < 1:
        raise InputError(f"duration: {duration:g} s is shorter than a sample of {sample_time:g} s")
    return count


def _time(duration: float, sample_time: float) -> Array:
    return np.arange(_count(duration, sample_time), dtype=np.float64) * sample_time
