# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Runs side by side never share a ROS domain, also when one was killed and left its nodes behind."""

import subprocess
import sys

from hyst_control.processes.ros_domain import lock_of, own_domain


def test_two_runs_have_domains_of_their_own():
    with own_domain() as one, own_domain() as other:
        assert one != other


def test_a_domain_stays_taken_while_a_child_of_its_run_lives():
    with own_domain() as taken:
        child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, pass_fds=lock_of(taken))
    try:
        assert lock_of(taken) == ()
        with own_domain() as other:
            assert other != taken
    finally:
        child.communicate(b"\n")
