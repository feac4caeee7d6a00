# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Spectrum of a model discrepancy: what it makes white, and what it leaves of an effect beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import dct
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.signal import lfilter

from hyst_control.chain import Chain
from hyst_control.chain.coordinates import chain_coordinates
from hyst_control.chain.memoryless import Gain
from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.problem.coefficient_prior import pinned, reduced, scatter_of
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.run.prepare import _floor
from hyst_control.diagnose.search.beam_search import effective_sample_weight
from hyst_control.diagnose.search.fit import Linearized, fit
from hyst_control.diagnose.validate.present_in_baseline import CleanRecords
from hyst_control.identify.model_error.error_spectrum import FUNDAMENTALS, MEDIAN, OCTAVES, SMOOTHED, UPPER, ErrorSpectrum, filtered
from hyst_control.model_file import Model

STEP, ROWS, NOISE = 0.005, 1200, 0.05


def slow_error(seed: int) -> np.ndarray:
    """Red noise of 0.2 rms, correlated over 100 samples, beside white noise."""
    random = np.random.default_rng(seed)
    keep = np.exp(-1.0 / 100.0)
    red = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], random.standard_normal(ROWS + 1000))[1000:]
    return (0.2 * red + NOISE * random.standard_normal(ROWS))[:, None]


def spectrum_of(*seeds: int) -> ErrorSpectrum:
    return ErrorSpectrum.of([slow_error(seed) for seed in seeds], STEP, ROWS, 1.0)


def model(tolerance: float = 0.0) -> Model:
    units = {"command": "V", "measurement": "um"}
    found = Model("gain", ("x",), units, STEP, Chain((Gain(2.0),)))
    factor = {"parameters": ["gain.gain"], "factor": [[2.0 * tolerance]]}
    return replace(found, uncertainty=factor) if tolerance else found


def problem(measurement: np.ndarray, command: np.ndarray, **given: object) -> Problem:
    return Problem(model(), (Piece(command, measurement),), STEP, "foh", np.array([NOISE]), **given)  # type: ignore[arg-type]


def test_own_error_and_noise_of_another_record_become_white():
    gain = spectrum_of(1, 2).gain(ROWS, np.array([NOISE]), STEP)
    rows = np.array([filtered(slow_error(seed), gain)[:, 0] / NOISE for seed in range(3, 23)])
    assert 0.3 < np.mean(rows**2) < 1.2  # the envelope is an upper one
    neighbours = np.mean(rows[:, 1:] * rows[:, :-1]) / np.mean(rows**2)
    assert abs(neighbours) < 0.25
    plain = np.array([slow_error(seed)[:, 0] for seed in range(3, 23)])
    assert np.mean(plain[:, 1:] * plain[:, :-1]) / np.mean(plain**2) > 0.85


def test_a_line_of_the_clean_records_hides_its_own_frequency_alone():
    time = STEP * np.arange(ROWS)
    clean = slow_error(1) + 0.2 * np.sin(2 * np.pi * 50.0 * time)[:, None]
    gain = ErrorSpectrum.of([clean], STEP, ROWS, 1.0).gain(ROWS, np.array([NOISE]), STEP)[:, 0]
    frequencies = np.arange(ROWS) / (2.0 * ROWS * STEP)
    assert gain[np.argmin(np.abs(frequencies - 50.0))] < 0.1
    assert gain[np.argmin(np.abs(frequencies - 60.0))] > 0.7


def test_a_low_pass_that_takes_noise_off_makes_a_record_no_better_than_a_clean_one():
    spectrum = spectrum_of(1, 2)
    quiet = spectrum.gain(ROWS, np.array([NOISE / 10.0]), STEP) / (NOISE / 10.0)
    usual = spectrum.gain(ROWS, np.array([NOISE]), STEP) / NOISE
    assert quiet == pytest.approx(usual, rel=0.1)


def test_vectors_of_a_problem_come_back_in_their_unit():
    command = np.sin(2 * np.pi * STEP * np.arange(ROWS))[:, None]
    keep = np.arange(ROWS) >= 200
    whole = problem(2.0 * command + slow_error(5), command, own_error=np.array([0.2]), own_spectrum=spectrum_of(1))
    part = replace(whole, pieces=(replace(whole.pieces[0], keep=keep),))
    assert part.rows(part.measured()) == pytest.approx(whole.pieces[0].measurement[keep])
    assert part.in_noise(part.whitened(part.measured())) == pytest.approx(part.measured())
    assert not np.allclose(part.measured(), part.in_noise(part.measured()))


def test_what_is_fast_beside_a_slow_error_counts_in_full():
    """Nearly ½ |fast|² / noise² nats, and not what a weight for the size of the error leaves of it."""
    time = STEP * np.arange(ROWS)
    command, fast = np.sin(2 * np.pi * time)[:, None], 0.05 * np.sin(2 * np.pi * 80.0 * time)[:, None]
    clean = slow_error(7)

    def gained(given: Problem) -> float:
        rows = [
            replace(given, pieces=(Piece(command, y),)).measured() for y in (2.0 * command + clean + fast, 2.0 * command + clean)
        ]
        return 0.5 * given.weight * float((rows[0] - rows[1]) @ (rows[0] - rows[1]))

    sized = problem(clean, command, own_error=np.array([0.2]), own_correlation=100.0)
    exact = 0.5 * ROWS * np.mean(fast**2) / NOISE**2
    assert gained(replace(sized, own_spectrum=spectrum_of(1, 2))) > 0.6 * exact
    assert gained(sized) < 0.01 * exact


def test_coefficients_are_pinned_by_clean_records():
    """A gain that is known to 30 % is known to what the own error of a baseline record allows."""
    command = 3.0 * np.sin(2 * np.pi * STEP * np.arange(ROWS))[:, None]
    clean = Problem(model(0.3), (Piece(command, 2.0 * command + slow_error(1)),), STEP, "foh", np.array([NOISE]))
    clean = replace(clean, own_spectrum=spectrum_of(1))
    narrow = pinned(scatter_of(clean.model), CleanRecords(clean).columns)
    assert narrow.joint is not None
    rest = clean.simulate(Chain((Gain(1.0),)).stages) * 2.0
    exact = 0.6 / np.sqrt(1.0 + 0.3**2 * float(rest @ rest))
    assert abs(narrow.joint.factor[0, 0]) == pytest.approx(exact, rel=0.02)
    other = problem(1.4 * command, command, own_error=np.array([0.2]), own_spectrum=spectrum_of(1))
    assert abs(fit(Linearized(other, scatter_of(clean.model))).z[0]) < 1.1  # within 30 %
    assert abs(fit(Linearized(other, narrow)).z[0]) > 5.0  # many deviations: the gain of the baseline record does not take it up


def test_coefficients_keep_the_directions_in_which_they_move_the_records():
    """Of two gains in series a record shows the product alone: one coefficient explains what both do."""
    command = 3.0 * np.sin(2 * np.pi * STEP * np.arange(ROWS))[:, None]
    chain = Chain((Gain(2.0), Gain(1.0)))
    uncertainty = {"parameters": list(chain_coordinates(chain.stages, ("x",))), "factor": [[0.06, 0.0], [0.0, 0.03]]}
    series = Model("two gains", ("x",), {"command": "V", "measurement": "um"}, STEP, chain, uncertainty=uncertainty)
    measured = 2.06 * command + NOISE * np.random.default_rng(3).standard_normal((ROWS, 1))
    given = Problem(series, (Piece(command, measured),), STEP, "foh", np.array([NOISE]))
    whole = Linearized(given, scatter_of(series))
    fewer = Linearized(given, reduced(whole.scatter, whole.columns))
    assert (whole.count, fewer.count) == (2, 1)
    assert fit(fewer).misfit == pytest.approx(fit(whole).misfit, rel=1e-6)
    alone = reduced(fewer.scatter, fewer.columns)
    assert alone is fewer.scatter  # what all is seen of stays as it is stated


@pytest.mark.parametrize("slowest", [0.02, 1.0, 10.0])
def test_every_frequency_has_a_power_of_its_own(monkeypatch, slowest):
    """The same records have the same spectrum, whatever unused memory holds: every bin is written."""
    wanted = ErrorSpectrum.of([slow_error(1)], STEP, ROWS, slowest).power
    monkeypatch.setattr(np, "empty_like", lambda rows: np.full_like(rows, np.nan))
    np.testing.assert_array_equal(ErrorSpectrum.of([slow_error(1)], STEP, ROWS, slowest).power, wanted)
    assert np.isfinite(wanted).all()


@pytest.mark.parametrize("count, slowest", [(40, 3.0), (700, 20.0), (3000, 400.0)])
def test_the_power_around_a_frequency_is_the_largest_bin_and_the_mean(count, slowest):
    """Bin by bin from filters of the whole spectrum."""
    sample_time = 1e-3
    error = np.cumsum(np.random.default_rng(count).normal(size=(count, 1)), axis=0)
    bins = dct(error, norm="ortho", axis=0) ** 2
    noise = np.median(bins[int(UPPER * count) :]) / MEDIAN
    smooth, due = uniform_filter1d(bins, SMOOTHED, axis=0), np.empty(count)
    for at in range(count):
        octave = max((2**OCTAVES - 1) * at, 1.0)
        half = 2 ** int(np.ceil(np.log2(min(octave, max(FUNDAMENTALS * slowest * 2 * sample_time * count, 1.0)))))
        width = 2 * half + 1
        largest = maximum_filter1d(smooth, width, axis=0)[at, 0] - (1.0 + (np.log(width) + 1.0) / (0.5 * SMOOTHED)) * noise
        due[at] = max(largest, uniform_filter1d(bins, width, axis=0)[at, 0] - noise, 0.0)
    found = ErrorSpectrum.of([error], sample_time, count, slowest)
    np.testing.assert_allclose(found.power[:, 0], due, rtol=1e-9, atol=1e-9 * due.max())


def test_a_low_frequency_error_is_that_of_fewer_rows_where_they_excite_it():
    """All rows have a jump, a line far above it, and an error at 4 Hz where the command excites that in the first half alone."""
    time = STEP * np.arange(ROWS)
    late = time >= 0.5 * STEP * ROWS
    white = NOISE * np.random.default_rng(5).standard_normal(ROWS)
    error = white + 2.0 * late + 0.3 * np.sin(2 * np.pi * 90.0 * time) + 0.3 * ~late * np.sin(2 * np.pi * 4.0 * time)
    whole, known = (ErrorSpectrum.of([rows[:, None]], STEP, ROWS, 1.0) for rows in (error, error[late] - 2.0))
    frequencies = whole.frequencies
    excited = np.where(np.abs(frequencies - 4.0) < 0.5, 1e6, 1.0)[:, None]
    joined = whole.with_slow_part(known, excited)

    def power(spectrum: ErrorSpectrum, frequency: float) -> float:
        return float(np.interp(frequency, frequencies, spectrum.power[:, 0]))

    assert power(joined, 0.5) < 0.05 * power(whole, 0.5)
    assert power(joined, 4.0) == power(whole, 4.0) > 0.1
    assert power(joined, 90.0) == power(whole, 90.0) > 1.0
    assert (joined.power <= whole.power).all()


def test_a_small_slow_residual_beside_an_own_error_keeps_its_weight():
    """What a low-pass leaves of a record has a tenth of the noise, and is slow: its density is below that of own error and noise."""
    command = np.sin(2 * np.pi * STEP * np.arange(ROWS))[:, None]
    given = problem(2.0 * command, command, own_error=np.array([0.2]), own_spectrum=spectrum_of(1), beside_error=True)
    slow = (slow_error(9)[:, 0] - slow_error(9).mean()) / 0.2
    assert effective_sample_weight(given, 0.05 * slow) == 1.0
    assert effective_sample_weight(given, slow) < 0.1  # as large as own error and noise: few of its samples are independent


def test_practical_size_is_in_units_of_own_error_and_noise():
    """A record that a low-pass took the noise off is whitened by the noise of the baseline records: its effects are no smaller for it."""
    command = np.sin(2 * np.pi * STEP * np.arange(ROWS))[:, None]
    given = problem(2000.0 * command, command, own_error=np.array([0.2]), own_spectrum=spectrum_of(1, 2))
    usual, quiet = (_floor(replace(given, sigma=np.array([size])), np.zeros(1), CONFIGURATION) for size in (NOISE, 0.01 * NOISE))
    assert quiet == pytest.approx(usual, rel=0.1)


def test_the_error_on_a_larger_output_is_the_same_share_of_it():
    """At frequencies that no baseline record drove the usual share counts: a smaller output does not make the error smaller."""
    known, new = (replace(spectrum_of(1), power=np.full((ROWS, 1), size)) for size in (4.0, 36.0))
    foreseen = spectrum_of(1).for_output(known, new, np.zeros(1))
    np.testing.assert_allclose(foreseen.power, 9.0 * spectrum_of(1).power)
    nothing = replace(known, power=np.zeros((ROWS, 1)))
    bare = replace(spectrum_of(1), power=np.zeros((ROWS, 1)))
    np.testing.assert_allclose(bare.for_output(nothing, new, np.array([0.1])).power, 0.36)
    np.testing.assert_allclose(spectrum_of(1).for_output(new, known, np.array([0.1])).power, spectrum_of(1).power)


def test_the_size_of_own_error_and_noise_together():
    spectrum = replace(spectrum_of(1), power=np.full((ROWS, 1), 0.09), noise=np.array([0.1]))
    np.testing.assert_allclose(spectrum.rms(np.array([0.4])), 0.5)
