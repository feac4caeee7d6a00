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
