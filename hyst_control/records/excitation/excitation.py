# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reference and excitation signals, from a description to rows: used by the reference generator and offline.

A description is a mapping with `signal`, the kind, and that kind's parameters (seconds, hertz, and the signal's own unit: V for
an excitation, um or mrad for a reference); `parameters.py` declares them. `build` turns it into rows (N, A). Every kind takes besides:

    lower, upper   bounds of the values; a signal that leaves them is refused
    slew_limit     bound of the rate (unit/s): a jump that is held is spread along a straight line over as many samples as it takes;
                   a signal that exceeds the bound anywhere else is refused
    axis           index of the axis that moves, the others rest at `idle` (default: all axes move alike)
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.records.excitation.broadband_signals import multisine, multisine_lines, sweep
from hyst_control.records.excitation.identification_signals import diagnostic, hampi_identification, joined, mhl_identification
from hyst_control.records.excitation.parameters import described
from hyst_control.records.excitation.signal_size import check_size, is_shown, max_samples, number
from hyst_control.records.excitation.waveforms import (
    cosine_ramp,
    decaying_sine,
    loops,
    multi_frequency,
    raster,
    rest,
    sine,
    spiral,
    staircase,
    step,
    steps,
    triangle,
)

__all__ = [
    "KINDS", "build", "cosine_ramp", "decaying_sine", "diagnostic", "hampi_identification", "loops", "mhl_identification",
    "multi_frequency", "multisine", "multisine_lines", "raster", "rest", "sequence", "sine", "spiral", "staircase", "step", "steps",
    "sweep", "triangle",
]  # fmt: skip


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
        number(given.pop(key, default), key) for key, default in (("lower", -np.inf), ("upper", np.inf), ("slew_limit", np.inf))
    )
    axis, idle = given.pop("axis", None), number(given.pop("idle", 0.0), "idle")
    function = KINDS[kind]
    every = inspect.signature(function).parameters
    known = {key: parameter for key, parameter in every.items() if key not in ("sample_time", "axes")}
    for key in given:
        if key not in known:
            raise InputError(
                f"{kind}: {key}: no such parameter, must be one of {', '.join([*known, 'lower', 'upper', 'slew_limit', 'axis'])}"
            )
    for key, parameter in known.items():
        if parameter.default is inspect.Parameter.empty and key not in given:
            raise InputError(f"{kind}: {key}: is missing")
    given = {key: _usable(kind, key, value, str(known[key].annotation)) for key, value in given.items()}
    for key, value in given.items():
        _check_frequency(kind, key, value, sample_time)
    if given.get("lowest", -np.inf) > (highest := given.get("highest", np.inf)):
        raise InputError(f"{kind}: lowest: must be <= highest ({highest:g}), got {given['lowest']:g}: exchange them")
    if "duration" in given and given["duration"] / sample_time > max_samples():
        raise InputError(f"{kind}: duration: {given['duration']} s at {sample_time:g} s a sample is too long for memory")
    extra = {"axes": axes} if "axes" in every else {}
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # of values that are refused below
            rows = np.asarray(function(sample_time=sample_time, **extra, **given), dtype=float)
    except InputError as error:
        raise InputError(f"{kind}: {error}") from None
    except (TypeError, ValueError, OverflowError, ZeroDivisionError, IndexError, MemoryError) as error:
        raise InputError(f"{kind}: its parameters are not the numbers and lists it needs ({error})") from None
    if rows.ndim == 1:
        if rows.size * axes > max_samples():
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


def _usable(kind: str, key: str, value: Any, declared: str) -> Any:
    """A parameter's value, checked to be the number, whole number or list of numbers that its kind declares."""
    if declared.startswith("Sequence[float]") and value is not None:
        if not isinstance(value, (list, tuple, np.ndarray)):
            raise InputError(f"{kind}: {key}: must be a list of numbers, such as [1, 2], got {value!r}")
        return [number(each, f"{kind}: {key}") for each in value]
    if declared == "float":
        return number(value, f"{kind}: {key}")
    if declared == "int":
        if not number(value, f"{kind}: {key}").is_integer() or value < 0:
            raise InputError(f"{kind}: {key}: must be a whole number >= 0, got {value!r}")
        return int(value)
    return value


def _check_frequency(kind: str, key: str, value: Any, sample_time: float) -> None:
    """Refuse a frequency below 0, or one that the sample rate cannot show: it would appear as another one."""
    if described(kind, key).unit != "Hz":
        return
    for frequency in np.atleast_1d(value):
        if frequency < 0 and kind != "spiral":  # which turns the other way then
            raise InputError(f"{kind}: {key}: must be >= 0 Hz, got {frequency:g} Hz: give it without its sign")
        if key not in LIMITED_BY_RATE and not is_shown(frequency, sample_time):
            raise InputError(
                f"{kind}: {key}: must be below half the sample rate, {0.5 / sample_time:g} Hz, got {frequency:g} Hz: lower it, or raise "
                "the rate"
            )


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


def sequence(sample_time: float, axes: int, parts: Sequence[Mapping[str, Any]], join: float = 0.0) -> Array:
    """Signals one after the other, rows (N, A).

    Parameters
    ----------
    sample_time, axes, parts, join
        Sample time, s, number of axes, and as `records.excitation.parameters` declares them.

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
        check_size(sum(each.size for each in rows) + following.size + number(join, "join") * axes / sample_time)
        if rows and join:
            rows.append(joined(sample_time, rows[-1][-1], following[0], join))
        rows.append(following)
    return np.concatenate(rows)


CURVES = (rest, sine, cosine_ramp, decaying_sine, multi_frequency, triangle, staircase, step, steps, loops)
OTHERS = (multisine, sweep, spiral, raster, sequence, hampi_identification, mhl_identification, diagnostic)
LIMITED_BY_RATE = ("band", "highest")
"""Frequencies that their kinds lower to what the sample rate can show."""
KINDS: dict[str, Callable[..., Array]] = {function.__name__: function for function in (*CURVES, *OTHERS)}
"""Every kind of signal by name."""
