# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C at any time of a command, also while it is still being loaded: one line or none, never a traceback."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

from hyst_control.base.config_files import config_path

HYST = "import sys; from hyst_control.processes.executables import hyst; print('begun', flush=True); sys.exit(hyst())"
MODEL = str(config_path("models/pea_hampi.yaml"))
COMMANDS = {
    "help": ["--help"],
    "doctor": ["doctor"],
    "tune": ["tune", MODEL],
    "export": ["export", MODEL, "--output", "out"],
    "identify": ["identify", "no_bag", "--output", "model.yaml"],
}


def interrupted(words: list[str], delay: float, folder) -> tuple[int, str]:
    """Exit status and standard error of a command that is interrupted so long after it has begun to load."""
    process = subprocess.Popen(
        [sys.executable, "-c", HYST, *words], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None and process.stdout.readline() == "begun\n"
    try:
        process.wait(delay)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    return process.returncode, told


@pytest.mark.parametrize("command", COMMANDS)
def test_an_interrupt_in_the_first_second_is_no_traceback(command, tmp_path):
    begin = time.monotonic()
    for delay in (0.02, 0.2, 0.6):
        status, told = interrupted(COMMANDS[command], delay, tmp_path)
        assert "Traceback" not in told and told.count("\n") <= 1, told
        assert status in (0, 2, 130, -signal.SIGINT), told
        if time.monotonic() - begin > 60.0:
            break


def test_a_command_that_ignores_interrupts_goes_on_ignoring_them(tmp_path):
    """As `nohup` and a shell's background jobs start it."""
    ignoring = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); "
    process = subprocess.Popen(
        [sys.executable, "-c", ignoring + HYST, "excite", "--list"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None and process.stdout.readline() == "begun\n"
    process.send_signal(signal.SIGINT)
    out, told = process.communicate(timeout=100)
    assert process.returncode == 0 and "cosine_ramp" in out and not told


def test_an_interrupt_that_python_drops_comes_again():
    """One that arrives in a destructor ends the command all the same, without a traceback."""
    script = """
import signal, time
import hyst_control.cli as cli

class Late:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def slow(arguments):
    Late()
    time.sleep(30)

cli.run = slow
raise SystemExit(cli.main())
"""
    ended = subprocess.run([sys.executable, "-c", script, "doctor"], capture_output=True, text=True, timeout=25)
    assert (ended.returncode, ended.stderr) == (130, "hyst doctor: interrupted\n")
