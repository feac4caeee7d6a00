"""Foreign formats whose readers are machine code: read in a process of its own, which a damaged file may end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from hyst_control.errors import InputError
from hyst_control.records import array_files

CHILD = "from hyst_control.records.child_reader import main; main()"
REFUSED = 2


def arrays_from_child(path: Path, kind: str) -> dict[str, array_files.Array]:
    """`array_files.read_arrays` in another process: a crash there is a refusal here."""
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
        # Large ones are mapped: they are there until nobody uses them, though their names are gone.
        return {name: array_files.read_array(Path(folder) / f"{number}.npy") for number, name in enumerate(json.loads(done.stdout))}


def main() -> None:
    """In the child: the arrays go to numbered files in a folder, their names, or the reason of a refusal, to the standard output."""
    path, kind, folder = sys.argv[1:]
    try:
        found = array_files.read_arrays(path, kind, in_child=True)
    except InputError as error:
        print(json.dumps(str(error)))
        raise SystemExit(REFUSED) from None
    for number, value in enumerate(found.values()):
        np.save(Path(folder) / f"{number}.npy", value)
    print(json.dumps(list(found)))
