# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Export a folder and run its harness, as the tests of several files do."""

from __future__ import annotations

import subprocess
from pathlib import Path

from hyst_control.base.config_files import config_path
from hyst_control.cli import main


def export(model: str, *options: str, output: Path) -> None:
    assert main(["export", str(config_path(f"models/{model}")), *options, "--output", str(output)]) == 0


def make(folder: Path, target: str, *words: str) -> str:
    done = subprocess.run(
        ["make", "-s", "-C", str(folder), target, *words], capture_output=True, text=True, check=False, timeout=250
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def fuzzed(folder: Path, steps: int = 100_000) -> None:
    """Compared after so many odd steps, with sanitizers."""
    compared(folder, f"STEPS={steps}", target="fuzz")


def compared(folder: Path, *words: str, target: str = "test") -> None:
    """By every compiler that is here, unless `words` for make say otherwise."""
    told = make(folder, target, *words)
    lines = [line for line in told.splitlines() if "rows" in line]
    assert lines and all(" 0 wrong" in line for line in lines), told
