# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The worked example of docs/extending.md: its files are put into a copy of the package, tested there, and used from the command line."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "extending.md"


def blocks() -> dict[str, str]:
    """Code of the page by the file that heads it."""
    return dict(re.findall(r"^\*\*([\w./]+)\*\*\n\n```\w+\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.S | re.M))


def commands() -> list[list[str]]:
    """Commands of the page."""
    (text,) = re.findall(r"^```sh\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.S | re.M)
    return [shlex.split(line) for line in text.splitlines()]


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with a copy of both packages in which the page's files are new, compiled kernels included."""
    folder = tmp_path_factory.mktemp("worked_example")
    for package in ("hyst_control", "hyst_plant_sim"):
        shutil.copytree(ROOT / package, folder / package)
    for name, text in blocks().items():
        path = folder / name
        assert not path.exists(), f"{name}: is a file of the package already"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


def run(place: Path, *words: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(place), "XDG_CACHE_HOME": str(place / "cache")}
    done = subprocess.run(
        [sys.executable, *words], cwd=place, env=environment, capture_output=True, text=True, timeout=250, check=False
    )
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}"
    return done.stdout


def test_the_page_has_three_files_and_their_tests():
    files = [Path(name) for name in blocks() if name.endswith(".py")]
    assert [path.parts[1] for path in files if path.parts[0] == "hyst_control"] == ["chain", "identify", "effects"]
    assert {(path.parts[1], f"test_{path.name}") for path in files if path.parts[0] == "hyst_control"} == {
        (path.parts[1], path.name) for path in files if path.parts[0] == "test"
    }


def test_its_files_are_written_as_the_package_is(place):
    pytest.importorskip("ruff", reason="a tool of `make lint`")
    files = [name for name in blocks() if name.endswith(".py")]
    config = ["--config", str(ROOT / "pyproject.toml")]
    run(place, "-m", "ruff", "check", *config, *files)
    run(place, "-m", "ruff", "format", "--check", *config, *files)


def test_its_tests_pass(place):
    """Of the copy: the module says which one was imported."""
    assert run(place, "-c", "import hyst_control.chain.dahl as new; print(new.__file__)").strip().startswith(str(place))
    tests = [name for name in blocks() if name.startswith("test/")]
    run(place, "-m", "pytest", "-q", "--import-mode=importlib", "-p", "no:cacheprovider", *tests)


def test_its_commands_identify_and_diagnose_with_the_new_files(place):
    assert all(name == "hyst" for name, *_ in commands())
    program = (
        "import json, sys; from hyst_control.cli import main; sys.exit(max(main(words) for _, *words in json.loads(sys.argv[1])))"
    )
    run(place, "-c", program, json.dumps(commands()))  # in one process, which imports and loads its kernels once
    fit = json.loads((place / "fit.json").read_text())
    found = {row["name"]: (row["value"], row["standard_error"]) for row in fit["parameters"]}
    for name, true in {"slope": 0.1, "friction": 0.4, "transition": 5.0}.items():
        value, error = found[name]
        assert abs(value - true) < 5.0 * error and error < 0.01 * true
    gap = json.loads((place / "gap.json").read_text())
    assert (gap["verdict"], [effect["name"] for effect in gap["effects"]]) == ("effect", ["dahl_transition"])
    assert gap["effects"][0]["parameters"]["stretch"]["value"] == pytest.approx(0.3, rel=0.05)
    assert "stage: dahl_transition" in (place / "better.yaml").read_text()
