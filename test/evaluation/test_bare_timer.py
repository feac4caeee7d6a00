# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Ticks that a bare loop misses, with a clock whose halts are known."""

from __future__ import annotations

import pytest

from evaluation.benchmarks import bare_timer


def test_a_halt_costs_the_ticks_within_it(monkeypatch):
    clock, halts = [5.0], iter([0.0] * 40 + [3.2e-3] + [0.0] * 40 + [0.4e-3])

    def sleep(seconds):
        clock[0] += seconds + next(halts, 0.0)

    monkeypatch.setattr(bare_timer.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(bare_timer.time, "sleep", sleep)
    wakes = bare_timer.wait_for_ticks(1000.0, 0.2, 0)
    assert wakes.missed == 3 and wakes.ticks + wakes.missed == 200  # 0.4 ms late is within the tick
    assert wakes.latest == pytest.approx(3.2e-3, rel=1e-6) and wakes.refused == ""


def test_a_fresh_process_says_what_it_met():
    wakes = bare_timer.measure(100.0, 0.3, 0)
    assert wakes.ticks + wakes.missed >= 30 and wakes.ticks > 0
