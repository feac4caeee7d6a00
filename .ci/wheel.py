# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Build the wheel twice, compare its content with the tree, and use it in a fresh environment that has no ROS."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import venv
import zipfile
from configparser import ConfigParser
from pathlib import Path

from readme import untrue_errors
from sources import ROOT, copy_sources

IMPORT_ALL = """
import importlib, pkgutil, hyst_control, hyst_plant_sim
names = [found.name for package in (hyst_control, hyst_plant_sim)
         for found in pkgutil.walk_packages(package.__path__, package.__name__ + ".")]
names = [name for name in names if not name.startswith(("hyst_control.nodes", "hyst_control.hardware")) and name != "hyst_plant_sim.node"]
for name in names:
    importlib.import_module(name)
print(len(names), "modules imported without ROS")
"""


ELSEWHERE = ("win_amd64", "macosx_14_0_arm64")
"""Platforms for which pip must find a wheel of everything that is needed."""


def run(*words: str | Path, **options) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; its output is shown when it fails."""
    ended = subprocess.run([str(word) for word in words], capture_output=True, text=True, **options)
    if ended.returncode:
        sys.exit(f"{' '.join(map(str, words))}: exit status {ended.returncode}\n{ended.stdout}{ended.stderr}")
    return ended


def missing(wheel: Path) -> set[str]:
    """Files of the packages and of `config/` that the wheel does not hold."""
    with zipfile.ZipFile(wheel) as archive:
        held = {name.partition(".data/data/share/hyst_control/")[2] or name for name in archive.namelist()}
    due = {
        str(path.relative_to(ROOT))
        for folder in ("hyst_control", "hyst_plant_sim", "config")
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    return (due | {"package.xml"}) - held


def entry_points(wheel: Path) -> list[str]:
    """Names of the wheel's executables."""
    with zipfile.ZipFile(wheel) as archive:
        [name] = [name for name in archive.namelist() if name.endswith("/entry_points.txt")]
        parser = ConfigParser(delimiters="=")
        parser.read_string(archive.read(name).decode())
    return list(parser["console_scripts"])


def build(folder: Path) -> Path:
    """Build the wheel from a copy of the sources of its own, dated by the last commit."""
    dated = run("git", "log", "-1", "--format=%ct", cwd=ROOT).stdout.strip()
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", folder]
    run(*command, copy_sources(folder / "sources"), env={**os.environ, "SOURCE_DATE_EPOCH": dated})
    [wheel] = folder.glob("*.whl")
    return wheel


def constraints(folder: Path) -> Path:
    """The pinned versions without their hashes, which pip would ask of the wheel too."""
    pinned = (ROOT / "requirements.txt").read_text(encoding="utf-8")
    path = folder / "constraints.txt"
    path.write_text(re.sub(r" \\\n|^ *--hash=\S+", "", pinned, flags=re.MULTILINE), encoding="utf-8")
    return path


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wheel, again = (build(folder / name) for name in ("first", "second"))
        if wheel.read_bytes() != again.read_bytes():
            sys.exit(f"{wheel.name}: two builds of the same sources differ")
        if absent := missing(wheel):
            sys.exit(f"{wheel.name} lacks {', '.join(sorted(absent))}")
        venv.create(folder / "fresh", with_pip=True)
        bin_folder = folder / "fresh" / "bin"
        run(bin_folder / "pip", "install", "--quiet", "--constraint", constraints(folder), f"{wheel}[dashboard]")
        for executable in entry_points(wheel):
            if not (bin_folder / executable).exists():
                sys.exit(f"{wheel.name} did not install {executable}")
        # Elsewhere, isolated, and with nothing of another environment: what is imported is what was installed.
        clean = {"cwd": folder, "env": {"PATH": "/usr/bin:/bin", "HOME": name}}
        print(run(bin_folder / "python", "-I", "-c", IMPORT_ALL, **clean).stdout.strip())
        run(bin_folder / "hyst", "--help", **clean)
        run(
            bin_folder / "hyst",
            "simulate",
            folder / "fresh/share/hyst_control/config/models/pea_hampi.yaml",
            "--excitation",
            "sine",
            "frequency=10",
            "amplitude=20",
            "offset=25",
            "duration=0.2",
            "--output",
            "simulated",
            **clean,
        )
        for words in (("hyst", "record", "--output", "bag"), ("pipeline",)):
            refused = subprocess.run([bin_folder / words[0], *words[1:]], capture_output=True, text=True, **clean)
            if refused.returncode != 2 or len(refused.stderr.splitlines()) != 1:
                sys.exit(
                    f"{' '.join(words)} without ROS: one line and exit status 2 are due, not {refused.returncode}\n{refused.stderr}"
                )
        demo = run(bin_folder / "hyst", "demo", **clean).stdout
        if untrue := untrue_errors((ROOT / "README.md").read_text(encoding="utf-8"), demo):
            sys.exit("\n".join(["hyst demo without ROS does not print what README.md says:", *untrue]))
        for platform in ELSEWHERE:
            command = ["install", "--quiet", "--dry-run", "--ignore-installed", "--target", folder / platform]
            run(bin_folder / "pip", *command, "--only-binary", ":all:", "--platform", platform, "--python-version", "3.12", wheel)
            print(f"installs on {platform}")
        print(f"{wheel.name}: the same bytes twice, complete, installs, runs")


if __name__ == "__main__":
    main()
