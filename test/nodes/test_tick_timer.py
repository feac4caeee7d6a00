"""The wall clock's ticks, with the clock given by hand: missed and early calls, a clock set back, ticks that take too long."""

from __future__ import annotations

import time
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.nodes.signal_node.timer import LONGEST_GAP, Jitter, Timer

PERIOD, BLOCK = 0.01, 5
INTERVAL = PERIOD * BLOCK


class Owner:
    """Notes the ticks and the samples that were missed before them."""

    def __init__(self):
        self.counts, self.ticks, self.lines, self.resets = Counter(), [], [], 0
        self.inputs, self.settings, self.ever_active = [], SimpleNamespace(ahead=1.0), True
        self.diagnostics = SimpleNamespace(go_on=lambda: None)

    def tick(self, tick):
        self.ticks.append((tick, self.timer.missed))

    def reset(self):
        self.resets += 1

    def warn(self, key, text):
        self.lines.append(text)


@pytest.fixture
def owner():
    made = Owner()
    made.timer = Timer(made, PERIOD, BLOCK)
    return made


@settings(deadline=None)
@given(st.lists(st.integers(0, 12), min_size=1, max_size=40))
def test_every_sample_is_ticked_for_or_counted_as_missed(steps):
    """Calls in the middle of ticks that are 0 to 12 intervals apart."""
    owner = Owner()
    owner.timer = Timer(owner, PERIOD, BLOCK)
    numbers = 100 + np.cumsum([0, *steps])
    for number in numbers:
        owner.timer.call((number + 0.5) * INTERVAL)
    assert [tick for tick, _ in owner.ticks] == [BLOCK * number for number in dict.fromkeys(numbers.tolist())]
    for (before, _), (tick, missed) in zip(owner.ticks, owner.ticks[1:]):
        assert before + BLOCK + missed == tick
    assert owner.counts["missed ticks"] * BLOCK == sum(missed for _, missed in owner.ticks)
    assert owner.counts["early calls"] == steps.count(0) and owner.counts["ticks"] == len(owner.ticks)


def test_no_more_than_the_longest_gap_is_made_up_for(owner):
    owner.timer.call(0.5 * INTERVAL)
    owner.timer.call(0.5 * INTERVAL + 10 * LONGEST_GAP)
    assert owner.ticks[-1][1] == round(LONGEST_GAP / PERIOD)


def test_a_clock_that_is_set_back_begins_anew(owner):
    for now in (10.5 * INTERVAL, 3.5 * INTERVAL, 4.5 * INTERVAL):
        owner.timer.call(now)
    assert owner.resets == owner.counts["time ran backwards"] == 1 and any("0.35 s" in line for line in owner.lines)
    assert [tick for tick, _ in owner.ticks] == [10 * BLOCK, 3 * BLOCK, 4 * BLOCK]


def test_ticks_that_take_longer_than_their_time_are_counted_in_a_row(owner):
    now = time.monotonic()
    for late in (2.0, 1.0):
        owner.timer.call(now - late)
    assert owner.timer.overrun_streak == owner.counts["overruns"] == 2 and len(owner.lines) == 2
    owner.timer.call(time.monotonic() + 10.0)  # in time, however slow this test is
    assert owner.timer.overrun_streak == 0 and owner.counts["overruns"] == 2


def test_jitter_is_the_standard_deviation_since_it_was_asked_last():
    jitter, intervals = Jitter(), np.array([0.9, 1.1, 1.0, 1.4])
    for interval in intervals:
        jitter.add(interval)
    assert jitter.take() == pytest.approx(np.std(intervals))
    assert jitter.take() == 0.0
