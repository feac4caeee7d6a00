# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The configuration of the diagnosis: one file, typed, with the unit and the meaning of every value."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from importlib.resources import files

import pytest
import yaml

from hyst_control.base.errors import InputError
from hyst_control.diagnose.configuration import CONFIGURATION, configuration_text, load_configuration

FILE = files("hyst_control.diagnose") / "configuration.yaml"


def groups() -> dict:
    return {one.name: getattr(CONFIGURATION, one.name) for one in fields(CONFIGURATION) if one.name != "tuning_seeds"}


def test_the_committed_file_has_the_meanings_of_the_code():
    assert FILE.read_text(encoding="utf-8") == configuration_text(CONFIGURATION)


def test_every_value_has_a_unit_and_a_meaning():
    for group in groups().values():
        assert is_dataclass(group) and type(group).__doc__
        for one in fields(group):
            assert one.metadata["quantity"].meaning, one.name


def test_what_is_written_is_read_again(tmp_path):
    changed = replace(CONFIGURATION, noise=replace(CONFIGURATION.noise, least=1e-7, band=(0.5, 0.9)))
    (tmp_path / "other.yaml").write_text(configuration_text(changed), encoding="utf-8")
    assert load_configuration(tmp_path / "other.yaml") == changed != CONFIGURATION


def test_every_value_is_in_the_hash():
    seen = {CONFIGURATION.digest()}
    for name, group in groups().items():
        for one in fields(group):
            value = getattr(group, one.name)
            other = (*value[:-1], value[-1] + 1) if isinstance(value, tuple) else value + 1
            seen.add(replace(CONFIGURATION, **{name: replace(group, **{one.name: other})}).digest())
    assert len(seen) == 1 + sum(len(fields(group)) for group in groups().values())


@pytest.mark.parametrize(
    "path, value, said",
    [
        (("policy",), None, "policy: must be a mapping"),
        (("policy", "margin"), "three", "policy.margin: must be a number, got 'three'"),
        (("policy", "margin"), True, "policy.margin: must be a number, got True"),
        (("policy", "margin"), float("nan"), "policy.margin: must be a finite number, got nan"),
        (("policy", "max_effects"), 2.5, "policy.max_effects: must be an integer, got 2.5"),
        (("noise", "band"), [0.6], "noise.band: must be a list of 2 numbers, got [0.6]"),
        (("checks", "mains_harmonics"), 3, "checks.mains_harmonics: must be a list of some numbers, got 3"),
        (("search", "width"), 3, "search: has no 'width'"),
    ],
)
def test_a_value_of_another_kind_is_refused_in_one_line(path, value, said, tmp_path):
    document = yaml.safe_load(FILE.read_text(encoding="utf-8"))
    inside = document
    for name in path[:-1]:
        inside = inside[name]
    inside[path[-1]] = value
    refused(document, said, tmp_path)


def test_a_missing_value_is_refused_in_one_line(tmp_path):
    document = yaml.safe_load(FILE.read_text(encoding="utf-8"))
    del document["search"]["beam"]
    refused(document, "search: lacks 'beam': add it", tmp_path)


def refused(document: dict, said: str, folder) -> None:
    (folder / "wrong.yaml").write_text(yaml.safe_dump(document), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_configuration(folder / "wrong.yaml")
    assert said in str(caught.value) and str(caught.value).startswith(str(folder)) and "\n" not in str(caught.value)
