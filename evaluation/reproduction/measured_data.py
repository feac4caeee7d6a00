"""Location of the public measurements: the folder named by `HYST_DATA`, or `../shared/data` beside the repository."""

from __future__ import annotations

import os
from pathlib import Path

from hyst_control.base.errors import InputError


def data_folder(name: str) -> Path:
    """Find the folder of one set of measurements."""
    given = os.environ.get("HYST_DATA")
    root = Path(given) if given else Path(__file__).resolve().parents[2].parent / "shared" / "data"
    if (root / name).is_dir():
        return root / name
    raise InputError(f"{name}: the measurements are not in {root}: set HYST_DATA to the folder that holds {name}")
