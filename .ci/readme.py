# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Run what the README shows: every line of its `console` blocks that begins with `$ `, in order, in one empty folder.

Lines that start with `$ hyst` and `$ pipeline` are run; `make`, `colcon` and `ros2` have checks of their own. The folder is one
within the tree, as far as they can see: `../config` leads to the tree's.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from sources import ROOT


def commands(text: str) -> list[str]:
    """The command lines, without their comments."""
    blocks = re.findall(r"^```console\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.splitlines()]
    return [line[2:].partition(" #")[0].strip() for line in lines if line.startswith(("$ hyst ", "$ pipeline "))]


def main() -> None:
    lines = commands((ROOT / "README.md").read_text(encoding="utf-8"))
    if not lines:
        sys.exit("README.md: no `$ hyst` line in a console block")
    environment = {**os.environ, "PATH": f"{ROOT / '.venv/bin'}:{os.environ['PATH']}"}
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "config").symlink_to(ROOT / "config")
        folder = Path(name) / "tour"
        folder.mkdir()
        for line in lines:
            begin = time.monotonic()
            ended = subprocess.run(
                ["bash", "-c", line], cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True
            )
            if ended.returncode:
                sys.exit(f"README.md: {line}: exit status {ended.returncode}\n{ended.stdout}{ended.stderr}")
            print(f"{time.monotonic() - begin:6.1f} s  {line}")


if __name__ == "__main__":
    main()
