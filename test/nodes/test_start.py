# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Imports of a node before it can tick: every second of them is waited for at each start, and in a restart after a fault."""

from __future__ import annotations

import subprocess
import sys

SLOW = {"scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.stats", "matplotlib"}
"""Half a second to a second each."""

LOOP = (
    "hyst_control.nodes.reference_generator",
    "hyst_control.nodes.hampi_feedforward",
    "hyst_control.nodes.mhl_feedforward",
    "hyst_control.nodes.pi_feedback",
    "hyst_control.nodes.recorder",
    "hyst_plant_sim.node",
)


def slow_imports(modules: str) -> set[str]:
    """Slow modules that a fresh process has after it imported others, whose names stand behind one another with commas."""
    program = f"import sys, {modules}; print(*sorted(set(sys.modules) & {SLOW!r}))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=True)
    return set(done.stdout.split())


def test_nodes_of_the_loop_import_nothing_slow():
    assert not slow_imports(", ".join(LOOP)), "import it in the function that calls it"


def test_what_is_slow_is_recognized():
    assert "scipy.stats" in slow_imports("scipy.stats")
