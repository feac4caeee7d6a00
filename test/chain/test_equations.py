# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Equations of the stages: of parameters that they declare, and drawn by a browser without help from outside."""

from __future__ import annotations

import inspect
import re
import runpy
import xml.etree.ElementTree as tree
from pathlib import Path

import pytest
from latex2mathml.converter import convert

from docs.reference.stages import stage_pages
from hyst_control.chain.stage import STAGES

DOCS = Path(__file__).resolve().parents[2] / "docs"
WORDS = {"round", "Re", "Im", "sign"}
WITH_EQUATION = sorted(name for name, stage in STAGES.items() if stage.equation)


@pytest.mark.parametrize("name", WITH_EQUATION)
def test_an_equation_names_declared_parameters(name):
    stage = STAGES[name]
    named = {word.replace("\\_", "_") for word in re.findall(r"\\mathrm\{(.+?)\}", stage.equation)} - WORDS
    assert named and named <= set(stage.__dataclass_fields__)


@pytest.mark.parametrize("name", WITH_EQUATION)
def test_a_browser_can_draw_it(name):
    markup = convert(STAGES[name].equation, display="block")
    root = tree.fromstring(markup)
    assert root.tag.endswith("math") and "\\" not in "".join(root.itertext()) and "merror" not in markup


def test_a_stage_that_is_a_formula_has_an_equation():
    """Its docstring begins with the output, as `y = …`."""
    begun = {name for name, stage in STAGES.items() if re.match(r"(y(\(\w+\)|_i)?|G\(s\)|Ψ) = ", inspect.getdoc(stage) or "")}
    assert len(begun) > 10 and begun <= set(WITH_EQUATION)


def test_the_site_shows_every_equation_of_the_reference():
    text = "\n".join(stage_pages().values())
    page = runpy.run_path(str(DOCS / "build_hook.py"))["with_equations"](text)
    assert "$$" not in page and page.count("<math") == page.count("</math>") == len(WITH_EQUATION) == text.count("$$") / 2


def test_the_site_fetches_neither_libraries_nor_fonts():
    site = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8")
    assert "extra_javascript" not in site and "arithmatex" not in site and "font: false" in site
