# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Excitations from which a model is identified or a gap diagnosed: the published ones and one of our own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.excitation.broadband_signals import multisine, sweep
from hyst_control.records.excitation.signal_size import check_size, is_shown, number
from hyst_control.records.excitation.waveforms import cosine_ramp, loops, rest, staircase, triangle


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
    """
    frequencies = [float(f) for f in frequencies if is_shown(f, sample_time)]  # of those by default at a low rate
    longest = [1.0 / number(quasi_static, "quasi_static"), *(max(3.0 / f, time) for f in frequencies)]
    check_size(2 * (sum(map(abs, longest)) + len(longest) * abs(number(pause, "pause"))) / sample_time)
    pieces = [rest(sample_time, pause), rest(sample_time, 0.15, step_height), rest(sample_time, 0.1)]
    for share in (1.0, 0.6):
        pieces += [loops(sample_time, quasi_static, share * peak, 1), rest(sample_time, pause)]
    for index, frequency in enumerate(sorted(frequencies)):
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
    """
    check_size((5.0 / number(slow, "slow") + 3 * number(sweep_time, "sweep_time")) * axes**2 / sample_time)
    small = 0.1 * peak
    centre = 0.5 * peak
    highest, full = min(highest, 0.4 / sample_time), min(100.0, 0.4 / sample_time)
    whole_sweep = sweep(sample_time, 1.0, full, centre, centre, sweep_time, False)
    own = np.concatenate(
        [
            rest(sample_time, 0.02),
            rest(sample_time, 0.1, step_height),
            rest(sample_time, 0.1),
            *(loops(sample_time, slow, share * peak, 1) for share in (1.0, 0.8, 0.6, 0.4, 0.2)),
            rest(sample_time, 0.05),
            whole_sweep,
            cosine_ramp(sample_time, float(whole_sweep[-1]), centre - small, 0.05),
            rest(sample_time, 0.05, centre - small),
            sweep(sample_time, 20.0, highest, small, centre, sweep_time, True),
        ]
    )
    own = np.concatenate([own, cosine_ramp(sample_time, own[-1], 0.0, 0.1), rest(sample_time, 0.05)])
    return _in_turn(own, axes, 0.0)


def diagnostic(
    sample_time: float, lowest: float, highest: float, axes: int, duration: float = 1.5, band: float = 1000.0, seed: int = 0
) -> Array:
    """Experiments that show every effect of the catalogue, within `lowest` to `highest`.

    Rest; a step that is held (creep, drift); a small and a large multisine of two equal periods each, odd with detection lines and
    none near the mains (linear, even, odd, noise); a triangle (static curve, velocity sign); fast steps (slew, delay); rest. The
    axes move with separate phases; in the triangle and the steps they move in turn, so that cross-coupling shows.
    """
    check_size(2 * number(duration, "duration") * axes / sample_time)
    span, centre = highest - lowest, 0.5 * (lowest + highest)
    unit = duration / 15.0
    period = max(round(2 * unit / sample_time), 40) * sample_time
    band = min(band, 0.35 / sample_time)

    def everywhere(column: Array) -> Array:
        return np.repeat(column[:, None], axes, axis=1)

    small = multisine(sample_time, period, 1.0 / period, band, 0.03 * span, axes, centre, 2, True, 4, True, seed)
    large = multisine(sample_time, period, 1.0 / period, 0.3 * band, 0.13 * span, axes, centre, 2, True, 4, True, seed + 1)
    large = np.clip(large, lowest, highest)
    share = 1.0 / axes
    levels = centre + span * np.array([0.3, -0.3, 0.15, -0.15, 0.4, -0.4])
    pieces = [
        everywhere(rest(sample_time, unit, lowest)),
        everywhere(rest(sample_time, 2.5 * unit, lowest + 0.6 * span)),
        joined(sample_time, np.full(axes, lowest + 0.6 * span), small[0], 0.25 * unit),
        small,
        joined(sample_time, small[-1], large[0], 0.25 * unit),
        large,
        joined(sample_time, large[-1], np.full(axes, lowest), 0.25 * unit),
        _in_turn(triangle(sample_time, 1.0 / (1.25 * unit * share), 0.5 * span, centre, 2.5 * unit * share), axes, lowest),
        _in_turn(staircase(sample_time, levels, 0.2 * unit * share), axes, centre),
        everywhere(rest(sample_time, unit, lowest)),
    ]
    return np.concatenate(pieces)


def _in_turn(column: Array, axes: int, idle: float) -> Array:
    """Rows in which one axis after the other moves while the others rest at `idle`."""
    rows = np.full((axes, len(column), axes), float(idle))
    for axis in range(axes):
        rows[axis, :, axis] = column
    return rows.reshape(-1, axes)


def joined(sample_time: float, start: Array, stop: Array, duration: float) -> Array:
    """Ramps of all axes from one position (A,) to another one."""
    return np.stack([cosine_ramp(sample_time, a, b, duration) for a, b in zip(start, stop, strict=True)], axis=1)
