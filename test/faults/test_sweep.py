# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The first faults of `make faults`."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SWEEP = Path(__file__).with_name("sweep.py")


@pytest.mark.skipif(sys.platform != "linux" or not shutil.which("cc"), reason="faults are made by a library that is preloaded")
def test_no_fault_of_the_machine_costs_more_than_the_run_itself():
    found = subprocess.run(
        [sys.executable, str(SWEEP), "2", "record", "import", "export C"], capture_output=True, text=True, timeout=250
    )
    assert found.returncode == 0, found.stdout + found.stderr
    tried = [int(line.split()[-2]) for line in found.stdout.splitlines() if line.endswith(" 0") and line.count(" ") > 4]
    assert sum(tried) > 30 and found.stdout.endswith("lost: 0\n")
