"""package.xml as ROS tools read it: format 3's rules, one version everywhere, and a rosdep key for everything that is imported."""

from __future__ import annotations

import ast
import re
import runpy
import sys
import unittest.mock
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from catkin_pkg.package import Dependency, Package, parse_package
from sources import ROOT

KEYS = {
    "PIL": "python3-pil",
    "argcomplete": "python3-argcomplete",
    "cffi": "python3-cffi",
    "jinja2": "python3-jinja2",
    "markupsafe": "python3-jinja2",  # which brings it
    "matplotlib": "python3-matplotlib",
    "numba": "python3-numba",
    "numpy": "python3-numpy",
    "platformdirs": "python3-platformdirs",
    "scipy": "python3-scipy",
    "tqdm": "python3-tqdm",
    "yaml": "python3-yaml",
}
"""rosdep's name of what is imported; a ROS package's is its own."""
WITHOUT_KEY = "requirements-ros.txt"


def main() -> None:
    warnings: list[str] = []
    package = parse_package(str(ROOT / "package.xml"), warnings=warnings)
    package.validate(warnings=warnings)
    by_pip = [
        f"{each.name} is installed by pip, on which no Debian package can depend"
        for each in depends(package)
        if "-pip" in each.name
    ]
    faults = [*warnings, *by_pip, *versions(package), *dependencies(package)]
    if faults:
        sys.exit("\n".join(f"package.xml: {fault}" for fault in faults))
    print(
        f"package.xml: format {package.package_format}, version {package.version}, {len(package.exec_depends)} dependencies in order"
    )


def depends(package: Package) -> list[Dependency]:
    """What the package depends on for anything: building, running, tests, documents."""
    return [*package.build_depends, *package.exec_depends, *package.test_depends, *package.doc_depends]


def versions(package: Package) -> Iterator[str]:
    """Versions and licenses of setup.py, changelog and citation that differ from those of package.xml."""
    given = setup_arguments()
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    changelog = re.search(r"^## (\d\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    for_bloom = re.search(r"^(\d\S+) \(", (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8"), re.MULTILINE)
    for where, version in (
        ("setup.py", given["version"]),
        ("CITATION.cff", str(citation["version"])),
        ("CHANGELOG.md", changelog.group(1) if changelog else "none"),
        ("CHANGELOG.rst", for_bloom.group(1) if for_bloom else "none"),
    ):
        if version != package.version:
            yield f"version {package.version}, {where} has {version}"
    if given["name"] != package.name:
        yield f"name {package.name}, setup.py has {given['name']}"
    if package.licenses != [given["license"]] or citation["license"] != given["license"]:
        yield f"license {', '.join(package.licenses)}, setup.py has {given['license']}, CITATION.cff {citation['license']}"


def setup_arguments() -> dict[str, Any]:
    """Arguments that setup.py gives to setuptools."""
    with unittest.mock.patch("setuptools.setup") as setup:
        runpy.run_path(str(ROOT / "setup.py"))
    return dict(setup.call_args.kwargs)


def dependencies(package: Package) -> Iterator[str]:
    """Dependencies that are imported but not named in package.xml, and named but not imported."""
    named = {depend.name for depend in package.exec_depends}
    optional = {re.split(r"\W", each)[0] for extra in setup_arguments()["extras_require"].values() for each in extra}
    by_pip = optional | set(re.findall(r"^([\w-]+)==", (ROOT / WITHOUT_KEY).read_text(encoding="utf-8"), re.MULTILINE))
    needed = {
        KEYS.get(module, module)
        for folder in ("hyst_control", "hyst_plant_sim", "launch")
        for file in (ROOT / folder).rglob("*.py")
        for module in imported(file)
        if module not in by_pip
    }
    yield from (f"{key} is imported and not an exec_depend, nor in {WITHOUT_KEY}" for key in sorted(needed - named))
    yield from (f"exec_depend {key} is imported nowhere" for key in sorted(named - needed))


def imported(file: Path) -> set[str]:
    """Top-level names of the packages that a file imports, without its own and Python's."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.split(".")[0])
    return found - {"hyst_control", "hyst_plant_sim", "evaluation"} - set(sys.stdlib_module_names)


if __name__ == "__main__":
    main()
