# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Progress on a terminal: the time moves while a step lasts, and nothing of the line is left when the result is printed."""

from __future__ import annotations

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios

LONG = """
import sys, time
from hyst_control.base import progress
with progress.shown():
    progress.step("a long step")
    begin = time.monotonic()
    while time.monotonic() - begin < 1.5:
        time.sleep(0.1)
    progress.end()
    print("the result", file=sys.stderr)
"""


def on_a_terminal(code: str) -> str:
    """What a terminal got from a program."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))  # a terminal without a width shows nothing
    with subprocess.Popen([sys.executable, "-c", code], stderr=theirs) as process:
        os.close(theirs)
        received = b""
        while True:
            try:
                part = os.read(ours, 4096)
            except OSError:  # the program has ended
                break
            if not part:
                break
            received += part
        assert process.wait() == 0
    os.close(ours)
    return received.decode()


def test_the_time_moves_and_the_line_ends_cleanly():
    shown = on_a_terminal(LONG)
    assert "00:00 a long step" in shown and "00:01 a long step" in shown
    last = shown.rstrip().split("\r")[-1]  # what stands on the line in the end
    assert last == "the result"
    blanked = shown[: shown.index("the result")].rstrip("\r").split("\r")[-1]
    assert not blanked.strip()


def test_a_redirected_command_prints_its_parts_and_nothing_when_quiet():
    code = """
from hyst_control.base import progress
for wanted in (True, False):
    with progress.shown(wanted), progress.steps(2) as part:
        part("excite and record")
        progress.step("tick by tick")
        part("identify")
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stderr.splitlines() == ["1/2 excite and record", "2/2 identify"] and not ended.stdout
