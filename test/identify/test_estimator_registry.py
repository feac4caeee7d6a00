# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""One file is one new family: what `register` asks of it, and where it then appears."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from docs.reference.options import with_present_tables
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain
from hyst_control.chain.memoryless import Gain
from hyst_control.identify import Estimator, Fit, Options, estimators, identify, option, register
from hyst_control.identify.families import estimator
from hyst_control.identify.families.estimator import every_option
from hyst_control.identify.families.options import INTEGER, NUMBER, TEXT, TRUTH, Option, declared
from hyst_control.model_file import Model
from hyst_control.records.record import sampled_record


@dataclass(frozen=True)
class GainOptions(Options):
    scale: float = option(1.0, NUMBER, "factor on the gain", unit="um/V", lower=0.0)
    blocks: int | None = option(None, INTEGER, "number of blocks")


@pytest.fixture
def registry(monkeypatch):
    """The families, and only in this test those that it adds."""
    estimators()
    monkeypatch.setattr(estimator, "_ESTIMATORS", dict(estimator._ESTIMATORS))


def gain_family(**change):
    def fit(self, records, options):
        data = records[0]
        slope = float(np.sum(data.command * data.measurement) / np.sum(data.command**2)) * options.scale
        model = Model("gain", data.axes, {"command": "V", "measurement": data.unit}, data.sample_time, Chain((Gain(slope),)))
        return Fit(model, {"family": "slope", "method": "joint", "unit": "um", "records": [], "parameters": [], "notes": []})

    return type("Slope", (Estimator,), {"name": "slope", "sentence": "a gain", "Options": GainOptions, "fit": fit, **change})


def test_a_registered_family_is_like_any_other(registry):
    made = gain_family()
    assert register(made) is made
    assert list(estimators())[-1] == "slope" and every_option()["scale"].keys() == {"slope"}
    command = np.linspace(0.0, 1.0, 60)[:, None]
    data = sampled_record("line", command, 3.0 * command, 1e-3, ("x",), "um", start="settled")
    assert identify([data], "slope", scale="2").model.chain.stages[0].gain == pytest.approx(6.0)
    with pytest.raises(InputError, match="slope: scale: must be a number >= 0 um/V, got -1"):
        identify([data], "slope", scale=-1)
    with pytest.raises(InputError, match="operators: slope has no such option: it has method, scale, blocks"):
        identify([data], "slope", operators=3)


@pytest.mark.parametrize("change", [{"name": ""}, {"sentence": ""}, {"name": "pi"}])
def test_a_family_without_a_name_of_its_own_is_refused(registry, change):
    with pytest.raises(InputError, match="must have name, sentence and Options|choose another"):
        register(gain_family(**change))


def test_an_option_must_be_declared(registry):
    @dataclass(frozen=True)
    class Bare(Options):
        width: float = 1.0

    with pytest.raises(TypeError, match="width: declare it by `option`"):
        register(gain_family(Options=Bare))


@pytest.mark.parametrize("name", ["hold", "json", "output", "model", "quiet", "help"])
def test_an_option_named_like_one_of_the_command_is_refused(registry, name):
    made = dataclass(frozen=True)(
        type("Clash", (Options,), {"__annotations__": {name: str}, name: option("a", TEXT, "a clash of names")})
    )
    with pytest.raises(InputError, match=f"slope: {name}: "):
        register(gain_family(Options=made))


def test_values_are_converted_and_kept_in_their_type():
    [_, scale, blocks] = declared(GainOptions)
    assert (scale.checked("2"), scale.checked(np.float64(0.5)), scale.checked(3)) == (2.0, 0.5, 3.0)
    assert blocks.checked(None) is None and blocks.checked("4") == 4 and blocks.checked(4.0) == 4
    for option_, value in ((scale, "nan"), (scale, True), (scale, None), (blocks, 2.5), (blocks, "x"), (blocks, [1])):
        with pytest.raises(InputError, match="must be"):
            option_.checked(value)
    truth = Option("truth", False, "", "of a test", kind=TRUTH)
    assert [truth.checked(text) for text in ("true", "No", True)] == [True, False, True]


def test_the_document_shows_every_family_and_option():
    """Made anew by `python -m docs.reference.options docs/identification.md`."""
    document = (Path(__file__).parents[2] / "docs/identification.md").read_text(encoding="utf-8")
    assert with_present_tables(document) == document
    for name, families in every_option().items():
        assert f"`--{name.replace('_', '-')}`" in document and all(f"| `{family}` |" in document for family in families)
    with pytest.raises(InputError, match="one pair of the marks"):
        with_present_tables("without")
