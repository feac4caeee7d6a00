# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The package of ros2_control: compiled against stubs of its headers and driven as a controller manager does."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml

from hyst_control.cli import main

STUBS = Path(__file__).with_name("ros2_control")
RATE = 2000
CONTROLLER = """
/**: {{ros__parameters: {{rate_hz: {rate}.0, axes: [{axes}], unit: um}}}}
pi_feedback: {{ros__parameters: {{kp: 0.5, ki: 900.0, upper: 50.0, safe_command: [3.0], frozen_time: 0.0}}}}
"""
FLAGS = ("-std=c++17", "-O1", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off", f"-DRATE={RATE}")


def exported(folder: Path, axes: str = "x", rate: int = RATE) -> Path:
    """Folder of the package, with the golden vectors of the C beside it."""
    (folder / "loop.yaml").write_text(CONTROLLER.format(axes=axes, rate=rate), encoding="utf-8")
    package, c = folder / "package", folder / "c"
    assert main(["export", str(folder / "loop.yaml"), "--ros2-control", "--output", str(package)]) == 0
    assert main(["export", str(folder / "loop.yaml"), "--output", str(c)]) == 0
    shutil.copy(c / "loop_golden.h", package)
    return package


@pytest.mark.skipif(not (shutil.which("gcc") and shutil.which("g++")), reason="no compiler of C++ is installed")
@pytest.mark.parametrize("axes", ["x", "x, y"])
def test_the_controller_gives_the_bits_of_python_and_allocates_nothing(tmp_path, axes):
    package, include = exported(tmp_path, axes), tmp_path / "include"
    for name in re.findall(r'#include "(\w+/.+)"', (package / "controller.cpp").read_text(encoding="utf-8")):
        (include / name).parent.mkdir(parents=True, exist_ok=True)
        (include / name).write_text('#include "stubs.hpp"\n', encoding="utf-8")
    subprocess.run(["gcc", "-std=c99", "-O1", "-ffp-contract=off", "-c", "loop.c"], cwd=package, check=True)
    folders = [f"-I{folder}" for folder in (include, STUBS, package)]
    subprocess.run(["g++", *FLAGS, *folders, "-o", "drive", str(STUBS / "drive.cpp"), "loop.o", "-lm"], cwd=package, check=True)
    ended = subprocess.run([package / "drive"], capture_output=True, text=True, check=True)
    told = dict(line.split(" ", 1) for line in ended.stdout.splitlines())
    assert told["golden"] == "399 wrong 0 allocations 0"
    assert float(told["held"]) == 12.0 and float(told["first"]) == pytest.approx(12.0, abs=1e-9)
    assert told["silent"] == "fault 1 command 3"
    assert told["chained"].startswith("fault 0 command 50 ")  # the integral of an error of 0.5 um has gone to the limit
    assert told["chained"].endswith("name loop/x/position")
    assert ended.stderr == f"update_rate: the controller was exported for {RATE} Hz: set that, or export it again"


def test_the_package_is_named_alike_throughout(tmp_path):
    package = exported(tmp_path, "x, y")
    settings = yaml.safe_load((package / "controllers.yaml").read_text(encoding="utf-8"))
    assert settings["controller_manager"]["ros__parameters"] == {
        "update_rate": RATE,
        "loop": {"type": "loop_controller/Controller"},
    }
    assert settings["loop"]["ros__parameters"]["command_interfaces"] == ["x/voltage", "y/voltage"]
    for name in ("package.xml", "plugin.xml", "CMakeLists.txt", "controller.cpp"):
        assert "loop_controller" in (package / name).read_text(encoding="utf-8"), name


@pytest.mark.parametrize(("source", "reason"), [("model", "is of a controller"), ("fraction", "whole Hz")])
def test_what_ros2_control_cannot_run_is_refused_in_one_line(tmp_path, capsys, source, reason):
    path = tmp_path / "loop.yaml"
    path.write_text(CONTROLLER.format(axes="x", rate=RATE).replace("2000.0", "2000.5"), encoding="utf-8")
    given = "config/models/pea_hampi.yaml" if source == "model" else str(path)
    output = tmp_path / "package"
    assert main(["export", given, "--ros2-control", "--output", str(output)]) == 2
    told = capsys.readouterr().err.strip()
    assert reason in told and "\n" not in told and not output.exists()
