# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Arrays out of NumPy and MATLAB files. What a file announces is held against its size before any memory is taken for it."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.foreign_readers import foreign_reader
from hyst_control.records.bags.decompression import Budget
from hyst_control.records.stream.row_store import IN_MEMORY, blocks, empty_rows

KINDS = (".npy", ".npz", ".mat")
CRASHING = (".mat",)  # Kinds whose readers are machine code that a damaged file can crash: read in a child process
CHILD = "from hyst_control.records.tables.array_files import main; main()"
REFUSED = 2  # Exit status of a child that refuses a file
PIECE = 2**20
MAT_HEADER, MAT_COMPRESSED = 128, 15


def read_array(path: str | Path) -> Array:
    """Numbers of the .npy file at `path`, of any shape. Raises `InputError` when it holds no array of real numbers."""
    found = read_arrays(path, ".npy")
    if "" not in found:
        raise InputError(f"{path}: holds no real numbers: give an array of them")
    return found[""]


def read_arrays(path: str | Path, kind: str, in_child: bool = False) -> dict[str, Array]:
    """All arrays of real numbers in a file, by name."""
    path = Path(path)
    if kind in CRASHING and not in_child and path.exists():
        return _read_in_child(path, kind)
    with foreign_reader(path, f"a {kind} file", "check how it was written, or save it as CSV"):
        if kind == ".npy":
            with open(path, "rb") as file:
                return real_arrays({"": _npy(file, path.stat().st_size, path)})
        return real_arrays(_npz(path) if kind == ".npz" else _mat(path))


def _read_in_child(path: Path, kind: str) -> dict[str, Array]:
    """`read_arrays` in another process: a crash there is a refusal here."""
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-c", CHILD, str(path), kind, folder],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            check=False,
        )
        if done.returncode == REFUSED:
            raise InputError(json.loads(done.stdout))
        if done.returncode:
            ended = signal.Signals(-done.returncode).name if done.returncode < 0 else f"status {done.returncode}"
            raise InputError(f"{path}: is damaged, its reader ended with {ended}: check how it was written, or save it as CSV")
        files = {name: Path(folder) / f"{number}.npy" for number, name in enumerate(json.loads(done.stdout))}
        # Large ones are mapped: they stay while they are used, though their files have no name any more.
        return {name: np.load(file, "r" if file.stat().st_size > IN_MEMORY else None) for name, file in files.items()}


def main() -> None:
    """In the child, write the arrays to numbered files in a folder, and print their names, or the reason of a refusal."""
    path, kind, folder = sys.argv[1:]
    try:
        found = read_arrays(path, kind, in_child=True)
    except InputError as error:
        print(json.dumps(str(error)))
        raise SystemExit(REFUSED) from None
    for number, value in enumerate(found.values()):
        np.save(Path(folder) / f"{number}.npy", value)
    print(json.dumps(list(found)))


def hdf5_arrays(path: Path) -> dict[str, Any]:
    """Arrays of an HDF5 file by their path, with dots; those that MATLAB wrote are turned, as it stores columns first."""
    import h5py

    found: dict[str, Any] = {}
    budget = Budget(path.stat().st_size)

    def keep(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or item.dtype.kind not in "iufV" or not item.ndim or item.external:
            return
        budget.take(item.size * item.dtype.itemsize)
        found[name.replace("/", ".")] = np.squeeze(item[()].T) if "MATLAB_class" in item.attrs else item[()]

    with h5py.File(path, "r") as file:
        file.visititems(keep)
    return real_arrays({name: value for name, value in found.items() if not name.startswith("#")})


def real_arrays(found: Mapping[str, Any]) -> dict[str, Array]:
    """The arrays of real numbers as float64, moments as seconds from the first, and each column of a table by its path."""
    arrays: dict[str, Array] = {}
    for name, value in found.items():
        if not isinstance(value, np.ndarray):
            continue
        if value.dtype.names:
            arrays |= real_arrays({f"{name}.{column}".lstrip("."): value[column] for column in value.dtype.names})
        if value.dtype.kind in "mM" and value.size:
            value = (value - value.flat[0]) / np.timedelta64(1, "ns") * 1e-9
        if value.dtype.kind in "iuf":
            arrays[name] = _as_float64(value)
    return arrays


def _as_float64(value: Any) -> Array:
    """An array of real numbers as float64; a large one that has to be converted is put on a file."""
    if value.dtype == np.float64 or value.nbytes <= IN_MEMORY or value.ndim == 0:
        return np.asarray(value, dtype=np.float64)
    found = empty_rows(*value.shape)
    for part in blocks(len(value)):
        found[part] = value[part]
    return found


def _npy(file: IO[bytes], size: int, path: Path | None = None) -> Any:
    """The array of a .npy stream of so many bytes; None where it holds no numbers, moments or table. A large one in a file is mapped."""
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(file)
    if dtype.kind not in "biufmMV" or dtype.hasobject:
        return None  # texts, objects, complex numbers
    count = math.prod(shape)  # of Python's integers: they do not overflow
    if count * dtype.itemsize > size:
        raise ValueError(f"it announces {count * dtype.itemsize} bytes and has {size}")
    if path is not None and count * dtype.itemsize > IN_MEMORY:
        return np.lib.format.open_memmap(path, "r")
    file.seek(0)
    return np.lib.format.read_array(file, allow_pickle=False)


def _npz(path: Path) -> dict[str, Any]:
    budget = Budget(path.stat().st_size)
    found: dict[str, Any] = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if member.filename.endswith(".npy"):
                budget.take(member.file_size)
                with archive.open(member) as file:
                    found[member.filename.removesuffix(".npy")] = _npy(file, member.file_size)
    return found


def _mat(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    _check_mat(path)
    try:
        content = loadmat(path, simplify_cells=True)
    except NotImplementedError:
        try:
            return hdf5_arrays(path)
        except (ModuleNotFoundError, OSError):
            raise InputError(f"{path}: is a MATLAB 7.3 file: save it with -v7, or as .npz or CSV, or install h5py") from None
    found: dict[str, Any] = {}
    objects: list[str] = []
    for name, value in content.items():
        if not name.startswith("__"):
            _flatten(name, value, found, objects)
    if objects and not any(isinstance(value, np.ndarray) and value.dtype.kind in "iuf" for value in found.values()):
        raise InputError(
            f"{path}: {objects[0]}: only MATLAB reads it: save its columns there as arrays (u = T.u; save run.mat u y)"
        )
    return found


def _flatten(name: str, value: Any, found: dict[str, Any], objects: list[str]) -> None:
    """Collect the arrays within structures and cells by their path; MATLAB's own objects by name and class."""
    if isinstance(value, dict):
        for key, inner in value.items():
            _flatten(f"{name}.{key}", inner, found, objects)
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        cells = list(value) if isinstance(value, list) else value.ravel().tolist()
        if cells and all(isinstance(cell, (int, float)) for cell in cells):
            found[name] = np.array(cells, dtype=np.float64)
            return
        for number, inner in enumerate(cells, start=1):
            _flatten(f"{name}({number})", inner, found, objects)
    elif isinstance(value, np.ndarray) and value.dtype.names and "s2" in value.dtype.names:
        said = value.ravel()[0]
        title, kind = (part.decode() if isinstance(part, bytes) else str(part) for part in (said["s0"], said["s2"]))
        objects.append(f"{title or name} is a MATLAB object ({kind})")
    else:
        found[name] = value


def _check_mat(path: Path) -> None:
    """Hold what the compressed variables of a MATLAB 5 file expand to against its size."""
    budget = Budget(path.stat().st_size)
    with open(path, "rb") as file:
        order: Any = {b"IM": "little", b"MI": "big"}.get(file.read(MAT_HEADER)[126:])
        if order is None:
            return  # MATLAB 4: nothing is compressed
        while len(tag := file.read(8)) == 8:
            kind, length = int.from_bytes(tag[:4], order), int.from_bytes(tag[4:], order)
            if kind != MAT_COMPRESSED:
                file.seek(length, 1)
                continue
            expander, left = zlib.decompressobj(), length
            while left and (piece := file.read(min(left, PIECE))):
                left -= len(piece)
                while piece:
                    budget.take(len(expander.decompress(piece, PIECE)))
                    piece = expander.unconsumed_tail
