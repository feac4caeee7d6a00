"""Licenses of what `make` installs, as each package states them: checks that Apache-2.0 may be built on them; `--write` makes the table.

A package is taken as stated in its metadata, a ROS package in its package.xml. What neither says is in `STATED`, with its source.
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import Distribution, distributions
from pathlib import Path

from sources import ROOT

TABLE = ROOT / "docs" / "data" / "licenses.csv"
GROUPS = {
    "ROS": ("requirements-jazzy.txt",),
    "Python": ("requirements.txt",),
    "checks only": ("requirements-checks.txt",),
}
FREE = r"Apache|MIT|BSD|0BSD|ISC|PSF|Python Software Foundation|HPND|Zlib|CC0|Unlicense|Public Domain|LLVM-exception|Unicode|any-OSI|DFSG"
COMPATIBLE = re.compile(rf"{FREE}|MPL|Mozilla|LGPL", re.IGNORECASE)
"""Licenses under which a package may be used by one under Apache-2.0: permissive ones, and those whose copyleft ends at their own files."""
STATED = {
    "docutils": "Public Domain, BSD-2-Clause",  # its COPYING.txt: only an editor's file, which is not installed, is under the GPL
    "pipython": "Physik Instrumente's own",  # optional, for hardware of its maker; not distributed with this package
    "ros-fastcdr": "Apache-2.0",
    "ros-fastrtps": "Apache-2.0",
    "setuptools": "MIT",
}
OPTIONAL = {"pipython"}
"""Of no free license: needed by no function but the driver of its maker's hardware."""


def normalized(name: str) -> str:
    """Name as PyPI writes it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def stated(distribution: Distribution) -> str:
    """License of an installed package in a few words; "" where nothing says it."""
    meta = distribution.metadata
    name = normalized(meta["Name"])
    if name in STATED:
        return STATED[name]
    manifest = Path(sys.prefix, "share", name.removeprefix("ros-").replace("-", "_"), "package.xml")
    if name.startswith("ros-") and manifest.is_file():
        return ", ".join(re.findall(r"<license[^>]*>([^<]+)", manifest.read_text(encoding="utf-8")))
    if expression := meta.get("License-Expression"):
        return expression
    classifiers = [each.split(" :: ")[-1] for each in meta.get_all("Classifier") or [] if each.startswith("License ::")]
    if known := [each for each in classifiers if each not in ("OSI Approved", "DFSG approved")]:
        return ", ".join(known)
    text = (meta.get("License") or "").strip()
    return text if "\n" not in text and len(text) < 60 else ""


def pinned(group: str) -> set[str]:
    """Names that the requirement files of a group pin."""
    texts = [(ROOT / name).read_text(encoding="utf-8") for name in GROUPS[group]]
    return {normalized(name) for text in texts for name in re.findall(r"^([\w.-]+)==", text, re.MULTILINE)}


def rows() -> list[tuple[str, str, str]]:
    """Group, name and license of what is pinned and installed here."""
    installed = {normalized(each.metadata["Name"]): each for each in distributions()}
    found = []
    for group in GROUPS:
        found += [(group, name, stated(installed[name])) for name in sorted(pinned(group) & set(installed))]
    return found


def main() -> None:
    """Check every license, and write the table or compare with it."""
    found = rows()
    refused = [
        f"{name}: {text or 'states no license'}" for _, name, text in found if name not in OPTIONAL and not COMPATIBLE.search(text)
    ]
    refused += [f"{name}: {text}" for _, name, text in found if re.search(r"(?<!L)GPL|Affero|Commercial", text)]
    if refused:
        sys.exit("\n".join(["licenses that do not fit Apache-2.0, or are not known (STATED in .ci/licenses.py):", *refused]))
    lines = ["group,name,license", *(f'{group},{name},"{text}"' for group, name, text in found)]
    if "--write" in sys.argv:
        TABLE.write_text("\n".join(lines) + "\n", encoding="utf-8")
    elif missing := set(lines) - set(TABLE.read_text(encoding="utf-8").splitlines()):
        sys.exit("\n".join([f"{TABLE.name} is old: .ci/licenses.py --write makes it anew", *sorted(missing)]))
    print(f"licenses: {len(found)} packages, all compatible with Apache-2.0; optional and not free: {', '.join(sorted(OPTIONAL))}")


if __name__ == "__main__":
    main()
