# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A program as a functional mock-up unit: co-simulation by FMI 2.0, of the exported C, with its sources."""

from __future__ import annotations

import hashlib
import platform
import subprocess
import tempfile
import zipfile
from pathlib import Path

from hyst_control.base.errors import InputError
from hyst_control.export.c_source import Program, header, source
from hyst_control.export.c_text import c_identifiers
from hyst_control.export.compiled import FLAGS, c_compiler
from hyst_control.reporting.templates import render

PLATFORMS = {
    ("Linux", "x86_64"): "linux64",
    ("Darwin", "x86_64"): "darwin64",
    ("Darwin", "arm64"): "darwin64",
    ("Windows", "AMD64"): "win64",
}
"""Folders of binaries by system and processor, as FMI 2.0 names them."""
SUFFIXES = {"Windows": "dll", "Darwin": "dylib"}
EPOCH = (1980, 1, 1, 0, 0, 0)  # Date of every entry, so that the same program gives the same bytes


def write_fmu(program: Program, path: str | Path) -> Path:
    """Write a unit for this machine: the same program and compiler give the same bytes."""
    path, name = Path(path), program.name
    inputs, outputs = (
        [{"name": word, "text": slot.text} for word, slot in zip(c_identifiers([slot.name for slot in slots]), slots, strict=True)]
        for slots in (program.inputs, program.outputs)
    )
    texts = {f"{name}.h": header(program), f"{name}.c": source(program)}
    guid = hashlib.sha256(repr((texts, inputs, outputs)).encode()).hexdigest()[:32]
    values = {"name": name, "upper": name.upper(), "guid": f"{{{guid}}}", "sample_time": repr(program.sample_time)}
    texts["fmi2.c"] = render("export/templates/fmi2.c", **values)
    description = render(
        "export/templates/modelDescription.xml", **values, inputs=inputs, outputs=outputs, description=program.facts[0]
    )
    system = platform.system()
    folder = PLATFORMS.get((system, platform.machine()), f"{platform.machine()}-{system.lower()}")
    entries = {
        "modelDescription.xml": description.encode(),
        **{f"sources/{file}": text.encode() for file, text in texts.items()},
        f"binaries/{folder}/{name}.{SUFFIXES.get(system, 'so')}": _library(name, texts),
    }
    try:
        with zipfile.ZipFile(path, "w") as archive:
            for entry, content in entries.items():
                archive.writestr(zipfile.ZipInfo(entry, EPOCH), content, zipfile.ZIP_DEFLATED)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}: choose another file") from None
    return path


def _library(name: str, texts: dict[str, str]) -> bytes:
    """The compiled library, which exports the functions of FMI alone."""
    command = [c_compiler(), *FLAGS, "-fvisibility=hidden", "-o", "unit.so", f"{name}.c", "fmi2.c", "-lm"]
    with tempfile.TemporaryDirectory() as work:
        for file, text in texts.items():
            (Path(work) / file).write_text(text, encoding="utf-8")
        done = subprocess.run(command, cwd=work, capture_output=True, text=True, check=False)
        if done.returncode:
            raise InputError(f"{command[0]}: cannot compile {name}: {done.stderr.strip().splitlines()[0]}")
        return (Path(work) / "unit.so").read_bytes()
