# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A program compiled on this machine into a shared library and called from Python: the exported C itself, cached by its hash."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from platformdirs import user_cache_path

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.export.c_source import Program, header, source

COMPILERS = ("gcc", "clang", "cc")
FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-ffp-contract=off")

INTERFACE = """
typedef struct {name}_state {name}_state;
void {name}_settle({name}_state *state, const {real} *in, {real} *out);
void {name}_block({name}_state *state, const {real} *in, {real} *out, int rows);
int {name}_state_bytes(void);
"""


class CompiledProgram:
    """A program running in C. Its state is memory of its own: `state` may be copied, kept and written back."""

    def __init__(self, program: Program) -> None:
        self.type = np.dtype(np.float64 if program.real == "double" else np.float32)
        ffi = cffi.FFI()
        # The state is opaque here: its size is what the library says.
        ffi.cdef(INTERFACE.format(name=program.name, real=program.real))
        self._ffi = ffi
        self._library = ffi.dlopen(str(shared_library(program)))
        self._settle = getattr(self._library, f"{program.name}_settle")
        self._block = getattr(self._library, f"{program.name}_block")
        self.state = np.zeros(getattr(self._library, f"{program.name}_state_bytes")(), dtype=np.uint8)
        self._state = ffi.cast(f"{program.name}_state *", ffi.from_buffer(self.state))
        self._kind = f"{program.real}[]"
        self.widths = len(program.inputs), len(program.outputs)
        # A single tick has its memory, and the pointers to it, once and for all.
        self.row_in = np.zeros((1, self.widths[0]), dtype=self.type)
        self.row_out = np.zeros((1, self.widths[1]), dtype=self.type)
        self._row = self._state, self._pointer(self.row_in), self._pointer(self.row_out), 1

    def numbers(self, kind: str, offset: int) -> Any:
        """Numbers of the state of a `kind`, "double" or "int", by index, from an `offset` in bytes on."""
        return self._ffi.cast(f"{kind} *", self._ffi.from_buffer(self.state) + offset)

    def settle(self, value: Array) -> Array:
        """Come to rest at a constant input; the output."""
        given = np.ascontiguousarray(value, dtype=self.type)
        output = np.empty(self.widths[1], dtype=self.type)
        self._settle(self._state, self._pointer(given), self._pointer(output))
        return output.astype(np.float64, copy=False)

    def step(self) -> None:
        """One step from `row_in` (1, inputs) to `row_out` (1, outputs)."""
        self._block(*self._row)

    def process(self, block: Array) -> Array:
        """Outputs (N, outputs) of N steps for a `block` of inputs (N, inputs)."""
        if len(block) == 1:
            self.row_in[:] = block
            self.step()
            return self.row_out.astype(np.float64)
        given = np.ascontiguousarray(block, dtype=self.type).reshape(-1, self.widths[0])
        output = np.empty((len(given), self.widths[1]), dtype=self.type)
        self._block(self._state, self._pointer(given), self._pointer(output), len(given))
        return output.astype(np.float64, copy=False)

    def _pointer(self, array: np.ndarray) -> Any:
        return self._ffi.from_buffer(self._kind, array)


def c_compiler(compiler: str | None = None) -> str:
    """Command of a C compiler. Raises `InputError` where none is installed."""
    for name in (compiler,) if compiler else COMPILERS:
        if shutil.which(name):
            return name
    wanted = compiler or " or ".join(COMPILERS)
    raise InputError(f"no C compiler: {wanted} is not installed: install gcc, or take backend: python")


def shared_library(program: Program) -> Path:
    """Shared library of a program, compiled unless the user's cache has it."""
    command = c_compiler()
    name = program.name
    told = subprocess.run([command, "--version"], capture_output=True, text=True, check=False).stdout
    size = f"int {name}_state_bytes(void);\n\nint {name}_state_bytes(void)\n{{\n    return (int)sizeof({name}_state);\n}}\n"
    texts = {f"{name}.h": header(program), f"{name}.c": source(program) + size}
    key = hashlib.sha256(repr((texts, FLAGS, command, told)).encode()).hexdigest()
    folder = user_cache_path("hyst_control") / "compiled"
    target = folder / f"{name}-{key[:32]}.so"
    if target.exists():
        return target
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as work:
        for file, text in texts.items():
            (Path(work) / file).write_text(text, encoding="utf-8")
        built = Path(work) / "library.so"
        done = subprocess.run(
            [command, *FLAGS, "-o", str(built), str(Path(work) / f"{name}.c"), "-lm"], capture_output=True, text=True, check=False
        )
        if done.returncode:
            raise InputError(f"{command}: cannot compile {name}.c: {done.stderr.strip().splitlines()[0]}")
        os.replace(built, target)  # another process may have built the same
    return target
