# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reference of the stages: a page for each with its equation and parameters, written from their declarations."""

from __future__ import annotations

import inspect
from dataclasses import MISSING, fields
from typing import Any

import numpy as np

import hyst_control.effects  # noqa: F401  (registers the effects' stages)
from hyst_control.chain.parameter import Parameter, declared
from hyst_control.chain.stage import STAGES, Stage, thawed

HEAD = """# Stages

Every stage of a model file, with its equation from input u to output y and its parameters. *Form*: a number applies to every axis; a list
in place of a number (a list of lists in place of a list) gives a value per axis. *Scatter*: the coordinates in
which `tolerance` and `uncertainty` of a model file give the parameter's scatter; `none` if they do not accept it.

| stage | |
|---|---|
"""


def stage_pages() -> dict[str, str]:
    """Every registered stage's page by its name, and their list as `index`."""
    names = sorted(STAGES)
    rows = [f"| [`{name}`]({name}.md) | {_cell(_title(STAGES[name]))} |\n" for name in names]
    return {"index": HEAD + "".join(rows)} | {name: _page(name, STAGES[name]) for name in names}


def _title(stage: type[Stage]) -> str:
    return (inspect.getdoc(stage) or "").split("\n\n")[0].replace("\n", " ")


def _page(name: str, stage: type[Stage]) -> str:
    known = {found.name: found for found in fields(stage)}
    rows = [_row(key, parameter, known[key].default) for key, parameter in declared(stage).items()]
    head = "| parameter | form | unit | bounds | default | scatter | |\n|---|---|---|---|---|---|---|\n"
    equation = f"$$\n{stage.equation}\n$$\n\n" if stage.equation else ""
    return f"# {name}\n\n{_title(stage)}\n\n{equation}{head}{''.join(rows)}"


def _row(name: str, parameter: Parameter, default: Any) -> str:
    without = "" if default is MISSING else "none" if default is None else f"{thawed(default)}".lower()
    form = f"{parameter.kind.value}: {parameter.form}" if parameter.dimensions else parameter.kind.value
    cells = (f"`{name}`", form, parameter.unit, bounds(parameter), without, parameter.scatter.value, parameter.text)
    return f"| {' | '.join(map(_cell, cells))} |\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def bounds(parameter: Parameter) -> str:
    """Bounds of a parameter in words."""
    found = [
        f"{sign} {bound:g}"
        for sign, bound in (
            ("≥", parameter.lower),
            (">", parameter.above),
            ("≤", parameter.upper),
            ("<", parameter.below),
        )
        if np.isfinite(bound)
    ]
    return ", ".join([*found, *(["whole"] * parameter.whole), *(["may be infinite"] * parameter.infinite)])
