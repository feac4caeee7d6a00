"""Checks without a fit, each beside what it must not take for its finding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.linear import StateSpace, TransferFunction
from hyst_control.diagnose.flicker_estimation import flicker
from hyst_control.diagnose.gap_report import sentence
from hyst_control.diagnose.problem import Piece, Problem
from hyst_control.diagnose.record_checks import (
    background,
    lattice_of,
    level_crossings,
    lines,
    outliers,
    repeated_samples,
    stuck_stretches,
)
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.effects import EFFECTS
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record, Signal

STEP = 5e-3
TIME = STEP * np.arange(6000)


def test_numbers_of_few_digits_are_no_held_samples():
    """A slow motion in noise, printed with so few digits that neighbors coincide now and then, on more levels than a lattice has."""
    random = np.random.default_rng(1)
    printed = np.round(20.0 * np.sin(2 * np.pi * TIME) + 0.2 * random.standard_normal(len(TIME)), 3)
    same = np.mean(np.diff(printed) == 0.0)
    assert same > 5e-4
    assert repeated_samples(printed, 0.0, 0.2)[0] == 0.0
    held = printed.copy()
    for k in np.flatnonzero(random.random(len(held)) < 0.02):
        held[k] = held[max(k - 1, 0)]
    assert repeated_samples(held, 0.0, 0.2)[0] == pytest.approx(0.02, abs=0.006)


@pytest.mark.parametrize("fraction", [0.5, 0.75, 0.95])
def test_most_samples_may_be_held(fraction):
    """Of nineteen samples in twenty that are held, whole stretches stand still: that is no coarse printing."""
    random = np.random.default_rng(4)
    held = 20.0 * np.sin(2 * np.pi * TIME) + 0.02 * random.standard_normal(len(TIME))
    for k in np.flatnonzero(random.random(len(held)) < fraction):
        held[k] = held[max(k - 1, 0)]
    assert repeated_samples(held, 0.0, 0.02)[0] == pytest.approx(fraction, abs=0.03)


@pytest.mark.parametrize("frequency, due", [(3.0, []), (3.5, [3.5])])
def test_a_harmonic_of_a_sine_that_swells_is_no_vibration(frequency, due):
    """Unipolar strokes of changing height, whose mean wanders with them; a line at their third harmonic, and one between two."""
    height = 1.0 + 0.8 * np.sin(2 * np.pi * 0.1 * TIME)
    command = (0.5 * height * (1.0 - np.cos(2 * np.pi * TIME)))[:, None]
    model = Model("gain", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((TransferFunction((1.0,), (1.0,)),)))
    problem = Problem(model, (Piece(command, command),), STEP, "zoh", np.array([1e-3]))
    residual = 1e-3 * np.random.default_rng(2).standard_normal(len(TIME)) + 0.02 * height * np.sin(2 * np.pi * frequency * TIME)
    found = lines(problem, residual / 1e-3)["vibration"]
    assert found == pytest.approx(due, abs=0.05)


@pytest.mark.parametrize("frequency, due", [(1.98, []), (7.4, [7.4])])
def test_a_harmonic_of_six_strokes_is_no_vibration(frequency, due):
    """A fundamental between two bins of so short a record, and a line at its second harmonic or at none."""
    time = TIME[TIME < 6.0]
    command = (1.0 - np.cos(2 * np.pi * 0.99 * time))[:, None]
    model = Model("gain", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((TransferFunction((1.0,), (1.0,)),)))
    problem = Problem(model, (Piece(command, command),), STEP, "zoh", np.array([1e-3]))
    residual = 1e-3 * np.random.default_rng(2).standard_normal(len(time)) + 0.02 * np.sin(2 * np.pi * frequency * time)
    assert lines(problem, residual / 1e-3)["vibration"] == pytest.approx(due, abs=0.05)


@pytest.mark.parametrize("length, reach", [(1, 3), (5, 9), (40, 9), (300, 40)])
def test_the_background_is_the_median_around_every_bin(length: int, reach: int) -> None:
    """A few lines on a sloping floor: the median of every window, of what is mirrored at the ends, one after the other."""
    power = np.random.default_rng(length).exponential(size=length) * np.linspace(5.0, 1.0, length)
    power[::17] *= 1e4
    order = np.arange(-reach, length + reach)
    if length > reach + 1:
        order = np.abs(order)
        order = np.where(order < length, order, 2 * (length - 1) - order)
    windows = [power[np.clip(order[i : i + 2 * reach + 1], 0, length - 1)] for i in range(length)]
    np.testing.assert_array_equal(background(power, reach), [np.sort(window)[reach] / np.log(2.0) for window in windows])


def test_a_line_of_another_axis_command_is_no_vibration():
    """Axes couple: what the other one is driven at is seen on this one too."""
    random = np.random.default_rng(5)
    command = random.standard_normal((len(TIME), 1))
    beside = 5.0 * np.sin(2 * np.pi * 22.5 * TIME)[:, None]
    model = Model("gain", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((TransferFunction((1.0,), (1.0,)),)))
    residual = random.standard_normal(len(TIME)) + np.sin(2 * np.pi * 22.5 * TIME)
    for driven_beside, due in ((None, [22.5]), (beside, [])):
        piece = Piece(command, command, others=beside, driven_beside=driven_beside)
        found = lines(Problem(model, (piece,), STEP, "zoh", np.array([1e-3])), residual)["vibration"]
        assert found == pytest.approx(due, abs=0.05)


def test_a_gain_of_all_coupled_axes_is_one_effect():
    """Both axes of a coupled plant are 4 % weak: one value on both, not an effect per axis."""
    w = 2 * np.pi * 300.0
    a = w * np.array([[-0.2, -1.0, 0.0, 0.0], [1.0, -0.2, 0.0, 0.0], [0.0, 0.0, -0.3, -1.3], [0.0, 0.0, 1.3, -0.3]])
    b, c = w * np.array([[1.0, 0.2], [0.0, 0.1], [0.3, 1.0], [0.1, 0.0]]), np.array([[0.2, 1.0, 0.1, 0.3], [0.1, 0.2, 0.0, 1.0]])
    plant = StateSpace(a, b, c, np.zeros((2, 2)))
    model = Model("coupled", ("x", "y"), {"command": "V", "measurement": "mrad"}, 2e-4, Chain((plant,)), noise={"sigma": 2e-3})
    random = np.random.default_rng(3)
    command = np.repeat(random.uniform(0.0, 1.0, (250, 2)), 16, axis=0)
    command[:300] = 0.0
    weak = replace(model, chain=Chain((replace(plant, C=0.96 * c),)))
    measured = simulate(weak, command) + 2e-3 * random.standard_normal(command.shape)
    time = 2e-4 * np.arange(len(command))
    record = Record(
        {"command": Signal(time, command, ("x", "y"), "V"), "measurement": Signal(time, measured, ("x", "y"), "mrad")}, "weak"
    )
    others = [name for name in EFFECTS if name not in ("gain", "gain_drift", "delay", "cross_coupling", "resonance")]
    report, _, better = diagnosed([record], model, without=others)
    first = report["effects"][0]
    assert (first["name"], first["axis"]) == ("gain", ["x", "y"])
    low, high = first["parameters"]["gain"]["ci90"]
    assert low < -0.04 < high and high - low < 0.02
    left = measured - simulate(better, command)
    assert np.sqrt(np.mean(left**2)) < 1.1 * 2e-3


def test_rest_before_a_step_is_no_held_samples_on_a_lattice():
    time = np.arange(20000) * 1e-4
    steps = np.cumsum(np.where(np.arange(20000) % 100 == 50, 1.0, 0.0) * np.random.default_rng(3).normal(size=20000))
    moved = np.convolve(steps, np.exp(-np.arange(200) / 5.0) / 5.0)[:20000] + 0.5 * np.sin(2 * np.pi * 40.0 * time)
    step = 0.004
    rounded = step * np.rint(moved / step)
    share, count = repeated_samples(rounded, lattice_of(rounded), 1e-3)
    assert count >= 200 and share < 0.005
    random = np.random.default_rng(4)
    for k in np.flatnonzero(random.random(20000) < 0.05):
        rounded[k] = rounded[max(k - 1, 0)]
    assert repeated_samples(rounded, lattice_of(rounded), 1e-3)[0] == pytest.approx(0.05, abs=0.02)


def test_outliers_are_told_from_noise_of_any_colour():
    random = np.random.default_rng(5)
    white = random.normal(size=30000)
    for noise in (
        white,
        np.cumsum(white),
        np.convolve(white, np.ones(10) / 10, "same"),
        np.sin(np.arange(30000) * 0.3) * 50 + white,
    ):
        assert outliers(noise)[0] == 0
    spiked = white.copy()
    at = random.choice(30000, 60, replace=False)
    spiked[at] += random.choice([-1, 1], 60) * random.uniform(20, 40, 60)
    count, rms = outliers(spiked)
    assert 55 <= count <= 60 and rms == pytest.approx(np.sqrt(np.mean((spiked - white) ** 2)), rel=0.1)
    assert outliers(np.round(white, 0))[0] == 0


def test_a_dead_band_comes_back_to_one_value_and_held_samples_do_not():
    random = np.random.default_rng(7)
    command = np.sin(2 * np.pi * 8.0 * np.linspace(0.0, 1.0, 4000))
    measured = 10.0 * command + 0.05 * random.normal(size=4000)

    def stuck(values, drive=command, step=0.0):
        return stuck_stretches([(drive, values)], step, 0.05)

    assert stuck(measured) == 0
    dead = np.sign(measured) * np.maximum(np.abs(measured) - 0.5, 0.0)
    assert stuck(dead) >= 16  # it is crossed twice a period
    assert stuck(np.minimum(measured, 9.0)) >= 8  # so is the end of a sensor's range
    held = measured.copy()
    for k in np.flatnonzero(random.random(4000) < 0.2)[1:]:
        held[k] = held[k - 1]
    assert stuck(held) == 0
    assert stuck(np.round(measured, 1), step=0.1) == 0
    assert stuck(dead, drive=np.zeros(4000)) == 0  # at rest it may stand where it likes
    assert stuck_stretches([(command, np.minimum(command, 0.9))], 0.0, 0.0) == 0


def test_a_dead_band_under_the_noise_is_told_by_the_level_that_it_is_passed_on():
    """Noise behind the band: no value comes back. What stands elsewhere, or turns there, is none."""
    random, time = np.random.default_rng(8), np.arange(8000) / 8000
    motion = 10.0 * np.sin(2 * np.pi * 8.0 * time) * (1.0 - 0.5 * time)
    fast = motion + 1.5 * np.sin(2 * np.pi * 300.0 * time)

    def passed(values, simulated=motion, noise=0.02, step=0.0):
        return level_crossings([(simulated, values + noise * random.normal(size=len(values)))], step, 0.02)

    def play(values, half=1.0):
        place = np.zeros_like(values)
        for k in range(1, len(values)):
            place[k] = np.clip(place[k - 1], values[k] - half, values[k] + half)
        return place

    def dead(values, half=1.0):
        return values - np.clip(values, -half, half)

    assert passed(dead(motion)) >= 14  # twice in each of eight periods
    assert passed(dead(motion + 1.0, 1.2), 1.1 * motion + 1.0) >= 14
    assert passed(dead(motion), noise=0.0) >= 14
    assert passed(motion) == 0 and passed(0.8 * motion) == 0
    assert passed(np.minimum(motion, 4.0)) < 2  # turns where it came from
    assert passed(play(10.0 * np.sin(2 * np.pi * 8.0 * time))) < 2
    assert passed(motion, fast) < 2 and passed(np.roll(motion, 40), motion) < 2  # a low-pass, a delay
    assert passed(np.round(dead(motion), 1), step=0.1) == 0
    assert passed(np.round(dead(motion), 2), step=0.01) >= 14  # a lattice that the noise hides
    assert level_crossings([(motion, dead(motion))], 0.0, 0.0) == 0
    few = motion[::25]  # most samples are held, and the motion passes by meanwhile
    for seed in range(20):
        seen, kept = few + 0.02 * random.normal(size=len(few)), np.random.default_rng(seed).random(len(few)) > 0.9
        assert passed(seen[np.maximum.accumulate(np.where(kept, np.arange(len(few)), 0))], few, noise=0.0) < 2


def test_the_sentence_says_why_nothing_known_explains_a_gap():
    report = {
        "verdict": "unknown",
        "gap": {"rms": 1.0, "nrmse": 2.0, "unit": "um", "floor_rms": 0.1},
        "effects": [{"name": name} for name in ("offset", "gain_drift", "softening_modes")],
        "unexplained_share": 0.5,
    }
    assert "offset and gain drift and softening modes, leaves 50 % of it" in sentence(report)
    told = sentence(report | {"unexplained_share": 0.001, "reasons": ["too_many_effects"]})
    assert "it would take offset and gain drift and softening modes at once" in told and "leaves" not in told
    told = sentence(report | {"unexplained_share": 0.01, "reasons": ["at_bound"]})
    assert "would, with a size at the end of its range" in told and "leaves" not in told
    stands = {"name": "held_samples", "variable": "level", "change": 2.0}
    told = sentence(report | {"reasons": ["distortion_level"], "distortions": [stands]})
    assert "stands on one level" in told and "held samples" not in told
    told = sentence(report | {"reasons": ["distortion_level"], "distortions": [stands | {"name": "offset"}]})
    assert "offset is the nearest, but its size would have to change by 200 %" in told
    both = sentence(report | {"reasons": ["energy_left", "too_many_effects"]})
    assert "leaves 50 % of it" in both and "at once" not in both
    assert sentence(report | {"effects": []}).endswith("noise floor 0.1 um).")


@pytest.mark.parametrize(("exponent", "size"), [(1.0, 3.0), (0.8, 8.0)])
def test_flicker_noise_has_its_shape_in_most_draws(exponent, size):
    """1/f^p noise of several times the white noise's rms, made in the spectrum: its few lowest lines scatter widely."""
    rows = 16950
    lines = np.arange(1, rows // 2)

    def drawn(seed: int) -> np.ndarray:
        random = np.random.default_rng(seed)
        spectrum = np.zeros(rows // 2 + 1, complex)
        spectrum[1 : rows // 2] = (random.normal(size=len(lines)) + 1j * random.normal(size=len(lines))) / lines ** (0.5 * exponent)
        noise = np.fft.irfft(spectrum, rows)
        return size * noise / noise.std() + random.normal(size=rows)

    seen = [flicker(drawn(seed), np.ones(rows)) for seed in range(40)]
    assert sum(one.plausible for one in seen) >= 36
    assert np.median([one.rms for one in seen]) == pytest.approx(size, rel=0.05)
