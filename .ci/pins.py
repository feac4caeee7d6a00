# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Write the hashes of pinned lines that have none into the requirement files: `python .ci/pins.py python3.10 python3.11 ...`.

Each interpreter's pip names, without installing anything, the file that it would take for each version. The platform is this machine's,
x86-64 Linux; pip refuses any other file for these versions.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from sources import ROOT

FILES = (
    "requirements.txt",
    "requirements-jazzy.txt",
    "requirements-kilted.txt",
    "requirements-checks.txt",
    "requirements-labs.txt",
)


def pinned(text: str) -> list[str]:
    """Lines of a requirement file without hashes: comments, and a version with its marker each."""
    return [line.removesuffix("\\").rstrip() for line in text.splitlines() if not line.lstrip().startswith("--hash")]


def known_hashes(text: str) -> dict[tuple[str, str], set[str]]:
    """Hashes that a requirement file has already."""
    lines = text.replace("\\\n", " ").splitlines()
    found = {name_and_version(line): set(re.findall(r"--hash=sha256:(\w+)", line)) for line in lines if not line.startswith("#")}
    return {key: digests for key, digests in found.items() if digests}


def name_and_version(line: str) -> tuple[str, str]:
    """Name, as PyPI normalizes it, and version of a pinned line."""
    name, _, rest = line.partition("==")
    return re.sub(r"[-_.]+", "-", name.strip()).lower(), re.split(r"[;\s]", rest.strip())[0]


def hashes(python: str, lines: list[str]) -> dict[tuple[str, str], set[str]]:
    """SHA-256 of the files that an interpreter's pip would install, by name and version."""
    with tempfile.TemporaryDirectory() as folder:
        listed, report = Path(folder, "listed.txt"), Path(folder, "report.json")
        listed.write_text("\n".join(lines) + "\n", encoding="utf-8")
        command = [python, "-m", "pip", "install", "--quiet", "--quiet", "--dry-run", "--ignore-installed", "--no-deps"]
        subprocess.run([*command, "--report", report, "--requirement", listed], check=True)
        found: dict[tuple[str, str], set[str]] = {}
        for each in json.loads(report.read_text(encoding="utf-8"))["install"]:
            key = name_and_version(f"{each['metadata']['name']}=={each['metadata']['version']}")
            found.setdefault(key, set()).add(each["download_info"]["archive_info"]["hashes"]["sha256"])
    return found


def with_hashes(lines: list[str], found: dict[tuple[str, str], set[str]]) -> str:
    """The text of a requirement file with every hash; a version that no interpreter takes is an error."""
    text = []
    for line in lines:
        if line.startswith("#") or not line:
            text.append(line)
            continue
        if not (known := found.get(name_and_version(line))):
            sys.exit(f"{line}: no interpreter given takes it: give those of all versions, CPython 3.10 to 3.13")
        text.append(" \\\n".join([line, *(f"    --hash=sha256:{digest}" for digest in sorted(known))]))
    return "\n".join(text) + "\n"


def main() -> None:
    """Ask every interpreter for what has no hash, and write each file that all have answered."""
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    texts = {name: (ROOT / name).read_text(encoding="utf-8") for name in FILES}
    known = {name: known_hashes(text) for name, text in texts.items()}
    lines = {name: [line for line in pinned(text) if "==" in line] for name, text in texts.items()}
    new = {name: [line for line in lines[name] if name_and_version(line) not in known[name]] for name in FILES}
    with ThreadPoolExecutor(len(FILES) * len(sys.argv)) as pool:  # pip mostly waits for the index
        asked = {name: [pool.submit(hashes, python, wanted) for python in sys.argv[1:]] for name, wanted in new.items() if wanted}
        for name, answers in asked.items():
            for answer in answers:
                for key, digests in answer.result().items():
                    known[name].setdefault(key, set()).update(digests)
            (ROOT / name).write_text(with_hashes(pinned(texts[name]), known[name]), encoding="utf-8")
            print(f"{name}: {len(new[name])} lines got their hashes", flush=True)


if __name__ == "__main__":
    main()
