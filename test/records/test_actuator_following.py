# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rows at which an actuator does not follow its command: left out of what is identified and diagnosed, kept in the bag."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.base.errors import InputError
from hyst_control.diagnose.report.block_replay import replay as replayed
from hyst_control.identify.workflow import gapless_records, identify_bags
from hyst_control.model_file import load_model
from hyst_control.records.actuator_following import INTERVAL, FollowingWatch, ticks_not_followed
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag

STEP, LAG, GAIN = 0.02, 0.02, 0.12
DECAY = np.exp(-STEP / LAG)


def command(count, seed=1):
    """Filtered noise about 40 V, rows (count,)."""
    rng = np.random.default_rng(seed)
    return 40.0 + 8.0 * np.convolve(rng.normal(size=count + 4), np.ones(5) / np.sqrt(5.0), "valid")


def approached(wanted, rate=10.0, rest=0.0):
    """Voltages of a stage that goes from `rest` to its command by at most `rate` V a tick, and the ticks until it is there."""
    applied = np.array(wanted)
    voltage, tick = rest, 0
    while abs(wanted[tick] - voltage) > rate:
        voltage += np.sign(wanted[tick] - voltage) * rate
        applied[tick] = voltage
        tick += 1
    return applied, np.arange(tick)


def answer(applied):
    """A first-order lag in closed form for a held voltage."""
    position = np.zeros(len(applied))
    for tick in range(1, len(applied)):
        position[tick] = DECAY * position[tick - 1] + GAIN * (1.0 - DECAY) * applied[tick - 1]
    return position


def signal(ticks, values, unit):
    return Signal(np.asarray(ticks) * STEP, np.asarray(values, float).reshape(len(values), -1), ("x",), unit)


def record(count=450, first=1000, **changes):
    """A stage that approaches its command first and says so, from tick `first` on."""
    wanted = command(count)
    applied, ticks = approached(wanted)
    everywhere = first + np.arange(count)
    signals = {
        "command": signal(everywhere, wanted, "V"),
        "measurement": signal(everywhere, answer(applied), "um"),
        "applied": signal(first + ticks, applied[ticks], "V"),
    }
    return Record({**signals, **changes}, "made"), len(ticks)


def test_a_stage_that_approaches_its_command_is_identified_as_well_as_one_that_follows(tmp_path):
    made, approach = record()
    write_bag(tmp_path / "bag", made)
    result = identify_bags([tmp_path / "bag"], "linear", tmp_path / "model.yaml")
    found = load_model(tmp_path / "model.yaml").chain.stages[0]
    assert len(found.den) == 2  # the lag has one state
    assert found.num[-1] / found.den[-1] == pytest.approx(GAIN, rel=1e-9)
    assert found.den[0] / found.den[-1] == pytest.approx(LAG, rel=1e-9)
    [note] = [note for note in result.fit.report["notes"] if "did not follow" in note]
    assert f"for {approach * STEP:.3g} s" in note and f"until t = {(1000 + approach) * STEP:g} s" in note
    assert len(read_bag(tmp_path / "bag").signals["measurement"].time) == 450  # nothing is lost


def test_without_a_word_of_the_stage_all_rows_are_used():
    made, _ = record()
    unsaid = replace(made, signals={topic: each for topic, each in made.signals.items() if topic != "applied"})
    [data] = gapless_records(unsaid)
    assert len(data.command) == 450


def test_rows_amid_a_record_are_a_gap_that_has_to_be_allowed():
    made, approach = record()
    ticks = 1000 + np.arange(200, 205)  # as after a fault
    at = np.append(made.signals["applied"].time / STEP, ticks)
    values = np.append(made.signals["applied"].values[:, 0], np.arange(5.0))
    stopped = replace(made, signals={**made.signals, "applied": signal(at, values, "V")})
    with pytest.raises(InputError, match="the actuator did not follow the command in 6 ticks in 1 gaps"):
        gapless_records(stopped)
    parts = replace(stopped, start="settled").aligned(allow_gaps=True)
    assert [len(part.time) for part in parts] == [199 - approach, 450 - 205]
    assert np.array_equal(parts[1].command, made.signals["command"].values[205:])
    assert all(part.start == "unknown" for part in parts)
    assert [data.start for data in gapless_records(made, start="settled")] == ["unknown"]
    transport = replayed(made)[-1]
    assert transport.text == "every tick is there"


def test_an_actuator_that_never_followed_is_refused():
    made, _ = record()
    time = made.signals["command"].time
    off = replace(made, signals={**made.signals, "applied": Signal(time, np.zeros((len(time), 1)), ("x",), "V")})
    with pytest.raises(InputError, match="never followed the command"):
        gapless_records(off)


@pytest.mark.parametrize("late", [0, 1])
@pytest.mark.parametrize("bits", [16, None])
def test_a_plant_that_always_says_what_it_applies_follows_where_that_is_the_command(late, bits):
    made, _ = record()
    values = made.signals["command"].values
    said = np.roll(values, late, axis=0)
    if bits:
        said = np.rint(said * 2**bits / 100.0) * 100.0 / 2**bits
    told = replace(made, signals={**made.signals, "applied": replace(made.signals["command"], values=said)})
    [part] = told.aligned()
    assert len(part.time) >= len(values) - late


@pytest.mark.parametrize("step", [1e-4, 1e-3, 0.02])
def test_stretches_reach_from_the_first_word_to_where_the_next_would_be_due(step):
    interval = max(1, round(INTERVAL / step))
    time = np.arange(100 * interval) * step
    values = np.linspace(0.0, 100.0, len(time))[:, None]
    said = np.concatenate([np.arange(10, 15) * interval, np.arange(50, 52) * interval])
    found = ticks_not_followed((time, values), (said * step, np.full((len(said), 1), -50.0)), step)
    assert found == [range(10 * interval - 1, 15 * interval), range(50 * interval - 1, 52 * interval)]
    assert ticks_not_followed((time, values), (said[:0] * step, np.zeros((0, 1))), step) == []


@settings(max_examples=40, deadline=None)
@given(cuts=st.lists(st.integers(1, 449), max_size=8), seed=st.integers(0, 100))
def test_a_running_loop_finds_the_same_ticks_part_by_part(cuts, seed):
    """A stage at 1 kHz that starts, and once more comes back from a fault. The tick before a stretch may be in the part before."""
    step, count, first = 1e-3, 450, 10**6
    wanted = 40.0 + 8.0 * np.sin(2 * np.pi * np.arange(count) / 150.0 + seed)
    start, came_back = approached(wanted, rate=0.8), approached(wanted[250:], rate=1.1, rest=5.0)
    applied = wanted.copy()
    applied[start[1]], applied[250 + came_back[1]] = start[0][start[1]], came_back[0][came_back[1]]
    said = np.concatenate([start[1][::5], 250 + came_back[1][::5]])
    ticks = first + np.arange(count)
    whole = np.zeros(count, bool)
    for stretch in ticks_not_followed((ticks * step, wanted[:, None]), ((first + said) * step, applied[said, None]), step):
        whole[max(stretch.start - first, 0) : stretch.stop - first] = True
    watch, found, edges = FollowingWatch(step, 1), [], sorted({0, *cuts, count})
    for begin, end in zip(edges, edges[1:]):
        part = said[(begin <= said) & (said < end)]
        found.append(watch.look((ticks[begin:end], wanted[begin:end, None]), (first + part, applied[part, None])))
    not_followed, voltages = (np.concatenate(each) for each in zip(*found))
    assert whole.any() and not whole.all()
    assert set(np.flatnonzero(not_followed != whole)) <= {edge - 1 for edge in edges}
    np.testing.assert_array_equal(voltages[~not_followed, 0], wanted[~not_followed])
    for begin, way in ((0, start[1][::5]), (250, came_back[1][::5])):  # straight ways; where the command is met is not said
        there = np.arange(begin + way[1], begin + way[-1] + 1)  # the first message alone does not tell how fast it goes
        there = there[not_followed[there]]
        np.testing.assert_allclose(voltages[there, 0], applied[there], atol=1e-9)
