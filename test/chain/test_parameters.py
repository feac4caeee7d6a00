# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Declared parameters: every stage's declarations hold together, and the split by axis is the whole, axis by axis."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
import pytest

from docs.reference.stages import stage_pages
from hyst_control.base.errors import InputError
from hyst_control.chain import STAGES, Chain, Sampling
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.chain.parameter import Form, Parameter, Scattering, declared, flag, scalar, vector
from hyst_control.chain.stage import Stage, register
from hyst_control.effects import EFFECTS
from hyst_control.effects.effect import PLACES
from hyst_control.effects.random_stages import RandomStage
from test.chain.test_every_stage import BEFORE, CASES, SAMPLE_TIME, command

SPLIT = {
    case: (name, make)
    for case, (name, make) in CASES.items()
    if not STAGES[name](**make(2)).mixes_axes and not issubclass(STAGES[name], RandomStage)
}
"""Stages whose axes are each by themselves; those with random numbers draw others for other axes."""


@dataclass(frozen=True)
class Example(Stage):
    """A stage with a parameter of every kind and bound."""

    rate: float = scalar("V/s", "", default=1.0, lower=0.0)
    share: float = scalar("", "", default=0.5, above=0.0, below=1.0)
    count: float = scalar("", "", default=1, upper=9.0, whole=True)
    limit: float = scalar("V", "", default=np.inf, infinite=True)
    shape: tuple[float, ...] = vector("", "", default=(1.0, 2.0))
    on: bool = flag("")


@pytest.mark.parametrize(
    "given, message",
    [
        ({"rate": -3}, "rate: must be a number >= 0 V/s, got -3"),
        ({"rate": [1.0, -3.0]}, "rate: must be a number >= 0 V/s, got -3"),
        ({"rate": np.inf}, "rate: must be a finite number >= 0 V/s, got inf"),
        ({"rate": np.nan}, "rate: must be a finite number >= 0 V/s, got nan"),
        ({"rate": "fast"}, "rate: must be a number >= 0 V/s, got 'fast'"),
        ({"rate": True}, "rate: must be a number >= 0 V/s, got True"),
        ({"rate": []}, "rate: is empty, at least one value is needed"),
        ({"rate": [[1.0]]}, "rate: must be a number for all axes, or a list with one of them per axis, got ((1.0,),)"),
        ({"share": 0.0}, "share: must be a number > 0 and < 1, got 0"),
        ({"share": 1.0}, "share: must be a number > 0 and < 1, got 1"),
        ({"count": 10}, "count: must be an integer <= 9, got 10"),
        ({"count": 1.5}, "count: must be an integer <= 9, got 1.5"),
        ({"shape": 1.0}, "shape: must be a list of numbers for all axes, or a list with one of them per axis, got 1.0"),
        ({"shape": [1.0, [2.0]]}, "shape: must be a list of numbers for all axes"),
        ({"on": 1}, "on: must be true or false, got 1"),
    ],
)
def test_a_value_out_of_its_declaration_is_refused_by_name_and_bound(given, message):
    with pytest.raises(InputError) as refused:
        Example(**given)
    assert str(refused.value).startswith(message)


def test_values_within_their_declaration_are_kept():
    kept = Example(rate=np.array([0.0, 2.0]), share=0.999, count=9.0, limit=[np.inf, 3.0], shape=[[1.0], [2.0, 3.0]], on=True)
    assert kept.rate == (0.0, 2.0) and kept.shape == ((1.0,), (2.0, 3.0)) and kept.limit == (np.inf, 3.0)


@pytest.mark.parametrize("name", STAGES)
def test_every_field_of_a_stage_says_what_it_is(name):
    known = declared(STAGES[name])
    assert set(known) == {field.name for field in fields(STAGES[name])}
    assert STAGES[name].place in ("", *PLACES)
    for parameter in known.values():
        assert parameter.meaning
        assert parameter.dimensions or parameter.form is not Form.ALL_AXES
        assert parameter.scatter is Scattering.NONE or parameter.form in (Form.SCALAR, Form.VECTOR, Form.ALL_AXES)


def test_a_stage_that_declares_nothing_is_not_registered():
    @dataclass(frozen=True)
    class Silent(Stage):
        name: ClassVar[str] = "silent"
        size: float = 1.0

    with pytest.raises(TypeError, match=r"Silent\.size: declares no parameter"):
        register(Silent)
    assert "silent" not in STAGES


@pytest.mark.parametrize("case", SPLIT)
def test_a_stage_split_by_axis_is_the_whole_axis_by_axis(case):
    name, make = SPLIT[case]
    stages = (*BEFORE.get(name, ()), STAGES[name](**make(2)))
    u = command(3, 200, 2)
    whole = Chain(stages).filter(Sampling(SAMPLE_TIME, 2))
    settled, output = whole.settle(u[0]), whole.process(u)
    for axis in range(2):
        own = Chain(tuple(stage.for_axis(axis) for stage in stages)).filter(Sampling(SAMPLE_TIME, 1))
        np.testing.assert_allclose(own.settle(u[0, axis : axis + 1])[0], settled[axis], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(
            own.process(np.ascontiguousarray(u[:, axis : axis + 1]))[:, 0], output[:, axis], rtol=1e-9, atol=1e-12
        )


@pytest.mark.parametrize("case", SPLIT)
def test_a_stage_spread_over_the_axes_is_the_same_stage(case):
    name, make = SPLIT[case]
    stage = STAGES[name](**make(2))
    known = stage.declarations()
    spread = stage.spread([key for key in known if getattr(stage, key) is not None], 2)
    for key, parameter in known.items():
        if parameter.per_axis is not None and getattr(stage, key) is not None:
            assert len(getattr(spread, key)) == 2
    u = command(3, 100, 2)
    outputs = []
    for one in (stage, spread):
        running = Chain((*BEFORE.get(name, ()), one)).filter(Sampling(SAMPLE_TIME, 2))
        running.settle(u[0])
        outputs.append(running.process(u))
    np.testing.assert_array_equal(*outputs)


def test_what_mixes_the_axes_is_not_split():
    coupled = TransferFunction([[[1.0], [0.1]], [[0.2], [1.0]]], [0.01, 1.0], coupled=True)
    assert coupled.mixes_axes and all(known.per_axis is None for name, known in coupled.declarations().items() if name != "coupled")
    with pytest.raises(InputError, match="transfer_function: mixes the axes"):
        coupled.for_axis(0)


def test_scattered_branches_of_madelung_hysteresis_still_meet():
    stage = Madelung([0.2, 0.5, 0.3], [-0.3, -0.2, 1.5], 100.0, 2.0)
    moved = stage.with_values({"ascending": np.array([0.25, 0.5, 0.3])})
    # Sums 1.05 and 1.0: both are scaled to their mean.
    np.testing.assert_allclose([sum(moved.ascending), sum(moved.descending)], 1.025, rtol=1e-15)
    np.testing.assert_allclose(moved.ascending, np.array([0.25, 0.5, 0.3]) * 1.025 / 1.05, rtol=1e-15)


def test_a_bound_is_open_or_closed_as_declared():
    Parameter("x", 0.0, "", "", lower=0.0).check(0.0)
    with pytest.raises(InputError):
        Parameter("x", 0.0, "", "", above=0.0).check(0.0)


def test_the_catalogue_names_places_that_there_are():
    assert {effect.place for effect in EFFECTS.values()} <= set(PLACES)


def test_a_reader_finds_every_parameter_of_a_stage():
    pages = stage_pages()
    for name, stage in STAGES.items():
        rows = [line.split("|") for line in pages[name].splitlines() if line.startswith("| `")]
        assert [row[1].strip(" `") for row in rows] == list(declared(stage)), name
        assert [row[3].strip() for row in rows] == [each.unit for each in declared(stage).values()], name
        assert f"[`{name}`]({name}.md)" in pages["index"]
