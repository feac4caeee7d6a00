# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Every shipped parameter file that drives a loop, run as it stands: the actuator is moved smoothly from rest to rest."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import yaml
from loop_case import MODEL, recorded

from hyst_control.base.config_files import config_folders, config_path
from hyst_control.records.excitation import excitation

pytestmark = pytest.mark.long_file

FILES = sorted(path.name for path in config_path("nodes/lockstep.yaml").parent.glob("*.yaml"))
LOOPS = [name for name in FILES if "reference_generator" in config_path(f"nodes/{name}").read_text()]
MARGIN = 30
"""Ticks that a feedforward may come late."""
SECONDS = 3.0
"""Of a file whose run does not end by itself."""


def parameters(document, node):
    return document.get(f"/**/{node}", {}).get("ros__parameters", {})


def in_time(rows, period):
    """Steps of the command for which a busy machine brought the feedforward of one tick later, and not of several at once."""
    ticks, fed = (np.rint(rows[name][:, 0] / period).astype(int) for name in ("command", "feedforward"))
    used = (
        rows["command"][:, 1:] - rows["feedback"][np.searchsorted(rows["feedback"][:, 0], rows["command"][:, 0] - period / 2), 1:]
    )
    sound = np.zeros(len(ticks) - 1, dtype=bool)
    for late in range(MARGIN):
        at = np.minimum(np.searchsorted(fed, ticks - late), len(fed) - 1)
        same = (fed[at] == ticks - late) & (np.abs(rows["feedforward"][at, 1:] - used).max(axis=1) < 1e-9)
        sound |= same[1:] & same[:-1]
    return sound & (np.diff(ticks) == 1)


@pytest.mark.parametrize("name", LOOPS)
def test_the_command_has_no_step_of_a_tenth_of_its_range_and_is_never_slew_limited(name, tmp_path, domain):
    document = yaml.safe_load(config_path(f"nodes/{name}").read_text())
    common = document["/**"]["ros__parameters"]
    given, plant = parameters(document, "pi_feedback"), parameters(document, "plant")
    folder = tmp_path / "run"
    folder.mkdir()
    (tmp_path / "config").symlink_to(config_folders()[0])
    spec = {"signal": "hampi_identification", "peak": 60.0, "upper": 150.0}  # the README's first command
    np.save(folder / "drive.npy", excitation.build(spec, 1.0 / common["rate_hz"]))
    for model in ("hampi.yaml", "pea.yaml"):
        shutil.copy(MODEL, folder / model)
    nodes = [] if plant else ["reference_generator", "hampi_feedforward", "pi_feedback", "simulated_stage", "recorder"]
    file = ["--ros-args", "--params-file", str(config_path(f"nodes/{name}"))]
    run = subprocess.Popen(
        [sys.executable, "-m", "hyst_control.nodes.pipeline", *nodes, *file],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(config_folders()[0].parent), "ROS_DOMAIN_ID": str(domain)},
        stderr=subprocess.PIPE,
        text=True,
    )
    if common["schedule"] == "timer":
        bag = folder / parameters(document, "recorder")["output"]
        end = time.monotonic() + 60.0
        while not bag.exists() and time.monotonic() < end:
            time.sleep(0.05)
        time.sleep(SECONDS)  # of the wall clock
        run.send_signal(signal.SIGINT)
    said = run.communicate(timeout=200)[1]
    assert run.returncode == 0, said
    assert not re.search("asks for|measurement (frozen|moves|out of range)|Traceback", said), said
    rows = recorded(folder / parameters(document, "recorder")["output"])
    period, span = 1.0 / common["rate_hz"], given["upper"] - given["lower"]
    sound = in_time(rows, period) if common["schedule"] == "timer" else np.ones(len(rows["command"]) - 1, dtype=bool)
    assert sound.sum() > 100
    for axis in rows["command"].T[1:]:
        assert abs(axis[0]) < 0.1 * span, "it begins at 0 V"
        step = np.abs(np.diff(axis))[sound]
        assert step.max() < 0.1 * span
        if given.get("slew_limit"):
            assert step.max() < 0.99 * given["slew_limit"] * period
        assert np.ptp(axis) > 0.1 * span, "and it moves"
    reference = rows["reference"][:, 1:]
    greatest = np.abs(np.diff(reference, axis=0)).max()
    assert np.abs(np.diff(reference[:3], axis=0)).max() < 0.1 * greatest
    if common["schedule"] == "lockstep":
        assert np.abs(np.diff(reference[-3:], axis=0)).max() < 0.1 * greatest


def test_the_files_that_drive_a_loop_are_known():
    assert set(FILES) - set(LOOPS) == {"diagnosis.yaml", "identification.yaml", "live_view.yaml"}
