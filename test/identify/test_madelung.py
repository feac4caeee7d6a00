# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identification of Madelung hysteresis from slow loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.identify import identify
from hyst_control.identify.mhl import madelung
from hyst_control.model_file import Model, load_model, save_model, simulate
from hyst_control.records.record import Record, sampled_record

UP = 3.2 * np.array([-0.4624, 1.788, -2.398, 2.037, 2.228]) / 3.1926
DOWN = 3.2 * np.array([0.9457, -3.005, 3.248, -2.083, 4.104]) / 3.2097
SIGMA = 0.002


def loops(seconds: float = 12.0, rate: float = 200.0) -> np.ndarray:
    """Loops of 0.5 Hz from 0 V, a full one of 100 V, then of an amplitude that falls to 20 V."""
    t = np.arange(int(seconds * rate)) / rate
    return (100.0 - 80.0 * np.maximum(t - 2.0, 0.0) / seconds) * 0.5 * (1.0 - np.cos(np.pi * t))


def made(stages, command: np.ndarray, seed: int = 0, start: str = "settled", rows: slice = slice(None)) -> Record:
    model = Model("truth", ("x",), {"command": "V", "measurement": "mrad"}, 5e-3, Chain(tuple(stages)), hold="foh")
    y = simulate(model, command[:, None]) + np.random.default_rng(seed).normal(0, SIGMA, (len(command), 1))
    return sampled_record("loops", command[rows, None], y[rows], 5e-3, ("x",), "mrad", "foh", start)


def deviation(found: Madelung, truth: Madelung) -> float:
    """Largest distance of the curves, relative to the full output."""
    x = np.linspace(0, 1, 101)
    pairs = zip(found.curves(1)[0], truth.curves(1)[0])
    return max(float(np.max(np.abs(found.output_scale * a(x) - truth.output_scale * b(x)))) for a, b in pairs) / 2.0


TRUTH = Madelung(UP, DOWN, 100.0, 0.625)


@pytest.mark.parametrize("sign, zero", [(1.0, 0.0), (1.0, -7.3), (-1.0, 2.0)])
def test_the_published_curves_are_found_again(sign, zero):
    """Noise of 0.1 % of the range; sensor zero and a response that falls with the command are found, too."""
    fit = identify([made([TRUTH, Gain(sign), Offset(zero)], loops())], "madelung")
    assert deviation(fit.model.chain.stages[0], TRUTH) < 1e-3
    clean = made([TRUTH, Gain(sign), Offset(zero)], 50 + 40 * np.sin(np.linspace(0, 30, 3000)), seed=1)
    error = simulate(fit.model, clean.command) - clean.measurement
    assert np.sqrt(np.mean(error**2)) < 1.1 * SIGMA
    assert fit.report["records"][0]["nrmse"] < 0.12
    np.testing.assert_allclose(fit.model.noise["sigma"], SIGMA, rtol=0.1)


def test_the_standard_errors_cover_the_truth():
    rows = identify([made([TRUTH], loops())], "madelung").report["parameters"]
    truth = np.concatenate([UP, DOWN]) / 3.2
    z = [(row["value"] - value) / row["standard_error"] for row, value in zip(rows, truth)]
    assert len(z) == 10 and np.sqrt(np.mean(np.square(z))) < 3.0


def test_piecewise_cubics_follow_any_curve():
    fit = identify([made([TRUTH], loops())], "madelung", knots=np.linspace(0, 1, 7))
    assert deviation(fit.model.chain.stages[0], TRUTH) < 6e-3
    other = Madelung([0.0, 0.1, 0.3, 1.0], [0.0, 0.5, 0.8, 1.0], 100.0, 2.0, knots=[0.0, 0.25, 0.5, 1.0])
    fit = identify([made([other], loops())], "madelung", knots=[0.0, 0.25, 0.5, 1.0])
    assert deviation(fit.model.chain.stages[0], other) < 1e-3


def test_a_record_that_begins_anywhere_counts_from_where_its_memory_is_full():
    whole = np.concatenate([loops(), loops()])
    fit = identify([made([TRUTH], whole, start="unknown", rows=slice(1700, None))], "madelung")
    assert deviation(fit.model.chain.stages[0], TRUTH) < 1.5e-3


def test_curves_stay_monotone_where_the_data_would_bend_them():
    """A truth with a flat piece and noise: a free least squares would fall there."""
    flat = Madelung([0.0, 0.4, 0.401, 1.0], [0.0, 0.598, 0.6, 1.0], 100.0, 2.0, knots=[0.0, 0.3, 0.6, 1.0])
    for options, allowed in (({"degree": 7}, 10.0), ({"knots": np.linspace(0, 1, 11)}, 2.0)):
        fit = identify([made([flat], loops())], "madelung", **options)
        x = np.linspace(0, 1, 2001)
        assert all(np.all(np.diff(curve(x)) > 0) for curve in fit.model.chain.stages[0].curves(1)[0])
        assert fit.report["records"][0]["nrmse"] < allowed


def test_the_model_is_written_and_read(tmp_path):
    fit = identify([made([TRUTH, Offset(1.0)], loops())], "madelung")
    save_model(fit.model, tmp_path / "model.yaml")
    assert load_model(tmp_path / "model.yaml") == fit.model
    assert fit.model.valid["command"] == [0.0, pytest.approx(100.0, rel=0.02)]


def test_separate_inverse_curves_invert_the_major_loop():
    """As the paper's pair does: within 7e-4 of the range."""
    inverse = madelung.fit_inverse(TRUTH)
    assert (inverse.input_scale, inverse.output_scale) == (pytest.approx(2.0), pytest.approx(100.0))
    u = np.concatenate([np.linspace(0, 100, 500), np.linspace(100, 0, 500)])
    runs = []
    for stage, signal in ((TRUTH, u), (inverse, None)):
        running = stage.filter(Sampling(1.0, 1))
        running.settle(np.zeros(1))
        runs.append(running.process((runs[-1] if signal is None else signal[:, None]).copy()))
    assert np.max(np.abs(runs[1][:, 0] - u)) < 0.1


def test_what_the_records_do_not_reach_is_said():
    fit = identify([made([TRUTH], 0.6 * loops())], "madelung", input_scale=100.0)
    assert any("span 0 to 6" in note and "slow loop over the whole drive" in note for note in fit.report["notes"])


@pytest.mark.parametrize("shift", [-100.0, -60.0, 30.0])
@pytest.mark.parametrize("start", ["settled", "unknown"])
def test_any_drive_has_curves(shift, start):
    """Negative, bipolar and offset drives: the same curves between other ends, which the model file says."""
    truth = replace(TRUTH, input_offset=shift)
    whole = np.concatenate([loops(), loops()]) + shift
    fit = identify(
        [made([truth, Offset(0.3)], whole, start=start, rows=slice(1700 if start == "unknown" else 0, None))], "madelung"
    )
    stage = fit.model.chain.stages[0]
    assert (stage.input_offset, stage.input_scale) == (pytest.approx(shift, abs=0.1), pytest.approx(100.0, rel=0.002))
    assert deviation(stage, truth) < 1.5e-3


@pytest.mark.parametrize(
    "change, options, word",
    [
        (lambda u: u, {"input_offset": 200.0}, "input_scale: must be > 200 V, the lower end of the curves"),
        (lambda u: u, {"input_offset": 50.0, "input_scale": 40.0}, "input_scale: must be > 50 V"),
        (lambda u: 0 * u + 3.0, {}, "never moves"),
        (lambda u: u, {"degree": 0}, "degree: must be an integer from 1 to 12, got 0"),
        (lambda u: u, {"knots": [0.0, 1.0]}, "knots: must be at least three"),
        (lambda u: u, {"input_scale": -1.0}, "input_scale: must be a number >= 0 V, got -1"),
    ],
)
def test_what_cannot_be_fitted_is_refused(change, options, word):
    data = made([TRUTH], loops())
    bad = sampled_record("loops", change(data.command), data.measurement, 5e-3, ("x",), "mrad", "foh", start="settled")
    with pytest.raises(InputError, match=word):
        identify([bad], "madelung", **options)


@pytest.mark.parametrize("seed", [1, 6, 8])
def test_records_that_no_curve_explains_end_in_a_small_curve(seed):
    """Noise for a measurement: the search ended in "the curve falls between 0.1736 and 0.1742 … correct the coefficients"."""
    rng = np.random.default_rng(seed)
    command = 50.0 + 10.0 * rng.normal(size=(3000, 1))
    fit = identify([sampled_record("noise", command, rng.normal(size=(3000, 1)), 1e-3, ("x",), "um", start="settled")], "madelung")
    x = np.linspace(0, 1, 201)
    assert all(np.all(np.diff(curve(x)) > 0) for curve in fit.model.chain.stages[0].curves(1)[0])
