# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Madelung hysteresis: the rules, the published curves (MHL paper Table 1), the inverse, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from hyst_control.base.errors import InputError
from hyst_control.chain import Sampling
from hyst_control.chain.hysteresis.madelung import Madelung

PUBLISHED_ASCENDING = np.array([-0.4624, 1.788, -2.398, 2.037, 2.228])
PUBLISHED_DESCENDING = np.array([0.9457, -3.005, 3.248, -2.083, 4.104])
INVERSE_ASCENDING = np.array([0.4523, -1.422, 1.7, -1.125, 1.397])
INVERSE_DESCENDING = np.array([-0.04333, 0.3898, -0.5418, 0.4221, 0.7696])
"""MHL paper Table 1, signs recovered from closure and monotony."""
F = 3.2
UP, DOWN = (F * p / p.sum() for p in (PUBLISHED_ASCENDING, PUBLISHED_DESCENDING))
STAGES = {
    "quintic": Madelung(UP, DOWN, 100.0, 0.625),
    "quadratic": Madelung([0.5, 0.5], [-0.5, 1.5], 100.0, 2.0),
    "knots": Madelung([0.0, 0.15, 0.4, 1.0], [0.0, 0.4, 0.8, 1.0], 100.0, 2.0, knots=[0.0, 0.3, 0.6, 1.0]),
}
RANGE = {name: stage.output_scale * float(stage.curves(1)[0][0](np.ones(1))[0]) for name, stage in STAGES.items()}
voltages = st.lists(st.integers(0, 10_000).map(lambda i: i / 100.0), min_size=1, max_size=60)


def run(stage, u) -> np.ndarray:
    """Output (N,) for an input (N,) from the virgin state at 0."""
    running = stage.filter(Sampling(1e-3, 1))
    running.settle(np.zeros(1))
    return running.process(np.array(u, dtype=float).reshape(-1, 1))[:, 0]


def inverse_of(stage: Madelung) -> Madelung:
    return replace(stage, inverse=True)


def with_steps(turns, count: int = 7) -> np.ndarray:
    """A signal that runs straight from one turn to the next in `count` steps."""
    turns = np.array([0.0, *turns])
    return np.interp(np.arange((len(turns) - 1) * count + 1) / count, np.arange(len(turns)), turns)


def by_recursion(turns, stage: Madelung) -> float:
    """Output at the end of a list of turning points by Madelung's three rules as they are stated, not through a stack.

    The list is reduced first: an inner pair that a later extreme passes is forgotten (rule 3), then each remaining point lies on
    the branch from its predecessor towards the one before that (rules 1 and 2).
    """
    f0, g0 = stage.curves(1)[0]
    full = float(f0(np.ones(1))[0])
    points = [0.0]
    for value in [t / stage.input_scale for t in turns]:
        if value == points[-1]:
            continue
        if len(points) > 1 and (value > points[-1]) == (points[-1] > points[-2]):
            points.pop()
        points.append(value)
        while len(points) > 2 and (
            points[-1] >= points[-3] > points[-2] if points[-1] > points[-2] else points[-1] <= points[-3] < points[-2]
        ):
            del points[-3:-1]
    # The major loop's upper end is the point to which the first, ascending branch runs.
    known = [(1.0, full), (0.0, 0.0)]
    for value in points[1:]:
        (u_to, y_to), (u_from, y_from) = known[-2:]
        distance, whole = abs(value - u_from), abs(u_to - u_from)
        if value > u_from:
            share = float(f0(np.array([distance]))[0] / f0(np.array([whole]))[0])
        else:
            down = lambda d: full - float(g0(np.array([1.0 - d]))[0])  # noqa: E731
            share = down(distance) / down(whole)
        known.append((value, y_from + (y_to - y_from) * share))
    return known[-1][1] * stage.output_scale


def test_the_major_loop_is_the_published_curves():
    """Polynomials p5…p1 of the normalized input, MHL paper Eq. 1, 2, scaled to meet at 3.2."""
    x = np.linspace(0, 1, 101)
    y = run(STAGES["quintic"], np.concatenate([100 * x, 100 * x[::-1], 100 * x]))
    up, down = np.polyval([*UP, 0.0], x), np.polyval([*DOWN, 0.0], x)
    np.testing.assert_allclose(y, 0.625 * np.concatenate([up, down[::-1], up]), rtol=1e-12, atol=1e-12)


def test_the_published_pair_misses_closure_by_half_a_per_cent_and_is_refused():
    np.testing.assert_allclose([PUBLISHED_ASCENDING.sum(), PUBLISHED_DESCENDING.sum()], [3.193, 3.210], atol=5e-4)
    with pytest.raises(InputError, match="descending: ends at 3.2097 where ascending ends at 3.1926"):
        Madelung(PUBLISHED_ASCENDING, PUBLISHED_DESCENDING, 100.0, 1.0)


@pytest.mark.parametrize("name", STAGES)
@settings(max_examples=60, deadline=None)
@given(turns=voltages)
def test_the_stack_is_the_three_rules(name, turns):
    y = run(STAGES[name], turns)
    np.testing.assert_allclose(y[-1], by_recursion(turns, STAGES[name]), atol=1e-11 * RANGE[name])


@pytest.mark.parametrize("name", STAGES)
@settings(max_examples=40, deadline=None)
@given(turns=voltages)
def test_only_the_turning_points_matter(name, turns):
    """Rule 1: what lies between two turns has no influence on where the curve leads."""
    np.testing.assert_allclose(run(STAGES[name], with_steps(turns))[::7][1:], run(STAGES[name], turns), atol=1e-10 * RANGE[name])


@pytest.mark.parametrize("name", STAGES)
@settings(max_examples=40, deadline=None)
@given(before=voltages, a=st.floats(0, 100), b=st.floats(0, 100))
def test_return_point_memory(name, before, a, b):
    """Rule 2: an inner loop closes where it began, at any depth."""
    y = run(STAGES[name], [*before, a, b, a, b, a])
    np.testing.assert_allclose(y[-2:], y[-4:-2], atol=1e-10 * RANGE[name])


@pytest.mark.parametrize("name", STAGES)
@settings(max_examples=40, deadline=None)
@given(low=st.floats(0, 45), high=st.floats(55, 100), inner=voltages, on=st.floats(0, 100))
def test_a_passed_turning_point_is_forgotten(name, low, high, inner, on):
    """Rule 3: past the point where it began, an inner loop has left no trace."""
    inside = [low + (high - low) * (0.01 + 0.98 * value / 100.0) for value in inner]
    with_loop = run(STAGES[name], [high, low, *inside, high, on])
    without = run(STAGES[name], [high, low, high, on])
    np.testing.assert_allclose(with_loop[-2:], without[-2:], atol=1e-10 * RANGE[name])


@pytest.mark.parametrize("name", STAGES)
@settings(max_examples=60, deadline=None)
@given(turns=st.lists(st.floats(-20.0, 120.0), min_size=1, max_size=60))
def test_the_inverse_undoes_the_model(name, turns):
    u = with_steps(turns, 3)
    back = run(inverse_of(STAGES[name]), run(STAGES[name], u))
    np.testing.assert_allclose(back, u, atol=1e-9 * 100.0)


@pytest.mark.parametrize("name", STAGES)
@settings(max_examples=40, deadline=None)
@given(turns=st.lists(st.floats(-0.2, 1.2), min_size=1, max_size=60))
def test_the_model_undoes_the_inverse(name, turns):
    demand = RANGE[name] * with_steps(turns, 3)
    np.testing.assert_allclose(run(STAGES[name], run(inverse_of(STAGES[name]), demand)), demand, atol=1e-9 * RANGE[name])


def test_the_papers_separate_inverse_curves_nearly_invert():
    """MHL paper Table 1, right: fitted inverse curves, scaled to close: within 7e-4 of the range of the true inverse."""
    paper = Madelung(INVERSE_ASCENDING / INVERSE_ASCENDING.sum(), INVERSE_DESCENDING / INVERSE_DESCENDING.sum(), F, 1.0)
    model = Madelung(UP, DOWN, 1.0, 1.0)
    u = np.concatenate([np.linspace(0, 1, 2001), np.linspace(1, 0, 2001)])
    assert np.max(np.abs(run(paper, run(model, u)) - u)) <= 7e-4
    y = F * u
    assert np.max(np.abs(run(model, run(paper, y)) - y)) <= 2e-3 * F


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_more_nested_loops_than_the_stack_begins_with(seed):
    """200 nested turning points, in blocks of any size, and back out of them."""
    random = np.random.default_rng(seed)
    inward = np.cumsum(random.uniform(0.05, 0.2, 100))
    turns = np.empty(200)
    turns[0::2], turns[1::2] = 90.0 - inward, 10.0 + inward
    stage, running = STAGES["quintic"], STAGES["quintic"].filter(Sampling(1e-3, 1))
    running.settle(np.zeros(1))
    pieces = np.split(turns.reshape(-1, 1), np.sort(random.integers(0, 200, 5)))
    y = np.concatenate([running.process(np.ascontiguousarray(piece)) for piece in pieces])[:, 0]
    assert running.stack_depth[0][0] > 64
    np.testing.assert_allclose(y[-1], by_recursion(turns, stage), atol=1e-10)
    # Back out: every turning point is met again on the way.
    out = running.process(np.array([[turns[-2]], [turns[-3]], [turns[-4]], [100.0]]))[:, 0]
    np.testing.assert_allclose(out[:3], y[[-2, -3, -4]], atol=1e-10)
    np.testing.assert_allclose(out[3], 2.0, rtol=1e-12)


@pytest.mark.parametrize("name", STAGES)
def test_beyond_the_ends_the_curve_goes_on_straight_and_remembers_nothing(name):
    stage, full = STAGES[name], RANGE[name]
    y = run(stage, [0.0, 110.0, 120.0, 100.0, 130.0, 100.0, -10.0, -20.0, 0.0])
    np.testing.assert_allclose(y[3], full, rtol=1e-12)
    assert np.isclose(y[2] - y[1], y[1] - full) and y[1] > full
    np.testing.assert_allclose([y[5], y[8]], [full, 0.0], atol=1e-12)
    assert np.isclose(y[7], 2 * y[6]) and y[6] < 0
    # The end slope continues the curve without a kink.
    edge = run(stage, [100.0 - 1e-5, 100.0, 100.0 + 1e-5])
    np.testing.assert_allclose(edge[2] - edge[1], edge[1] - edge[0], rtol=1e-3)


coefficients = st.tuples(st.lists(st.floats(-1.5, 1.5), max_size=5), st.floats(0.3, 3.0)).map(lambda parts: [*parts[0], parts[1]])


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(p=coefficients, q=coefficients)
def test_a_polynomial_is_accepted_when_it_rises_and_only_then(p, q):
    """Against the derivative sampled finely; curves that are within round-off of a plateau may go either way."""
    x = np.linspace(0, 1, 4001)
    least = [np.polyval(np.polyder([*c, 0.0]), x).min() for c in (p, q)]
    assume(all(abs(value) > 1e-3 for value in least) and min(sum(p), sum(q)) > 0.1)
    scaled = np.array(q) * (sum(p) / sum(q))
    if min(least) > 0:
        Madelung(p, scaled, 1.0, 1.0)
    else:
        with pytest.raises(InputError, match="the curve falls between"):
            Madelung(p, scaled, 1.0, 1.0)


def test_a_falling_curve_is_refused_with_its_interval():
    """x - 2.4 x² + 2.4 x³ … falls where 1 - 4.8 x + 4.5 x² < 0, between 0.283 and 0.784."""
    with pytest.raises(InputError, match=r"ascending: the curve falls between 0\.28\d* and 0\.78\d* of the normalized input"):
        Madelung([1.5, -2.4, 1.0], [0.1], 1.0, 1.0)
    with pytest.raises(InputError, match=r"descending: the curve falls between 0.4 and 0.7 .*values"):
        Madelung([0.0, 0.2, 0.5, 1.0], [0.0, 0.5, 0.5, 1.0], 1.0, 1.0, knots=[0.0, 0.4, 0.7, 1.0])


@pytest.mark.parametrize(
    "make, word",
    [
        (lambda: Madelung([1.0], [1.0], 0.0, 1.0), "input_scale: must be a number > 0 V, got 0"),
        (lambda: Madelung([1.0], [1.0], 1.0, -2.0), "output_scale: must be a number > 0 measurement unit, got -2"),
        (lambda: Madelung([], [1.0], 1.0, 1.0), "ascending: is empty"),
        (lambda: Madelung([0.0, 1.0], [0.0, 1.0], 1.0, 1.0, knots=[0.0, 0.5, 1.0]), "ascending: 2 values for 3 knots"),
        (lambda: Madelung([0.0, 0.5, 1.0], [0.0, 0.6, 1.0], 1.0, 1.0, knots=[0.0, 0.5, 0.5]), "knots"),
        (lambda: Madelung([0.1, 0.5, 1.0], [0.0, 0.6, 1.0], 1.0, 1.0, knots=[0.0, 0.5, 1.0]), "ascending: starts at 0.1"),
        (lambda: Madelung([0.0, 0.5, 1.0], [0.0, 0.6, 1.0], 1.0, 1.0, knots="abc"), "knots"),
        (lambda: Madelung([[1.0], [1.0], [1.0]], [[1.0], [1.0]], 1.0, 1.0), "descending: 2 values for 3 axes"),
    ],
)
def test_curves_that_make_no_sense_are_refused_by_name(make, word):
    with pytest.raises(InputError, match=word):
        make()


BIPOLAR = replace(STAGES["quintic"], input_scale=180.0, input_offset=-90.0)


def test_curves_that_begin_elsewhere_are_those_of_a_shifted_command():
    """Once both ends of the loop have been met, the stage is its unipolar twin behind a shift of the command."""
    random = np.random.default_rng(3)
    u = np.concatenate([[0.0, 90.0, -90.0], np.cumsum(random.normal(0.0, 15.0, 400)).clip(-100.0, 100.0)])
    twin = replace(BIPOLAR, input_offset=0.0)
    np.testing.assert_allclose(run(BIPOLAR, u)[2:], run(twin, u + 90.0)[2:], atol=1e-13)
    np.testing.assert_allclose(run(inverse_of(BIPOLAR), run(BIPOLAR, u))[2:], u[2:], atol=1e-9)


def test_rest_inside_the_loop_has_no_preferred_side():
    """A symmetric pair of curves starts in the middle, rises as it falls, and lies inside the major loop all the way."""
    f = np.array([0.2, 0.5, 0.3])
    mirrored = np.array([0.2, -1.1, 1.9])  # 1 - f(1 - x)
    stage = Madelung(f, mirrored, 2.0, 1.0, input_offset=-1.0)
    half = np.linspace(0.0, 0.99, 100)
    up, down = run(stage, half), run(stage, -half)
    assert abs(up[0] - 0.5) < 0.01
    np.testing.assert_allclose(up - up[0], -(down - down[0]), atol=0.01)
    rising, falling = (curve((half + 1.0) / 2.0) for curve in stage.curves(1)[0])
    assert np.all((rising - 1e-12 <= up) & (up <= falling + 1e-12)) and np.all(np.diff(up) > 0)


def test_a_loop_below_zero_starts_at_its_top():
    stage = replace(STAGES["quintic"], input_offset=-100.0)
    u = with_steps([-30.0, -10.0, -90.0, 0.0])
    full = RANGE["quintic"]
    assert run(stage, u)[0] == pytest.approx(full)
    falling = stage.output_scale * stage.curves(1)[0][1](1.0 + u[:8] / 100.0)
    np.testing.assert_allclose(run(stage, u)[:8], falling, rtol=1e-12)
