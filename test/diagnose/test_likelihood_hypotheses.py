# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Weights of hypotheses: probabilities are frequencies, and what no effect does is something else."""

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.diagnose.likelihood.decide import Judgement, judge
from hyst_control.diagnose.likelihood.evidence import Fit
from hyst_control.diagnose.likelihood.fits import Fits, Hypothesis
from hyst_control.diagnose.likelihood.hypotheses import Kind, Priors, weigh
from hyst_control.diagnose.likelihood.octaves import Octaves
from hyst_control.diagnose.search.fit import TAIL
from hyst_control.diagnose.verdict import Verdict

SIZES = (8, 16, 32, 64)
OCTAVES = Octaves(np.repeat(np.arange(4), SIZES), np.zeros(4), np.full(4, 4.0), 1e9, np.ones(4), 4)
COUNT = sum(SIZES)
NEVER = 1e-12
ALONE = Priors(
    nothing=0.4,
    single=0.6,
    flicker=NEVER,
    else_odds=NEVER,
    unlike=NEVER,
    stage=((0.0, 1.0),),
    other=((1.0, 1.0),),
    features=(),
    motion=((0.001, 1.0),),
    flicker_powers=(1.0,),
    flicker_sizes=(0.01,),
    temperature=1.0,
)
"""Effects that are exact, and nothing else."""


def hypothesis(names: tuple[str, ...], residual: np.ndarray, columns: np.ndarray) -> Hypothesis:
    """A hypothesis at its best fit by least squares, its change modulated by four random signals that are not fitted."""
    size = columns.shape[1]
    value = np.linalg.solve(columns.T @ columns + np.eye(size), columns.T @ residual) if size else np.zeros(0)
    change = columns @ value
    modulations = change[:, None] * np.random.default_rng(99).uniform(-1.0, 1.0, (COUNT, 4)) if size else np.zeros((COUNT, 0))
    free = np.full(size + modulations.shape[1], np.inf)
    start = np.concatenate([value, np.zeros(modulations.shape[1])])
    design = np.hstack([columns, modulations])
    fit = Fit.of(OCTAVES, residual - change, design, start, np.arange(len(start)) < size, (-free, free))
    reduction = float(np.sqrt(np.mean(change**2)))
    count = modulations.shape[1]
    return Hypothesis(0, names, False, 1.0, False, fit, 0, size, count, OCTAVES.energies(change), reduction)


def fits(residual: np.ndarray, effects: dict[str, np.ndarray]) -> Fits:
    """Nothing, and each of some effects of one parameter."""
    none = hypothesis((), residual, np.zeros((COUNT, 0)))
    found = [hypothesis((name,), residual, column[:, None]) for name, column in effects.items()]
    return Fits(OCTAVES, (none, *found), len(effects), 1e4 * np.array(SIZES), np.ones(4))


def test_a_hypothesis_named_with_p_is_right_in_a_share_p_of_the_cases():
    random, names = np.random.default_rng(7), ("nothing", "first", "second")
    given, right = [], []
    for _ in range(150):
        shared, columns = random.standard_normal(COUNT), random.standard_normal((2, COUNT))
        effects = {name: 0.3 * (shared + 0.5 * one) for name, one in zip(names[1:], columns, strict=True)}
        truth = random.choice(3, p=[0.4, 0.3, 0.3])
        size = TAIL / np.sqrt(TAIL**2 - 1.0) * random.standard_t(TAIL**2 - 1.0)
        record = random.standard_normal(COUNT) + (size * effects[names[truth]] if truth else 0.0)
        known = [one for one in weigh(fits(record, effects), ALONE) if one.kind is not Kind.SOMETHING_ELSE and not one.flicker]
        probability = {(one.names or ("nothing",))[0]: one.probability for one in known}
        given.append([probability[name] for name in names])
        right.append(np.arange(3) == truth)
    p, hit = np.concatenate(given), np.concatenate(right)
    for low, high in ((0.0, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 1.0)):
        inside = (p >= low) & (p < high)
        assert inside.sum() > 15
        spread = np.sqrt(np.sum(p[inside] * (1.0 - p[inside])))
        assert abs(hit[inside].sum() - p[inside].sum()) < 2.6 * spread  # 1 in 100 by chance


def test_a_residual_of_an_effect_names_it():
    random = np.random.default_rng(1)
    effects = {"first": random.standard_normal(COUNT), "second": random.standard_normal(COUNT)}
    weighed = weigh(fits(2.0 * effects["second"] + random.standard_normal(COUNT), effects), Priors())
    assert (weighed[0].kind, weighed[0].names) == (Kind.EFFECTS, ("second",))
    judged = judge(weighed, fits(2.0 * effects["second"], effects), 0.1, 0.9, 0.5)
    assert judged.verdict is Verdict.EFFECT


def test_noise_alone_is_nothing():
    random = np.random.default_rng(2)
    effects = {"first": random.standard_normal(COUNT)}
    some = fits(random.standard_normal(COUNT), effects)
    assert judge(weigh(some, Priors()), some, 0.1, 0.9, 0.5).verdict is Verdict.NO_GAP


def test_what_is_too_small_to_matter_is_no_gap():
    random = np.random.default_rng(3)
    effects = {"first": random.standard_normal(COUNT)}
    some = fits(1.5 * effects["first"] + random.standard_normal(COUNT), effects)
    assert judge(weigh(some, Priors()), some, 0.1, 0.9, 0.5).verdict is Verdict.EFFECT
    assert judge(weigh(some, Priors()), some, 5.0, 0.9, 0.5).verdict is Verdict.NO_GAP


@pytest.mark.parametrize(("off", "verdict"), [(0.003, Verdict.EFFECT), (0.7, Verdict.UNKNOWN)])
def test_a_stage_that_is_a_little_off_is_its_effect_and_one_that_is_far_off_is_something_else(off, verdict):
    random = np.random.default_rng(4)
    effects = {"first": 100.0 * random.standard_normal(COUNT)}
    wrong = off * 100.0 * random.standard_normal(COUNT)
    some = fits(effects["first"] + wrong + random.standard_normal(COUNT), effects)
    assert judge(weigh(some, Priors()), some, 0.1, 0.9, 0.5).verdict is verdict


def alike(first: str, second: str, better: float) -> Judgement:
    """The judgement on two effects that cannot be separated, of which the first is `better` times as probable."""
    random = np.random.default_rng(5)
    column = random.standard_normal(COUNT)
    some = fits(2.0 * column + random.standard_normal(COUNT), {first: column, second: column})
    weighed = [replace(one, probability=one.probability * better ** (one.names == (first,))) for one in weigh(some, Priors())]
    total = sum(one.probability for one in weighed)
    weighed = sorted((replace(one, probability=one.probability / total) for one in weighed), key=lambda one: -one.probability)
    return judge(weighed, some, 0.1, 0.9, 0.5)


def test_two_effects_that_cannot_be_separated_are_both_named():
    judged = alike("first", "second", 1.0)
    assert judged.verdict is Verdict.AMBIGUOUS
    assert {one.names for one in judged.named} >= {("first",), ("second",)}


@pytest.mark.parametrize(("plain", "rich"), [("gain", "resonance"), ("gain", "gain_drift"), ("offset", "offset_drift")])
def test_an_effect_that_may_stand_for_a_more_probable_simpler_one_is_not_listed_beside_it(plain, rich):
    """A mode far above the command does what a gain does, whatever its frequency; one that explains more is named all the same."""
    judged = alike(plain, rich, 2.0)
    assert [one.names for one in judged.named] == [(plain,)] and (rich,) not in judged.probability
    assert {one.names for one in alike(rich, plain, 2.0).named} == {(plain,), (rich,)}


def test_many_realizations_make_an_effect_no_likelier():
    random = np.random.default_rng(6)
    column = random.standard_normal(COUNT)
    some = fits(column + random.standard_normal(COUNT), {"first": column, "second": column})
    once = {one.names: one.log_weight for one in weigh(some, ALONE) if one.kind is Kind.EFFECTS}
    none, first, second = some.hypotheses
    several = replace(some, hypotheses=(none, *(replace(first, realizations=5.0) for _ in range(5)), second))
    again = {one.names: one.log_weight for one in weigh(several, ALONE) if one.kind is Kind.EFFECTS}
    assert again[("first",)] == pytest.approx(once[("first",)], abs=1e-9)
    assert again[("first",)] == pytest.approx(again[("second",)], abs=1e-9)
