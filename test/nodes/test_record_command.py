# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst record` beside running nodes: what it stores is what they sent."""

from __future__ import annotations

import subprocess
import sys

from loop_case import assert_same_bits, offline, parameters, recorded
from pipeline_thread import ProcessesBesideThread

COMMAND = "import sys; from hyst_control.cli import main; raise SystemExit(main(sys.argv[1:]))"


def test_lockstep_run_is_recorded_whole(tmp_path, domain):
    settings = parameters(tmp_path, 500)
    del settings["recorder"]
    bag = tmp_path / "bag"
    with ProcessesBesideThread(tmp_path / "log", domain) as processes:
        processes.compose(settings)
        ended = subprocess.run(
            [
                sys.executable,
                "-c",
                COMMAND,
                "record",
                "--schedule",
                "lockstep",
                "--rate",
                "20000",
                "--ticks",
                "500",
                "--output",
                str(bag),
            ],
            timeout=90,
            capture_output=True,
            text=True,
        )
        assert ended.returncode == 0, ended.stderr
        processes.wait("pipeline", timeout=30)
    assert "/measurement: 500 messages" in ended.stdout
    assert_same_bits(recorded(bag), offline(500))


def test_bad_output_is_refused_in_one_line(tmp_path, domain):
    (tmp_path / "bag").mkdir()
    ended = subprocess.run(
        [sys.executable, "-c", COMMAND, "record", "--output", str(tmp_path / "bag")], timeout=60, capture_output=True, text=True
    )
    assert ended.returncode == 2 and "exists already" in ended.stderr and len(ended.stderr.strip().splitlines()) == 1


def test_a_name_that_ros_does_not_allow_is_refused_in_one_line(tmp_path, domain):
    for option, kind in (("--topics", "topic name"), ("--namespace", "namespace")):
        command = [sys.executable, "-c", COMMAND, "record", option, "a b", "--output", str(tmp_path / "bag")]
        ended = subprocess.run(command, timeout=60, capture_output=True, text=True)
        assert ended.returncode == 2 and f"Invalid {kind}: {kind} must not contain" in ended.stderr
        assert len(ended.stderr.strip().splitlines()) == 1 and not (tmp_path / "bag").exists()


def test_a_recording_of_nothing_is_refused_and_not_kept(tmp_path, domain):
    ended = subprocess.run(
        [sys.executable, "-c", COMMAND, "record", "--duration", "0.3", "--topics", "command", "--output", str(tmp_path / "bag")],
        timeout=60,
        capture_output=True,
        text=True,
    )
    assert ended.returncode == 2 and not ended.stdout and not (tmp_path / "bag").exists()
    assert ended.stderr.splitlines()[-1].startswith("hyst record: nothing was received on /command, and no bag is kept")
