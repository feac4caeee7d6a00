# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A vibration whose phase wanders: a hump in a residual's spectrum that has no waveform, separated from what follows the command."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.ndimage import uniform_filter1d

from hyst_control.base.arrays import Array
from hyst_control.base.simplex import lowest
from hyst_control.diagnose.configuration import CONFIGURATION, HumpSettings
from hyst_control.diagnose.evidence import HumpEvidence

HANN_BINS = 35.0 / 18.0  # Bins of a Hann window's spectrum per independent one: N Σw⁴ / (Σw²)²
NORMAL_95 = 1.645  # 95 % quantile of the normal distribution: half a 90 % interval
OUTSIDE = 1e300  # Misfit outside the range: finite, since the simplex subtracts misfits
MAX_LOG = 300.0  # Logarithm up to which the floor, height and width of a trial are taken: their products are finite
SHAPES = ("tone", "mode")  # Sources of a hump: a tone whose phase wanders, or a mode excited by white noise


@dataclass(frozen=True)
class Hump:
    """White noise and a hump, S = floor (1 + height · shape), all in bins and in the power of a residual's spectrum."""

    floor: float  # Power of the white noise
    height: float  # Of the hump over the floor
    frequency: float  # Of its top, bins
    half_width: float  # Half its width at half its height, bins
    shape: str  # One of `SHAPES`

    def spectrum(self, at: Array) -> Array:
        """Power (K,) at frequencies (K,) in bins."""
        if self.shape == "tone":
            form = 1.0 / (1.0 + ((at - self.frequency) / self.half_width) ** 2)
        else:
            damped = (2.0 * self.half_width * self.frequency) ** 2
            form = damped / ((self.frequency**2 - at**2) ** 2 + damped * (at / self.frequency) ** 2)
        return np.asarray(self.floor * (1.0 + self.height * form), dtype=np.float64)

    def misfit(self, power: Array, at: Array) -> float:
        """Whittle's negative logarithm of the likelihood of powers (K,), each bin for itself, nats."""
        spectrum = self.spectrum(at)
        return float(np.sum(np.log(spectrum) + power / spectrum))


def random_vibration(
    residual: Annotated[Array, "N"],
    in_noise: Annotated[Array, "N"],
    commands: Annotated[Array, "N A"],
    simulated: Annotated[Array, "N"],
    sample_time: float,
    settings: HumpSettings = CONFIGURATION.hump,
) -> HumpEvidence | None:
    """Measure a hump in the spectrum of a residual by Whittle's likelihood."""
    count = len(residual)
    whole = np.abs(_windowed(residual)) ** 2
    every = np.arange(len(whole), dtype=float)
    power, at = whole[settings.lowest_bins :], every[settings.lowest_bins :]
    starts = _starts(power, at, settings)
    if not starts:
        return None
    hump = min((_fitted(start, power, at, settings) for start in starts), key=lambda one: one.misfit(power, at))
    spectrum = hump.spectrum(at)
    share = 1.0 - hump.floor / spectrum
    colored = share > settings.colored_share
    gain = float(np.sum(np.log(hump.floor) + power / hump.floor)) - hump.misfit(power, at)
    raw = np.abs(np.fft.rfft(in_noise - in_noise.mean())[settings.lowest_bins : settings.lowest_bins + len(power)]) ** 2 / count
    rms = float(np.sqrt(2.0 * np.sum(raw * share) / count))
    above = spectrum - hump.floor
    spread = 0.5 * NORMAL_95 * float(np.sqrt(np.sum(above**2)) / np.sum(above))
    off = NORMAL_95 * _deviation(hump, power, at)
    width = 1.0 / (count * sample_time)
    plausible = (
        1.05 * settings.min_half_width < hump.half_width < 0.95 * settings.max_half_width * hump.frequency
        and _has_shape(power[colored], at[colored], hump, settings)
        and _is_steady(residual, commands[:, 0], hump, settings)
        and _followed(residual, commands, simulated, hump) < settings.followed
    )
    return HumpEvidence(
        hump.frequency * width,
        ((hump.frequency - off) * width, (hump.frequency + off) * width),
        2.0 * hump.half_width * width,
        rms,
        (rms * float(np.exp(-spread)), rms * float(np.exp(spread))),
        gain,
        hump.misfit(whole, every),
        float(np.mean(whole * hump.floor / hump.spectrum(every))),
        plausible,
    )


def _windowed(values: Array) -> Array:
    """Spectrum (K,) of a signal under a Hann window: the mean power of white noise is its variance."""
    count = len(values)
    window = np.sqrt(8.0 / 3.0 / count) * np.hanning(count)
    return np.asarray(np.fft.rfft(values * window)[: count // 2])


def _starts(power: Array, at: Array, settings: HumpSettings) -> list[Hump]:
    """Humps to begin fits at: where a running mean exceeds the white noise most, for several widths; none if chance explains it."""
    floor = float(np.median(power)) / np.log(2.0)
    found: list[tuple[float, Hump]] = []
    half_width = settings.min_half_width
    while half_width < settings.max_half_width * at[-1]:
        bins = int(2.0 * half_width) + 1
        mean = uniform_filter1d(power, bins) / floor
        mean[at < half_width / settings.max_half_width] = 0.0
        top = int(np.argmax(mean))
        gain = bins * (mean[top] - 1.0 - np.log(max(mean[top], 1.0))) / HANN_BINS
        if gain > settings.min_gain:
            height = max(2.0 * (float(mean[top]) - 1.0), 1.0)
            found.append((gain, Hump(floor, height, float(at[top]), 0.7 * half_width, SHAPES[0])))
        half_width *= 1.6
    best = [hump for _, hump in sorted(found, key=lambda item: -item[0])[: settings.starts]]
    return [Hump(one.floor, one.height, one.frequency, one.half_width, shape) for one in best for shape in SHAPES]


def _fitted(start: Hump, power: Array, at: Array, settings: HumpSettings) -> Hump:
    """The hump of greatest likelihood near a start."""
    most = settings.max_half_width

    def of(x: Array) -> Hump:
        floor, height, half_width = np.exp(np.clip(x[[0, 1, 3]], -MAX_LOG, MAX_LOG))  # a search may try any number
        return Hump(float(floor), float(height), float(x[2]), float(half_width), start.shape)

    def misfit(x: Array) -> float:
        hump = of(x)
        inside = at[0] <= x[2] <= at[-1] and settings.min_half_width <= hump.half_width <= most * x[2]
        return hump.misfit(power, at) if inside else OUTSIDE

    half_width = float(np.clip(start.half_width, 1.05 * settings.min_half_width, 0.95 * most * start.frequency))
    first = np.array([np.log(start.floor), np.log(start.height), start.frequency, np.log(half_width)])
    simplex = first + np.vstack([np.zeros(4), np.diag([0.2, 0.4, 0.4 * half_width, 0.3])])
    return of(lowest(misfit, simplex, 1e-3, 1e-2)[0])


def _deviation(hump: Hump, power: Array, at: Array) -> float:
    """Standard deviation of the frequency, bins: from the curvature of the misfit, since a shift changes nothing else of a hump."""
    step = 0.2 * hump.half_width
    moved = [Hump(hump.floor, hump.height, hump.frequency + sign * step, hump.half_width, hump.shape) for sign in (-1.0, 0.0, 1.0)]
    below, here, above = (one.misfit(power, at) for one in moved)
    return float(np.sqrt(HANN_BINS * step**2 / max(below - 2.0 * here + above, 1e-9)))


def _has_shape(power: Array, at: Array, hump: Hump, settings: HumpSettings) -> bool:
    """True where the medians of bands, which no line moves, are on the hump but for chance and what a shape may be off."""
    apart = (at - hump.frequency) / hump.half_width
    edges = np.geomspace(settings.narrowest_band, max(float(np.max(np.abs(apart), initial=0.0)), 1.0) * 1.01, settings.bands)
    scatter = []
    for low, high in zip((0.0, *edges[:-1]), edges, strict=True):
        for side in (-1.0, 1.0):
            band = (side * apart >= low) & (side * apart < high)
            if np.count_nonzero(band) >= 3:
                level = float(np.median(power[band] / hump.spectrum(at[band]))) / np.log(2.0)
                chance = 1.5 * HANN_BINS / np.count_nonzero(band)  # a median knows less than a mean
                scatter.append(np.log(level) ** 2 / (settings.shape_misfit**2 + chance))
    return len(scatter) >= settings.min_bands and float(np.mean(scatter)) < 1.0


def _is_steady(residual: Array, command: Array, hump: Hump, settings: HumpSettings) -> bool:
    """True where the hump is about as strong where the command moves most as where it moves least."""
    count = len(residual)
    segments = min(settings.segments, int(2.0 * hump.half_width))  # more are not independent of each other
    if segments < settings.min_segments:
        return True
    spectrum = np.fft.rfft(residual)
    spectrum[np.abs(np.arange(len(spectrum)) - hump.frequency) > 2.0 * hump.half_width] = 0.0
    inside = np.fft.irfft(spectrum, count)
    length = count // segments
    energy = np.var(inside[: segments * length].reshape(segments, length), axis=1)
    activity = np.mean(np.abs(np.diff(command, append=command[-1]))[: segments * length].reshape(segments, length), axis=1)
    order = np.argsort(activity, kind="stable")
    third = segments // 3
    return bool(np.mean(energy[order[-third:]]) < settings.motion_ratio * np.mean(energy[order[:third]]))


def _followed(residual: Array, commands: Array, simulated: Array, hump: Hump) -> float:
    """Share of the hump that modes of its frequency and width make of the commands, of the simulation, and of its powers."""
    count = len(_windowed(residual))
    at = np.arange(count, dtype=float)
    near = np.abs(at - hump.frequency) < 3.0 * hump.half_width
    centered = (simulated - simulated.mean()) / max(float(np.ptp(simulated)), 1e-300)
    apart = (at[near] - hump.frequency) / hump.half_width
    # As many columns as a quarter of the independent bins leaves room for.
    most = max(int(np.count_nonzero(near) / HANN_BINS / 4.0), 2)
    driving = (*commands.T, simulated, centered**2, centered**3)
    columns = [_windowed(one)[near] / (1.0 + 1j * apart) ** order for one in driving for order in (0, 1)][:most]
    design = np.column_stack([column / max(float(np.linalg.norm(column)), 1e-300) for column in columns])
    target = _windowed(residual)[near]
    weight = 1.0 / np.sqrt(hump.spectrum(at[near]))
    solution, *_ = np.linalg.lstsq(design * weight[:, None], target * weight, rcond=1e-9)
    left = float(np.sum(np.abs((target - design @ solution) * weight) ** 2) / np.sum(np.abs(target * weight) ** 2))
    free = max(1.0 - HANN_BINS * len(columns) / np.count_nonzero(near), 0.05)
    return float(1.0 - left / free)
