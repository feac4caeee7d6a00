# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identification of the Prandtl-Ishlinskii family, against parameters that are known and records that are measured."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling
from hyst_control.chain.hysteresis.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PlayOperator, PrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import Delay, TransferFunction
from hyst_control.chain.stage import frozen
from hyst_control.identify import Fit, identify
from hyst_control.identify.data.fit_windows import stretches, whole_records
from hyst_control.identify.data.reversal_points import turning_points
from hyst_control.identify.solve.gram_sums import Operators, Window, gram_matrices
from hyst_control.identify.solve.stable_dynamics import Structure
from hyst_control.model_file import Model, load_model, save_model, simulate
from hyst_control.records.record import Record, sampled_record

SAMPLE_TIME = 5e-5
THRESHOLDS = [0.0, 2.0, 5.0, 9.0, 14.0, 20.0]
WEIGHTS = [0.055, 0.012, 0.010, 0.008, 0.006, 0.004]
SIGMA = 0.004


def plant(tau: float = 4e-5) -> Model:
    """A HAMPI of unit static gain of G (HAMPI paper Eq. 7's mode and zero), with a delay; b = -25 k, as identification sets it."""
    stages = (
        ModifiedPrandtlIshlinskii(THRESHOLDS, WEIGHTS, m1=6e-8, m2=3e-8, k=-4e-5, b=0.001),
        Delay(tau),
        TransferFunction([-5e3, 5.982e7], [1.0, 8602.0, 5.982e7]),
    )
    return Model("plant", ("x",), {"command": "V", "measurement": "um"}, SAMPLE_TIME, Chain(stages))


def mode(frequency: float, damping: float) -> TransferFunction:
    w = 2 * np.pi * frequency
    return TransferFunction([w**2], [1.0, 2 * damping * w, w**2])


def excitation(seed: int, scale: float = 1.0) -> np.ndarray:
    """A step, slow loops, and loops up to 400 Hz at several amplitudes, each from and back to 0 V, with rests between."""
    rng = np.random.default_rng(seed)
    parts = [np.zeros(100), np.full(2000, 10.0), np.zeros(600)]
    for frequency, peak in [(2.0, 50.0), (100.0, 50.0), (20.0, 30.0), (400.0, 50.0), (200.0, 20.0), (60.0, 45.0)]:
        cycles = 1 if frequency < 10 else 12
        phase = 2 * np.pi * np.arange(int(cycles / frequency / SAMPLE_TIME)) * frequency * SAMPLE_TIME
        parts += [0.5 * peak * scale * rng.uniform(0.9, 1.0) * (1 - np.cos(phase)), np.zeros(200)]
    return np.concatenate(parts)[:, None]


def record(model: Model, seed: int, scale: float = 1.0, sigma: float = SIGMA) -> Record:
    command = excitation(seed, scale)
    noise = np.random.default_rng(seed + 1000).normal(0.0, sigma, command.shape)
    return sampled_record(f"record {seed}", command, simulate(model, command) + noise, SAMPLE_TIME, ("x",), "um", start="settled")


def test_a_slow_pair_that_all_rows_do_not_tell_is_left_out():
    """Creep as long as the record: a pole at the record's length would only share the static gain with the session's drift."""
    rng, rate, count = np.random.default_rng(2), 4000.0, 12_000
    time = np.arange(count) / rate
    frequency = np.geomspace(0.7, 150.0, 12)[:, None]
    waves = np.sin(2 * np.pi * frequency * time + rng.uniform(0, 2 * np.pi, (12, 1))) / (1 + frequency / 8)
    wave = waves.sum(axis=0) * np.minimum(time / 0.5, 1)
    command = np.abs(50.0 * wave / np.abs(wave).max())[:, None]
    thresholds, weights = np.sort(rng.uniform(1, 49, 8)), rng.uniform(0.0035, 0.007, 8)
    plays = PrandtlIshlinskii(thresholds, weights, w0=0.066)
    moved = simulate(
        Model("plant", ("x",), {"command": "V", "measurement": "um"}, 1 / rate, Chain((plays, Delay(1 / rate), mode(420.0, 0.03)))),
        command,
    )
    left = np.exp(-1 / rate / 3.0)
    creep = 0.05 * lfilter([1 - left], [1, -left], moved, axis=0)
    noisy = moved + creep + 0.002 * rng.normal(size=moved.shape)
    found = identify([sampled_record("creep", command, noisy, 1 / rate, ("x",), "um")], "hapi", "joint")
    poles = np.concatenate([np.roots(stage.den) for stage in found.model.chain.stages if isinstance(stage, TransferFunction)])
    assert np.abs(poles).min() > 10.0


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize(
    "structure", [Structure(), Structure(modes=1, zeros=1, delay=True), Structure(modes=1, lags=1, slow_pair=True, delay=True)]
)
def test_regressors_are_the_chain(hold, structure):
    """Every column of the Gram matrix's rows is what the chain gives for that parameter alone; another code computes it."""
    command = excitation(3)[:, 0]
    parameters = structure.start(900.0) + 0.1 * np.arange(structure.size)
    operators = Operators(np.array(THRESHOLDS), dynamic=True, center=25.0)
    rng = np.random.default_rng(0)
    theta = rng.normal(size=operators.columns) * np.array([*[0.02] * 6, 1e-7, 1e-7, 1e-5])
    count = len(THRESHOLDS)
    stage = ModifiedPrandtlIshlinskii(
        THRESHOLDS, frozen(theta[:count]), m1=theta[count], m2=theta[count + 1], k=theta[count + 2], b=-25.0 * theta[count + 2]
    )
    model = replace(plant(), chain=Chain((stage, *structure.stages(parameters))), hold=hold)
    measurement = simulate(model, command[:, None])[:, 0]
    window = Window(command, np.ascontiguousarray(measurement), SAMPLE_TIME, hold, 0, 0)
    grams = gram_matrices([window], operators, structure, parameters, theta, "none", 1)
    gram = grams.fitted + grams.held_out
    vector = np.concatenate([theta, np.zeros(structure.size), [-1.0]])
    assert np.sqrt(max(vector @ gram @ vector, 0.0) / len(command)) < 1e-6 * np.ptp(measurement)


@pytest.mark.parametrize("rows, skip", [(50, 7), (5000, 1234), (12_345, 0), (12_345, 8100)])
def test_gram_matrices_are_those_of_the_rows_that_count(rows, skip):
    """Against the whole table at once: weights, offset and drift, every third block held out, rows before `skip` left out."""
    rng = np.random.default_rng(rows)
    command, measurement, weight = rng.uniform(0.0, 50.0, rows), rng.normal(size=rows), rng.uniform(0.2, 5.0, rows)
    window = Window(command, measurement, SAMPLE_TIME, "foh", skip, 1, begin=0.25, share=0.5, weight=weight)
    operators = Operators(np.array([0.0, 60.0]))  # a straight line; and no motion from rest
    found = gram_matrices([window], operators, Structure(), np.zeros(0), np.zeros(2), "linear", 2)
    nothing, place = np.zeros(rows), -0.25 + 0.5 * np.arange(rows) / rows
    table = np.sqrt(weight) * np.array([command, nothing, nothing, nothing, np.ones(rows), place, measurement])
    block = np.arange(rows) // max(min(4000, rows // 90), 1)
    counts, held = np.arange(rows) >= skip, block % 3 == 2
    assert found.rows == (np.sum(counts & ~held), np.sum(counts & held))
    for gram, part in ((found.fitted, table[:, counts & ~held]), (found.held_out, table[:, counts & held])):
        np.testing.assert_allclose(gram, part @ part.T, rtol=1e-10, atol=1e-8)
    assert len(found.blocks) == len(np.unique(block[counts]))
    for gram, number in zip(found.blocks, np.unique(block[counts]), strict=True):
        part = table[:, counts & (block == number)]
        np.testing.assert_allclose(gram, part @ part.T, rtol=1e-10, atol=1e-8)


def test_recovers_a_hampi_and_predicts_another_record():
    truth = plant()
    fit = identify(
        [record(truth, 1), record(truth, 2, 0.8)], "hampi", thresholds=THRESHOLDS, structure=Structure(modes=1, zeros=1, delay=True)
    )
    rows = {row["name"]: row for row in fit.report["parameters"]}
    for name, value in {"weights[0]": 0.055, "weights[3]": 0.008, "m1": 6e-8, "m2": 3e-8, "k": -4e-5}.items():
        assert abs(rows[name]["value"] - value) < 5 * rows[name]["standard_error"] + 1e-3 * abs(value), name
        assert rows[name]["standard_error"] < 0.1 * abs(value), name
    fresh = record(truth, 7, 0.95)
    clean = simulate(truth, fresh.command)
    error = simulate(fit.model, fresh.command) - clean
    assert np.sqrt(np.mean(error**2)) / np.ptp(clean) < 5e-4
    # The delay and the right-half-plane zero look alike; their sum is what the phase shows.
    stages = {stage.name: stage for stage in fit.model.chain.stages}
    tau = stages["delay"].tau if "delay" in stages else 0.0
    num = stages["transfer_function"].num
    lag = tau - num[-2] / num[-1] if len(num) > 1 else tau
    assert lag == pytest.approx(4e-5 + 5e3 / 5.982e7, rel=0.1)


@cache
def identified(family: str) -> Fit:
    """From two records, with what the family chooses where nothing is said."""
    return identify([record(plant(), 1), record(plant(), 2, 0.8)], family)


def test_default_thresholds_predict_within_half_a_percent():
    truth = plant()
    fresh = record(truth, 9, 0.9)
    clean = simulate(truth, fresh.command)
    assert np.sqrt(np.mean((simulate(identified("hampi").model, fresh.command) - clean) ** 2)) / np.ptp(clean) < 5e-3


def test_the_richer_family_predicts_better():
    truth = plant()
    fresh = record(truth, 8)
    clean = simulate(truth, fresh.command)
    errors = {
        family: np.sqrt(np.mean((simulate(identified(family).model, fresh.command) - clean) ** 2))
        for family in ("pi", "hapi", "hampi")
    }
    assert errors["hampi"] < 0.5 * errors["hapi"] < 0.5 * errors["pi"]


def test_joint_beats_the_papers_sequence_on_a_held_out_record():
    truth = plant()
    training, fresh = [record(truth, 1)], record(truth, 5, 0.9)
    clean = simulate(truth, fresh.command)
    errors = {
        method: np.sqrt(np.mean((simulate(identify(training, "hampi", method).model, fresh.command) - clean) ** 2))
        for method in ("paper", "joint")
    }
    assert errors["joint"] < errors["paper"]


def test_standard_errors_tell_the_scatter():
    """Over independent noise the estimates scatter as the errors say: the rms of z is near 1."""
    truth = plant()
    structure = Structure(modes=1, zeros=1, delay=True)
    z = []
    for seed in range(12):
        data = record(truth, 1, sigma=0.0)
        noisy = data.with_values(measurement=data.measurement + np.random.default_rng(seed).normal(0, 0.02, data.measurement.shape))
        fit = identify([noisy], "hampi", thresholds=THRESHOLDS, structure=structure, nuisance="none")
        rows = {row["name"]: row for row in fit.report["parameters"]}
        z += [
            (rows[name]["value"] - value) / rows[name]["standard_error"]
            for name, value in {"weights[1]": 0.012, "weights[4]": 0.006, "m1": 6e-8, "k": -4e-5}.items()
        ]
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.7


def test_the_model_file_keeps_what_was_identified(tmp_path):
    fit = identified("hapi")
    save_model(fit.model, tmp_path / "hapi.yaml")
    loaded = load_model(tmp_path / "hapi.yaml")
    command = excitation(4)
    np.testing.assert_array_equal(simulate(loaded, command), simulate(fit.model, command))
    assert set(loaded.tolerance) <= {"w0", "weights", "num", "den", "tau"} and loaded.noise["sigma"] == pytest.approx(
        SIGMA, rel=0.2
    )


def test_two_axes_are_identified_side_by_side():
    first, second = plant(), plant(9e-5)
    a, b = record(first, 1), record(second, 2)
    rows = min(len(a.command), len(b.command))
    both = sampled_record(
        "both",
        np.hstack([a.command[:rows], b.command[:rows]]),
        np.hstack([a.measurement[:rows], b.measurement[:rows]]),
        SAMPLE_TIME,
        ("x", "y"),
        "um",
        start="settled",
    )
    fit = identify([both], "hampi", structure=Structure(modes=1, zeros=1, delay=True))
    simulated = simulate(fit.model, both.command)
    single = simulate(
        identify([a.rows(0, rows)], "hampi", structure=Structure(modes=1, zeros=1, delay=True)).model, a.command[:rows]
    )
    np.testing.assert_allclose(simulated[:, 0], single[:, 0], atol=1e-6)
    assert np.std(simulated[:, 1] - both.measurement[:, 1]) < 2 * SIGMA


def test_what_the_data_cannot_tell_is_named():
    """Slow loops of a plant without dynamics or rate part show neither, and the report says so with its sizes, without fixed advice."""
    truth = replace(plant(), chain=Chain((ModifiedPrandtlIshlinskii(THRESHOLDS, WEIGHTS, k=-4e-5, b=0.001),)))
    phase = 2 * np.pi * np.arange(20000) * SAMPLE_TIME
    command = (25.0 * (1 - np.cos(phase)))[:, None]
    noise = np.random.default_rng(0).normal(0.0, SIGMA, command.shape)
    data = sampled_record("slow", command, simulate(truth, command) + noise, SAMPLE_TIME, ("x",), "um", start="settled")
    notes = " ".join(identify([data], "hampi", thresholds=THRESHOLDS).report["notes"])
    assert "not identifiable from these records" in notes and "m1 (± " in notes
    assert "no resonance is identifiable" in notes
    assert "record" not in notes.replace("records", "") and "100 Hz" not in notes


@pytest.mark.parametrize("count", [3, 4, 5])
def test_few_operators_are_for_the_loop(count):
    """Of a drive from 0 V and back no play that is wider than half of it moves after the first rise."""
    command = (25.0 * (1 - np.cos(2 * np.pi * np.arange(4000) / 1000)))[:, None]
    measured = sum(simulate(replace(plant(), chain=Chain((PlayOperator(r),))), command) for r in (0.0, 4.0, 8.0, 12.0, 16.0))
    model = identify(
        [sampled_record("loops", command, measured, SAMPLE_TIME, ("x",), "um", start="settled")], "pi", operators=count
    ).model
    left = np.std((measured - simulate(model, command))[2000:])
    straight = np.polynomial.Polynomial.fit(command[2000:, 0], measured[2000:, 0], 1)(command[2000:, 0])
    assert left < 0.2 * np.std(measured[2000:, 0] - straight)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"command": np.full((200, 1), 3.0)}, "never moves"),
        ({"measurement": np.full((200, 1), 3.0)}, "never moves"),
        ({"command": np.zeros((20, 1)), "measurement": np.zeros((20, 1))}, "at least 50"),
    ],
)
def test_records_that_tell_nothing_are_refused(change, words):
    k = np.arange(200.0)[:, None]
    rows = {"command": np.sin(k), "measurement": np.sin(k), **change}
    data = sampled_record("dull", rows["command"], rows["measurement"], 1e-3, ("x",), "um", start="settled")
    with pytest.raises(InputError, match=words):
        identify([data], "hapi")


def test_the_papers_sequence_names_the_missing_experiment():
    phase = 2 * np.pi * 50.0 * np.arange(4000) * SAMPLE_TIME
    command = (20.0 * (1 - np.cos(phase)))[:, None]
    data = sampled_record("fast only", command, simulate(plant(), command), SAMPLE_TIME, ("x",), "um", start="settled")
    with pytest.raises(InputError, match="fast only: the paper's sequence needs a step"):
        identify([data], "hampi", "paper")


@pytest.mark.parametrize("family", ["pi", "rdpi", "hapi", "hampi"])
def test_a_stage_that_falls_as_the_command_rises_is_fitted_like_its_mirror_image(family, tmp_path):
    """It once left more than a gain did. The hysteresis rises as elsewhere; a gain of -1 turns it over, in the model file as well."""
    rising = record(plant(), 4)
    falling = rising.with_values(measurement=-rising.measurement)
    known, found = (identify([data], family) for data in (rising, falling))
    assert [stage.name for stage in found.model.chain.stages if stage.name != "offset"] == [
        *(stage.name for stage in known.model.chain.stages if stage.name != "offset"),
        "gain",
    ]
    assert found.model.chain.stages[0] == known.model.chain.stages[0]
    save_model(found.model, tmp_path / "falling.yaml")
    turned = simulate(load_model(tmp_path / "falling.yaml"), rising.command)
    np.testing.assert_allclose(turned, -simulate(known.model, rising.command), rtol=0.0, atol=1e-12 * np.ptp(turned))


def test_a_rising_stage_driven_beyond_its_resonance_is_not_turned_over():
    """There the measurement falls as the command rises."""
    mode = TransferFunction([4e6], [1.0, 200.0, 4e6])
    model = replace(plant(), chain=Chain((ModifiedPrandtlIshlinskii(THRESHOLDS, WEIGHTS), mode)))
    row = np.arange(8000)
    sweep = 25.0 - 20.0 * np.cos(2 * np.pi * SAMPLE_TIME * (450.0 * row + 0.02 * row**2))
    data = sampled_record("fast", sweep[:, None], simulate(model, sweep[:, None]), SAMPLE_TIME, ("x",), "um", start="settled")
    assert np.cov(data.command[:, 0], data.measurement[:, 0])[0, 1] < 0.0
    fit = identify([data], "hapi")
    assert "gain" not in [stage.name for stage in fit.model.chain.stages]
    assert fit.report["records"][0]["nrmse_own_zero"] < 1.0


def test_turning_points_are_all_that_operators_remember():
    rng = np.random.default_rng(0)
    command = np.cumsum(rng.normal(size=3000))
    stage = ModifiedPrandtlIshlinskii(THRESHOLDS, WEIGHTS)
    whole, short = (stage.filter(Sampling(SAMPLE_TIME, 1)) for _ in range(2))
    whole.settle(np.zeros(1))
    short.settle(np.zeros(1))
    full = whole.process(command[:, None])[-1]
    turning = np.append(turning_points(command), len(command) - 1)
    np.testing.assert_array_equal(short.process(command[turning][:, None])[-1], full)


def test_stretches_see_the_memory_of_what_came_before():
    """A window from the middle of a record gives the same residual as the whole record does there."""
    truth = plant()
    data = record(truth, 2, sigma=0.0)
    windows = whole_records([data], 0)
    structure = Structure(modes=1, zeros=1, delay=True)
    parameters = np.array([np.log(np.sqrt(5.982e7)), np.log(8602.0 / 2 / np.sqrt(5.982e7)), -5e3 / 5.982e7 * np.sqrt(5.982e7), 0.4])
    theta = np.array([*WEIGHTS, 6e-8, 3e-8, -4e-5])
    operators = Operators(np.array(THRESHOLDS), dynamic=True, center=25.0)
    cut = stretches(windows, 12000, length=0.2)
    assert sum(len(window.command) for window in cut) < 0.8 * len(data.command)
    grams = gram_matrices(cut, operators, structure, parameters, theta, "none", 1)
    vector = np.concatenate([theta, np.zeros(structure.size), [-1.0]])
    assert np.sqrt(max(vector @ (grams.fitted + grams.held_out) @ vector, 0.0) / sum(grams.rows)) < 1e-5


def test_measured_nested_loops_of_a_piezo_stack(measured_data):
    """Fitted on one full cycle of the first file, scored on nested loops of the second: at most 3.5 % of range."""
    folder = measured_data / "pea_p885"
    first, second = (np.loadtxt(folder / name) for name in ("Model_Vi_Do.dat", "Test_Vi_Do_Di.dat"))
    cycle = sampled_record(
        "cycle", first[2005:2206, :1].copy(), first[2005:2206, 4:5].copy(), 1 / 200, ("x",), "um", "foh", "unknown"
    )
    for family in ("hapi", "hampi"):
        model = identify([cycle], family).model
        simulated = simulate(model, second[5:14150, :1].copy(), 1 / 200, "foh")[7945:, 0]
        measured = second[7950:14150, 4]
        assert np.std(simulated - measured) / np.ptp(measured) < 0.035, family


def late_plant(command: np.ndarray, modes: list[tuple[float, float, float]], late: int) -> np.ndarray:
    """Play operators before parallel modes (gain, rad per sample, damping), some samples late; exact, by numpy alone."""
    driven = 0.7 * command
    for threshold in (4.0, 12.0, 25.0, 40.0):
        held, state = np.empty_like(command), command[0]
        for row, value in enumerate(command):
            held[row] = state = min(max(state, value - threshold), value + threshold)
        driven += 0.08 * held
    driven = np.concatenate([np.full(late, driven[0]), driven])[: len(driven)]
    measured = np.zeros_like(driven)
    for gain, omega, damping in modes:
        pole = omega * (-damping + 1j * np.sqrt(1.0 - damping**2))
        weight = gain * omega**2 / (2j * pole.imag)
        state = -driven[0] * weight / pole
        for row, value in enumerate(driven):
            measured[row] += 2.0 * state.real
            state = np.exp(pole) * state + weight * value * np.expm1(pole) / pole
    return measured


def loops_and_noise(rows: int, seed: int) -> np.ndarray:
    """Slow shrinking loops, then noise of the lower fifth of the band."""
    rng = np.random.default_rng(seed)
    row = np.arange(rows)
    loops = 50.0 - 50.0 * np.cos(12 * np.pi * row / rows) * np.linspace(1.0, 0.3, rows)
    spectrum = np.fft.rfft(rng.normal(size=rows))
    spectrum[rows // 10 :] = 0.0
    noise = np.fft.irfft(spectrum, rows)
    return np.concatenate([loops * np.minimum(row / 200, 1.0), 50.0 + 45.0 * noise / np.abs(noise).max()])


def identified_of(command: np.ndarray, measured: np.ndarray, start: str = "settled", **options: object) -> Fit:
    noisy = measured + 1e-3 * np.random.default_rng(5).normal(size=len(measured)) * np.ptp(measured)
    data = sampled_record("late", command[:, None], noisy[:, None], 1e-4, ("x",), "um", start=start)
    return identify([data], "hapi", **options)


def left_of(fit: Fit, command: np.ndarray, measured: np.ndarray) -> float:
    """RMS error (% of the range) about its mean."""
    error = measured - simulate(fit.model, command[:, None], 1e-4)[:, 0]
    return 100.0 * float(np.std(error) / np.ptp(measured))


def test_a_mode_half_a_period_late_is_found():
    """Neither the mode nor the delay alone lowers the error: the fit had no dynamics and explained nothing."""
    command, fresh = loops_and_noise(5000, 1), loops_and_noise(5000, 2)
    modes = [(1.0, 2 * np.pi * 0.042, 0.015)]
    fit = identified_of(command, late_plant(command, modes, 12))
    assert left_of(fit, fresh, late_plant(fresh, modes, 12)) < 0.5
    [delay] = [stage for stage in fit.model.chain.stages if isinstance(stage, Delay)]
    assert float(np.max(delay.tau)) == pytest.approx(12e-4, abs=5e-5)


@pytest.mark.parametrize("structure", [None, Structure(modes=2, zeros=2, delay=True)])
def test_a_second_mode_behind_a_delay_is_found(structure):
    """A lag once stood in for the delay; from there the second mode was not seen, or with a third mode and six zeros."""
    command, fresh = (50.0 + 45.0 * lines(8000, seed) for seed in (1, 2))
    modes = [(0.9, 2 * np.pi * 0.031, 0.02), (0.1, 2 * np.pi * 0.07, 0.01)]
    fit = identified_of(command, late_plant(command, modes, 8), structure=structure)
    assert fit.report["structure"] == ["2 modes, 2 zeros, delay"]
    assert left_of(fit, fresh, late_plant(fresh, modes, 8)) < 0.7


def lines(rows: int, seed: int) -> np.ndarray:
    """Sines that are evenly spread in the logarithm of frequency."""
    rng = np.random.default_rng(seed)
    spectrum = np.zeros(rows // 2 + 1, complex)
    number = np.unique(np.geomspace(1, 0.15 * rows, 60).astype(int))
    spectrum[number] = np.exp(2j * np.pi * rng.random(len(number)))
    waves = np.fft.irfft(spectrum, rows)
    return waves / np.abs(waves).max()


def test_two_levels_tell_no_weights():
    """All plays follow such a command in proportion: the weights are those of a gain, and said to be unknown."""
    command = np.repeat(np.where(np.random.default_rng(2).random(1500) < 0.5, 10.0, 90.0), 4)
    modes = [(1.0, 2 * np.pi * 0.031, 0.02)]
    fit = identified_of(command, late_plant(command, modes, 0), "unknown", structure=Structure(modes=1))
    weights = [row for row in fit.report["parameters"] if row["name"].startswith("weights")]
    assert weights[0]["value"] == pytest.approx(0.9, abs=0.2)
    assert max(abs(row["value"]) for row in weights[1:]) < 0.2
    assert min(row["standard_error"] for row in weights) > 0.3
    assert any("not identifiable from these records" in note and "weights[" in note for note in fit.report["notes"])
    fresh = 50.0 + 45.0 * lines(6000, 3)
    assert left_of(fit, fresh, late_plant(fresh, modes, 0)) < 6.0
