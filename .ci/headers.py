# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Copyright and license in the first lines of every source file: checks them, or adds them with `--write`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from sources import ROOT

LINES = ("Copyright 2026 The hyst_control authors", "SPDX-License-Identifier: Apache-2.0")
COMMENTS = {".py": "# {}\n", ".sh": "# {}\n", "": "# {}\n", ".c": "/* {} */\n", ".h": "/* {} */\n", ".in": "/* {} */\n"}
"""How a line of a comment is written, by the ending of the file's name."""


def is_source(path: Path) -> bool:
    """Whether a file must have the header: a source file that is not empty, or a script without an ending."""
    if path.suffix not in COMMENTS or path.is_symlink() or not path.stat().st_size:
        return False
    return bool(path.suffix) or path.read_bytes().startswith(b"#!")


def header(path: Path) -> str:
    """The two lines, in the comments of the file's language."""
    return "".join(COMMENTS[path.suffix].format(line) for line in LINES)


def split(text: str) -> tuple[str, str]:
    """The line that names the interpreter, if there is one, and the rest."""
    first, end, rest = text.partition("\n")
    return (first + end, rest) if first.startswith("#!") else ("", text)


def lacking(folder: Path, names: list[str]) -> list[Path]:
    """Source files without the header behind the line of the interpreter."""
    paths = [folder / name for name in names if (folder / name).is_file()]
    return [path for path in paths if is_source(path) and not split(path.read_text(encoding="utf-8"))[1].startswith(header(path))]


def add(path: Path) -> None:
    """Put the header in; the file keeps its mode."""
    interpreter, rest = split(path.read_text(encoding="utf-8"))
    path.write_text(interpreter + header(path) + rest, encoding="utf-8")


def main() -> None:
    """Check the files that git tracks, or add what they lack."""
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
    found = lacking(ROOT, [name for name in names if name])
    if "--write" in sys.argv:
        for path in found:
            add(path)
        print(f"headers: added to {len(found)} files")
    elif found:
        names = [f"  {path.relative_to(ROOT)}" for path in found]
        sys.exit("\n".join(["headers: python .ci/headers.py --write adds them to", *names]))
    else:
        print("headers: every source file has its copyright and license")


if __name__ == "__main__":
    main()
