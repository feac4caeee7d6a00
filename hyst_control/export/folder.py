# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The exported folder: header and source, golden vectors made by Python, a test program, and a Makefile that runs it."""

from __future__ import annotations

import hashlib
import re
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.files import write_texts
from hyst_control.chain.c_code.c_code import CCode
from hyst_control.export.c_source import Program, header, source
from hyst_control.export.compiled import c_compiler
from hyst_control.export.controller import Controller
from hyst_control.export.programs import MADE_BY, Exported
from hyst_control.reporting.templates import render

ROWS = 400  # Golden vectors
SMALL = ("-std=c99", "-Os", "-ffp-contract=off", "-fno-asynchronous-unwind-tables")


@dataclass(frozen=True)
class Size:
    """Memory of a program."""

    state: int  # Bytes of the state
    flash: int | None  # Bytes of code and constants, compiled for this machine; None without a compiler


def write_folder(
    exported: Exported, folder: str | Path, sources: Sequence[str | Path] = (), plant: Exported | None = None
) -> list[Path]:
    """Write everything; the same program gives the same bytes."""
    hashes = [f"{Path(path).name}: SHA-256 {hashlib.sha256(Path(path).read_bytes()).hexdigest()}" for path in sources]
    program = replace(exported.program, facts=(*exported.program.facts, *hashes))
    values: dict[str, object] = {"name": program.name, "upper": program.name.upper(), "exact": int(program.exact)}
    values["plant"] = plant.program.name if plant else ""
    _check_outputs(exported, program.real)
    values["reals"] = _reals(exported)
    values["limits"] = ()
    if isinstance(exported.python, Controller):
        law = exported.python.pi
        values["limits"] = program.axes, float(law.lower).hex(), float(law.upper).hex()
    texts = {
        f"{program.name}.h": header(program),
        f"{program.name}.c": source(program),
        f"{program.name}_golden.h": golden(exported),
        f"{program.name}_test.c": render("export/templates/test.c", **values),
        "Makefile": render("export/templates/Makefile", **values),
    }
    if plant is not None:
        texts.update(_loop(exported, plant, values))
    return write_texts(folder, texts, MADE_BY)


def _loop(exported: Exported, plant: Exported, values: Mapping[str, object]) -> dict[str, str]:
    """A program that closes the loop, and the plant that it closes it against."""
    program, simulated, running = exported.program, plant.program, exported.python
    if not isinstance(running, Controller):
        raise InputError("plant: closes the loop of a controller: give a file of nodes' parameters, not a model")
    if (simulated.axes, simulated.sample_time) != (program.axes, program.sample_time) or simulated.name == program.name:
        raise InputError(
            f"plant: {simulated.name} has {simulated.axes} axes, the controller {program.name} {program.axes}: "
            "take the model of its plant, and different names"
        )
    low, high = exported.spans[: program.axes].T
    loop = render(
        "export/templates/loop.c",
        **values,
        plant_upper=simulated.name.upper(),
        ahead=running.ahead,
        middle=", ".join(float(value).hex() for value in 0.5 * (low + high)),
        amplitude=", ".join(float(value).hex() for value in 0.25 * (high - low)),
    )
    return {f"{program.name}_main.c": loop, f"{simulated.name}.h": header(simulated), f"{simulated.name}.c": source(simulated)}


def golden(exported: Exported) -> str:
    """Golden vectors as a header: inputs, and what Python makes of them."""
    rows, outputs = _golden_rows(exported)

    def table(name: str, values: Array) -> list[str]:
        lines = [f"    {{{', '.join(float(value).hex() for value in row)}}}," for row in values]
        return [f"static const double {name}[][{values.shape[1]}] = {{", *lines, "};", ""]

    head = [
        "/* Made by hyst export with Python: the first row is settled at, the others are stepped through. */",
        f"enum {{ ROWS = {len(rows)} }};",
        "",
    ]
    return "\n".join([*head, *table("golden_in", rows), *table("golden_out", outputs)])


def _golden_rows(exported: Exported) -> tuple[Array, Array]:
    """Inputs, and what Python makes of them."""
    rows = golden_inputs(exported.spans)
    with np.errstate(all="ignore"):  # what comes of it is looked at
        start = np.atleast_2d(exported.python.settle(rows[0].copy()))
        return rows, np.concatenate([start, exported.python.process(rows[1:])])


def _check_outputs(exported: Exported, real: str) -> None:
    """Refuse a program whose outputs are not finite, or too large or small for the type."""
    program, largest = exported.program, float(np.abs(_golden_rows(exported)[1]).max())
    held = np.finfo("float32" if real == "float" else "float64")
    if not largest <= float(held.max) or 0 < largest < float(held.tiny / held.eps):
        raise InputError(
            f"{program.name}: its output reaches {largest:g} within its own range, which {real} cannot hold: "
            "check the model's parameters and units"
        )


def _reals(exported: Exported) -> str:
    """Types that the tests go through, as in the header: double, and float where it can hold all numbers."""
    try:
        replace(exported.program, real="float")
        _check_outputs(exported, "float")
    except InputError:
        return "0"
    return "0 1"


def golden_inputs(spans: Annotated[Array, "I 2"]) -> Array:
    """Inputs (`ROWS`, I) of the golden vectors: smooth loops within loops, then a walk with holds and reversals, then both ends."""
    random = np.random.default_rng(25)
    count, columns = ROWS // 2, len(spans)
    time, phase = np.arange(count)[:, None] / count, np.arange(columns)[None, :]
    loops = 0.5 - 0.5 * np.cos(2 * np.pi * 6 * time + phase) * np.exp(-2.0 * time)
    steps = random.normal(0.0, 0.06, (count - 20, columns)) * (random.random((count - 20, columns)) < 0.7)
    walk = 0.5 + 0.5 * np.sin(np.pi * (loops[-1] - 0.5 + np.cumsum(steps, axis=0)))
    ends = np.repeat([np.ones(columns), np.zeros(columns)], 10, axis=0)
    shares = np.concatenate([loops, walk, ends])
    # Inputs that float holds too.
    return np.asarray((spans[:, 0] + shares * (spans[:, 1] - spans[:, 0])).astype(np.float32).astype(float))


def sizes(program: Program) -> Size:
    """Memory that a program takes."""
    try:
        compiler = c_compiler()
    except InputError:
        return Size(_state_bytes(program.code, program.real), None)
    probe = f"extern const char state_bytes[];\nconst char state_bytes[sizeof({program.name}_state)] = {{0}};\n"
    with tempfile.TemporaryDirectory() as work:
        (Path(work) / f"{program.name}.h").write_text(header(program), encoding="utf-8")
        (Path(work) / "unit.c").write_text(source(program) + probe, encoding="utf-8")
        subprocess.run([compiler, *SMALL, "-c", "unit.c"], cwd=work, check=True, capture_output=True)
        listed = subprocess.run(["nm", "-S", "unit.o"], cwd=work, check=True, capture_output=True, text=True).stdout
    found = re.findall(r"^\w+ (\w+) (\w) (\S+)$", listed, re.MULTILINE)
    state = next(int(size, 16) for size, _, name in found if name == "state_bytes")
    flash = sum(int(size, 16) for size, kind, name in found if kind in "tTrR" and name != "state_bytes")
    return Size(state, flash)


def _state_bytes(code: CCode, real: str) -> int:
    """Bytes of the members, without what a compiler puts between them."""
    width = 8 if real == "double" else 4
    own = sum(
        max(member.value.size, 1) * (4 if member.value.dtype.kind in "iub" else 8 if member.wide else width)
        for member in code.state.values()
    )
    return own + sum(_state_bytes(part, real) for part in code.parts)
