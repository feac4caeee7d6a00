# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Without ROS, and on a system that is not Linux: everything but the nodes works, and a node says in one line what it needs."""

from __future__ import annotations

import subprocess
import sys

from hyst_control.processes.executables import ROS
from hyst_control.processes.node_list import NODES

HIDDEN = f"""
import sys
sys.modules.update(dict.fromkeys({ROS}))
"""
"""First lines of a program that finds no ROS."""
ELSEWHERE = """
import multiprocessing, os, signal, sys, time, zoneinfo, tempfile, subprocess, asyncio
import numba, scipy, matplotlib, plotly, platformdirs, tqdm, jinja2, mcap, lz4, zstandard, argcomplete, cffi, PIL, yaml
for name in ("fcntl", "resource", "termios", "pwd", "grp", "pty", "tty", "syslog", "posix"):
    sys.modules[name] = None
for name in ("getuid", "geteuid", "fchmod", "sysconf", "sched_getaffinity", "sched_setaffinity", "sched_setscheduler", "pread", "pwrite"):
    delattr(os, name)
for name in ("SIGALRM", "setitimer", "getitimer", "SIGHUP", "SIGUSR1", "ITIMER_REAL"):
    delattr(signal, name)
multiprocessing.get_all_start_methods = lambda: ["spawn"]
"""
"""Further lines of one that runs where what belongs to Unix alone is missing; other packages are imported before."""
IMPORT_ALL = """
import importlib, pkgutil, hyst_control, hyst_plant_sim
for package in (hyst_control, hyst_plant_sim):
    for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not found.name.startswith(("hyst_control.nodes", "hyst_control.hardware", "hyst_plant_sim.node")):
            importlib.import_module(found.name)
"""
USED = """
from hyst_control.cli import main
def hyst(line):
    assert main(line.split()) == 0, line
hyst("excite triangle frequency=5 amplitude=20 offset=20 duration=1 --rate 1000 --output drive.npy")
hyst("simulate pea_hampi.yaml --excitation triangle frequency=5 amplitude=20 offset=20 duration=1 --rate 1000 --output run")
hyst("identify run --model pi --output model.yaml --json fit.json")
hyst("validate model.yaml run")
hyst("plot run --xy --output loops.png")
hyst("tune model.yaml")
"""


def run(code: str, folder) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True)


def test_every_node_says_in_one_line_what_it_needs(tmp_path):
    names = [name for name, node in NODES.items() if node.installed]
    code = f"{HIDDEN}from hyst_control.processes.executables import run\nprint([run(name) for name in {names}])"
    ended = run(code, tmp_path)
    assert ended.stdout.strip() == str([2] * len(names))
    for name, line in zip(names, ended.stderr.splitlines(), strict=True):
        assert line.startswith(f"{name}: ") and "is not installed" in line and "ROS 2 Jazzy" in line


def test_a_module_that_is_no_part_of_ros_is_not_taken_for_one(tmp_path):
    code = "import sys; sys.modules['numpy'] = None\nfrom hyst_control.processes.executables import run\nrun('plant')"
    assert "Traceback" in run(code, tmp_path).stderr


def test_modules_and_commands_need_neither_ros_nor_unix(tmp_path):
    from hyst_control.base.config_files import config_path

    (tmp_path / "pea_hampi.yaml").write_bytes(config_path("models/pea_hampi.yaml").read_bytes())
    ended = run(HIDDEN + ELSEWHERE + IMPORT_ALL + USED, tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "loops.png").stat().st_size > 1000
