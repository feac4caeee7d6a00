# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Topics with times of different clocks: put on one by their reception, and told; those of one clock are left as they are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.base.errors import InputError
from hyst_control.identify.workflow import gapless_records
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.bags.bag_writer import BagWriter
from hyst_control.records.record import Record, Signal
from hyst_control.records.stream.clock_alignment import aligned_by_reception
from hyst_control.records.stream.signal_message import Encoder

STEP, COUNT = 1e-3, 400
TOPICS = ("command", "measurement")
VALUES = np.random.default_rng(1).normal(size=(COUNT, 1))


def write(path, shift, rows=1):
    """A bag whose measurement has other times by `shift` samples, in messages of so many rows; received 1 to 3 ms after its sample."""
    rng = np.random.default_rng(0)
    with BagWriter(path) as writer:
        for topic, unit, off in (("/command", "V", 0), ("/measurement", "um", shift)):
            encoder = Encoder(f"t[s],x[{unit}]")
            for begin in range(0, COUNT, rows):
                part = np.arange(begin, begin + rows)
                block = np.column_stack([(part + 5000 + off) * STEP, VALUES[part]])
                writer.write(topic, encoder.encode(block), int(1e18 + (part[-1] * STEP + rng.uniform(1e-3, 3e-3)) * 1e9))


@pytest.mark.parametrize("shift, rows", [(-5000, 1), (10**9, 1), (-5000, 50)])
def test_other_clock_is_mended_by_reception_to_a_few_samples_and_told(tmp_path, shift, rows):
    write(tmp_path / "bag", shift, rows)
    record = read_bag(tmp_path / "bag")
    with pytest.raises(InputError, match="share no sample time"):
        record.aligned(TOPICS)
    mended = aligned_by_reception(record, TOPICS)
    assert "different clocks: aligned by the time of reception" in mended.notes[-1]
    [data] = gapless_records(mended)
    assert COUNT - len(data.command) <= 2
    gap = np.rint((mended.signals["measurement"].time - mended.signals["command"].time) / STEP)
    assert np.abs(gap).max() <= 2


def test_one_clock_is_left_as_it_is(tmp_path):
    write(tmp_path / "bag", 3)
    record = read_bag(tmp_path / "bag")
    assert aligned_by_reception(record, TOPICS) is record
    [data] = gapless_records(record)
    np.testing.assert_array_equal(data.command[:, 0], VALUES[3:, 0])
    np.testing.assert_array_equal(data.measurement[:, 0], VALUES[:-3, 0])


def test_without_a_time_of_reception_there_is_nothing_to_align_by():
    time = np.arange(10) * STEP
    signals = {"command": Signal(time, VALUES[:10], ("x",), "V"), "measurement": Signal(time + 9.0, VALUES[:10], ("x",), "um")}
    record = Record(signals, "made")
    assert aligned_by_reception(record, TOPICS) is record


@settings(max_examples=20, deadline=None)
@given(lost=st.sets(st.integers(1, 998), max_size=60))
def test_short_stretches_between_gaps_are_left_out_and_told(lost):
    kept = np.array(sorted(set(range(1000)) - lost))
    signals = {
        topic: Signal(kept * STEP, kept[:, None] * 1.0, ("x",), unit) for topic, unit in (("command", "V"), ("measurement", "um"))
    }
    notes: list[str] = []
    found = gapless_records(Record(signals, "made"), allow_gaps=True, notes=notes)
    lengths = [len(each) for each in np.split(kept, np.flatnonzero(np.diff(kept) > 1) + 1)]
    due = min(max(0.05 * max(lengths), 32), max(lengths))
    assert [len(each.command) for each in found] == [length for length in lengths if length >= due]
    assert bool(notes) == (len(found) < len(lengths))
    assert all(np.array_equal(np.diff(each.command[:, 0]), np.ones(len(each.command) - 1)) for each in found)
