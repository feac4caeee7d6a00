"""Reference of all stages and their parameters as Markdown, made from the declarations."""

from __future__ import annotations

import inspect
from dataclasses import MISSING, fields
from typing import Any

import numpy as np

from hyst_control.chain.parameter import Parameter, declared
from hyst_control.chain.stage import STAGES, Stage, thawed

HEAD = """# Stages

Written by `python docs/make_stages.py` from the stages' declarations.

Every stage of a model file with its equation, from input u to output y with the parameters by name, and its parameters. *Form*: a
number holds for every axis, a list where a number is due (a list of lists where a list is due) is per axis; what belongs to all axes
together is said so. *Scatter*: whether `tolerance` and `uncertainty` of a model file may name the parameter, and in which way an
identification knows it.
"""


def stages_reference() -> str:
    """Every registered stage in alphabetical order: its first sentence, its equation and a table of its parameters."""
    return HEAD + "".join(_section(name, STAGES[name]) for name in sorted(STAGES))


def _section(name: str, stage: type[Stage]) -> str:
    title = (inspect.getdoc(stage) or "").split("\n\n")[0].replace("\n", " ")
    known = {found.name: found for found in fields(stage)}
    rows = [_row(key, parameter, known[key].default) for key, parameter in declared(stage).items()]
    head = "| parameter | form | unit | bounds | default | scatter | |\n|---|---|---|---|---|---|---|\n"
    equation = f"$$\n{stage.equation}\n$$\n\n" if stage.equation else ""
    return f"\n## {name}\n\n{title}\n\n{equation}{head}{''.join(rows)}"


def _row(name: str, parameter: Parameter, default: Any) -> str:
    without = "" if default is MISSING else "none" if default is None else f"{thawed(default)}".lower()
    form = f"{parameter.kind.value}: {parameter.form}" if parameter.dimensions else parameter.kind.value
    cells = (f"`{name}`", form, parameter.unit, bounds(parameter), without, parameter.scatter.value, parameter.text)
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n"


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
