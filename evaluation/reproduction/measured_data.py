# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The public measurements, in the folder named by `HYST_DATA`, or in `../shared/data` beside the repository."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError

Content = TypeVar("Content")


def data_folder(name: str) -> Path:
    """Find the folder of one set of measurements."""
    given = os.environ.get("HYST_DATA")
    root = Path(given) if given else Path(__file__).resolve().parents[2].parent / "shared" / "data"
    if (root / name).is_dir():
        return root / name
    raise InputError(f"{name}: the measurements are not in {root}: set HYST_DATA to the folder that holds {name}")


def read(path: Path, reader: Callable[[Path], Content]) -> Content:
    """Read a file of the measurements."""
    try:
        return reader(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}): fetch the file again") from None


def read_array(path: Path, *shape: int) -> Array:
    """Read the array of a file, whose shape is known."""
    values = read(path, np.load)
    if values.shape != shape:
        raise InputError(f"{path}: shape {values.shape}, must be {shape}: fetch the file again")
    found: Array = values.astype(np.float64)
    return found
