"""Writing files so that a reader never meets half of one."""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

from hyst_control.errors import InputError


def check_writable(path: str | Path) -> None:
    """Raise `InputError` unless a file of this name can be written, as far as that can be told beforehand."""
    folder = Path(path).parent
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        raise InputError(f"{path}: its folder does not exist or cannot be written: create it first")
    if Path(path).is_dir():
        raise InputError(f"{path}: is a directory: give the name of a file")


def write_text(path: str | Path, text: str) -> None:
    """Write to a temporary file beside it, then rename. Raises `InputError` where the folder cannot be written."""
    path = Path(path)
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}: choose a folder that exists and can be written") from None
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        os.unlink(temporary)
        raise InputError(f"{path}: {error.strerror or error}: choose a file name that can be written") from None
    except BaseException:
        os.unlink(temporary)
        raise


def write_json(path: str | Path, document: Any) -> None:
    """A JSON document; numbers that are none are refused."""
    write_text(path, json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
