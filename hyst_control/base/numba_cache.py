# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A place for compiled code where neither the installation nor the home can be written: numba refuses to import kernels without one."""

from __future__ import annotations

import os
import stat
import sys
import tempfile
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


def prepare() -> None:
    """Choose a temporary folder, and say so in one line, unless the user chose one or numba's own places can be written.

    Child processes inherit the choice, so that kernels are compiled once.
    """
    if os.environ.get(VARIABLE):
        return
    home = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    if _writable(Path(__file__).parents[1] / "chain" / "__pycache__") or _writable(Path(home) / "numba"):
        return
    try:
        folder = _own_folder()
    except OSError:
        return  # numba says what is wrong
    os.environ[VARIABLE] = folder
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = folder  # it read the environment when it was imported
    print(f"hyst_control: the installation and {home} cannot be written: compiled code is kept in {folder}", file=sys.stderr)


def _writable(folder: Path) -> bool:
    """True where a file can be created in a folder, tried by creating one: permissions alone do not tell. A missing folder is created."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _own_folder() -> str:
    """A folder that nobody else can write: what is in it is executed. The same at the next start where it can be."""
    folder = os.path.join(tempfile.gettempdir(), f"hyst_control-numba-{_user()}")
    try:
        os.mkdir(folder, 0o700)
    except FileExistsError:
        found = os.lstat(folder)
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != _user() or found.st_mode & 0o022:
            return tempfile.mkdtemp(prefix="hyst_control-numba-")
    return folder


def _user() -> int:
    """Number of the user; 0 on Windows, where a user's temporary folder is the user's own and files have the owner 0."""
    return os.getuid() if hasattr(os, "getuid") else 0
