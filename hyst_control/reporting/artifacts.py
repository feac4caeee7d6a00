# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Artifacts of a command: its files with their sizes and hashes, and facts on their content, as JSON and as lines."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SCHEMA = "hyst_control/made"
VERSION = 1
MAX_NAMED = 4


@dataclass(frozen=True)
class Fact:
    """One number on an artifact."""

    case: str  # Topic or file it is about, "" for the whole
    quantity: str  # Name of the quantity
    unit: str  # Unit of the value
    value: float  # The value


@dataclass
class Artifacts:
    """Artifacts of one command."""

    source: str  # The command, such as "simulate"
    files: Sequence[str | Path]  # Files or folders written
    facts: list[Fact] = field(default_factory=list)  # Numbers on them
    lines: list[str] = field(default_factory=list)  # Lines of the summary
    exit_status: int = 0  # Exit status of the command

    def add(self, case: str, quantity: str, unit: str, value: float) -> None:
        """Append one `Fact` of case, quantity, unit and value; numpy numbers become Python ones."""
        self.facts.append(Fact(case, quantity, unit, value if isinstance(value, int) else float(value)))

    def document(self) -> dict[str, Any]:
        """Convert to plain JSON types; the hashes are computed now."""
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "source": self.source,
            "files": [file_description(path) for path in self.files],
            "rows": [vars(fact).copy() for fact in self.facts],
        }

    def text(self) -> str:
        """The lines, and the paths of the files."""
        files = list(self.files)
        where = [f"written: {path}" for path in files]
        if len(files) > MAX_NAMED:
            where = [f"written: {files[-1]} and {len(files) - 1} more files"]
        return "\n".join([*self.lines, *where])


def file_description(path: str | Path) -> dict[str, Any]:
    """Describe a file or folder: path, kind, bytes, sha256.

    A folder's hash is that of its files' names and hashes, in the names' order: for every file a line "SHA-256  NAME", as sha256sum
    prints it.
    """
    path = Path(path)
    if not path.is_dir():
        return {"path": str(path), "kind": "file", "bytes": path.stat().st_size, "sha256": _digest(path)}
    inner = {each.relative_to(path).as_posix(): each for each in path.rglob("*") if each.is_file()}
    listing = "".join(f"{_digest(inner[name])}  {name}\n" for name in sorted(inner))
    return {
        "path": str(path),
        "kind": "folder",
        "bytes": sum(each.stat().st_size for each in inner.values()),
        "sha256": hashlib.sha256(listing.encode()).hexdigest(),
    }


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        digest = hashlib.sha256()
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
