# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Limits beside the figures of `hyst bench`: what they compute, against closed forms and against the work that they stand for."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from evaluation.benchmarks import coverage, exported, limits
from hyst_control.base.config_files import config_path
from hyst_control.chain import Chain
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.export.compiled import COMPILERS
from hyst_control.model_file import Model, load_model
from hyst_control.reporting.tables import Limit, Table

compiled = pytest.mark.skipif(not any(map(shutil.which, COMPILERS)), reason="no C compiler")


def test_a_ratio_is_larger_the_further_a_figure_is_from_its_limit():
    table = Table("bench")
    table.add("loops", "composed", "hyst", "rounds_rate", "rounds/s", 10.0, limit=Limit(40.0, "bare C"))
    table.add("bags", "read", "hyst", "bag_read_time", "s", 6.0, limit=Limit(2.0, "the same bytes"))
    table.add("bags", "read", "hyst", "size", "byte", 1.0)
    assert [row.ratio for row in table.rows[:2]] == [4.0, 3.0]
    rows = table.document()["rows"]
    assert (rows[1]["limit"], rows[1]["limit_of"], rows[1]["ratio"]) == (2.0, "the same bytes", 3.0) and "limit" not in rows[2]
    assert "the same bytes" in table.text() and "x limit" in table.text()


@compiled
def test_a_bare_timer_wakes_once_a_tick_and_costs_little():
    awake, load, _ = limits.wakes(500.0, 0.2)
    assert len(awake) == 100 and np.all(np.diff(awake) > 0.0)
    assert np.all(awake >= 2e-3 * np.arange(1, 101)) and 0.0 < load < 1.0  # later on a busy machine, never earlier


@compiled
def test_a_ring_of_processes_ends():
    assert limits.ring(3).value > 0.0


@compiled
def test_the_bare_controller_computes_what_the_exported_one_does():
    compensator = build_compensator(load_model(config_path("models/pea_hampi.yaml")), "hampi", sample_time=5e-5)
    seconds, _, limit = exported.step_time(compensator, 20e3, "um")  # raises where the commands differ
    assert limit is not None and 0.0 < limit.value and 0.0 < seconds


@compiled
def test_the_bare_controller_leaves_the_arithmetic_of_the_process_as_it_is():
    limits.ring(2)
    smallest = np.array([np.finfo(float).tiny])
    assert smallest[0] / 4.0 > 0.0 and 4.0 * (smallest[0] / 4.0) == smallest[0]


def test_the_bound_of_linear_numbers_is_that_of_least_squares():
    random = np.random.default_rng(0)
    command = coverage.excitation(random)[:, None]
    weights = np.array([0.012, 0.010, 0.008, 0.006])
    truth = Model(
        "truth",
        ("x",),
        {"command": "V", "measurement": "um"},
        1.0 / coverage.RATE,
        Chain((PrandtlIshlinskii(coverage.THRESHOLDS, weights, w0=0.06),)),
    )
    names = [f"prandtl_ishlinskii.weights[{index}]" for index in range(4)]
    columns = []
    for threshold in coverage.THRESHOLDS:
        play, y = [], 0.0
        for u in command[:, 0]:
            y = max(u - threshold, min(u + threshold, y))
            play.append(y)
        columns.append(play[:-1])
    covariance = coverage.SIGMA**2 * np.linalg.inv(np.array(columns) @ np.transpose(columns))
    assert coverage.cramer_rao(truth, command, names) == pytest.approx(np.sqrt(np.diag(covariance)), rel=1e-5)
