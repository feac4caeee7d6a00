# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Signals of one axis with energy over a whole band: multisines and sweeps."""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array, Integers
from hyst_control.base.errors import InputError
from hyst_control.records.excitation.signal_size import check_size, number, sample_times


def multisine_lines(
    period: float,
    lower_frequency: float,
    upper_frequency: float,
    odd: bool = True,
    detection: int = 0,
    avoid_mains: bool = False,
    seed: int = 0,
) -> Integers:
    """Harmonics of 1 / period that a multisine excites."""
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
    """
    check_size(max(number(period, "period"), period * number(periods, "periods")) * axes / sample_time)
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
    """Frequency sweep offset - amplitude cos φ(t), which begins at its lowest point."""
    time = sample_times(duration, sample_time)
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
