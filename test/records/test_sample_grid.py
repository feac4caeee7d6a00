# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Sample times on the ticks of a clock: what was rounded, jittered, repeated or passed over comes out where it was sampled."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.base.errors import InputError
from hyst_control.records.record import Signal
from hyst_control.records.tables.importing import import_records, parse_columns
from hyst_control.records.tables.regular_signals import on_one_clock
from hyst_control.records.tables.sample_grid import find_grid, resampled

COLUMNS = parse_columns("time=1[s],command=2[V],measurement=3[um]")


@settings(max_examples=80, deadline=None)
@given(
    rate=st.floats(20.0, 800.0),
    count=st.integers(100, 3000),
    lost=st.sets(st.integers(1, 98), max_size=6),
    start=st.sampled_from([0.0, 1.7e9]),
)
def test_times_rounded_to_milliseconds_give_their_ticks_back(rate, count, lost, start):
    lost = lost if rate < 450.0 else set()  # times hardly finer than the steps show no lost row
    ticks = np.setdiff1d(np.arange(count), sorted(lost))
    time = np.round(start + ticks / rate, 3)
    grid = find_grid(time - time[0])
    assert grid is not None and grid.missing == len(lost)
    assert grid.step * rate == pytest.approx(1.0, abs=2e-3 * rate / count)
    np.testing.assert_array_equal(np.arange(count) if grid.ticks is None else grid.ticks, ticks if lost else np.arange(count))


@pytest.mark.parametrize("count", [1200, 5000])
def test_a_lost_row_is_found_wherever_it_is(count):
    for gap in range(1, count - 1, 61):
        grid = find_grid(np.delete(np.arange(count) / 300.0, gap).round(3))
        assert grid.missing == 1 and grid.ticks[gap - 1] == gap - 1 and grid.ticks[gap] == gap + 1


def test_several_rows_a_reading_of_the_clock():
    """2 kHz with times in ms: every time stands twice."""
    grid = find_grid((np.arange(3000) / 2000.0).round(3))
    assert grid.step == pytest.approx(5e-4, rel=1e-6) and grid.ticks is None


@pytest.mark.parametrize("least, most", [(4.0, 17.0), (8.0, 12.0)])
def test_irregular_times_have_no_ticks(least, most):
    assert find_grid(np.cumsum(np.random.default_rng(0).uniform(least, most, 1500)) * 1e-3) is None


def test_a_held_command_is_resampled_so_that_a_lag_answers_alike():
    """The lag's answer to the means of the command over the steps, against that to the command itself in closed form."""
    rng = np.random.default_rng(1)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.004, 0.017, 400))])
    command = np.repeat(rng.uniform(0.0, 1.0, 81), 5)[: len(time)]
    tau, exact = 0.05, np.zeros(len(time))
    for k, step in enumerate(np.diff(time)):
        exact[k + 1] = command[k] + (exact[k] - command[k]) * np.exp(-step / tau)
    step = 0.01
    due = np.arange(0.0, time[-1], step)
    means = resampled(time, command[:, None], due, step, held=True)[:, 0]
    answer = np.zeros(len(due))
    for k in range(len(due) - 1):
        answer[k + 1] = means[k] + (answer[k] - means[k]) * np.exp(-step / tau)
    assert np.abs(answer - np.interp(due, time, exact)).max() < 0.02 < np.ptp(exact)
    assert step * means.sum() == pytest.approx(np.sum(command[:-1] * np.diff(time)) + (due[-1] + step - time[-1]) * command[-1])


def written(path, time, *columns):
    np.savetxt(path, np.column_stack([time, *columns]), "%.9g", ",")
    return path


def test_irregular_times_are_refused_or_interpolated_with_the_error(tmp_path):
    time = np.cumsum(np.random.default_rng(2).uniform(4, 17, 900)) * 1e-3
    path = written(tmp_path / "a.csv", time, np.sin(time), np.cos(time))
    with pytest.raises(
        InputError,
        match=r"irregular: steps of 0.00\d+ to 0.01\d+ s, the longest before its row 398.*: --resample interpolates it at 9\d",
    ):
        import_records(path, COLUMNS, None)
    [record] = import_records(path, COLUMNS, None, hold="foh", resample=100.0)
    signal = record.signals["measurement"]
    assert record.common_step(["measurement"]) == pytest.approx(0.01)
    np.testing.assert_allclose(signal.values[:, 0], np.cos(time[0] + signal.time), atol=1e-4)
    assert "interpolated at 100 Hz" in record.notes[-1] and "% of the range of measurement" in record.notes[-1]
    with pytest.raises(InputError, match="resample: 10 Hz is below half"):
        import_records(path, COLUMNS, None, resample=10.0)


def test_repeated_rows_are_dropped_and_counted(tmp_path):
    rows = np.sort(np.concatenate([np.arange(500), [7, 30, 30, 499]]))
    path = written(tmp_path / "a.csv", rows / 500, rows * 0.1, rows * 0.2)
    [record] = import_records(path, COLUMNS, None)
    assert "4 rows are duplicates" in record.notes[0]
    np.testing.assert_allclose(record.signals["command"].values[:, 0], 0.1 * np.arange(500), atol=1e-9)
    other = rows * 0.2
    other[8] += 1.0
    with pytest.raises(InputError, match="does not increase in row 8: another row has the same time"):
        import_records(written(tmp_path / "b.csv", rows / 500, rows * 0.1, other), COLUMNS, None)


def test_a_time_that_starts_again_begins_a_record(tmp_path):
    time = np.concatenate([np.arange(300), np.arange(200)]) / 500
    values = np.arange(500.0)
    records = import_records(written(tmp_path / "a.csv", time, values, values), COLUMNS, None, rows=(10, None))
    assert "starts again in row 300: 2 runs" in records[0].notes[0]
    assert [len(record.signals["command"].time) for record in records] == [290, 200]
    assert records[1].signals["command"].values[0, 0] == 300 and records[1].signals["command"].time[0] == 0
    disorder = np.arange(100.0)
    disorder[[50, 52]] = disorder[[52, 50]]
    with pytest.raises(InputError, match="does not increase in row 51"):
        import_records(written(tmp_path / "b.csv", disorder, disorder, disorder), COLUMNS, None)


def test_seconds_and_microseconds_are_summed_without_losing_digits(tmp_path):
    ticks = 1_300_000_000_859_987 + 2000 * np.arange(600)
    path = tmp_path / "a.csv"
    np.savetxt(path, np.column_stack([ticks // 10**6, ticks % 10**6, np.arange(600), np.arange(600)]), "%d", ",")
    [record] = import_records(path, parse_columns("time=1[s]+2[us],command=3[V],measurement=4[um]"), None)
    np.testing.assert_allclose(record.signals["command"].time, np.arange(600) / 500, rtol=1e-12)
    assert record.notes == ()


def test_signals_of_two_rates_are_brought_to_one():
    fast, slow = np.arange(1000) * 1e-3, np.arange(100) * 1e-2
    signals = {
        "command": Signal(slow, np.sin(slow)[:, None], ("x",), "V"),
        "measurement": Signal(fast, np.cos(fast)[:, None], ("x",), "um"),
    }
    with pytest.raises(InputError, match="command has 100 samples/s, measurement 1000: record both at one rate, or let --resample"):
        on_one_clock("a", signals, "zoh")
    found, _ = on_one_clock("a", signals, "zoh", resample=0.0)
    np.testing.assert_array_equal(found["command"].time, found["measurement"].time)
    np.testing.assert_allclose(found["command"].values[:900, 0], np.repeat(np.sin(slow), 10)[:900], atol=1e-12)


def test_a_clock_that_jumps_ahead_is_named_with_its_row(tmp_path):
    time = 1e-3 * np.arange(400)
    time[150:] += 3600.0
    path = written(tmp_path / "jump.csv", time, np.sin(time), np.cos(time))
    for gaps in (False, True):
        with pytest.raises(
            InputError, match=r"steps of 0.001 to 3.6e\+03 s, the longest before its row 150, after 0.149 s: .*--rows"
        ):
            import_records(path, parse_columns("time=1[s],command=2[V],measurement=3[um]"), None, allow_gaps=gaps)
