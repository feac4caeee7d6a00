# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A vibration whose phase wanders, against noise of known variance, top and width, and against what is no vibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from hyst_control.base.arrays import Array
from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.decide.policy import decide
from hyst_control.diagnose.evidence import HumpEvidence
from hyst_control.diagnose.noise.narrowband import random_vibration
from hyst_control.diagnose.report.attribution import attribute
from hyst_control.diagnose.report.augmented_model import augmented
from hyst_control.diagnose.run.diagnosis import diagnose
from hyst_control.diagnose.verdict import Reason, Verdict
from hyst_control.effects.effect import RecordCheck
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record, Signal
from test.diagnose.made_evidence import LIMITS, QUIET, effect, evidence, none

STEP, ROWS, SETTLED = 1e-4, 16000, 20000
FREQUENCY, WIDTH = 300.0, 12.0


def shaken_mode(rms: float, random: np.random.Generator) -> Array:
    """A mode that white noise shakes: an autoregression of second order, whose variance is (1 + b) / ((1 - b) ((1 + b)² - a²))."""
    damping, rate = 0.5 * WIDTH / FREQUENCY, 2 * np.pi * FREQUENCY * STEP
    pole = np.exp(-damping * rate + 1j * rate * np.sqrt(1.0 - damping**2))
    a, b = -2.0 * pole.real, abs(pole) ** 2
    variance = (1.0 + b) / ((1.0 - b) * ((1.0 + b) ** 2 - a**2))
    return rms * lfilter([1.0], [1.0, a, b], random.standard_normal(SETTLED + ROWS))[SETTLED:] / np.sqrt(variance)


def wandering_tone(rms: float, random: np.random.Generator) -> Array:
    """A tone whose sine and cosine forget as exp(-π width t): a Lorentz curve of that width."""
    keep = np.exp(-np.pi * WIDTH * STEP)
    sine, cosine = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], random.standard_normal((2, SETTLED + ROWS)), axis=1)[:, SETTLED:]
    angle = 2 * np.pi * FREQUENCY * STEP * np.arange(ROWS)
    return rms * (sine * np.sin(angle) + cosine * np.cos(angle))


def seen_in(residual: Array, command: Array | None = None, beside: Array | None = None) -> HumpEvidence | None:
    if command is None:
        command = lfilter([0.01], [1.0, -0.99], np.random.default_rng(99).standard_normal(ROWS))
    commands = np.column_stack([command] if beside is None else [command, beside])
    return random_vibration(residual, residual, commands, np.roll(command, 1), STEP)


@pytest.mark.parametrize("made", [shaken_mode, wandering_tone])
@pytest.mark.parametrize("rms", [1.0, 3.0])
def test_top_width_and_size_are_those_that_are_known(made, rms):
    """Over 20 draws: plausible, right in the median, and within the 90 % intervals as often as these say."""
    found = []
    for seed in range(20):
        random = np.random.default_rng(seed)
        one = seen_in(made(rms, random) + random.standard_normal(ROWS))
        assert one is not None
        found.append(one)
    assert sum(one.plausible for one in found) >= 18
    assert np.median([one.frequency for one in found]) == pytest.approx(FREQUENCY, abs=1.0)
    assert np.median([one.width for one in found]) == pytest.approx(WIDTH, rel=0.2)
    assert np.median([one.rms for one in found]) == pytest.approx(rms, rel=0.08)
    assert np.median([one.left for one in found]) == pytest.approx(1.0, rel=0.03)
    for low_high, true in (("frequency_ci90", FREQUENCY), ("ci90", rms)):
        covered = sum(getattr(one, low_high)[0] <= true <= getattr(one, low_high)[1] for one in found)
        assert 15 <= covered


def test_what_is_no_vibration_is_not_called_one():
    """A steady line, white and 1/f noise, a mode that a command drives, and one that is shaken where the command moves."""
    random = np.random.default_rng(3)
    white = random.standard_normal(ROWS)
    time = STEP * np.arange(ROWS)
    driving = random.standard_normal(ROWS)
    damping = 0.5 * WIDTH / FREQUENCY
    pole = np.exp(2 * np.pi * FREQUENCY * STEP * (-damping + 1j))
    driven = lfilter([1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], driving)
    lines = np.arange(1, ROWS // 2)
    spectrum = np.zeros(ROWS // 2 + 1, complex)
    spectrum[1 : ROWS // 2] = np.exp(2j * np.pi * random.random(len(lines))) / np.sqrt(lines)
    falling = np.fft.irfft(spectrum, ROWS)
    moves = (time % 0.4 < 0.1).astype(float)
    none_of_them = {
        "line": (white + 3.0 * np.sin(2 * np.pi * 301.3 * time), None),
        "white noise": (white, None),
        "1/f noise": (white + 3.0 * falling / falling.std(), None),
        "driven mode": (white + 3.0 * driven / driven.std(), driving),
        "where it moves": (white + 5.0 * moves * shaken_mode(1.0, random), np.cumsum(moves * driving)),
    }
    for name, (residual, command) in none_of_them.items():
        one = seen_in(residual, command)
        assert one is None or not one.plausible, name
    mode = white + 3.0 * driven / driven.std()
    alone, beside = seen_in(mode), seen_in(mode, beside=driving)  # by the other axis' command
    assert alone is not None and alone.plausible and beside is not None and not beside.plausible


HUMP = HumpEvidence(300.0, (299.0, 301.0), 12.0, 9.9, (9.5, 10.3), 9e5, 2e4, 1.0, True)


def decided(*others, hump: HumpEvidence | None = HUMP, **changes):
    return decide(evidence(*others, base=none(residual=replace(QUIET, energy=101.0, hump=hump)), **changes), LIMITS)


def test_a_hump_explains_a_gap_of_which_no_effect_explains_much():
    decision = decided(effect("a", 50.0, left=95.0))
    assert decision.verdict is Verdict.EFFECT and decision.reasons == (Reason.RECORD_CHECK, Reason.NOISE_EXPLAINS_MORE)
    [finding] = decision.findings
    assert finding.check is RecordCheck.SPECTRAL_HUMP
    assert finding.value == pytest.approx(np.sqrt(2.0) * 9.9) and finding.rms == pytest.approx(9.9)
    assert {name: value for name, value, *_ in finding.further} == {"frequency": 300.0, "width": 12.0}
    assert decision.novelty < 0.5


def test_a_hump_without_the_shape_or_with_much_beside_it_stays_unknown():
    other = decided(hump=replace(HUMP, plausible=False))
    assert other.verdict is Verdict.UNKNOWN and not other.findings
    more = decided(hump=replace(HUMP, left=30.0))
    assert more.verdict is Verdict.UNKNOWN and more.remainder == pytest.approx(0.29)


def test_a_hump_is_not_looked_at_where_an_effect_explains_the_gap():
    decision = decided(effect("a", residual=replace(QUIET, hump=replace(HUMP, rms=0.5))))
    assert decision.listed == (1,) and not decision.findings


def test_a_hump_within_what_the_model_leaves_on_clean_records_is_no_gap():
    small = replace(HUMP, rms=0.9)
    decision = decide(evidence(base=none(energy=1.9, residual=replace(QUIET, energy=1.9, hump=small)), stated=1.9), LIMITS)
    assert decision.verdict is Verdict.NO_GAP and not decision.findings


def test_an_effect_and_a_hump_in_what_it_leaves_are_both_named():
    beside = replace(QUIET, energy=50.0, hump=replace(HUMP, rms=7.0, gain=4e5, misfit=1.5e4))
    decision = decided(effect("a", left=50.0, residual=beside), hump=replace(HUMP, plausible=False))
    assert decision.verdict is Verdict.EFFECT and decision.listed == (1,)
    assert [finding.check for finding in decision.findings] == [RecordCheck.SPECTRAL_HUMP]


def test_an_effect_that_only_takes_a_part_of_the_hump_is_not_named():
    beside = replace(QUIET, energy=80.0, hump=replace(HUMP, rms=8.8, misfit=HUMP.misfit - 5.0))
    decision = decided(effect("a", left=80.0, residual=beside))
    assert not decision.listed and [finding.check for finding in decision.findings] == [RecordCheck.SPECTRAL_HUMP]


def test_a_line_that_leaves_much_of_a_hump_gives_way_to_it():
    decision = decided(effect("vibration", left=20.0))
    assert not decision.listed and [finding.check for finding in decision.findings] == [RecordCheck.SPECTRAL_HUMP]


def test_the_report_has_frequency_width_and_amplitude_and_the_model_its_rms():
    random = np.random.default_rng(5)
    command = 20.0 + 10.0 * lfilter([0.02], [1.0, -0.98], random.standard_normal(ROWS))[:, None]
    chain = Chain((TransferFunction((500.0,), (1.0, 1000.0)),))
    model = Model("m", ("x",), {"command": "V", "measurement": "um"}, STEP, chain, noise={"sigma": 0.01}, tolerance={"num": 0.01})
    time = STEP * np.arange(ROWS)
    shaken = 0.03 * shaken_mode(1.0, random)[:, None] + 0.01 * random.standard_normal((ROWS, 1))
    record = Record(
        {
            "command": Signal(time, command, ("x",), "V"),
            "measurement": Signal(time, simulate(model, command, STEP) + shaken, ("x",), "um"),
        },
        "shaken",
    )
    diagnosis = diagnose([record], model, cache=False)
    [named] = attribute(diagnosis).effects
    assert named.name == "vibration" and named.share > 0.8
    for name, true in (("amplitude", 0.03 * np.sqrt(2.0)), ("frequency", FREQUENCY), ("width", WIDTH)):
        value, (low, high), _ = named.values[name]
        assert low < value < high and low < true < high
    better = augmented(diagnosis)
    assert better is not None and better.noise["sigma"] == pytest.approx(np.hypot(0.03, 0.01), rel=0.1)
