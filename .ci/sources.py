# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A copy of the tree as a user gets it: without environments, builds and caches."""

from __future__ import annotations

import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LEFT_OUT = shutil.ignore_patterns(".*", "__pycache__", "*.nb[ic]", "*.egg-info", "build", "install", "log", "site", "demo_out")


def copy_sources(folder: Path) -> Path:
    """Copy the tree to `folder`, which must not exist; returns it."""
    return Path(shutil.copytree(ROOT, folder, ignore=LEFT_OUT))
