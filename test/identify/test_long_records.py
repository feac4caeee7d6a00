# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Long records: what is found block by block is what the whole has, in the memory of some blocks."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain import command_features as features_module
from hyst_control.chain.command_features import CommandFeatures
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.identify import identify
from hyst_control.identify.assess import fit_report
from hyst_control.identify.data.fit_windows import first_motion, memory_filled, response_sign, virgin_rows, with_sign
from hyst_control.identify.model_error import learned_discrepancy
from hyst_control.identify.model_error.learned_discrepancy import discrepancy_of, learn
from hyst_control.identify.solve import gram_sums
from hyst_control.identify.solve.bounded_least_squares import covariance
from hyst_control.identify.solve.gram_sums import Operators, Window
from hyst_control.identify.solve.simulation_error import driving_signal
from hyst_control.identify.solve.stable_dynamics import Structure
from hyst_control.model_file import Model, simulate
from hyst_control.records import correlation, quantization_step
from hyst_control.records.correlation import correlation_length
from hyst_control.records.quantization_step import rounding_weights
from hyst_control.records.record import sampled_record
from hyst_control.records.stream import row_store

STEP = 1e-3
ROWS = 2**16


@pytest.fixture
def small(monkeypatch):
    """Blocks of 1001 rows, and everything that is bounded for long records bounded at a few thousand."""
    monkeypatch.setattr(row_store, "BLOCK", 1001)
    monkeypatch.setattr(row_store, "IN_MEMORY", 1024)
    monkeypatch.setattr(features_module, "BLOCK", 1001)
    monkeypatch.setattr(features_module, "LONGEST", 4000)
    monkeypatch.setattr(fit_report, "NOISE_ROWS", 4000)
    monkeypatch.setattr(fit_report, "SPECTRUM_ROWS", 4000)
    monkeypatch.setattr(learned_discrepancy, "LONGEST", 4000)
    monkeypatch.setattr(learned_discrepancy, "SHORTEST_PART", 2000)
    monkeypatch.setattr(correlation, "LONGEST", 4000)
    monkeypatch.setattr(quantization_step, "LONGEST", 4000)


def loops(frequency: float, rows: int = ROWS, amplitude: float = 10.0) -> np.ndarray:
    time = STEP * np.arange(rows)
    return amplitude * (0.7 + 0.3 * np.sin(0.3 * time)) * np.sin(2 * np.pi * frequency * time)


def peak(work) -> float:
    """Largest memory (bytes) that a call takes for itself."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("keep", [0.0, 0.9, 0.999])
def test_the_correlation_length_of_a_long_first_order_process(monkeypatch, keep):
    """(1 + keep) / (1 - keep), whether its lags lie within a stretch or not."""
    from scipy.signal import lfilter

    monkeypatch.setattr(correlation, "LONGEST", 2**15)
    noise = np.random.default_rng(1).standard_normal(2**20)
    found = correlation_length(lfilter([1.0], [1.0, -keep], noise)[:, None])
    assert found == pytest.approx((1 + keep) / (1 - keep), rel=0.2)


def test_the_correlation_length_of_a_slow_wave_is_that_of_the_whole(monkeypatch):
    wave = np.cos(2 * np.pi * np.arange(60000) / 20000.0)[:, None]
    whole = correlation_length(wave)
    monkeypatch.setattr(correlation, "LONGEST", 4000)
    assert correlation_length(wave) == pytest.approx(whole, rel=0.05)
    assert correlation_length(np.zeros((60000, 1))) == 1.0


def test_features_block_by_block_are_the_features(small):
    command = loops(2.0, 7000)
    features = CommandFeatures.of([command], STEP)
    found = [rows for _, rows in features.blocks(command, STEP)]
    assert len(found) == 7
    np.testing.assert_array_equal(np.concatenate(found), features.rows(command, STEP))


def test_a_long_record_teaches_what_the_whole_of_it_does(request):
    from hyst_control.chain.command_features import play

    clean = [loops(2.0), loops(6.0)]
    random = np.random.default_rng(2)
    errors = [0.2 * (play(u, 2.6) - u) + 0.01 * u**2 + 0.02 * random.standard_normal(len(u)) for u in clean]
    whole = learn(clean, [error[500:] for error in errors], STEP)
    request.getfixturevalue("small")
    parts = learn(clean, [error[500:] for error in errors], STEP)
    assert whole is not None and parts is not None
    rows = whole.features.rows(loops(4.0), STEP)
    expected, found = rows @ whole.mean, parts.features.rows(loops(4.0), STEP) @ parts.mean
    assert np.std(found - expected) < 0.1 * np.std(expected)
    assert parts.rest == pytest.approx(whole.rest, rel=0.2)


def test_the_error_of_a_long_record_takes_the_memory_of_blocks(small):
    commands = [loops(2.0), loops(6.0)]
    errors = [np.random.default_rng(3).standard_normal((ROWS, 1)) + 0.1 * u[:, None] for u in commands]
    taken = peak(lambda: discrepancy_of([u[:, None] for u in commands], errors, STEP))
    assert taken < 4 * 8 * ROWS  # the features alone of one record are 28 such columns


LONG = 2**18


@pytest.fixture(scope="module")
def long_record():
    """A rounded record of play operators that begins on the initial loading curve."""
    command = loops(2.0, LONG)[:, None] + 10.0 * np.minimum(np.arange(LONG) / 500.0, 1.0)[:, None]
    plant = Model(
        "", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((PrandtlIshlinskii([2.0, 5.0], [0.3, 0.2], w0=1.0),))
    )
    noise = 0.01 * np.random.default_rng(4).standard_normal((LONG, 1))
    return sampled_record(
        "long", command, np.round((simulate(plant, command) + noise) / 0.01) * 0.01, STEP, ("x",), "um", start="auto"
    )


@pytest.mark.parametrize("family, options", [("pi", {"thresholds": (0.0, 2.0, 5.0)}), ("madelung", {})])
def test_the_memory_of_a_fit_does_not_grow_with_the_record(long_record, small, family, options):
    """Twice the rows take less than half a column of them more."""
    half = long_record.rows(0, LONG // 2)
    identify([half.rows(0, 3000)], family, **options)  # compiles what it needs
    fits = []
    shorter, longer = (peak(lambda data=data: fits.append(identify([data], family, **options))) for data in (half, long_record))
    assert fits[1].report["records"][0]["nrmse"] < 0.5
    assert longer - shorter < 0.5 * 8 * (LONG // 2)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_sign_of_a_response_is_found_and_turned(small, sign):
    command = loops(2.0, 5000)
    window = Window(command, sign * (0.5 * command + 3.0), STEP, "zoh", 0, 0)
    assert response_sign([window]) == sign
    turned = with_sign(window, sign)
    assert (turned is window) == (sign == 1.0)
    np.testing.assert_array_equal(turned.measurement, 0.5 * command + 3.0)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_the_memory_before_a_record_is_run_through_first(small, hold):
    command = loops(2.0, 5000)[:, None]
    chain = Chain((PrandtlIshlinskii([2.0], [0.3], w0=1.0), TransferFunction([1.0], [1.0, 0.01])))
    model = Model("", ("x",), {"command": "V", "measurement": "um"}, STEP, chain, hold=hold)
    expected = simulate(model, command)[3000:]
    np.testing.assert_array_equal(simulate(model, command[3000:], memory=command[:3000]), expected)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_the_driving_signal_has_the_memory_first(hold):
    command, memory = np.arange(5.0), np.array([8.0, 9.0])
    window = Window(command, command, STEP, hold, 0, 0, memory=memory)
    expected = [8, 8, 9, 0, 1, 2, 3] if hold == "zoh" else [8, 9, 0, 1, 2, 3, 4]
    signal, first = driving_signal(window)
    assert signal[:, 0].tolist() == expected and first == 2
    alone = driving_signal(Window(command, command, STEP, hold, 0, 0))[0][:, 0].tolist()
    assert alone == ([0, 0, 1, 2, 3] if hold == "zoh" else [0, 1, 2, 3, 4])


def test_gram_matrices_of_neighbors_are_added_up(monkeypatch):
    command = loops(2.0, 40000)
    measured = 0.5 * command + 0.1 * np.random.default_rng(5).standard_normal(len(command))
    window = Window(command, measured, STEP, "foh", 0, 0)
    monkeypatch.setattr(gram_sums, "BLOCK", 40)

    def grams():
        return gram_sums.gram_matrices([window], Operators(np.array([0.0])), Structure(), np.zeros(0), np.zeros(1), "offset", 1)

    many = grams()
    monkeypatch.setattr(gram_sums, "MAX_BLOCKS", 300)
    few = grams()
    assert len(many.blocks) == 1000 and len(few.blocks) == 250
    np.testing.assert_array_equal(few.fitted, many.fitted)
    np.testing.assert_array_equal(few.held_out, many.held_out)
    np.testing.assert_allclose(few.blocks.sum(axis=0), many.blocks.sum(axis=0), rtol=1e-12)
    spread = [np.sqrt(covariance(each.blocks, np.array([0.5, 0.0]))[0, 0]) for each in (many, few)]
    assert spread[1] == pytest.approx(spread[0], rel=0.3)


def test_places_in_a_command_are_found_block_by_block(small):
    command = np.concatenate(
        [
            np.full(3000, 2.0),
            np.linspace(2.0, 9.0, 2000),
            np.linspace(9.0, -4.0, 2500),
            np.linspace(-4, 9, 4500),
            np.linspace(9, -4, 4500),
        ]
    )
    assert command[first_motion(command)] != 2.0 and first_motion(command) == 3001
    assert first_motion(np.full(5000, 1.0)) == 5000
    reached = memory_filled(command)
    assert 5000 < reached <= 7500 and command[reached] <= -4.0 + 0.01 * 13.0 < command[reached - 1]
    assert virgin_rows(command) == reached
    assert virgin_rows(command[:8000]) == 0


def test_runs_of_rounded_readings_count_once_in_long_records(small):
    readings = np.repeat(np.tile(np.arange(50.0), 5), 100)
    weight = rounding_weights(np.random.default_rng(6).standard_normal(len(readings)), readings)
    assert weight is not None and weight.mean() == pytest.approx(1.0)
    whole = weight.reshape(-1, 100).sum(axis=1)
    np.testing.assert_allclose(whole, whole[0])
