"""Location of the files of `config/`: in the source tree, or in the share folder of an installed package."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from hyst_control.base.errors import InputError


def config_folders() -> list[Path]:
    """List the existing `config` folders, the source tree first, then installed ones (colcon workspaces, then pip)."""
    prefixes = [Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    folders = [
        Path(__file__).resolve().parents[2] / "config",
        *(prefix / "share" / "hyst_control" / "config" for prefix in (*prefixes, Path(sys.prefix))),
    ]
    return [folder for folder in folders if folder.is_dir()]


def config_path(name: str | Path) -> Path:
    """Find a shipped configuration file.

    Parameters
    ----------
    name
        Path within `config/`, such as ``plants/pea.yaml``.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    InputError
        There is no such file.
    """
    for folder in config_folders():
        if (folder / name).is_file():
            return folder / name
    siblings = sorted({path.name for folder in config_folders() for path in (folder / name).parent.glob("*.yaml")})
    raise InputError(
        f"config/{name}: no such file: {'use one of ' + ', '.join(siblings) if siblings else 'reinstall hyst_control'}"
    )
