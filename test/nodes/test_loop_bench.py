# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst bench`: the rows it promises, figures that are possible, and histograms that tell quantiles rightly."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.benchmarks import loops, suite
from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.nodes.signal_node.duration_histogram import Durations
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag

pytestmark = pytest.mark.long_file


@pytest.mark.parametrize(
    "case, subject, schedule",
    [("composed", "plain rclpy", "lockstep"), ("composed", "hyst", "timer"), ("processes", "hyst", "lockstep")],
)
def test_a_short_run_measures_rate_and_load(case, subject, schedule, tmp_path, monkeypatch):
    # s, from the plant's first tick on: no figure here depends on how far a run has settled.
    monkeypatch.setattr(loops, "SETTLING", 0.2)
    bag = tmp_path / "bag" if subject == "hyst" else None
    measured = loops.measure(case, subject, schedule, 0.5, bag)
    assert measured.rate > 20 and measured.cpu > 1 and min(measured.memory) > 10
    if schedule == "timer":
        assert measured.rate < 1100
        assert 100 < measured.microseconds("period p50 [us]") < 20_000
        assert measured.microseconds("loop latency p50 [us]") <= measured.microseconds("loop latency p99 [us]")
    if bag:
        missing, due = loops.missing_rows(bag)
        assert due > 100 and 0 <= sum(missing.values()) < due and (not any(missing.values()) or schedule == "timer")


def test_rows_are_missing_between_the_first_and_the_last(tmp_path):
    time = np.delete(np.arange(100) * 1e-3, [10, 50, 51])
    write_bag(tmp_path / "bag", Record({"command": Signal(time, np.zeros((97, 1)), ("x",), "V")}, "test"))
    assert loops.missing_rows(tmp_path / "bag") == ({"command": 3}, 100)


def test_quantiles_are_those_of_the_values_to_a_class():
    values = np.random.default_rng(0).lognormal(-7.0, 1.0, 20_000)
    durations = Durations()
    for value in values:
        durations.add(value)
    for share in (0.01, 0.5, 0.99, 0.999):
        assert durations.quantile(share) == pytest.approx(np.quantile(values, share, method="inverted_cdf"), rel=0.011)
    assert durations.count == 20_000
    assert np.isnan(Durations().quantile(0.5)) and Durations().entries("period") == {}
    extremes = Durations()
    for value in (0.0, -1.0, 1e9):
        extremes.add(value)
    assert extremes.count == 3


def test_times_that_make_no_sense_are_refused(capsys):
    with pytest.raises(InputError, match="seconds"):
        suite.run("loops", seconds=0.0)
    assert main(["bench", "--soak", "-1"]) == 2
    assert "soak" in capsys.readouterr().err
