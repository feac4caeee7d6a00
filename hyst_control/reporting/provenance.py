# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Provenance of a page or file: version, date, command, and the files it was made from."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path

from hyst_control.base.installed import installed_version


@dataclass(frozen=True)
class Origin:
    """One line of the provenance."""

    name: str  # Such as "model"
    texts: tuple[str, ...]  # One or several texts; paths where `files` is true
    files: bool = False  # Whether the texts are paths of files or folders, to which the page links

    def seen_from(self, folder: Path) -> tuple[str, list[tuple[str, str | None]]]:
        """Prepare the line for a page."""
        if not self.files:
            return self.name, [(text, None) for text in self.texts]
        links = [_link(text, folder) for text in self.texts]
        return self.name, [
            (text if link is None or link.startswith("..") else link, link) for text, link in zip(self.texts, links, strict=True)
        ]


def provenance(files: Sequence[tuple[str, Sequence[str | Path]]] = (), facts: Sequence[tuple[str, str]] = ()) -> list[Origin]:
    """Describe where a result comes from."""
    found = [Origin(name, tuple(str(path) for path in paths), True) for name, paths in files if paths]
    found += [Origin(name, (text,)) for name, text in facts]
    return [
        *found,
        Origin("command", (shlex.join([Path(sys.argv[0] or "python").name, *sys.argv[1:]]),)),
        Origin("made by", (f"hyst_control {installed_version()}",)),
        Origin("date", (datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),)),
    ]


def _link(text: str, folder: Path) -> str | None:
    path = Path(text)
    return Path(os.path.relpath(os.path.realpath(path), os.path.realpath(folder))).as_posix() if path.exists() else None
