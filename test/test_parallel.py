"""Pieces of a computation on all cores, as the command line runs them."""

import subprocess
import sys

PROGRAM = """
import os, signal
from hyst_control.parallel import forked
os.sched_getaffinity = lambda process: {0, 1}
signal.signal(signal.SIGTERM, signal.default_int_handler)
for _ in range(5):
    assert list(forked(lambda i: i * i, 7)) == [i * i for i in range(7)]
"""


def test_workers_end_without_a_word_where_the_command_line_catches_the_signal():
    """The command line turns the signal that ends a process into an interrupt: workers that end by it would print tracebacks."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0 and done.stderr == ""
