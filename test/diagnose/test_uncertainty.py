"""The diagnosis draws its coefficients from `uncertainty` of the model file, where it has one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.chain.coordinates import chain_coordinates
from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.problem.coefficient_prior import idle_tolerances, scatter_of
from hyst_control.diagnose.problem.problem import Piece, Problem, split
from hyst_control.diagnose.run.diagnosis import problem_of
from hyst_control.diagnose.search.beam_search import inflated
from hyst_control.diagnose.search.fit import Linearised
from hyst_control.model_file import load_model, model_from_document, model_to_document, save_model, simulate
from hyst_control.records.record import Record, Signal
from test.diagnose.conftest import nominal

NAMES = ["transfer_function.frequency[0]", "transfer_function.damping[0]", "delay.tau"]


def correlated(size=0.01):
    """The stack's model with three numbers that scatter together, and the covariance."""
    model = nominal("pea_published")
    known = chain_coordinates(model.chain.stages, model.axes)
    names = [name for name in NAMES if name in known]
    sizes = np.array([known[name].size for name in names])
    factor = size * sizes[:, None] * (np.tril(np.ones((len(names), len(names)))) - 0.5 * np.eye(len(names)))
    return replace(model, uncertainty={"parameters": names, "factor": factor.tolist()}), factor @ factor.T


def test_draws_have_the_stated_covariance():
    model, covariance = correlated()
    scatter = scatter_of(model)
    random = np.random.default_rng(0)
    names = model.uncertainty["parameters"]
    drawn = []
    for _ in range(1000):
        stages = scatter.at(random.normal(size=len(scatter.coefficients)))
        known = chain_coordinates(stages, model.axes)
        drawn.append([known[name].value for name in names])
    deviations = np.sqrt(np.diag(covariance))
    found = np.cov(np.array(drawn).T) / np.outer(deviations, deviations)
    np.testing.assert_allclose(found, covariance / np.outer(deviations, deviations), atol=0.12)


def test_tolerances_are_left_aside_and_poles_stay_stable():
    """With the tolerance of 17,800 % that a fit once wrote, independent coefficients are unstable."""
    model, _ = correlated(0.3)
    model = replace(model, tolerance={"num": 178.0, "den": 178.0})
    scatter = scatter_of(model)
    assert len(scatter.coefficients) == len(model.uncertainty["parameters"])
    random = np.random.default_rng(1)
    for _ in range(100):
        stages = scatter.at(3.0 * random.normal(size=len(scatter.coefficients)))
        for stage in stages:
            if stage.name == "transfer_function":
                assert np.all(np.roots(stage.den).real < 0.0)


def test_columns_are_finite_and_widen_with_the_tolerances():
    model, _ = correlated()
    command = 25.0 + 10.0 * np.sin(np.arange(400) / 7.0)[:, None]
    problem = Problem(model, (Piece(command, simulate(model, command)),), model.sample_time, model.hold, np.array([1e-3]))
    linearised = Linearised(problem, scatter_of(model))
    assert np.isfinite(linearised.columns).all() and np.all(np.abs(linearised.columns).max(axis=0) > 0.0)
    wide = inflated(linearised, 2.0)
    z = np.full(linearised.count, 0.1)
    before, after = linearised.simulate(z) - linearised.nominal, wide.simulate(z) - linearised.nominal
    np.testing.assert_allclose(after, 2.0 * before, rtol=0.1, atol=0.05 * np.abs(before).max())


def test_an_axis_keeps_the_covariance_of_its_own_numbers():
    model = nominal("fsm_published")
    names = ["delay.tau (x)", "delay.tau (y)", "transfer_function.frequency[0] (x)"]
    factor = [[1e-6, 0.0], [1e-6, 2e-6], [1.0, 1.0]]
    model = replace(model, uncertainty={"parameters": names, "factor": factor})
    command = np.ones((50, 2))
    problem = Problem(model, (Piece(command, simulate(model, command)),), model.sample_time, model.hold, np.ones(2))
    parts = split(problem)
    assert [part.model.uncertainty["parameters"] for part in parts] == [
        ["delay.tau", "transfer_function.frequency[0]"],
        ["delay.tau"],
    ]
    own = np.array(parts[0].model.uncertainty["factor"])
    np.testing.assert_allclose(own @ own.T, (np.array(factor) @ np.array(factor).T)[np.ix_([0, 2], [0, 2])], rtol=1e-9)
    assert {c.name for c in scatter_of(parts[0].model).coefficients} == {"tau", "frequency[0]"}


def test_a_model_file_keeps_its_uncertainty(tmp_path):
    model, _ = correlated()
    save_model(model, tmp_path / "model.yaml")
    again = load_model(tmp_path / "model.yaml")
    assert again.uncertainty == model.uncertainty


@pytest.mark.parametrize(
    "changed, line",
    [
        ({"parameters": ["delay.tau", "delay.tau"]}, "uncertainty.parameters: must be a list of different names"),
        (
            {"parameters": ["transfer_function.frequency[9]"], "factor": [[1e-6]]},
            "uncertainty.parameters: 'transfer_function.frequency[9]' is no number of the chain: did you mean",
        ),
        ({"factor": [[1.0]]}, "uncertainty.factor: must be a list of"),
        ({"factor": [[float("nan")] * 3] * 3}, "uncertainty.factor: must be a list of"),
        ({"names": []}, "uncertainty: must be a mapping with parameters and factor"),
    ],
)
def test_an_uncertainty_that_makes_no_sense_is_refused(changed, line):
    document = model_to_document(correlated()[0])
    document["uncertainty"] = {**document["uncertainty"], **changed}
    with pytest.raises(InputError) as caught:
        model_from_document(document)
    assert str(caught.value).startswith(line)


def test_a_tolerance_that_no_parameter_takes_is_named_in_the_notes():
    """A misspelled name leaves its coefficients exact; nothing said so, and what is off by it would be called an effect."""
    model = replace(nominal("pea_published"), tolerance={"weights": 0.01, "asscending": 0.01, "delay.num": 0.02, "delay.b": 0.0})
    time = model.sample_time * np.arange(400)
    command = 20.0 - 20.0 * np.cos(2 * np.pi * 50.0 * time)[:, None]
    record = Record(
        {
            "command": Signal(time, command, model.axes, "V"),
            "measurement": Signal(time, simulate(model, command), model.axes, "um"),
        },
        "a",
    )
    _, notes = problem_of([record], model, 0.0, CONFIGURATION)
    assert [note for note in notes if "tolerance" in note] == [
        "tolerance of asscending, delay.num: no parameter of the model's chain scatters by this name; see the model file"
    ]
    _, notes = problem_of(
        [record], replace(model, tolerance={"modified_prandtl_ishlinskii.m1": 0.05, "num": 0.02}), 0.0, CONFIGURATION
    )
    assert not notes


@pytest.mark.parametrize("path", sorted((Path(__file__).parents[2] / "config/models").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_tolerance_of_a_shipped_model_is_taken(path):
    assert not idle_tolerances(load_model(path))
