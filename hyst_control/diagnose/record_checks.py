"""Checks that fit nothing: repeated samples, the lattice of a converter, lines of the mains, noise above what the model states.

They find transport and noise effects nearly always, and come first: fitted candidates would absorb them. They measure; the policy
says which of them found something.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.signal import fftconvolve, periodogram

from hyst_control.chain.stage import Array, Sampling
from hyst_control.diagnose.configuration import CONFIGURATION, CheckSettings, NoiseSettings
from hyst_control.diagnose.evidence import DistortionEvidence, Finding, RecordEvidence
from hyst_control.diagnose.noise_floor import noise_of
from hyst_control.diagnose.problem import Problem
from hyst_control.effects import EFFECTS
from hyst_control.effects.effect import Effect, RecordCheck
from hyst_control.records.quantization_step import quantization_step

NORMAL_95 = 1.645
"""95 % quantile of the normal distribution: half a 90 % interval."""
STANDS = 4.0
"""Noise rms within which a measurement stands on one level."""
PASSED = 10.0
"""Times as far as these the simulation must pass it meanwhile."""
MOST_LEVELS = 1e6
"""Levels up to which a range is resolved: beyond, the noise is that of a simulation without any."""


def effect_found_by(check: RecordCheck) -> Effect | None:
    """Effect of the catalogue that a check finds.

    Parameters
    ----------
    check : RecordCheck
        Check of a record.

    Returns
    -------
    Effect or None
        The first that names the check, None where there is none.

    """
    return next((effect for effect in EFFECTS.values() if check in (effect.record_check, effect.random_check)), None)


def lattice_of(values: Array, settings: CheckSettings = CONFIGURATION.checks) -> float:
    """Step of the lattice that all values lie on.

    Parameters
    ----------
    values : ndarray, shape (N,)
        Any unit.
    settings : CheckSettings
        Values of the configuration.

    Returns
    -------
    float
        In the values' unit, 0 where there is no lattice.

    """
    return quantization_step(
        values,
        fewest=settings.lattice_levels,
        crowding=settings.lattice_crowding,
        spread=settings.lattice_spread,
        off=settings.lattice_off,
        share=settings.lattice_share,
    )


def repeated_samples(values: Array, step: float, sigma: float, settings: CheckSettings = CONFIGURATION.checks) -> tuple[float, int]:
    """Share of samples that repeat the one before exactly, beyond what a lattice explains.

    Parameters
    ----------
    values : ndarray, shape (N,)
        Measurement.
    step : float
        Step of its lattice, 0 without.
    sigma : float
        Its noise (rms).
    settings : CheckSettings
        Values of the configuration.

    Returns
    -------
    share : float
    count : int
        Samples that it was counted on.

    """
    if step > 0:
        # On a lattice neighbors coincide by chance: only where the signal moves by several steps a sample does a repeat say much.
        smooth = np.convolve(values, np.ones(settings.repeat_smoothing) / settings.repeat_smoothing, "same")
        moving = np.abs(np.gradient(smooth)) > settings.repeat_motion * step
        # Before a step nothing moves yet, though the smoothed signal does.
        moving = np.convolve(moving, np.ones(settings.repeat_reach), "same") == settings.repeat_reach
    else:
        moving = np.ones(len(values), bool)
    moved = np.diff(values, prepend=np.nan)
    count = int(moving.sum())
    if count < settings.repeat_samples:
        return 0.0, count
    share = float(np.mean(moved[moving] == 0.0))
    if step > 0:  # by chance a sample repeats the one before as often as it is one step above, or one below
        share -= 0.5 * float(np.mean(np.abs(np.abs(moved[moving]) - step) < 0.01 * step))
        return max(share, 0.0), count
    if share < settings.repeat_chance * _chance(values, settings.repeat_window):
        return 0.0, count  # numbers of few digits coincide now and then
    if sigma < 1e-12 * max(np.ptp(values), 1e-300):
        return 0.0, count  # a noise-free record at rest repeats itself
    return share, count


def stuck_stretches(pieces: Sequence[tuple[Array, Array]], step: float, sigma: float) -> int:
    """Count stretches that stand on one and the same value while the command moves.

    Samples that are held at random stand on a value each; a sensor that does not follow about some level, or has reached its end,
    comes back to the same value again and again. No noise does.

    Parameters
    ----------
    pieces : sequence of (ndarray, ndarray)
        Command (N,) and measurement (N,) of each stretch of record.
    step : float
        Step of the measurement's lattice, 0 without: on one all values come back.
    sigma : float
        Noise of the measurement (rms): values of a simulation without any come back too.

    Returns
    -------
    int
        Stretches of at least two samples on the value that has most of them; 0 if these are not most of all repeated samples.
    """
    if step > 0 or sigma < 1e-12 * max((float(np.ptp(values)) for _, values in pieces), default=0.0):
        return 0
    stretches: Counter[float] = Counter()
    repeats: Counter[float] = Counter()
    for command, values in pieces:
        same = np.diff(values) == 0.0
        edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if np.ptp(command[begin : end + 1]) > 0.0:
                stretches[float(values[begin])] += 1
                repeats[float(values[begin])] += int(end - begin)
    if not repeats:
        return 0
    value, count = repeats.most_common(1)[0]
    return stretches[value] if 2 * count > repeats.total() else 0


def level_crossings(pieces: Sequence[tuple[Array, Array]], step: float, sigma: float) -> int:
    """Count passages through one level on which the measurement stands but for its noise, while the simulation moves on.

    A sensor that does not follow about some level lets go on the other side of it. Play and the end of a range let go on the side that the
    measurement came from. Friction holds at any level, and what a low-pass takes off is missing at any level: what the next level
    has is taken off.

    Parameters
    ----------
    pieces : sequence of (ndarray, ndarray)
        Simulation (N,) and measurement (N,) of each stretch of record.
    step : float
        Step of the measurement's lattice, 0 without: beside noise below it all values stand on levels.
    sigma : float
        Noise of the measurement, rms.

    Returns
    -------
    int
        Passages through the level at which the simulation moves most, less those through the next one; 0 where the noise does not
        resolve the range, or is none.
    """
    reach = STANDS * sigma
    values = np.concatenate([measured for _, measured in pieces])
    lowest, span = float(values.min()), float(np.ptp(values))
    if step > sigma or not PASSED * reach < span < MOST_LEVELS * reach:
        return 0
    moved = np.concatenate([np.abs(np.diff(simulated, prepend=simulated[:1])) for simulated, _ in pieces])
    bins = ((values - lowest) / reach).astype(np.int64)
    travel = np.bincount(bins, moved)
    first = int(np.argmax(travel))
    others = np.where(np.abs(np.arange(len(travel)) - first) > PASSED, travel, 0.0)
    counts = [_passages(pieces, float(np.median(values[bins == one])), reach) for one in (first, int(np.argmax(others)))]
    return max(counts[0] - counts[1], 0)


def _passages(pieces: Sequence[tuple[Array, Array]], level: float, reach: float) -> int:
    """Stretches within `reach` of a level, entered on one side and left on the other, over which the simulation moves much further."""
    found = 0
    for simulated, measured in pieces:
        on_it = np.abs(measured - level) <= reach
        edges = np.flatnonzero(np.diff(np.concatenate([[False], on_it, [False]]).astype(int)))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if begin == 0 or end == len(measured):
                continue
            stands = measured[begin:end]
            if np.count_nonzero(np.diff(stands) == 0.0) > len(stands) // 2 and float(np.median(stands)) != level:
                continue  # samples that were held, each stretch at a value of its own
            before, after = measured[begin - 1] - level, measured[end] - level
            passed = (simulated[end - 1] - simulated[begin]) * np.sign(after)
            found += bool(before * after < 0.0 and passed > 2.0 * PASSED * reach)
    return found


def _chance(values: Array, window: int) -> float:
    """Share of neighbors that coincide by chance in numbers that are rounded to the smallest step that occurs.

    A stretch without a step does not tell how fast the signal moves: many of them are held samples. The stretches around do.
    """
    steps = np.abs(np.diff(values))
    if not steps.any():
        return 1.0
    around = np.sqrt(np.convolve(steps**2, np.ones(window) / window, "same"))
    told = np.flatnonzero(np.convolve(steps > 0.0, np.ones(window), "same") > 0.5)
    around = np.interp(np.arange(len(steps)), told, around[told])
    return float(np.mean(np.minimum(steps[steps > 0].min() / np.maximum(around, 1e-300), 1.0)))


def record_evidence(
    problem: Problem,
    residuals: Array,
    settings: CheckSettings = CONFIGURATION.checks,
    noise_settings: NoiseSettings = CONFIGURATION.noise,
) -> tuple[RecordEvidence, ...]:
    """Measure repeated samples and the lattice of a problem's records.

    Parameters
    ----------
    problem : Problem
        Records and model.
    residuals : ndarray, shape (M, A)
        Measurement minus simulation, measurement unit.
    settings : CheckSettings
        Values of the configuration.
    noise_settings : NoiseSettings
        Values of the configuration.

    Returns
    -------
    tuple of RecordEvidence
        By axis.

    """
    lattice = effect_found_by(RecordCheck.VALUE_LATTICE)
    modelled = lattice is not None and any(stage.name == lattice.name for stage in problem.model.chain.stages)
    found = []
    for axis in range(len(problem.model.axes)):
        values = np.concatenate([piece.counted(piece.measurement)[:, axis] for piece in problem.pieces])
        noise = noise_of([residuals[:, axis]], settings=noise_settings)
        step = lattice_of(values, settings)
        share, count = repeated_samples(values, step, noise, settings)
        rms = float(np.sqrt(share * np.mean(np.abs(np.diff(values)) ** 2)))
        rough = problem.roughness[axis] if problem.roughness else None
        rows = [(piece.counted(piece.command)[:, axis], piece.counted(piece.measurement)[:, axis]) for piece in problem.pieces]
        simulated = np.split(values - residuals[:, axis], np.cumsum([len(measured) for _, measured in rows])[:-1])
        passages = level_crossings([(one, measured) for one, (_, measured) in zip(simulated, rows, strict=True)], step, noise)
        stuck = max(stuck_stretches(rows, step, noise), passages)
        found.append(RecordEvidence(len(values), share, count, rms, step, modelled, noise, roughness=rough, stuck=stuck))
    return tuple(found)


def held_samples(seen: RecordEvidence, axis: int) -> Finding:
    """Finding of repeated samples.

    Parameters
    ----------
    seen : RecordEvidence
        Evidence of the axis.
    axis : int
        Index in the problem.

    Returns
    -------
    Finding
        Its value is the share of the samples.

    """
    share, count = seen.repeated, seen.repeats_counted
    spread = NORMAL_95 * np.sqrt(share * (1 - share) / count)
    interval = (float(share - spread), float(share + spread))
    return Finding(RecordCheck.REPEATED_VALUES, axis, share, interval, seen.repeated_rms, share * count)


def held_at_one_value(seen: RecordEvidence) -> DistortionEvidence:
    """Distortion of held samples that occur at one value of the measurement alone.

    Parameters
    ----------
    seen : RecordEvidence
        Evidence of the axis, with stretches that are stuck.

    Returns
    -------
    DistortionEvidence
        Its change is that from none of them to twice the mean; its statistic what so many stretches on one of as many values as there
        are samples are unlikely by.

    """
    held = effect_found_by(RecordCheck.REPEATED_VALUES)
    name = RecordCheck.REPEATED_VALUES.value if held is None else held.name
    return DistortionEvidence(name, "level", 2.0, (seen.stuck - 1) * float(np.log(seen.samples)), 1.0)


def rounding(seen: RecordEvidence, axis: int) -> Finding:
    """Finding of a lattice of values.

    Parameters
    ----------
    seen : RecordEvidence
        Evidence of the axis.
    axis : int
        Index in the problem.

    Returns
    -------
    Finding
        Its value is the step, measurement unit.

    """
    step = seen.step
    interval = (step * 0.999, step * 1.001)
    return Finding(RecordCheck.VALUE_LATTICE, axis, step, interval, float(step / np.sqrt(12.0)), float(seen.samples))


def rounded_command(seen: RecordEvidence, axis: int) -> Finding:
    """Finding of a recorded command that is rough as a rounded one, which the plant did not receive.

    Parameters
    ----------
    seen : RecordEvidence
        Evidence of the axis, with a roughness.
    axis : int
        Index in the problem.

    Returns
    -------
    Finding
        Its value is the step, V: the roughness is uniform over one.

    """
    rough = seen.roughness
    assert rough is not None
    step = float(np.sqrt(12.0)) * rough.rms
    # Variance of the mean square of a uniform variable, and of how much is not known to be missing.
    error = NORMAL_95 * step * float(np.hypot(np.sqrt(0.2 / rough.samples), rough.deviation))
    gain = 0.5 * (rough.coefficient / rough.deviation) ** 2
    return Finding(RecordCheck.COMMAND_LATTICE, axis, step, (step - error, step + error), rough.response, gain)


def excess_noise(noise: float, stated: float, others: Sequence[Finding], axis: int, bins: float, ratio: float) -> Finding | None:
    """White noise beyond what the model states.

    Parameters
    ----------
    noise : float
        As measured in the upper spectrum (rms, measurement unit).
    stated : float
        By the model; where it states none, nothing is in excess.
    others : sequence of Finding
        Findings on the same axis, whose errors are in the measured noise.
    axis : int
        Index in the problem.
    bins : float
        Bins of the spectrum that the noise was read from.
    ratio : float
        Of the noise to the stated one from which it is in excess.

    Returns
    -------
    Finding or None
        Its value is the rms of the excess, measurement unit.

    """
    if stated <= 0:
        return None
    bare = float(np.sqrt(max(noise**2 - sum(finding.rms**2 for finding in others), 0.0)))
    if not bare > ratio * stated:
        return None
    rms = float(np.sqrt(bare**2 - stated**2))
    error = float(NORMAL_95 * bare**2 / rms / np.sqrt(bins))
    gain = bins * (np.log(stated / bare) + 0.5 * (bare / stated) ** 2 - 0.5)
    return Finding(RecordCheck.WHITE_SPECTRUM, axis, rms, (max(rms - error, 0.0), rms + error), rms, float(gain))


def outliers(residual: Array, settings: CheckSettings = CONFIGURATION.checks) -> tuple[int, float]:
    """Single samples of a residual that stand out of their neighbors as no white noise does.

    Against the mean of both neighbors, in robust standard deviations: what is smooth, steps or falls with frequency stands out little.

    Parameters
    ----------
    residual : ndarray, shape (N,)
        Any unit.
    settings : CheckSettings
        Values of the configuration.

    Returns
    -------
    count : int
    rms : float
        Error that they bring to all samples, in the residual's unit.

    """
    inner = residual[1:-1] - 0.5 * (residual[:-2] + residual[2:])
    scale = 1.4826 * float(np.median(np.abs(inner - np.median(inner))))
    size = np.pad(np.abs(inner), 1)
    apart = (size > settings.outlier_deviations * scale) & (size >= np.roll(size, 1)) & (size >= np.roll(size, -1))
    return int(apart.sum()), float(np.sqrt(np.sum(size[apart] ** 2) / len(residual)))


def lines(problem: Problem, unexplained: Array, settings: CheckSettings = CONFIGURATION.checks) -> dict[str, list[float]]:
    """Frequencies at which the residual's spectrum has a narrow line.

    A line of the command's of any axis is none, since the axes couple; nor a harmonic of a command that is nearly one sine: any
    nonlinearity has those.

    Parameters
    ----------
    problem : Problem
        Records and model.
    unexplained : ndarray, shape (M,)
        Residual without what the scattered coefficients explain, of all rows, in units of the noise.
    settings : CheckSettings
        Values of the configuration.

    Returns
    -------
    dict of str to list of float
        By the name of each effect that is fitted at lines, frequencies (Hz): those of the mains, and others; by the name of the one
        that rounds commands, steps (V) of its lattice.

    """
    mains_effect, line_effect = effect_found_by(RecordCheck.MAINS_LINE), effect_found_by(RecordCheck.SPECTRAL_LINE)
    of_mains, others = [], []
    rows = problem.rows(unexplained)
    commands = [piece.counted(piece.command) for piece in problem.pieces]
    index = int(np.argmax([len(command) for command in commands]))
    longest, piece = commands[index], problem.pieces[index]
    begin, count = sum(len(command) for command in commands[:index]), len(longest)
    driving = longest if piece.driven_beside is None else np.hstack([longest, piece.counted(piece.driven_beside)])
    rate = 1.0 / problem.sample_time
    for axis in range(rows.shape[1]):
        signal = rows[begin : begin + count, axis]
        frequency, power = periodogram(signal, rate, "hann")
        spectra = periodogram(driving, rate, "hann", detrend="linear", axis=0)[1].T
        width = rate / count
        ratio = power / np.maximum(background(power, settings.background_bins), 1e-300)
        mains = _mains(mains_effect, problem)
        for fundamental in mains:
            near = np.abs(frequency - fundamental) < max(settings.mains_width, settings.mains_bins * width)
            near |= np.abs(frequency - 2.0 * fundamental) < max(settings.mains_width, settings.mains_bins * width)
            if near.any() and ratio[near].max(initial=0.0) > settings.mains_ratio:
                of_mains.append(fundamental)
        sure = ratio > settings.line_ratio
        # In a band that is driven evenly, as by a sweep, a line is none of the command's; where the command has lines, it may be.
        sure &= frequency > settings.lowest_line_bins * width
        for driven in spectra:
            of_command = driven > settings.driven_share * driven.max()
            of_command &= driven > settings.driven_ratio * background(driven, settings.background_bins)
            sure &= ~np.convolve(of_command, np.ones(3), "same").astype(bool)
            sure &= ~_harmonics(frequency, driven, settings)
        for fundamental in mains:
            for harmonic in settings.mains_harmonics:
                reach = max(settings.mains_width, settings.mains_harmonic_bins * width)
                sure &= np.abs(frequency - harmonic * fundamental) > reach
        if sure.any():
            top = int(np.argmax(np.where(sure, power, 0.0)))
            others.append(_peak(frequency, power, top))
    apart = settings.same_line_bins / (count * problem.sample_time)
    suggested = ((mains_effect, of_mains), (line_effect, others))
    found = {effect.name: _distinct(values, apart) for effect, values in suggested if effect is not None}
    lattice_effect = effect_found_by(RecordCheck.COMMAND_LATTICE)
    if lattice_effect is not None:
        steps = [
            command_lattice(
                longest[:, axis], rows[begin : begin + count, axis], _response(problem, axis, settings.lattice_response), settings
            )
            for axis in range(rows.shape[1])
        ]
        found[lattice_effect.name] = [step for of_axis in steps for step in of_axis]
    return found


def command_lattice(
    command: Array, unexplained: Array, response: Array, settings: CheckSettings = CONFIGURATION.checks
) -> list[float]:
    """Steps of a lattice that the command may have been rounded to.

    The error of rounding is periodic over the command: what the residual holds of it, by a filter matched to the plant's response, has
    as a function of the command a line at one over the step. Differences in time take off what is slow, as most other gaps are.

    Parameters
    ----------
    command : ndarray, shape (N,)
        V.
    unexplained : ndarray, shape (N,)
        Residual without what the scattered coefficients explain, any unit.
    response : ndarray, shape (K,)
        Change of the measurement 1, 2, … samples after a change of the command.
    settings : CheckSettings
        Values of the configuration.

    Returns
    -------
    list of float
        V, the most likely first; none where no line stands out.
    """
    low, span = float(command.min()), float(np.ptp(command))
    bins, padded = settings.lattice_bins, 4
    if not (span > 0.0 and np.any(response)):
        return []
    later = np.append(np.diff(unexplained), 0.0)
    matched = fftconvolve(later, np.diff(response, prepend=0.0)[::-1])[len(response) - 1 :][: len(command)]
    place = np.rint((command - low) / span * (bins - 1)).astype(np.int64)
    sums = np.bincount(place, weights=matched, minlength=bins)
    counts = np.bincount(place, minlength=bins)
    window = np.ones(bins // 16)
    smooth = np.convolve(sums, window, "same") / np.maximum(np.convolve(counts, window, "same"), 1.0)
    power = np.abs(np.fft.rfft(sums - smooth * counts, padded * bins)) ** 2
    ratio = power / np.maximum(background(power, padded * settings.background_bins), 1e-300)
    cycles = np.arange(len(power)) / padded
    ratio[(cycles < settings.lattice_least) | (cycles > 0.2 * bins)] = 0.0
    found: list[float] = []
    for top in np.argsort(ratio)[::-1][: 4 * padded * settings.lattice_steps]:
        if ratio[top] > settings.lattice_ratio and all(abs(cycles[top] - other) > 1.0 for other in found):
            found.append(_peak(cycles, power, int(top)))
    return [span / one for one in found[: settings.lattice_steps]]


def _response(problem: Problem, axis: int, count: int) -> Array:
    """Change of the nominal measurement 1, 2, … `count` samples after the command of an axis has gone up by a quarter of its span."""
    commands = np.concatenate([piece.command for piece in problem.pieces])
    lower, upper = commands.min(axis=0), commands.max(axis=0)
    running = problem.model.chain.filter(Sampling(problem.sample_time, len(lower), problem.hold))
    first = running.settle(0.75 * lower + 0.25 * upper)[axis]
    raised = 0.75 * lower + 0.25 * upper
    raised[axis] += 0.25 * (upper - lower)[axis]
    return np.diff(running.process(np.repeat(raised[None], count, axis=0))[:, axis], prepend=first)


def _mains(effect: Effect | None, problem: Problem) -> tuple[float, ...]:
    """Frequencies (Hz) of the mains: where fits of the effect begin."""
    if effect is None:
        return ()
    return next(parameter.starts for parameter in effect.parameters(problem.surroundings) if parameter.unit == "Hz")


def _harmonics(frequency: Array, driven: Array, settings: CheckSettings) -> NDArray[np.bool_]:
    """Frequencies (N,) that are near a harmonic of a command whose power is near those of one fundamental."""
    fundamental = _peak(frequency, driven, int(np.argmax(driven * frequency**2)))  # of the rate: a mean that wanders is none
    order = np.round(frequency / fundamental)
    possible, bins = order >= 1, settings.harmonic_bins
    if fundamental < settings.fundamental_bins * frequency[1]:
        # Hardly resolved: everything would be near a harmonic, so that only the first ones count, which any nonlinearity has.
        possible &= order <= settings.first_harmonics
        bins = min(bins, 0.25 * fundamental / frequency[1])
    above = driven[frequency > 0.5 * fundamental].sum()
    for width in settings.harmonic_widths:
        reach = max(bins * frequency[1], width * fundamental)
        near = possible & (np.abs(frequency - order * fundamental) < reach)
        if driven[near].sum() > settings.harmonic_power * above:
            return np.asarray(near, dtype=bool)
    return np.zeros(len(frequency), bool)


def background(power: Array, reach: int) -> Array:
    """Mean power around every bin of a spectrum, from the median, which no line moves.

    Parameters
    ----------
    power : ndarray, shape (N,)
        By bin.
    reach : int
        Bins to either side.

    Returns
    -------
    ndarray, shape (N,)
        Mean of a floor of the same median: power of noise falls off exponentially.
    """
    padded = np.pad(power, reach, mode="reflect") if len(power) > reach + 1 else np.pad(power, reach, mode="edge")
    return np.asarray(median_filter(padded, 2 * reach + 1)[reach : reach + len(power)] / np.log(2.0), dtype=np.float64)


def _peak(frequency: Array, power: Array, top: int) -> float:
    around = slice(max(top - 1, 0), top + 2)
    return float(np.sum(frequency[around] * power[around]) / np.sum(power[around]))


def _distinct(values: Sequence[float], width: float) -> list[float]:
    kept: list[float] = []
    for value in values:
        if all(abs(value - other) > width for other in kept):
            kept.append(value)
    return kept
