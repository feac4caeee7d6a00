# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A controller as a package of ros2_control: a chainable controller around the exported C."""

from __future__ import annotations

from pathlib import Path

from hyst_control.base.errors import InputError
from hyst_control.base.files import write_texts
from hyst_control.base.installed import installed_version
from hyst_control.export.c_source import header, source
from hyst_control.export.c_text import c_comment, c_identifiers
from hyst_control.export.controller import Controller
from hyst_control.export.programs import MADE_BY, Exported
from hyst_control.reporting.templates import render

TEMPLATES = ("CMakeLists.txt", "controller.cpp", "controllers.yaml", "package.xml", "plugin.xml")


def write_package(exported: Exported, folder: str | Path) -> list[Path]:
    """Write the package's folder; the same controller gives the same bytes."""
    program = exported.program
    if not isinstance(exported.python, Controller):
        raise InputError("--ros2-control: is of a controller: give a file of nodes' parameters, not a model")
    rate = round(1.0 / program.sample_time)
    if abs(rate * program.sample_time - 1.0) > 1e-9:
        raise InputError(f"rate_hz: a controller manager takes whole Hz, got {1.0 / program.sample_time:g}: choose a whole rate")
    references = program.inputs[: program.axes]
    values = {
        "name": program.name,
        "upper": program.name.upper(),
        "package": f"{program.name}_controller",
        "axes": [name.removeprefix("reference_") for name in c_identifiers([slot.name for slot in references])],
        "unit": c_comment(program.inputs[program.axes].text),
        "rate": rate,
        "version": installed_version("1.0.0"),
        "description": program.facts[0],
    }
    texts = {f"{program.name}.h": header(program), f"{program.name}.c": source(program)}
    texts |= {name: render(f"export/templates/ros2_control/{name}", **values) for name in TEMPLATES}
    return write_texts(folder, texts, MADE_BY)
