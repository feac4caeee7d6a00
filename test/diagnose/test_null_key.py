# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The null's threshold is kept under a key that has all that it depends on, and no more."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.configuration import CONFIGURATION, Configuration
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.search import null_distribution
from hyst_control.diagnose.search.candidate import Candidate, Member
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.search.fit import Linearized, fit
from hyst_control.diagnose.search.null_distribution import cache_key, threshold
from hyst_control.effects import EFFECTS
from hyst_control.model_file import Model

STEP, COUNT = 1e-3, 600
FEW = replace(CONFIGURATION, null_distribution=replace(CONFIGURATION.null_distribution, records=4))
COMMAND = 10.0 * np.random.default_rng(1).standard_normal((COUNT, 1)).cumsum(axis=0) / np.sqrt(COUNT)


def linearized(sigma: float = 1e-2, seed: int = 2, step: float = STEP, tolerance: float = 0.01, **pieces: Any) -> Linearized:
    """A first-order lag with these tolerances, and a measurement of it with noise of this seed."""
    lag = TransferFunction((2.0,), (0.01, 1.0))
    model = Model(
        "lag", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((lag,)), tolerance={"num": tolerance, "den": tolerance}
    )
    problem = Problem(model, (Piece(COMMAND, np.zeros_like(COMMAND)),), step, "zoh", np.array([sigma]))
    clean = problem.rows(problem.simulate(model.chain.stages))
    noisy = clean + sigma * np.random.default_rng(seed).standard_normal(clean.shape)
    return Linearized(replace(problem, pieces=(Piece(COMMAND, noisy, **pieces),)), scatter_of(model))


def members(one: Linearized) -> list[Member]:
    return [member for member in catalogue(one.problem, {}) if member.name in ("gain", "delay", "offset")]


def key(one: Linearized, configuration: Configuration = FEW, seed: int = 0) -> str:
    return cache_key(one, members(one), seed, configuration)


def edited(monkeypatch: pytest.MonkeyPatch, **changes: float) -> None:
    """The offset's first parameter with another range or prior."""
    effect = EFFECTS["offset"]

    def parameters(around):
        first, *others = effect.parameters(around)
        return (replace(first, **changes), *others)

    monkeypatch.setitem(EFFECTS, "offset", replace(effect, parameters=parameters))


@pytest.mark.parametrize("change", [{"scale": 0.77}, {"upper": 0.77}, {"lower": -0.77}, {"starts": (0.077,)}])
def test_an_edited_prior_reuses_no_threshold(change, monkeypatch):
    """The same names on the same record: only the number says that it is another catalogue."""
    before = key(linearized())
    edited(monkeypatch, **change)
    assert key(linearized()) != before


def test_an_edited_prior_is_simulated_anew(monkeypatch, tmp_path):
    """Of an offset that is nearly known beforehand no record without a gap makes anything."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))

    def found(cache: bool = True) -> float:
        here = linearized()
        offsets = [member for member in members(here) if member.name == "offset"]
        return threshold(here, offsets, configuration=FEW, cache=cache)

    wide = found()
    assert found() == wide > 1e-3 and len(list(tmp_path.rglob("*.json"))) == 1
    edited(monkeypatch, scale=1e-9)
    assert found() == found(cache=False) < 1e-3
    assert len(list(tmp_path.rglob("*.json"))) == 2


def test_what_else_it_depends_on(monkeypatch):
    here = linearized()
    keep = np.arange(COUNT) >= 100
    wider = replace(FEW, policy=replace(FEW.policy, margin=FEW.policy.margin + 1.0))
    others = {
        "sample time": key(linearized(step=2.0 * STEP)),
        "noise": key(linearized(sigma=3e-2)),
        "rows that count": key(linearized(keep=keep)),
        "configuration": key(here, wider),
        "seed": key(here, seed=1),
        "members": cache_key(here, members(here)[:-1], 0, FEW),
    }
    monkeypatch.setattr(null_distribution, "installed_version", lambda otherwise: "another")
    others["version"] = key(here)
    monkeypatch.undo()
    assert len({key(here), *others.values()}) == 1 + len(others), others


def test_records_of_one_command_share_a_threshold():
    """Other noise of the same size moves the measurement's range, and with it the effects' ranges on that record."""
    one, other = linearized(seed=2), linearized(seed=3)
    assert one.problem.surroundings.measurement != other.problem.surroundings.measurement
    assert key(one) == key(other)


@pytest.mark.parametrize("text", ["NaN", "Infinity", "-Infinity", "-3.0", '"x"', "[" * 100_000, "1e999", "null"])
def test_a_spoilt_threshold_in_the_cache_is_computed_anew(text, tmp_path, monkeypatch):
    """NaN and infinity are numbers to JSON; every verdict would follow from them."""
    file = tmp_path / "threshold.json"
    monkeypatch.setattr(null_distribution, "_cache_file", lambda _: file)
    monkeypatch.setattr(null_distribution, "null_scores", lambda *_: np.array([1.0, 2.0, 3.0]))
    one = linearized()
    file.write_text(f'{{"threshold": {text}}}')
    found = threshold(one, members(one), configuration=FEW)
    assert 1.0 <= found <= 3.0 and threshold(one, members(one), configuration=FEW) == found


def test_scores_are_what_fits_gain_on_simulated_records():
    """Each record is simulated with the coefficients and the noise drawn for it, and fitted with and without every effect.

    Of effects of either sign: that a delay is never negative, the scores do not know.
    """
    here, some = linearized(), replace(CONFIGURATION.null_distribution, records=12)
    both_signs = [member for member in members(here) if member.name != "delay"]
    scores = null_distribution.null_scores(here, both_signs, 0, some)
    gained = []
    for index in range(12):
        random = np.random.default_rng([0, index])
        z = random.standard_normal(here.count)
        measured = here.simulate(z) + random.standard_normal(len(here.measured))
        alone = fit(here, measured=measured, rounds=20).misfit
        candidates = [Candidate((member,)) for member in both_signs]
        fits = [fit(here, each.unknowns(), x, measured=measured, rounds=20) for each in candidates for x in each.starts()]
        gained.append(alone - min(one.misfit for one in fits))
    np.testing.assert_allclose(scores, gained, rtol=0.05, atol=0.05)


@pytest.mark.parametrize("tolerance", [1e-3, 0.3])
def test_scores_are_ratios_of_gaussian_densities(tolerance):
    """Of a gain alone, beside coefficients that noise hardly tells or tells well, with the covariance of the record written out."""
    here = linearized(tolerance=tolerance)
    offsets = [member for member in members(here) if member.name == "offset"]
    some = replace(CONFIGURATION.null_distribution, records=5)
    scores = null_distribution.null_scores(here, offsets, 0, some)
    [design] = {tuple(design[:, 0]) for design in null_distribution.tangents(here, offsets, some.starts)}
    covariance = np.eye(len(here.measured)) + here.columns @ here.columns.T
    for index, score in enumerate(scores):
        random = np.random.default_rng([0, index])
        z = random.standard_normal(here.count)
        record = random.standard_normal(len(here.measured)) + here.columns @ z
        places = np.linspace(-6.0, 6.0, 5) / np.linalg.norm(design)  # in usual sizes of the offset, which noise tells well
        none, *densities = (
            multivariate_normal.logpdf(record, x * np.array(design), covariance) - 0.5 * x**2 for x in (0.0, *places)
        )
        curve = np.polynomial.Polynomial.fit(places, np.array(densities) - none, 2)
        assert score == pytest.approx(curve(curve.deriv().roots()[0]), rel=1e-6)


def test_scores_of_many_records_at_once_are_those_of_each(monkeypatch):
    """Also of a number of records that leaves the last block half full."""
    here = linearized()
    some = replace(CONFIGURATION.null_distribution, records=7)
    together = null_distribution.null_scores(here, members(here), 0, some)
    monkeypatch.setattr(null_distribution, "TOGETHER", 1)
    np.testing.assert_allclose(together, null_distribution.null_scores(here, members(here), 0, some), rtol=1e-9)
    assert len(together) == 7 and np.ptp(together) > 0.0


def test_records_without_a_gap_are_rounded_where_the_measurement_is():
    """Coarse steps of a converter let effects gain more than white noise of the same size: the threshold has to know of it."""
    white = linearized(sigma=0.3)
    coarse = Linearized(replace(white.problem, steps=(1.0,)), white.scatter)
    noise = np.random.default_rng(3).standard_normal(len(coarse.nominal))
    drawn = null_distribution._rounded(coarse.problem, coarse.nominal, noise)
    steps = (coarse.nominal + drawn) * 0.3
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
    assert np.std(drawn) == pytest.approx(1.0, rel=0.15)
    scores = [np.median(null_distribution.null_scores(one, members(one), 0, FEW.null_distribution)) for one in (white, coarse)]
    assert scores[1] > scores[0]
    assert key(coarse) != key(white)
