# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Foreign formats whose readers are machine code: read in a process of its own, which a damaged file may end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.records.stream.row_store import IN_MEMORY

CHILD = "from hyst_control.records.tables import array_files, child_reader; child_reader.main(array_files.read_arrays)"
REFUSED = 2


def arrays_from_child(path: Path, kind: str) -> dict[str, Array]:
    """`array_files.read_arrays` of a `path` and `kind` in another process: a crash there is a refusal here."""
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
        # Large ones are mapped: they are there until nobody uses them, though their files have no name any more.
        return {name: np.load(file, "r" if file.stat().st_size > IN_MEMORY else None) for name, file in files.items()}


def main(read: Callable[..., Mapping[str, Array]]) -> None:
    """In the child, write what `read` finds to numbered files in a folder, and print the names, or the reason of a refusal."""
    path, kind, folder = sys.argv[1:]
    try:
        found = read(path, kind, in_child=True)
    except InputError as error:
        print(json.dumps(str(error)))
        raise SystemExit(REFUSED) from None
    for number, value in enumerate(found.values()):
        np.save(Path(folder) / f"{number}.npy", value)
    print(json.dumps(list(found)))
