"""A diagnosis knows a parameter by its stage's declaration: two stages may have one name for different things."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.base.config_files import config_path
from hyst_control.chain.linear.linear_stages import CrossCoupling, TransferFunction
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.problem.problem import Piece, Problem, split
from hyst_control.diagnose.search.fit import Linearised
from hyst_control.effects.coupled_resonance import CoupledResonance
from hyst_control.effects.resonance import Resonance
from hyst_control.model_file import load_model, model_from_document, model_to_document, simulate
from test.diagnose.conftest import nominal


def problem_of(model, rows=300, size=10.0):
    random = np.random.default_rng(1)
    command = 4.0 * size + size * np.cumsum(random.normal(size=(rows, len(model.axes))), axis=0) / np.sqrt(rows)
    piece = Piece(command, simulate(model, command))
    return Problem(model, (piece,), model.sample_time, model.hold, np.full(len(model.axes), 1e-3))


def test_a_mode_of_another_frequency_on_every_axis_is_split_by_axis():
    """`frequency` is a number per axis here, a list over the modes in `softening_modal`."""
    model = nominal("fsm_published")
    model = model.with_stages((*model.chain.stages, Resonance([900.0, 1200.0], 0.05, [0.05, 0.1])))
    whole = problem_of(model)
    parts = split(whole)
    assert [part.model.axes for part in parts] == [("x",), ("y",)]
    together = whole.simulate(whole.model.chain.stages).reshape(-1, 2)
    for axis, part in enumerate(parts):
        np.testing.assert_allclose(part.simulate(part.model.chain.stages), together[:, axis], rtol=1e-9)


def test_a_scattered_frequency_is_one_coefficient_per_axis_or_per_mode():
    mirror = nominal("fsm_published")
    mirror = mirror.with_stages((*mirror.chain.stages, Resonance(900.0, 0.05, 0.1)))
    names = {coefficient.name for coefficient in scatter_of(replace(mirror, tolerance={"frequency": 0.01})).coefficients}
    assert names == {"frequency (x)", "frequency (y)"}


def test_the_coefficients_of_the_measured_mirror_belong_to_all_axes_together(measured_mirror):
    scatter = scatter_of(measured_mirror)
    modes = [stage for stage in measured_mirror.chain.stages if stage.mixes_axes][0]
    moving = [f"frequency[{i}]" for i, value in enumerate(modes.frequency) if value != 0.0]
    assert [c.name for c in scatter.coefficients] == [f"decay[{i}]" for i in range(len(modes.decay))] + moving
    assert {c.axis for c in scatter.coefficients} == {None}
    z = np.zeros(len(scatter.coefficients))
    z[3] = 2.0
    (moved,) = scatter.at(z)
    expected = np.array(modes.decay)
    expected[3] *= 1.0 + 2.0 * measured_mirror.tolerance["decay"]
    np.testing.assert_allclose(moved.decay, expected, rtol=1e-15)
    assert moved.frequency == modes.frequency


def test_the_measured_mirrors_own_coefficients_have_columns(measured_mirror):
    problem = problem_of(measured_mirror, 60, 0.1)
    columns = Linearised(problem, scatter_of(measured_mirror)).columns
    assert np.isfinite(columns).all() and (np.abs(columns).max(axis=0) > 0.0).all()


@pytest.fixture(scope="module")
def measured_mirror():
    return load_model(config_path("models/fsm_cubespec.yaml"))


def test_a_flag_and_a_clock_do_not_scatter():
    model = nominal("pea_published")
    found = scatter_of(replace(model, tolerance={"one_sided": 0.1, "weights": 0.01})).coefficients
    assert {coefficient.field for coefficient in found} == {"weights"}


def test_a_matrix_keeps_its_form_and_the_corner_beside_it_is_spread():
    model = nominal("fsm_published")
    coupling = CrossCoupling([[1.0, 0.02], [0.03, 1.0]], 300.0)
    model = replace(model.with_stages((*model.chain.stages, coupling)), tolerance={"matrix": 0.1, "corner": 0.1})
    assert [c.name for c in scatter_of(model).coefficients] == [
        "matrix[0][0]",
        "matrix[0][1]",
        "matrix[1][0]",
        "matrix[1][1]",
        "corner (x)",
        "corner (y)",
    ]
    assert len(split(problem_of(model))) == 1


def test_coupled_polynomials_scatter_as_they_stand():
    coupled = TransferFunction([[[2.0], [0.1]], [[0.2], [2.0]]], [1e-3, 1.0], coupled=True)
    model = replace(nominal("fsm_published").with_stages((coupled,)), tolerance={"num": 0.1, "den": 0.1})
    names = [c.name for c in scatter_of(model).coefficients]
    assert names == ["num[0][0][0]", "num[0][1][0]", "num[1][0][0]", "num[1][1][0]", "den[0]", "den[1]"]


def test_a_model_with_a_mode_of_all_axes_is_read_back():
    """The augmented model of a plant that mixes its axes is given to the next diagnosis."""
    model = nominal("fsm_published")
    mode = CoupledResonance(900.0, 0.05, [[0.1, 0.0], [0.02, 0.1]], [[0.0, 0.01], [0.0, 0.0]])
    model = model.with_stages((*model.chain.stages, mode))
    assert model_from_document(model_to_document(model)).chain == model.chain
    assert len(split(problem_of(model))) == 1
