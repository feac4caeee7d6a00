"""Checks that fit nothing: repeated samples, the lattice of a converter, lines of the mains, noise above what the model states.

They find transport and noise effects nearly always, and come first: fitted candidates would absorb them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import periodogram

from hyst_control.chain.stage import Array
from hyst_control.diagnose.noise_floor import noise_of
from hyst_control.diagnose.problem import Problem

MAINS = (50.0, 60.0)
EXCESS = 1.15
"""How far the noise must exceed the stated one: it is never stated better."""

BY_CHANCE = 3.0
"""How many times as often as by chance neighbours must coincide to be held samples."""

STANDS_OUT = 7.0
"""Robust standard deviations by which a single sample stands out of its neighbours (by chance: 1 in 4e11)."""

FEW_OUTLIERS, MANY_OUTLIERS = 3, 0.03
"""Count from which, and share of the samples up to which, those that stand out are outliers."""

LINE_RATIO = 40.0
"""How far a line stands out of the spectrum around it, in power, to be a suggestion (chance alone: 1 in e^40 per bin)."""

HARMONIC_WIDTHS = (0.0, 0.05, 0.15)
"""How near a harmonic counts as one, in fundamentals: amplitudes that change spread it. The first that holds the command counts."""


@dataclass(frozen=True)
class Finding:
    """Something that a check found on an axis: effect, parameter values and their 90 % intervals, and how sure (nats)."""

    name: str
    axis: int
    values: dict[str, float]
    ci90: dict[str, tuple[float, float]]
    rms: float
    evidence: float


def lattice_of(values: Array) -> float:
    """The step of the lattice that all values lie on, 0 when there is none."""
    levels = np.unique(values)
    if len(levels) < 4 or len(levels) > 0.7 * len(values):
        return 0.0
    steps = np.diff(levels)
    step = float(np.median(steps[steps <= 1.5 * steps.min()]))
    if step <= 0 or step < 1e-9 * np.ptp(levels):
        return 0.0
    step = float(np.ptp(levels) / np.rint(np.ptp(levels) / step))
    off = np.abs((levels - levels[0]) / step - np.rint((levels - levels[0]) / step))
    return step if np.mean(off < 1e-3) > 0.999 else 0.0


def repeated_samples(values: Array, step: float, sigma: float) -> tuple[float, int]:
    """Share of samples that repeat the one before exactly beyond what a lattice explains, and of how many it was counted."""
    if step > 0:
        # On a lattice neighbours coincide by chance: only where the signal moves by several steps a sample does a repeat say much.
        smooth = np.convolve(values, np.ones(5) / 5, "same")
        moving = np.abs(np.gradient(smooth)) > 6.0 * step
        moving = np.convolve(moving, np.ones(7), "same") == 7.0  # before a step nothing moves yet, though the smoothed signal does
    else:
        moving = np.ones(len(values), bool)
    moved = np.diff(values, prepend=np.nan)
    count = int(moving.sum())
    if count < 200:
        return 0.0, count
    share = float(np.mean(moved[moving] == 0.0))
    if step > 0:  # by chance a sample repeats the one before as often as it is one step above, or one below
        share -= 0.5 * float(np.mean(np.abs(np.abs(moved[moving]) - step) < 0.01 * step))
        return max(share, 0.0), count
    if share < BY_CHANCE * _chance(values):
        return 0.0, count  # numbers of few digits coincide now and then
    if sigma < 1e-12 * max(np.ptp(values), 1e-300):
        return 0.0, count  # a noise-free record at rest repeats itself
    return share, count


def _chance(values: Array) -> float:
    """Share of neighbours that coincide by chance in numbers that are rounded to the smallest step that occurs."""
    steps = np.abs(np.diff(values))
    if not steps.any():
        return 1.0
    around = np.sqrt(np.convolve(steps**2, np.ones(11) / 11, "same"))
    return float(np.mean(np.minimum(steps[steps > 0].min() / np.maximum(around, 1e-300), 1.0)))


def findings(problem: Problem, residuals: Array) -> list[Finding]:
    """Held samples and lattice of a problem. residuals (M, A): measurement minus simulation in the measurement's unit."""
    found: list[Finding] = []
    for axis in range(len(problem.model.axes)):
        values = np.concatenate([piece.counted(piece.measurement)[:, axis] for piece in problem.pieces])
        noise = noise_of([residuals[:, axis]])
        step = lattice_of(values)
        share, count = repeated_samples(values, step, noise)
        if share * count > 10 and share > (0.01 if step else 0.002):
            spread = 1.645 * np.sqrt(share * (1 - share) / count)
            moved = np.abs(np.diff(values))
            found.append(
                Finding(
                    "held_samples",
                    axis,
                    {"fraction": share},
                    {"fraction": (share - spread, share + spread)},
                    float(np.sqrt(share * np.mean(moved**2))),
                    share * count,
                )
            )
        if step > 0 and step / np.sqrt(12.0) > 0.2 * noise and not _has_quantization(problem):
            found.append(
                Finding(
                    "quantization",
                    axis,
                    {"step": step},
                    {"step": (step * 0.999, step * 1.001)},
                    step / np.sqrt(12.0),
                    float(len(values)),
                )
            )
    return found


def excess_noise(noise: float, stated: float, others: Sequence[Finding], axis: int, count: int) -> Finding | None:
    """White noise beyond what the model states: noise as measured (upper spectrum), without what other findings bring in."""
    if stated <= 0 or any(finding.name == "held_samples" and finding.axis == axis for finding in others):
        return None
    bare = float(np.sqrt(max(noise**2 - sum(finding.rms**2 for finding in others if finding.axis == axis), 0.0)))
    if not bare > EXCESS * stated:
        return None
    rms = float(np.sqrt(bare**2 - stated**2))
    bins = 0.19 * count
    error = 1.645 * bare**2 / rms / np.sqrt(bins)
    evidence = bins * (np.log(stated / bare) + 0.5 * (bare / stated) ** 2 - 0.5)
    return Finding("sensor_noise", axis, {"rms": rms}, {"rms": (max(rms - error, 0.0), rms + error)}, rms, float(evidence))


def outliers(residual: Array) -> tuple[int, float]:
    """How many single samples of a residual (N,) stand out of their neighbours as no white noise does, and the rms of all that they bring.

    Against the mean of both neighbours, in robust standard deviations: what is smooth, steps or falls with frequency stands out little.
    """
    inner = residual[1:-1] - 0.5 * (residual[:-2] + residual[2:])
    scale = 1.4826 * float(np.median(np.abs(inner - np.median(inner))))
    size = np.pad(np.abs(inner), 1)
    apart = (size > STANDS_OUT * scale) & (size >= np.roll(size, 1)) & (size >= np.roll(size, -1))
    return int(apart.sum()), float(np.sqrt(np.sum(size[apart] ** 2) / len(residual)))


def lines(problem: Problem, unexplained: Array) -> dict[str, list[float]]:
    """Frequencies (Hz) of `mains_hum` and `vibration` at which the residual's spectrum has a narrow line.

    unexplained (M,): residual without what the scattered coefficients explain, of all rows. A line of the command's is none,
    nor a harmonic of a command that is nearly one sine: any nonlinearity has those.
    """
    suggestions: dict[str, list[float]] = {"mains_hum": [], "vibration": []}
    rows = problem.rows(unexplained)
    commands = [piece.counted(piece.command) for piece in problem.pieces]
    longest = max(commands, key=len)
    begin = 0
    for command in commands:
        count = len(command)
        if command is longest:
            break
        begin += count
    rate = 1.0 / problem.sample_time
    for axis in range(rows.shape[1]):
        signal = rows[begin : begin + count, axis]
        frequency, power = periodogram(signal, rate, "hann")
        _, driven = periodogram(longest[:, axis], rate, "hann", detrend="linear")
        width = rate / count
        ratio = power / np.maximum(_background(power), 1e-300)
        for mains in MAINS:
            near = np.abs(frequency - mains) < max(0.7, 1.2 * width)
            if near.any() and ratio[near].max(initial=0.0) > LINE_RATIO / 2:
                suggestions["mains_hum"].append(mains)
        sure = ratio > LINE_RATIO
        sure &= (frequency > 4 * width) & ~(driven > 1e-3 * driven.max()) & ~_harmonics(frequency, driven)
        for mains in MAINS:
            for harmonic in (1, 2, 3, 5, 7):
                sure &= np.abs(frequency - harmonic * mains) > max(0.7, 2.0 * width)
        if sure.any():
            top = int(np.argmax(np.where(sure, power, 0.0)))
            suggestions["vibration"].append(_peak(frequency, power, top))
    return {name: _distinct(values, 2.0 / (count * problem.sample_time)) for name, values in suggestions.items()}


def _harmonics(frequency: Array, driven: Array) -> Array:
    """Which frequencies are near a harmonic of a command whose power is near those of one fundamental."""
    fundamental = frequency[int(np.argmax(driven * frequency**2))]  # of the rate: a mean that wanders is none
    if fundamental < 10.0 * frequency[1]:  # not resolved: everything would be near a harmonic
        return np.zeros(len(frequency), bool)
    order = np.round(frequency / fundamental)
    above = driven[frequency > 0.5 * fundamental].sum()
    for width in HARMONIC_WIDTHS:
        near = (order >= 1) & (np.abs(frequency - order * fundamental) < max(2.5 * frequency[1], width * fundamental))
        if driven[near].sum() > 0.9 * above:
            return near
    return np.zeros(len(frequency), bool)


def _background(power: Array, reach: int = 40) -> Array:
    """Mean power around every bin, from the median, which no line moves."""
    padded = np.pad(power, reach, mode="reflect") if len(power) > reach + 1 else np.pad(power, reach, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
    return np.median(windows, axis=1) / np.log(2.0)


def _peak(frequency: Array, power: Array, top: int) -> float:
    around = slice(max(top - 1, 0), top + 2)
    return float(np.sum(frequency[around] * power[around]) / np.sum(power[around]))


def _distinct(values: Sequence[float], width: float) -> list[float]:
    kept: list[float] = []
    for value in values:
        if all(abs(value - other) > width for other in kept):
            kept.append(value)
    return kept


def _has_quantization(problem: Problem) -> bool:
    return any(stage.name == "quantization" for stage in problem.model.chain.stages)
