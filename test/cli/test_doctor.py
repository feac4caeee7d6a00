# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst doctor`, `hyst --version` and `hyst` alone."""

from __future__ import annotations

import json
import re
from importlib.metadata import version

import pytest

from hyst_control.cli import main, parser
from hyst_control.processes.installation import Verdict, discovery


def checks(capsys, *words):
    """Exit status and checks by name."""
    status = main(["doctor", "--json", "-", *words])
    document = json.loads(capsys.readouterr().out)
    assert document["works"] == (status == 0)
    return status, {check["name"]: check for check in document["checks"]}


def test_a_working_computer(capsys, tmp_path, monkeypatch):
    pytest.importorskip("rclpy")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    status, found = checks(capsys, "--folder", str(tmp_path))
    assert status == 0
    assert found["messages"]["verdict"] == "good" and "ms" in found["messages"]["found"]
    assert found["discovery"]["verdict"] == "note" and "LOCALHOST" in found["discovery"]["remedy"]
    assert all(check["remedy"] for check in found.values() if check["verdict"] == "fault")
    assert not list(tmp_path.iterdir()), "the disk's check leaves nothing behind"


def test_what_does_not_work_is_a_fault(capsys, tmp_path, monkeypatch):
    pytest.importorskip("rclpy")
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_of_nobody")
    status, found = checks(capsys, "--folder", str(tmp_path / "missing"))
    assert status == 1
    assert found["disk"]["verdict"] == "fault" and "missing" in found["disk"]["found"]
    assert found["messages"]["verdict"] == "fault"


def test_version(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0 and version("hyst_control") in capsys.readouterr().out


def test_the_first_steps_are_commands_with_their_options(capsys):
    assert main([]) == 0
    lines = re.findall(r"^  hyst (\S.*?)  ", capsys.readouterr().out, re.M)
    assert len(lines) == 5
    for line in lines:
        parser().parse_args(line.split())


def test_where_nothing_is_set_the_nodes_keep_to_this_computer(monkeypatch):
    """As `environment.prepare` sees to it; and another choice is told."""
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"):
        monkeypatch.delenv(name, raising=False)
    assert discovery().verdict is Verdict.GOOD and "LOCALHOST" in discovery().found
    monkeypatch.setenv("ROS_LOCALHOST_ONLY", "0")
    assert discovery().verdict is Verdict.NOTE
