# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reference of the stages: a page for each with its equation and parameters, written from their declarations."""

from __future__ import annotations

import inspect
from dataclasses import MISSING

import hyst_control.effects  # noqa: F401  (registers the effects' stages)
from docs.reference.tables import table
from hyst_control.base.quantity import INTEGER, shown
from hyst_control.chain.parameter import Form, Parameter, declared
from hyst_control.chain.stage import STAGES, Stage, thawed

HEAD = """# Stages

Every stage of a model file, with its equation from input u to output y and its parameters. *Form*: a number applies to every axis; a list
in place of a number (a list of lists in place of a list) gives a value per axis. *Scatter*: the coordinates in
which `tolerance` and `uncertainty` of a model file give the parameter's scatter; `none` if they do not accept it.

"""


def stage_pages() -> dict[str, str]:
    """Every registered stage's page by its name, and their list as `index`."""
    names = sorted(STAGES)
    rows = [(f"[`{name}`]({name}.md)", _title(STAGES[name])) for name in names]
    return {"index": HEAD + table("stage | ", rows)} | {name: _page(name, STAGES[name]) for name in names}


def _title(stage: type[Stage]) -> str:
    return (inspect.getdoc(stage) or "").split("\n\n")[0].replace("\n", " ")


def _page(name: str, stage: type[Stage]) -> str:
    rows = table("parameter | form | unit | bounds | default | scatter | ", map(_row, declared(stage).values()))
    equation = f"$$\n{stage.equation}\n$$\n\n" if stage.equation else ""
    return f"# {name}\n\n{_title(stage)}\n\n{equation}{rows}"


def _row(parameter: Parameter) -> tuple[str, ...]:
    default = parameter.default
    without = "" if default is MISSING else "none" if default is None else shown(thawed(default))
    form = f"{parameter.form.value}: {parameter.shape}" if parameter.dimensions else parameter.form.value
    return f"`{parameter.name}`", form, parameter.unit, bounds(parameter), without, parameter.scatter.value, parameter.meaning


def bounds(parameter: Parameter) -> str:
    """Bounds of a parameter in words."""
    whole = parameter.kind is INTEGER and parameter.form is not Form.COUNT
    return ", ".join([*filter(None, [parameter.bounds]), *(["whole"] * whole), *(["may be infinite"] * parameter.infinite)])
